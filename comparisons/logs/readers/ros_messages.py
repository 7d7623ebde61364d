"""ROS messages as arrays; faults name the message's place, the value and what was expected."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError, shorten
from comparisons.logs.validation import LARGEST

_DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_TIMES = ("t", "time", "timestamp")
_LONGEST_SWEEP_S = 5.0
_UNIT_TOLERANCE = 0.01
_TURN = 2 * np.pi + 0.1


@dataclass(frozen=True)
class LaserScanMessage:
    """One LaserScan. angle_rad, range_m (NaN for no return), intensity: (B,). beam_s: a beam's."""

    angle_rad: Array
    range_m: Array
    intensity: Array
    beam_s: float


def stamp_ns(message: Any) -> int:
    """The header's time in nanoseconds."""
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def frame(name: str) -> str:
    """A frame's name without the slash that old systems put before it."""
    return str(name).lstrip("/")


def sweep(message: Any, place: str) -> LaserScanMessage:
    """A LaserScan; ranges outside range_min to range_max are no returns, as its definition says."""
    values = {
        name: float(getattr(message, name))
        for name in ("angle_min", "angle_increment", "range_min", "range_max", "time_increment")
    }
    for name, value in values.items():
        if not np.isfinite(value) and name != "range_max":
            raise InputError(f"{place}: {name} is {value}, expected a finite number")
    first, step = values["angle_min"], values["angle_increment"]
    least, most = values["range_min"], values["range_max"]
    ranges, intensity = _float64(message.ranges), _float64(message.intensities)
    count = len(ranges)
    if not count:
        raise InputError(f"{place}: no ranges, expected at least one beam")
    if not most > max(least, 0.0):
        raise InputError(f"{place}: range_max is {most:g}, expected above range_min {least:g}")
    if abs(first) > _TURN or abs(step) * (count - 1) > _TURN or (count > 1 and not step):
        raise InputError(
            f"{place}: angle_min is {first:g} and angle_increment {step:g} for {count} beams, "
            "expected radians of one turn"
        )
    if len(intensity) not in (0, count):
        raise InputError(f"{place}: {len(intensity)} intensities, expected 0 or {count}")
    with np.errstate(invalid="ignore"):
        good = np.isfinite(ranges) & (ranges >= least) & (ranges <= most) & (ranges > 0)
    return LaserScanMessage(
        first + step * np.arange(count, dtype=np.float64),
        np.where(good & (ranges <= LARGEST), ranges, np.nan),
        np.where(np.isfinite(intensity), intensity, 0.0) if len(intensity) else np.zeros(count),
        values["time_increment"],
    )


def cloud(message: Any, place: str) -> tuple[Array, Array]:
    """A PointCloud2 as (M, 3) points [m] and (M,) seconds after the scan, no returns left out.

    Points at the origin, and those that are not finite, are no returns. Times come from a field
    `t`, `time` or `timestamp`: whole numbers are nanoseconds after the scan; others are seconds or
    nanoseconds, after the scan or in all, whichever lies within 5 s of it. Without one they are 0.
    """
    records = _records(message, place)
    names = records.dtype.names or ()
    xyz = np.column_stack([_float64(records[name]) for name in "xyz"])
    with np.errstate(invalid="ignore"):
        found = np.isfinite(xyz).all(axis=1) & (xyz != 0).any(axis=1)
    xyz = xyz[found]
    if (np.abs(xyz) > LARGEST).any():
        value = xyz[np.abs(xyz) > LARGEST][0]
        raise InputError(f"{place}: a coordinate is {value:g}, expected at most {LARGEST:g}")
    name = next((name for name in _TIMES if name in names), None)
    if name is None or not len(xyz):
        return xyz, np.zeros(len(xyz))
    raw = records[name][found]
    return xyz, _seconds(raw, stamp_ns(message) * 1e-9, f"{place}: field {name}")


def planar_pose(pose: Any, place: str) -> Array:
    """(3,) x, y [m], heading [rad] of a Pose; height and tilt are dropped."""
    rotation = _rotation(pose.orientation, place)
    heading = np.arctan2(rotation[1, 0], rotation[0, 0])
    return np.array([*_vector(pose.position, place)[:2], heading])


