"""Serialised objects of MRPT rawlogs: bytes to records, with errors that name the byte.

An object is one byte 0x80 + n, its class's name of n characters (with or without namespaces), one
byte of version, the class's fields, and the byte 0x88. Numbers are little-endian; a string is its
length as 32 bits and its characters; a time is 64 bits, in 100 ns since 1601, 0 where unknown. No
sizes are stored, so nothing behind an object of an unknown class or version can be read.

The layouts are those of the files in Debian's mrpt-common (MRPT 0.5 to 0.9) and of the files that
simul-landmarks and carmen2rawlog of MRPT 2.5.8 write.
"""

from __future__ import annotations

import gzip
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.archive import most_unpacked
from comparisons.arrays import Array
from comparisons.errors import InputError, shorten
from comparisons.logs.readers.ros_messages import of_quaternion
from comparisons.logs.table import reading
from comparisons.logs.validation import LARGEST

MOST_BYTES = 2**28
"""Of an unpacked rawlog: 140,000 scans of 361 beams."""
MOST_OBJECTS = 2**20
"""Of a rawlog, those within others included: some 170,000 frames with the motions between."""
_CHUNK = 2**20
_END = 0x88
_GZIP = b"\x1f\x8b"
_NAME = re.compile(rb"(?:mrpt::[a-z]+::)?C[A-Z][A-Za-z0-9_]*\Z")
_ODOMETRY = 0
_GAUSSIAN, _THRUN = 0, 1


@dataclass(frozen=True, kw_only=True)
class RawlogRecord:
    """Anything with a place in the stream. at: its first byte. ticks: its time in 100 ns, or 0."""

    at: int
    ticks: int = 0


@dataclass(frozen=True, kw_only=True)
class Movement(RawlogRecord):
    """CActionRobotMovement2D. displacement: (3,). covariance: (3, 3) in the arriving frame."""

    displacement: Array
    covariance: Array


@dataclass(frozen=True, kw_only=True)
class RawlogRangeBearing(RawlogRecord):
    """CObservationBearingRange. sensor: (4, 4) its place on the robot.

    sigma: range [m], yaw and pitch [rad]. polar: (M, 3) the same of each measurement. landmark:
    (M,).
    """

    sensor: Array
    sigma: tuple[float, float, float]
    polar: Array
    landmark: NDArray[np.int32]


@dataclass(frozen=True, kw_only=True)
class RawlogScan(RawlogRecord):
    """CObservation2DRangeScan. sensor: (4, 4). angle, range, intensity: (B,), NaN for none."""

    sensor: Array
    label: str
    angle_rad: Array
    range_m: Array
    intensity: Array


@dataclass(frozen=True, kw_only=True)
class RawlogOdometry(RawlogRecord):
    """CObservationOdometry. pose: (3,) since the odometry's own start."""

    pose: Array


@dataclass(frozen=True, kw_only=True)
class Passed(RawlogRecord):
    """An observation that no estimator here uses. name: its class."""

    name: str


@dataclass(frozen=True, kw_only=True)
class RawlogFrame(RawlogRecord):
    """CSensoryFrame: observations of one instant, or one at top level."""

    observations: tuple[RawlogRecord, ...]


