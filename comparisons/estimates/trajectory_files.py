"""Trajectories as one file: TUM, KITTI with its times beside it, CSV with a header, and EuRoC's.

A CSV file has its columns in any order, under the usual names that files of a log may use. KITTI
holds twelve numbers a line, the upper three rows of a pose's 4 x 4 matrix; here the drive's plane
is x and y, and z points up. It knows no times; they stand in a file of their own, a number a line.
EuRoC's ground truth holds nanoseconds, a position and a quaternion, w first, with commas; what
follows them is passed over. Of poses whose times repeat the first is taken.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, symmetric, upper_triangles
from comparisons.atomic import NEW, check_file, write_whole
from comparisons.errors import InputError
from comparisons.estimates.folder import TUM, in_plane, planar_poses, tum_text
from comparisons.logs.plain_csv import PlainTable, need, read_plain
from comparisons.logs.schema import COVARIANCE, POSES
from comparisons.logs.stamps import Nanoseconds
from comparisons.logs.table import TextTable, first_record, is_number
from comparisons.logs.validation import LARGEST, increasing, within

UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
"""Of times that are not in seconds, and how many are one second."""
_SINCE_1970_S = 1e8
"""Times above it count from 1970, not from the start of a drive, which lasts no three years."""
FORMATS = ("tum", "kitti", "csv")
TIMES = "times.txt"
"""Stands beside a KITTI file."""

_CSV = POSES.needed
_KITTI = (*("r00", "r01", "r02", "x", "r10", "r11", "r12", "y"), *("r20", "r21", "r22", "z"))
_EUROC = ("time_ns", "x", "y", "z", "qw", "qx", "qy", "qz")


class Trajectory(NamedTuple):
    """time_s: (K,). pose: (K, 3) x, y [m], heading [rad], unwrapped. covariance: (K, 3, 3).

    left_out: how many poses of the file were, and why; empty where none. time_ns: (K,) the times
    exactly as written; None where time_s tells as much, as it does not of seconds since 1970.
    """

    time_s: Array
    pose: Array
    covariance: Array | None = None
    left_out: str = ""
    time_ns: Nanoseconds | None = None


def read_trajectory_file(path: Path, times: Path | None = None) -> Trajectory:
    """A file in any of the formats, recognised by its first record.

    times: of a KITTI file; `times.txt` beside it by default. Raises InputError.
    """
    return read_with_files(path, times)[0]


def read_with_files(path: Path, times: Path | None = None) -> tuple[Trajectory, tuple[Path, ...]]:
    """Do the same; the second is the files that were read. Raises InputError."""
    first = first_record(path)
    if len(first.split()) == len(_KITTI):
        clock = times or path.with_name(TIMES)
        return _read_kitti(path, clock), (path, clock)
    if times is not None:
        raise InputError(f"{path}: holds its own times; --times is for KITTI files")
    words = first.split(",")
    more = len(words) - len(_EUROC)
    if more >= 0 and all(map(is_number, words)):
        table = TextTable(
            path, (*_EUROC, *(f"column {len(_EUROC) + i + 1}" for i in range(more))), comma=True
        )
        time_s, time_ns = table["time_ns"] / 1e9, table.nanoseconds("time_ns", 10**9)
        return _timed(table, time_s, planar_poses(table, "w first"), time_ns=time_ns), (path,)
    if any(mark in first for mark in ",;\t") and not all(map(is_number, first.split())):
        return _read_csv(path), (path,)
    table = TextTable(path, TUM)
    time_ns = table.nanoseconds("time_s")
    return _timed(table, table["time_s"], planar_poses(table, "w last"), time_ns=time_ns), (path,)


def _timed(
    table: TextTable | PlainTable,
    time_s: Array,
    pose: Array,
    covariance: Array | None = None,
    time_ns: Nanoseconds | None = None,
) -> Trajectory:
    """Poses whose times rise, the first of those whose times repeat. Raises InputError."""
    unit = _too_large_for_seconds(time_s)
    if unit:
        raise InputError(
            f"{table.path}: times reach {np.abs(time_s).max():.4g}, expected seconds; they look "
            f"like {unit}; {in_seconds(unit)}"
        )
    with table.locating():
        increasing("trajectory", time_s, equal=True)
    kept = np.diff(time_s, prepend=-np.inf) > 0.0
    lost = int((~kept).sum())
    left_out = ""
    whole = (time_s > _SINCE_1970_S).all() and (time_s == np.round(time_s)).all()
    if 2 * lost > len(kept) and whole:
        raise InputError(
            f"{table.path}: {lost} of {len(kept)} poses repeat the time of the one before: their "
            "times since 1970 look rounded to seconds, as '%.10g' does; write nine decimals, '%.9f'"
        )
    if lost:
        left_out = (
            f"{lost} of {len(kept)} poses of {table.path.name} repeat the time of the one before "
            f"(first at {time_s[int(np.argmin(kept))]:.6f} s) and were left out"
        )
    covariance = None if covariance is None else covariance[kept]
    time_ns = None if time_ns is None else time_ns[kept]
    return Trajectory(time_s[kept], pose[kept], covariance, left_out, time_ns)


def _too_large_for_seconds(time_s: Array) -> str:
    """The unit that times (K,) look like that no log in seconds holds; empty where one may."""
    largest = np.abs(time_s).max(initial=0.0)
    if largest <= LARGEST:
        return ""
    if abs(time_s[0]) <= LARGEST:  # from the start of a drive
        return "nanoseconds"
    since_1970 = (unit for unit, factor in UNITS.items() if largest <= LARGEST * factor)
    return next(since_1970, "nanoseconds")


def in_seconds(unit: str) -> str:
    """Return the command that writes the times of a file in seconds."""
    return f"in seconds: {retimed(f'/ {UNITS[unit]:.0f}')}"


def retimed(change: str) -> str:
    """Return the command that changes the number at the head of each line, of TUM or CSV."""
    return f"""awk '{{sub(/^ *[-+.0-9eE]+/, sprintf("%.9f", $1 {change}))}} 1' OLD > NEW"""


def write_trajectory(trajectory: Trajectory, path: Path, format_name: str) -> None:
    """Write a new file, with KITTI also `times.txt` beside it. Raises InputError."""
    if format_name not in FORMATS:
        raise InputError(f"format '{format_name}' is unknown, expected {', '.join(FORMATS)}")
    check_file(path, NEW)
    texts = {path: _TEXTS[format_name](trajectory)}
    if format_name == "kitti":
        texts[path.with_name(TIMES)] = "".join(f"{t!r}\n" for t in trajectory.time_s.tolist())
        if len(texts) < 2:
            raise InputError(f"{path}: is the name of the file of times, expected another name")
    for target in texts:
        check_file(target, NEW)
    for target, text in texts.items():
        write_whole(target, partial(Path.write_text, data=text, encoding="utf-8"))


def _read_csv(path: Path) -> Trajectory:
    table = read_plain(path, _CSV + COVARIANCE)
    need(table, _CSV)
    found = table.columns
    has = any(found[name].any() for name in COVARIANCE if name in found)
    columns = _CSV + (COVARIANCE if has else ())
    need(table, columns)
    with table.locating():
        for name in columns:
            largest = LARGEST**2 if name in COVARIANCE else LARGEST
            within("trajectory", name, found[name], -largest, largest)
    data = np.column_stack([found[name] for name in columns])
    covariance = symmetric(data[:, 4:]) if has else None
    pose = np.column_stack((data[:, 1:3], np.unwrap(data[:, 3])))
    return _timed(table, data[:, 0], pose, covariance, table.time_ns)


def _read_kitti(path: Path, times: Path) -> Trajectory:
    if not times.exists():
        raise InputError(
            f"{path}: KITTI files have no times, expected {times.name} beside it, or --times"
        )
    table, clock = TextTable(path, _KITTI), TextTable(times, ("time_s",))
    if len(table) != len(clock):
        raise InputError(f"{times}: {len(clock)} times, expected {len(table)} as poses in {path}")
    place, up = (table.data[:, [i, i + 4, i + 8]] for i in (3, 2))
    in_plane(table, place, up)
    with table.locating():
        within("trajectory", "r22 (of a pose in the plane x, y)", table["r22"], 0.99, 1.01)
        norm = np.hypot(table["r00"], table["r10"])
        within("trajectory", "rotation's norm", norm, 0.99, 1.01)
    heading = np.unwrap(np.arctan2(table["r10"], table["r00"]))
    pose = np.column_stack((table["x"], table["y"], heading))
    return _timed(clock, clock["time_s"], pose, time_ns=clock.nanoseconds("time_s"))


def _csv_text(trajectory: Trajectory) -> str:
    columns = _CSV
    parts = [trajectory.time_s[:, None], trajectory.pose]
    if trajectory.covariance is not None:
        columns += COVARIANCE
        parts.append(upper_triangles(trajectory.covariance))
    return ",".join(columns) + "\n" + _rows(np.hstack(parts), ",")


def _kitti_text(trajectory: Trajectory) -> str:
    x, y, heading = trajectory.pose.T
    cos, sin, zero, one = np.cos(heading), np.sin(heading), np.zeros(len(x)), np.ones(len(x))
    rows = (cos, -sin, zero, x, sin, cos, zero, y, zero, zero, one, zero)
    return _rows(np.column_stack(rows), " ")


def _rows(table: Array, delimiter: str) -> str:
    """Numbers that read back to the same bits."""
    return "".join(delimiter.join(map(repr, row)) + "\n" for row in table.tolist())


_TEXTS = {
    "tum": lambda trajectory: tum_text(trajectory.time_s, trajectory.pose),
    "kitti": _kitti_text,
    "csv": _csv_text,
}