def rigid_motion(transform: Any, place: str) -> Array:
    """(4, 4) of a Transform: from the child's frame into the parent's."""
    motion = np.eye(4)
    motion[:3, :3] = _rotation(transform.rotation, place)
    motion[:3, 3] = _vector(transform.translation, place)
    return motion


def _records(message: Any, place: str) -> NDArray[Any]:
    """The points as a structured array, copied out of the message's rows."""
    order = ">" if message.is_bigendian else "<"
    step, row = int(message.point_step), int(message.row_step)
    height, width = int(message.height), int(message.width)
    formats: dict[str, tuple[str, int]] = {}
    for entry in message.fields:
        if entry.name not in ("x", "y", "z", *_TIMES):
            continue
        kind = _DATATYPES.get(int(entry.datatype))
        wanted = "floating point" if entry.name in "xyz" else "numbers"
        if kind is None or (entry.name in ("x", "y", "z") and kind[0] != "f"):
            raise InputError(
                f"{place}: field {entry.name} has datatype {entry.datatype}, expected {wanted}"
            )
        if int(entry.offset) + int(kind[1]) > step:
            raise InputError(
                f"{place}: field {entry.name} lies at byte {entry.offset}, expected within "
                f"point_step {step}"
            )
        formats[entry.name] = (order + kind, int(entry.offset))
    if not formats.keys() >= {"x", "y", "z"}:
        shown = shorten(", ".join(str(entry.name) for entry in message.fields), 80)
        raise InputError(f"{place}: fields are {shown or 'none'}, expected x, y and z among them")
    needed = (height - 1) * row + width * step if height and width else 0
    if (height > 1 and row < width * step) or needed > len(message.data):
        raise InputError(
            f"{place}: {len(message.data)} bytes in rows of {row}, expected {height} times {width} "
            f"points of {step}"
        )
    if not needed:
        return np.zeros(0, [(name, kind) for name, (kind, _) in formats.items()])
    layout = np.dtype(
        {
            "names": list(formats),
            "formats": [kind for kind, _ in formats.values()],
            "offsets": [offset for _, offset in formats.values()],
            "itemsize": step,
        }
    )
    data = np.ascontiguousarray(message.data)
    return np.ndarray((height, width), layout, data, strides=(row, step)).ravel()


def _seconds(raw: NDArray[Any], scan_s: float, place: str) -> Array:
    values = _float64(raw)
    if raw.dtype.kind in "iu":
        choices = [values * 1e-9]
    else:
        choices = [values, values * 1e-9]
        if scan_s > 2 * _LONGEST_SWEEP_S:
            choices = [values - scan_s, values * 1e-9 - scan_s, *choices]
    for seconds in choices:
        if (np.abs(seconds) <= _LONGEST_SWEEP_S).all():
            return seconds
    raise InputError(
        f"{place} runs from {values.min():.9g} to {values.max():.9g}, expected seconds or "
        f"nanoseconds within {_LONGEST_SWEEP_S:g} s of the scan"
    )


def _float64(values: Any) -> Array:
    """Converted; a NaN that signals stays one without a warning."""
    with np.errstate(invalid="ignore"):
        return np.asarray(values).astype(np.float64)


def _vector(value: Any, place: str) -> Array:
    xyz = np.array([value.x, value.y, value.z], dtype=float)
    if not (np.abs(xyz) <= LARGEST).all():
        raise InputError(f"{place}: a position is {xyz.tolist()}, expected at most {LARGEST:g}")
    return xyz


def _rotation(q: Any, place: str) -> Array:
    """(3, 3) of a unit quaternion."""
    quaternion = np.array([q.x, q.y, q.z, q.w], dtype=float)
    length = float(np.sqrt((quaternion**2).sum())) if (np.abs(quaternion) < 2).all() else np.nan
    if not abs(length - 1) <= _UNIT_TOLERANCE:
        raise InputError(
            f"{place}: a quaternion is {quaternion.tolist()}, expected one of unit length"
        )
    return of_quaternion(quaternion / length)


def of_quaternion(quaternion: Array) -> Array:
    """(3, 3) of x, y, z, w (4,), of unit length."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
