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


class Types:
    """Messages of one ROS version, and bags of them."""

    def __init__(self, store: Stores = Stores.ROS2_HUMBLE) -> None:
        self.store = get_typestore(store)
        self.is_ros1 = store == Stores.ROS1_NOETIC
        if self.is_ros1:
            definition = "geometry_msgs/TransformStamped[] transforms\n"
            self.store.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))

    def make(self, name: str, *values: Any, **named: Any) -> Any:
        return self.store.types[name](*values, **named)

    def header(self, time: Seconds, frame: str) -> Any:
        ns = round(time * SECOND)
        stamp = self.make("builtin_interfaces/msg/Time", ns // SECOND, ns % SECOND)
        counter = {"seq": 0} if self.is_ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **counter)

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
        header = self.header(time, frame)
        kind = "sensor_msgs/msg/LaserScan"
        return "/scan", kind, time, self.make(kind, header=header, **values)

    def quaternion(self, yaw: float, roll: float = 0.0) -> Any:
        c, s, a, b = np.cos(yaw / 2), np.sin(yaw / 2), np.cos(roll / 2), np.sin(roll / 2)
        return self.make("geometry_msgs/msg/Quaternion", c * b, s * b, s * a, c * a)

    def odometry(self, time: Seconds, x: float, yaw: float = 0.0, **changes: Any) -> Message:
        name = "geometry_msgs/msg/"
        point = self.make(name + "Point", x, changes.pop("y", 0.0), 0.3)
        turn = changes.pop("quaternion", None) or self.quaternion(yaw)
        pose = self.make(name + "Pose", point, turn)
        zero = self.make(name + "Vector3", 0.0, 0.0, 0.0)
        spread = [np.zeros(36), np.zeros(36)]
        for values, key in zip(spread, ("pose_covariance", "twist_variances"), strict=True):
            reported = np.asarray(changes.pop(key, np.zeros(3)), dtype=float)
            six = np.zeros((6, 6))
            six[np.ix_((0, 1, 5), (0, 1, 5))] = (
                reported if reported.ndim == 2 else np.diag(reported)
            )
            values[:] = six.ravel()
        kind = "nav_msgs/msg/Odometry"
        message = self.make(
            kind,
            self.header(time, "odom"),
            "base",
            self.make(name + "PoseWithCovariance", pose, spread[0]),
            self.make(name + "TwistWithCovariance", self.make(name + "Twist", zero, zero),
                      spread[1]),
        )  # fmt: skip
        return "/odom", kind, time, message

    def static(self, *transforms: tuple[str, str, float, float, float, float]) -> Message:
        """Parent, child, forward, left, yaw and roll of each."""
        name = "geometry_msgs/msg/"
        stamped = [
            self.make(
                name + "TransformStamped",
                self.header(0.0, parent),
                child,
                self.make(
                    name + "Transform",
                    self.make(name + "Vector3", x, y, 0.5),
                    self.quaternion(yaw, roll),
                ),
            )
            for parent, child, x, y, yaw, roll in transforms
        ]
        kind = "tf2_msgs/msg/TFMessage"
        return "/tf_static", kind, 0.0, self.make(kind, stamped)

    def fix(
        self, time: float, latitude: float, longitude: float, status: int = 0, **changes: Any
    ) -> Message:
        kind = "sensor_msgs/msg/NavSatFix"
        message = self.make(
            kind,
            self.header(time, "gps"),
            self.make("sensor_msgs/msg/NavSatStatus", status, 1),
            latitude,
            longitude,
            changes.get("altitude", 50.0),
            np.diag(changes.get("variances", (0.04, 0.04, 0.1))).ravel(),
            changes.get("kind", 2),
        )
        return "/fix", kind, time, message

    def pose(self, x: float, y: float, z: float = 0.0) -> Any:
        name = "geometry_msgs/msg/"
        return self.make(name + "Pose", self.make(name + "Point", x, y, z), self.quaternion(0.0))

    def markers(self, time: float, *points: tuple[int, float, float], **changes: Any) -> Message:
        """Number, x and y of each sphere."""
        kind = "visualization_msgs/msg/Marker"
        empty = {field: self._empty(of) for field, of in self.store.fielddefs[kind][1]}
        found = [
            self.make(
                kind,
                **{
                    **empty,
                    "header": self.header(time, changes.get("frame", "base")),
                    "ns": changes.get("ns", ""),
                    "id": number,
                    "type": changes.get("type", 2),
                    "action": changes.get("action", 0),
                    "pose": self.pose(x, y),
                },
            )
            for number, x, y in points
        ]
        return "/markers", kind + "Array", time, self.make(kind + "Array", found)

    def _empty(self, of: Any) -> Any:
        """A value of a field that a test does not look at."""
        kind, (inner, *_) = int(of[0]), of[1] if isinstance(of[1], tuple) else (of[1],)
        if kind == 1:
            return "" if inner == "string" else 0
        if kind == 2:
            name = str(of[1])
            fields = self.store.fielddefs[name][1]
            return self.make(name, **{field: self._empty(one) for field, one in fields})
        return np.zeros(0, np.uint8) if of[1][0][1] == ("uint8", 0) else []

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
        name = "vision_msgs/msg/"
        header = self.header(time, more.get("frame", "base"))
        zero = self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        found = []
        spreads = np.broadcast_to(more.get("covariance", np.zeros((6, 6))), (len(points), 6, 6))
        for (kind, own, x, y), spread in zip(points, spreads.reshape(-1, 36), strict=True):
            place = self.make("geometry_msgs/msg/PoseWithCovariance", self.pose(x, y), spread)
            if self.is_ros1:
                result = self.make(name + "ObjectHypothesisWithPose", int(kind), 0.5, place)
            else:
                of = self.make(name + "ObjectHypothesis", kind, 0.5)
                result = self.make(name + "ObjectHypothesisWithPose", of, place)
            box = self.make(name + "BoundingBox3D", self.pose(x, y), zero)
            named = {} if self.is_ros1 else {"id": own}
            found.append(
                self.make(name + "Detection3D", header=header, results=[result], bbox=box, **named)
            )
        kind = name + "Detection3DArray"
        return "/detections", kind, time, self.make(kind, header, found)

    def cloud(self, time: float, records: np.ndarray, **changes: Any) -> Message:
        """A structured array as the message's points, one row."""
        datatypes = {"f4": 7, "f8": 8, "u4": 6, "u2": 4, "i4": 5}
        assert records.dtype.fields is not None
        fields = [
            self.make("sensor_msgs/msg/PointField", name, offset, datatypes[dtype.str[1:]], 1)
            for name, (dtype, offset, *_) in records.dtype.fields.items()
        ]
        step = records.dtype.itemsize
        values: dict[str, Any] = {
            "height": 1,
            "width": len(records),
            "fields": fields,
            "is_bigendian": False,
            "point_step": step,
            "row_step": step * len(records),
            "data": np.frombuffer(records.tobytes(), np.uint8),
            "is_dense": True,
            **changes,
        }
        kind = "sensor_msgs/msg/PointCloud2"
        header = self.header(time, "lidar")
        return "/points", kind, time, self.make(kind, header=header, **values)

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