def is_rawlog(path: Path) -> bool:
    """A file, packed by gzip or not, that starts with the name of a class of MRPT."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        start = file.read(512)
    if start.startswith(_GZIP):
        try:
            start = zlib.decompressobj(31).decompress(start, 200)
        except zlib.error:
            return False
    length = start[0] - 0x80 if start else 0
    return length > 0 and _NAME.match(start[1 : 1 + length]) is not None


def records(path: Path) -> Iterator[Movement | RawlogFrame]:
    """What the file holds, in its order. Raises InputError naming the (unpacked) byte at fault."""
    with reading(path):
        stream = _Stream(path, _unpacked(path))
    while stream.at < len(stream.data):
        yield from stream.top()


def _unpacked(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            packed = file.read(2) == _GZIP
        with gzip.open(path) if packed else path.open("rb") as file:
            chunks, total = [], 0
            most = min(MOST_BYTES, most_unpacked(path.stat().st_size))
            while chunk := file.read(_CHUNK):
                chunks.append(chunk)
                total += len(chunk)
                if total > most:
                    raise InputError(
                        f"{path}: more than {most} bytes unpacked, expected at most so many "
                        "(cut it with MRPT's rawlog-edit --cut)"
                    )
    except (EOFError, zlib.error, gzip.BadGzipFile):
        raise InputError(f"{path}: damaged gzip file, expected a whole one") from None
    return b"".join(chunks)


@cache
def _form(form: str) -> struct.Struct:
    return struct.Struct("<" + form)


class _Stream:
    """The bytes and how far they are read."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path, self.data, self.at, self.objects = path, data, 0, 0

    def top(self) -> Iterator[Movement | RawlogFrame]:
        """One object at top level."""
        start = self.at
        found = self.read({**_GROUPS, **_OBSERVATIONS})
        if isinstance(found, tuple):
            yield from found
        elif isinstance(found, RawlogFrame):
            yield found
        else:
            yield RawlogFrame(at=start, observations=(found,))

    def read(self, known: dict[str, _Known]) -> Any:
        """One object of a known class."""
        start = self.at
        self.objects += 1
        if self.objects > MOST_OBJECTS:
            raise self.fault(start, f"more than {MOST_OBJECTS} objects, expected at most so many")
        length = int(self.number("B")) - 0x80
        name = self.take(length) if length > 0 else b""
        if not _NAME.match(name):
            raise self.fault(start, "no object starts here, expected the name of a class")
        word = name.decode("ascii").split("::")[-1]
        version = int(self.number("B"))
        reading = known.get(word)
        if word == "CActionRobotMovement3D":
            raise self.fault(start, f"{word}: a motion in space, expected one in the plane")
        if reading is None or version not in reading[0]:
            raise self.fault(
                start,
                f"{shorten(word)} of version {version}, expected {_list(known)}; sizes are not "
                "stored, so nothing behind it can be read (take such observations out with MRPT's "
                "rawlog-edit --remove-label)",
            )
        found = reading[1](self, start, version)
        if self.number("B") != _END:
            raise self.fault(start, f"{word} does not end with 0x88 at byte {self.at - 1}: damaged")
        return found

    def fault(self, at: int, text: str) -> InputError:
        return InputError(f"{self.path}: byte {at}: {text}")

    def take(self, count: int) -> bytes:
        if not 0 <= count <= len(self.data) - self.at:
            raise self.fault(
                self.at, f"{count} bytes more, expected at most {len(self.data) - self.at}: cut?"
            )
        self.at += count
        return self.data[self.at - count : self.at]

    def numbers(self, form: str) -> tuple[Any, ...]:
        known = _form(form)
        return known.unpack(self.take(known.size))

    def number(self, form: str) -> Any:
        return self.numbers(form)[0]

    def array(self, kind: np.dtype[Any] | str, count: int) -> NDArray[Any]:
        """(count,) numbers; a count that is too large fails before anything is allocated."""
        return np.frombuffer(self.take(np.dtype(kind).itemsize * count), kind)

    def floats(self, count: int) -> Array:
        """(count,) of single precision; what is not a number stays so."""
        with np.errstate(invalid="ignore"):
            return self.array("<f4", count).astype(float)

    def text(self) -> str:
        return self.take(int(self.number("I"))).decode("utf-8", "replace")


_Known = tuple[tuple[int, ...], Callable[[_Stream, int, int], Any]]


def _list(known: dict[str, _Known]) -> str:
    return ", ".join(
        f"{name} ({' or '.join(map(str, versions))})" for name, (versions, _) in known.items()
    )


def _three(stream: _Stream, start: int, version: int) -> Array:
    """x, y, heading of a pose, or x, y, z of a point."""
    return np.array(stream.numbers("3d"))


def _pose_2d(stream: _Stream, start: int, version: int) -> Array:
    return _bounded(stream, start, _three(stream, start, version))


def _bounded(stream: _Stream, start: int, values: Array) -> Array:
    """The same numbers, of which all are finite and none is beyond what a drive may hold."""
    wrong = values[~(np.abs(values) <= LARGEST)]
    if wrong.size:
        raise stream.fault(start, f"a pose holds {wrong[0]:g}, expected at most {LARGEST:g}")
    return values


