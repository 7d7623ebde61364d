"""Small ROS bags for tests, written with the `rosbags` package."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

Message = tuple[str, str, float, Any]
"""Topic, type, time of recording [s], message."""

SECOND = 10**9
EPOCH = 1_700_000_000.0


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

    def header(self, time: float, frame: str) -> Any:
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

    def odometry(self, time: float, x: float, yaw: float = 0.0, **changes: Any) -> Message:
        name = "geometry_msgs/msg/"
        point = self.make(name + "Point", x, changes.pop("y", 0.0), 0.3)
        turn = changes.pop("quaternion", None) or self.quaternion(yaw)
        pose = self.make(name + "Pose", point, turn)
        zero = self.make(name + "Vector3", 0.0, 0.0, 0.0)
        kind = "nav_msgs/msg/Odometry"
        message = self.make(
            kind,
            self.header(time, "odom"),
            "base",
            self.make(name + "PoseWithCovariance", pose, np.zeros(36)),
            self.make(name + "TwistWithCovariance", self.make(name + "Twist", zero, zero),
                      np.zeros(36)),
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
