"""CSV exports of ROS messages: one table of their fields, whatever the tool spells them like.

`rostopic echo -p` writes `field.pose.pose.position.x`, PlotJuggler `/odom/pose/pose/position/x`,
MATLAB and bagpy `pose.pose.position.x`, others `pose_pose_position_x`; `ros2 topic echo --csv`
writes no header, but always the same number of fields.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError, shorten
from comparisons.logs.schema import COLUMNS
from comparisons.logs.table import is_number

_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_BETWEEN = re.compile(r"[^a-z0-9]+")
_COVARIANCE = re.compile(r"(?:^|_)(pose|twist|position)_covariance_?(\d{1,2})$")
_UNIT_TOLERANCE = 0.01

ENDINGS = {
    "header_stamp": "stamp",
    **{f"stamp_{name}": "stamp_s" for name in ("s", "sec", "secs")},
    **{f"stamp_{name}": "stamp_ns" for name in ("ns", "nsec", "nsecs", "nanosec", "nanosecs")},
    **{f"position_{axis}": axis for axis in "xy"},
    **{f"orientation_{axis}": f"q{axis}" for axis in "xyzw"},
    **{f"q{axis}": f"q{axis}" for axis in "xyzw"},
    "linear_x": "forward",
    "angular_z": "turn",
    "angular_velocity_z": "turn",
    **{name: name for name in ("latitude", "longitude", "altitude")},
}
"""How the path of a message's field ends, and what the schema's columns call it."""


def _six(name: str) -> tuple[str, ...]:
    return tuple(f"{name}.covariance{k}" for k in range(36))


def _axes(name: str, axes: str = "xyz") -> tuple[str, ...]:
    return tuple(f"{name}.{axis}" for axis in axes)


_HEADER = ("header.stamp.sec", "header.stamp.nanosec", "header.frame_id")
_POSE = (*_axes("pose.pose.position"), *_axes("pose.pose.orientation", "xyzw"), *_six("pose"))
MESSAGES: dict[str, tuple[str, ...]] = {
    "nav_msgs/Odometry": (
        *_HEADER, "child_frame_id", *_POSE,
        *_axes("twist.twist.linear"), *_axes("twist.twist.angular"), *_six("twist"),
    ),
    "geometry_msgs/PoseWithCovarianceStamped": (*_HEADER, *_POSE),
    "sensor_msgs/Imu": (
        *_HEADER,
        *_axes("orientation", "xyzw"), *(f"orientation_covariance{k}" for k in range(9)),
        *_axes("angular_velocity"), *(f"angular_velocity_covariance{k}" for k in range(9)),
        *_axes("linear_acceleration"), *(f"linear_acceleration_covariance{k}" for k in range(9)),
    ),
    "sensor_msgs/NavSatFix": (
        *_HEADER, "status.status", "status.service", "latitude", "longitude", "altitude",
        *(f"position_covariance{k}" for k in range(9)), "position_covariance_type",
    ),
}  # fmt: skip
"""The fields of each message in the order in which `ros2 topic echo --csv` writes them."""


def message_of(words: Sequence[str]) -> str | None:
    """Return the message whose fields a line without names holds, by their number and kinds."""
    for name, fields in MESSAGES.items():
        if len(fields) == len(words) and all(
            field.endswith("frame_id") or is_number(word)
            for field, word in zip(fields, words, strict=True)
        ):
            return name
    return None


class MessageFields:
    """Fields of messages among a file's headers."""

    def __init__(self, path: Path, headers: Sequence[str]) -> None:
        """headers: of the file, in its order."""
        self._path, self._headers = path, headers
        self._places: dict[str, list[int]] = {}
        for place, header in enumerate(headers):
            name = _meaning(_path(header))
            if name:
                self._places.setdefault(name, []).append(place)
        for kind, last in (("pose", 36), ("twist", 36), ("position", 9)):
            if f"{kind}_{last}" in self._places and f"{kind}_0" not in self._places:
                for k in range(last):  # MATLAB counts from 1
                    self._places[f"{kind}_{k}"] = self._places.pop(f"{kind}_{k + 1}", [])

    def places(self, column: str) -> tuple[int, ...]:
        """Return where the fields stand that a column is made of; none where it is no message's.

        Raises InputError where two messages have them.
        """
        for fields in COLUMNS[column].fields:
            found = [self._places.get(field, []) for field in fields]
            if all(found):
                if several := next((places for places in found if len(places) > 1), None):
                    first, second = (self._headers[place] for place in several[:2])
                    raise InputError(
                        f"{self._path}: columns '{shorten(first)}' and '{shorten(second)}' both "
                        f"mean {column}, expected one; export one topic to a file"
                    )
                return tuple(places[0] for places in found)
        return ()


def is_message(header: str) -> bool:
    """Return whether a header is the path of a message's field."""
    return _meaning(_path(header)) is not None


def heading_of(quaternion: Array, path: Path, lines: Sequence[int]) -> Array:
    """Return the headings (N,) [rad] of unit quaternions (N, 4) x, y, z, w."""
    bad = np.flatnonzero(~(np.abs(np.linalg.norm(quaternion, axis=1) - 1.0) <= _UNIT_TOLERANCE))
    if len(bad):
        shown = ", ".join(f"{value:g}" for value in quaternion[bad[0]])
        raise InputError(
            f"{path}:{lines[bad[0]]}: orientation is ({shown}), expected a unit quaternion x, y, "
            "z, w"
        )
    x, y, z, w = quaternion.T
    heading: Array = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return heading


def _path(header: str) -> str:
    return _BETWEEN.sub("_", _CAMEL.sub("_", header).lower()).strip("_")


def _meaning(path: str) -> str | None:
    words = path.split("_")
    if words[-1][-1:].isdigit():
        covariance = _COVARIANCE.search("_".join(words[-3:]))
        return f"{covariance[1]}_{int(covariance[2])}" if covariance else None
    endings = ("_".join(words[-count:]) for count in (3, 2, 1))
    return next((ENDINGS[ending] for ending in endings if ending in ENDINGS), None)
