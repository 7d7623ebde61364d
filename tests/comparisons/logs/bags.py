"""Small ROS bags for tests, written with the `rosbags` package."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

Seconds = float | Fraction
"""A fraction is exact to the nanosecond, since 1970, too."""
Message = tuple[str, str, Seconds, Any]
"""Topic, type, time of recording [s], message."""

SECOND = 10**9
EPOCH = 1_700_000_000.0


VISION2 = [
    ("string class_id\nfloat64 score\n", "ObjectHypothesis"),
    (
        "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n",
        "ObjectHypothesisWithPose",
    ),
    ("geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n", "BoundingBox3D"),
    (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\n"
        "string id\n",
        "Detection3D",
    ),
    ("std_msgs/Header header\nDetection3D[] detections\n", "Detection3DArray"),
]
VISION1 = [
    (
        "int64 id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose\n",
        "ObjectHypothesisWithPose",
    ),
    VISION2[2],
    (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\n",
        "Detection3D",
    ),
    VISION2[4],
]
"""Definitions of vision_msgs, which the package does not have."""
_MESSAGE = 2
"""Of the package's kinds of fields: 1 is a number or a text, 3 and 4 are several."""


def header(time: Seconds, frame: str) -> dict[str, Any]:
    ns = round(time * SECOND)
    return {"stamp": {"sec": ns // SECOND, "nanosec": ns % SECOND}, "frame_id": frame}


def turned(yaw: float, roll: float = 0.0) -> dict[str, float]:
    c, s, a, b = np.cos(yaw / 2), np.sin(yaw / 2), np.cos(roll / 2), np.sin(roll / 2)
    return {"x": c * b, "y": s * b, "z": s * a, "w": c * a}


def at(x: float, y: float) -> dict[str, Any]:
    return {"position": {"x": x, "y": y}, "orientation": turned(0.0)}


def planar(spread: Any) -> np.ndarray:
    """(36,) of variances of x, y and heading, or of their covariance."""
    six, rows = np.zeros((6, 6)), (0, 1, 5)
    six[np.ix_(rows, rows)] = np.diag(spread) if np.ndim(spread) == 1 else spread
    return six.ravel()


class Types:
    """Messages of one ROS version, and bags of them."""

    def __init__(self, store: Stores = Stores.ROS2_HUMBLE) -> None:
        self.store = get_typestore(store)
        self.is_ros1 = store == Stores.ROS1_NOETIC
        if self.is_ros1:
            definition = "geometry_msgs/TransformStamped[] transforms\n"
            self.store.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))

    def make(self, kind: str, **given: Any) -> Any:
        """A message; mappings stand for messages within it, and what is not given is empty."""
        fields = dict(self.store.fielddefs[kind][1])
        assert given.keys() <= fields.keys(), kind
        values = {name: self._value(of, given.get(name)) for name, of in fields.items()}
        return self.store.types[kind](**values)

    def _value(self, of: Any, given: Any) -> Any:
        """What a field of a type holds: a message, a list of messages, numbers or a text."""
        node, what = int(of[0]), of[1]
        if node == _MESSAGE and (given is None or isinstance(given, dict)):
            return self.make(what, **(given or {}))
        if node > _MESSAGE and int(what[0][0]) == _MESSAGE:
            return [self._value(what[0], one) for one in given or ()]
        if given is not None:
            return given
        if node > _MESSAGE:
            return np.zeros(what[1], what[0][1][0])
        return "" if what[0] == "string" else 0

    def laser(self, time: float, frame: str = "laser", **changes: Any) -> Message:
        values: dict[str, Any] = {
            "angle_min": -0.5,
            "angle_max": 0.5,
            "angle_increment": 0.25,
            "time_increment": 1e-3,
            "scan_time": 0.1,
            "range_min": 0.1,
            "range_max": 10.0,
            "ranges": np.array((1.0, 0.05, np.inf, np.nan, 10.5), np.float32),
            "intensities": np.array((5, 4, 3, np.nan, 1), np.float32),
            **changes,
        }
        kind = "sensor_msgs/msg/LaserScan"
        return "/scan", kind, time, self.make(kind, header=header(time, frame), **values)

    def odometry(self, time: Seconds, x: float, yaw: float = 0.0, **changes: Any) -> Message:
        """changes: y, quaternion, pose_covariance, twist_variances."""
        kind, still = "nav_msgs/msg/Odometry", np.zeros(3)
        pose = {
            "position": {"x": x, "y": changes.get("y", 0.0), "z": 0.3},
            "orientation": changes.get("quaternion", turned(yaw)),
        }
        message = self.make(
            kind,
            header=header(time, "odom"),
            child_frame_id="base",
            pose={"pose": pose, "covariance": planar(changes.get("pose_covariance", still))},
            twist={"covariance": planar(changes.get("twist_variances", still))},
        )
        return "/odom", kind, time, message

    def static(self, *transforms: tuple[str, str, float, float, float, float]) -> Message:
        """Parent, child, forward, left, yaw and roll of each."""
        kind = "tf2_msgs/msg/TFMessage"
        stamped = [
            {
                "header": header(0.0, parent),
                "child_frame_id": child,
                "transform": {
                    "translation": {"x": x, "y": y, "z": 0.5},
                    "rotation": turned(yaw, roll),
                },
            }
            for parent, child, x, y, yaw, roll in transforms
        ]
        return "/tf_static", kind, 0.0, self.make(kind, transforms=stamped)

    def fix(
        self, time: float, latitude: float, longitude: float, status: int = 0, **changes: Any
    ) -> Message:
        kind = "sensor_msgs/msg/NavSatFix"
        message = self.make(
            kind,
            header=header(time, "gps"),
            status={"status": status, "service": 1},
            latitude=latitude,
            longitude=longitude,
            altitude=changes.get("altitude", 50.0),
            position_covariance=np.diag(changes.get("variances", (0.04, 0.04, 0.1))).ravel(),
            position_covariance_type=changes.get("kind", 2),
        )
        return "/fix", kind, time, message

    def markers(self, time: float, *points: tuple[int, float, float], **changes: Any) -> Message:
        """Number, x and y of each sphere."""
        kind = "visualization_msgs/msg/MarkerArray"
        head = header(time, changes.pop("frame", "base"))
        more = {"type": 2, **changes}
        found = [{"header": head, "id": i, "pose": at(x, y), **more} for i, x, y in points]
        return "/markers", kind, time, self.make(kind, markers=found)

    def with_detections(self) -> Types:
        """The same with the types of vision_msgs, of ROS 2's or ROS 1's release."""
        name = "vision_msgs/msg/"
        for text, kind in VISION1 if self.is_ros1 else VISION2:
            self.store.register(get_types_from_msg(text, name + kind))
        return self

    def detections(
        self, time: Seconds, *points: tuple[str, str, float, float], **more: Any
    ) -> Message:
        """Class, id, x and y of each; more: frame, covariance (6, 6), one or of each."""
        kind, head = "vision_msgs/msg/Detection3DArray", header(time, more.get("frame", "base"))
        found = []
        spreads = np.broadcast_to(more.get("covariance", np.zeros((6, 6))), (len(points), 6, 6))
        for (label, own, x, y), spread in zip(points, spreads.reshape(-1, 36), strict=True):
            result: dict[str, Any] = {"pose": {"pose": at(x, y), "covariance": spread}}
            if self.is_ros1:
                result |= {"id": int(label), "score": 0.5}
            else:
                result["hypothesis"] = {"class_id": label, "score": 0.5}
            named = {} if self.is_ros1 else {"id": own}
            box = {"center": at(x, y)}
            found.append({"header": head, "results": [result], "bbox": box, **named})
        return "/detections", kind, time, self.make(kind, header=head, detections=found)

    def cloud(self, time: float, records: np.ndarray, **changes: Any) -> Message:
        """A structured array as the message's points, one row."""
        datatypes = {"f4": 7, "f8": 8, "u4": 6, "u2": 4, "i4": 5}
        assert records.dtype.fields is not None
        fields = [
            {"name": name, "offset": offset, "datatype": datatypes[dtype.str[1:]], "count": 1}
            for name, (dtype, offset, *_) in records.dtype.fields.items()
        ]
        step = records.dtype.itemsize
        values: dict[str, Any] = {
            "height": 1,
            "width": len(records),
            "fields": fields,
            "point_step": step,
            "row_step": step * len(records),
            "data": np.frombuffer(records.tobytes(), np.uint8),
            "is_dense": True,
            **changes,
        }
        kind = "sensor_msgs/msg/PointCloud2"
        return "/points", kind, time, self.make(kind, header=header(time, "lidar"), **values)

    def write(self, path: Path, messages: list[Message], *, mcap: bool = True) -> Path:
        if self.is_ros1:
            with Writer1(path) as bag:
                self._fill(bag, messages, self.store.serialize_ros1)
            return path
        plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
        with Writer(path, version=9, storage_plugin=plugin) as bag:
            self._fill(bag, messages, self.store.serialize_cdr)
        return path

    def _fill(self, bag: Any, messages: list[Message], serialise: Callable[..., Any]) -> None:
        connections: dict[str, Any] = {}
        for topic, kind, time, message in messages:
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=self.store)
            raw = bytes(serialise(message, kind))
            bag.write(connections[topic], round(time * SECOND), raw)


T = Types()
XYZ = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]


def drive(types: Types, epoch: float = EPOCH) -> list[Message]:
    """Four scans, odometry at 2 Hz over the first three, the laser backwards at the rear."""
    return [
        types.static(("/base", "mast", 1.0, 0.0, np.pi / 2, 0.0),
                     ("mast", "laser", 0.0, 2.0, np.pi / 2, 0.0)),
        *(types.odometry(epoch + t, 2 * t, t) for t in (0.0, 0.5, 1.0, 1.0)),
        *(types.laser(epoch + t) for t in (0.1, 0.35, 0.9, 1.2)),
    ]  # fmt: skip