def _pose_3d(stream: _Stream, start: int, version: int) -> Array:
    """(4, 4): x, y, z and a matrix; x, y, z, w, x, y, z; or x, y, z and the rotation's rows."""
    if version == 1:
        matrix = stream.read(_MATRICES)
        if matrix.shape != (4, 4):
            raise stream.fault(start, f"CPose3D is a matrix {matrix.shape}, expected (4, 4)")
        return _bounded(stream, start, matrix)
    pose = np.eye(4)
    pose[:3, 3] = stream.numbers("3d")
    if version == 2:
        w_first = _bounded(stream, start, np.array(stream.numbers("4d")))
        pose[:3, :3] = of_quaternion(np.roll(w_first, -1))
    else:
        pose[:3, :3] = np.reshape(stream.numbers("9d"), (3, 3))
    return _bounded(stream, start, pose)


def _matrix(stream: _Stream, start: int, version: int) -> Array:
    rows, columns = stream.numbers("2I")
    return np.reshape(stream.array("<f8", rows * columns), (rows, columns))


def _movement(stream: _Stream, start: int, version: int) -> Movement:
    """Odometry with its model of motion; other sources' distributions are not known."""
    method = stream.number("I")
    if method != _ODOMETRY:
        raise stream.fault(
            start,
            f"CActionRobotMovement2D estimated by method {method}, expected {_ODOMETRY} (odometry)",
        )
    moved = stream.read(_POSES_2D)
    model = stream.number("I")
    gaussian = stream.numbers("6f")
    thrun = stream.numbers("i6f")[1:]
    if version == 6:
        stream.numbers("B2fB2i")
    else:
        if stream.number("B"):
            stream.numbers("3d")
        if stream.number("B"):
            stream.numbers("2i")
    ticks = stream.number("Q")
    numbers = np.concatenate((moved, gaussian, thrun))
    if not (np.abs(numbers) < 1e6).all() or model not in (_GAUSSIAN, _THRUN):
        raise stream.fault(
            start,
            f"CActionRobotMovement2D: model {model} of {numbers[np.argmax(np.abs(numbers))]:g}, "
            f"expected model {_GAUSSIAN} or {_THRUN} and numbers below 1e+06",
        )
    spread = _gaussian(moved, gaussian) if model == _GAUSSIAN else _thrun(moved, thrun)
    cos, sin = np.cos(-moved[2]), np.sin(-moved[2])
    turn = np.array(((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)))
    return Movement(at=start, ticks=ticks, displacement=moved, covariance=turn @ spread @ turn.T)


def _gaussian(moved: Array, model: tuple[float, ...]) -> Array:
    """(3, 3) in the departing frame, of MRPT's Gaussian model: sigmas grow with way and turn.

    The displacement is one along the heading in the middle of the turn, which moves with it.
    """
    way, turn = np.hypot(moved[0], moved[1]), abs(moved[2])
    a1, a2, a3, a4, least_m, least_rad = model
    sigma_m, sigma_rad = least_m + a1 * way + a2 * turn, least_rad + a3 * way + a4 * turn
    swing = np.array((-0.5 * moved[1], 0.5 * moved[0], 1.0))
    spread: Array = np.diag((sigma_m**2, sigma_m**2, 0.0)) + sigma_rad**2 * np.outer(swing, swing)
    return spread


def _thrun(moved: Array, model: tuple[float, ...]) -> Array:
    """(3, 3) in the departing frame, of turn, way and turn (Thrun et al. 2005, 5.4), linearised."""
    a1, a2, a3, a4, least_m, least_rad = model
    way = np.hypot(moved[0], moved[1])
    first = np.arctan2(moved[1], moved[0]) if way > 0.0 else 0.0
    second = np.angle(np.exp(1j * (moved[2] - first)))
    sigmas = (
        a1 * abs(first) + a2 * way,
        a3 * way + a4 * (abs(first) + abs(second)),
        a1 * abs(second) + a2 * way,
    )
    jacobian = np.array(
        ((-moved[1], np.cos(first), 0.0), (moved[0], np.sin(first), 0.0), (1.0, 0.0, 1.0))
    )
    least = np.diag((least_m**2, least_m**2, least_rad**2))
    return np.asarray(jacobian @ np.diag(np.square(sigmas)) @ jacobian.T + least)


def _actions(stream: _Stream, start: int, version: int) -> tuple[Movement, ...]:
    return tuple(stream.read(_MOVEMENTS) for _ in range(stream.number("I")))


def _frame(stream: _Stream, start: int, version: int) -> RawlogFrame:
    count = stream.number("I")
    return RawlogFrame(
        at=start, observations=tuple(stream.read(_OBSERVATIONS) for _ in range(count))
    )


def _bearing_range(stream: _Stream, start: int, version: int) -> RawlogRangeBearing:
    """Least and most range, fields of view, place, time, sigmas, measurements, label."""
    stream.numbers("4f")
    sensor, ticks = stream.read(_POSES_3D), stream.number("Q")
    if stream.number("B"):
        raise stream.fault(
            start,
            "CObservationBearingRange with a covariance for each measurement, expected one "
            "sigma for all",
        )
    sigma = stream.numbers("3f")
    count = stream.number("I")
    behind = stream.at
    ids = np.reshape(stream.array("<i4", 4 * count), (count, 4))[:, 3]
    stream.at = behind
    polar = np.reshape(stream.floats(4 * count), (count, 4))[:, :3]
    stream.text()
    return RawlogRangeBearing(
        at=start, ticks=ticks, sensor=sensor, sigma=sigma, polar=polar, landmark=ids
    )


def _sweep(stream: _Stream, start: int, version: int) -> RawlogScan:
    """Field of view, sense, maximum, place, ranges, which are valid, ..., time, ..., label, ..."""
    view, anticlockwise, maximum_m = stream.numbers("f?f")
    sensor = stream.read(_POSES_3D)
    count = stream.number("I")
    ranges = stream.floats(count)
    valid = stream.array("u1", count) != 0
    _, ticks, _ = stream.numbers("fQf")
    label = stream.text()
    stream.number("d")
    intensity = np.zeros(count)
    if version == 7 and stream.number("B"):
        intensity = stream.array("<i4", count).astype(float)
    if not 0 < view <= 2 * np.pi + 1e-3 or not count:
        raise stream.fault(
            start,
            f"CObservation2DRangeScan of {count} beams over {view:g} rad, expected at least one "
            "over one turn at most",
        )
    angle = np.linspace(-0.5 * view, 0.5 * view, count) * (1 if anticlockwise else -1)
    measured = valid & (ranges > 0) & (ranges < maximum_m)
    return RawlogScan(
        at=start,
        ticks=ticks,
        sensor=sensor,
        label=label,
        angle_rad=angle,
        range_m=np.where(measured, ranges, np.nan),
        intensity=intensity,
    )


def _odometry(stream: _Stream, start: int, version: int) -> RawlogOdometry:
    """Pose, label, time, ticks of encoders and velocities where there are any."""
    pose = stream.read(_POSES_2D)
    stream.text()
    ticks = stream.number("Q")
    if stream.number("B"):
        stream.numbers("2i")
    if stream.number("B"):
        stream.numbers("3d" if version > 1 else "2f")
    return RawlogOdometry(at=start, ticks=ticks, pose=pose)


def _beacons(stream: _Stream, start: int, version: int) -> Passed:
    """Ranges to beacons, without bearings; where the beacons are may be infinite."""
    stream.numbers("3f")
    for _ in range(stream.number("I")):
        stream.read(_BEACONS)
        stream.numbers("fi")
    stream.read(_BEACONS)
    stream.text()
    return Passed(at=start, ticks=stream.number("Q"), name="CObservationBeaconRanges")


def _comment(stream: _Stream, start: int, version: int) -> Passed:
    stream.text()
    return Passed(at=start, ticks=stream.number("Q"), name="CObservationComment")


_POSES_2D: dict[str, _Known] = {"CPose2D": ((1,), _pose_2d)}
_BEACONS: dict[str, _Known] = {"CPoint3D": ((1,), _three), "CPose2D": ((1,), _three)}
_POSES_3D: dict[str, _Known] = {"CPose3D": ((1, 2, 3), _pose_3d)}
_MATRICES: dict[str, _Known] = {"CMatrixD": ((0,), _matrix)}
_MOVEMENTS: dict[str, _Known] = {"CActionRobotMovement2D": ((6, 7), _movement)}
_OBSERVATIONS: dict[str, _Known] = {
    "CObservationBearingRange": ((3,), _bearing_range),
    "CObservation2DRangeScan": ((6, 7), _sweep),
    "CObservationOdometry": ((1, 2), _odometry),
    "CObservationBeaconRanges": ((3,), _beacons),
    "CObservationComment": ((0,), _comment),
}
_GROUPS: dict[str, _Known] = {
    "CActionCollection": ((0,), _actions),
    "CSensoryFrame": ((2,), _frame),
}
