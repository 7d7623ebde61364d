"""MRPT rawlogs (`.rawlog`): measurements, planar scans and odometry of a robot in the plane.

Two kinds are read. Actions and sensory frames in turns: each motion with the covariance of the
model it was recorded with (MRPT's Gaussian or Thrun's), each frame one instant. Or observations
alone, each with its time: odometry as poses, with the covariance stated in `scan_odometry`.

Beside `NAME.rawlog`, `NAME_ground_truth_robot_path.txt` (one pose a frame) and
`NAME_ground_truth.txt` (landmarks) are the truth, as MRPT's simulator of landmarks writes them, or
`NAME.rawlog.GT.txt` (seconds since 1970, x, y, heading), as its simulator of grid maps does.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError, RecordError, naming, shorten
from comparisons.logs.log import (
    NO_LANDMARK,
    LandmarkMeasurements,
    Landmarks,
    Log,
    Poses,
    Prior,
    Truth,
)
from comparisons.logs.odometry import NOISE_TEXT, RelativePoses, displacements, poses_at
from comparisons.logs.readers import rawlog_stream as stream
from comparisons.logs.readers.beams import BeamGrid
from comparisons.logs.readers.scan_odometry import PRIOR_SIGMA, no_measurements
from comparisons.logs.scans import Mount, Scans
from comparisons.logs.table import number_or_fail, read_text
from comparisons.logs.validation import whole_numbers
from graphslam.increments import MotionSamples, compose

_LEAST_STEP_S = 1e-3
"""Between frames: what is nearer is the clock of a simulation, not of a robot."""
_LEVEL = np.cos(np.deg2rad(5.0))
_FLAT_RAD = 1e-4
_TICKS_PER_S = 10_000_000
_EPOCH = datetime(1601, 1, 1, tzinfo=UTC)
_UNIX_TICKS = 116_444_736_000_000_000
_TIMED_TRUTH = ("time", "x", "y", "heading")
_TRUTH_POSE = ("x", "y", "z", "yaw", "pitch", "roll")
_TRUTH_LANDMARK = ("x", "y", "z", "type", "times seen", "time", "id")


@dataclass(frozen=True)
class _Drive:
    """Instants (K,) with measurements or scans, what was observed then, and the motion between.

    first_ticks: the first instant, where times are the file's.
    """

    time_s: Array
    frames: Sequence[stream.RawlogFrame]
    odometry: RelativePoses
    provenance: dict[str, str]
    first_ticks: int | None


def recognises(path: Path) -> bool:
    """A file that starts with an object of MRPT's, packed by gzip or not."""
    return stream.is_rawlog(path)


def read(path: Path) -> Log:
    """Read the file; times count from the first frame, or are frame numbers where its own fail.

    The log starts at its first frame: at the truth's first pose, or else the origin. Raises
    InputError naming the byte of the unpacked file at fault.
    """
    found = list(stream.records(path))
    every = [o for item in found if isinstance(item, stream.RawlogFrame) for o in item.observations]
    passed = Counter(o.name for o in every if isinstance(o, stream.Passed))
    passed_over = ", ".join(f"{count} {name}" for name, count in passed.items())
    if not any(isinstance(o, stream.RawlogScan) or _measures(o) for o in every):
        raise InputError(
            f"{path}: no CObservationBearingRange or CObservation2DRangeScan with readings, "
            f"expected at least one (it holds {passed_over or 'no other observations'})"
        )
    stepwise = any(isinstance(item, stream.Movement) for item in found)
    drive = _stepwise(path, found) if stepwise else _timed(path, found)
    scans, scanned = _scans(path, drive)
    measurements = _measurements(path, drive)
    truth = _truth(path, drive) if stepwise else Truth()
    start = np.zeros(3)
    if truth.poses is not None and len(truth.poses.time_s):
        start = truth.poses.at(drive.time_s[:1])[0]
    return Log(
        name=path.stem,
        format="rawlog",
        prior=Prior(float(drive.time_s[0]), start, PRIOR_SIGMA**2 * np.eye(3)),
        odometry=drive.odometry,
        measurements=measurements,
        scans=scans,
        truth=truth,
        provenance={"file": path.name, **drive.provenance, **scanned, "passed_over": passed_over},
    )


def _measures(item: stream.RawlogRecord) -> bool:
    return isinstance(item, stream.RawlogRangeBearing) and len(item.polar) > 0


def _stepwise(path: Path, found: Sequence[stream.Movement | stream.RawlogFrame]) -> _Drive:
    """Frames with the composed motion between them; frames without anything to use are bridged."""
    frames: list[stream.RawlogFrame] = []
    moves: list[stream.Movement] = []
    interval: list[int] = []
    for item in found:
        if isinstance(item, stream.Movement):
            moves.append(item)
            interval.append(len(frames) - 1)
        elif any(
            isinstance(o, stream.RawlogRangeBearing | stream.RawlogScan) for o in item.observations
        ):
            frames.append(item)
    steps = len(frames) - 1
    inside = [row for row, step in enumerate(interval) if 0 <= step < steps]
    for step in np.setdiff1d(np.arange(steps), interval):
        raise InputError(
            f"{path}: byte {frames[step + 1].at}: no motion since the frame before it, expected a "
            "CActionRobotMovement2D between two frames"
        )
    time_s, first_ticks, provenance = _frame_times(frames)
    composed = compose(
        MotionSamples(
            np.reshape([moves[row].displacement for row in inside], (-1, 3)),
            np.reshape([moves[row].covariance for row in inside], (-1, 3, 3)),
        ),
        np.array(interval, dtype=np.intp)[inside],
        steps,
    )
    with _locating(path, lambda row: frames[row + 1].at):
        odometry = RelativePoses(time_s[1:], composed.displacement, composed.covariance)
    provenance["odometry"] = f"{len(inside)} CActionRobotMovement2D, covariances of their models"
    beyond = f"{len(moves) - len(inside)} motions before the first frame or after the last"
    provenance["left_out"] = beyond
    return _Drive(time_s, frames, odometry, provenance, first_ticks)


def _frame_times(frames: Sequence[stream.RawlogFrame]) -> tuple[Array, int | None, dict[str, str]]:
    """(K,) of the frames; their numbers where their times are missing or do not increase."""
    ticks = [
        next(
            o.ticks
            for o in f.observations
            if isinstance(o, stream.RawlogRangeBearing | stream.RawlogScan)
        )
        for f in frames
    ]
    time_s = np.array([tick - ticks[0] for tick in ticks], dtype=float) / _TICKS_PER_S
    if all(ticks) and (np.diff(time_s) >= _LEAST_STEP_S).all():
        return time_s, ticks[0], {"time_origin": _when(ticks[0])}
    why = f"the file's times do not increase by {_LEAST_STEP_S:g} s from frame to frame"
    numbered = {"times": f"frame numbers in place of seconds, since {why}"}
    return np.arange(float(len(frames))), None, numbered


def _when(ticks: int) -> str:
    try:
        return (_EPOCH + timedelta(microseconds=ticks // 10)).isoformat()
    except OverflowError:
        return f"{ticks} times 100 ns after 1601"


def _timed(path: Path, found: Sequence[stream.Movement | stream.RawlogFrame]) -> _Drive:
    """Observations by their own times, with the odometry's poses interpolated there."""
    moving: dict[int, stream.RawlogOdometry] = {}
    seen: dict[int, list[stream.RawlogRecord]] = {}
    every = [o for item in found if isinstance(item, stream.RawlogFrame) for o in item.observations]
    for item in every:
        if isinstance(item, stream.Passed):
            continue
        if not item.ticks:
            raise InputError(f"{path}: byte {item.at}: an observation without a time, expected one")
        if isinstance(item, stream.RawlogOdometry):
            moving.setdefault(item.ticks, item)
        else:
            seen.setdefault(item.ticks, []).append(item)
    ticks = sorted(seen)
    sampled = sorted(moving)
    if moving:
        ticks = [tick for tick in ticks if sampled[0] <= tick <= sampled[-1]]
    if not ticks:
        raise InputError(
            f"{path}: no measurements or scans within the time of the odometry, expected at "
            "least one"
        )
    time_s = np.array([tick - ticks[0] for tick in ticks], dtype=float) / _TICKS_PER_S
    frames = [
        stream.RawlogFrame(at=seen[tick][0].at, observations=tuple(seen[tick])) for tick in ticks
    ]
    provenance = {
        "time_origin": _when(ticks[0]),
        "odometry": f"{len(moving)} CObservationOdometry, {len(ticks) - 1} motions between instants"
        if moving
        else "none",
        "odometry_noise": NOISE_TEXT if moving else "no odometry",
        "left_out": f"{len(seen) - len(ticks)} instants outside the odometry",
    }
    if not moving:
        none = RelativePoses(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))
        return _Drive(time_s, frames, none, provenance, ticks[0])
    sample_s = np.array([tick - ticks[0] for tick in sampled], dtype=float) / _TICKS_PER_S
    with _locating(path, lambda row: moving[sampled[row]].at):
        poses = Poses(sample_s, np.array([moving[tick].pose for tick in sampled]))
    with _locating(path, lambda row: frames[row + 1].at):
        odometry = displacements(time_s, poses_at(time_s, poses.time_s, poses.pose))
    return _Drive(time_s, frames, odometry, provenance, ticks[0])


def _measurements(path: Path, drive: _Drive) -> LandmarkMeasurements:
    """All of the plane, in the robot's frame. Raises InputError for others."""
    found = [
        (time, item)
        for time, frame in zip(drive.time_s, drive.frames, strict=True)
        for item in frame.observations
        if isinstance(item, stream.RawlogRangeBearing) and _measures(item)
    ]
    if not found:
        return no_measurements()
    for _, item in found:
        _check_planar(path, item)
    times, items = zip(*found, strict=True)
    counts = [len(item.polar) for item in items]
    polar = np.concatenate([item.polar for item in items])
    offset = np.array([item.at for item in items])
    turned = np.array([np.arctan2(item.sensor[1, 0], item.sensor[0, 0]) for item in items])
    sigma = np.array([item.sigma[:2] for item in items])
    bearing = polar[:, 1] + np.repeat(turned, counts)
    bearing = np.where(np.abs(bearing) > np.pi, np.angle(np.exp(1j * bearing)), bearing)
    with _locating(path, lambda row: int(np.repeat(offset, counts)[row])):
        return LandmarkMeasurements.of(
            np.repeat(times, counts),
            np.column_stack((polar[:, 0], bearing)),
            np.repeat(sigma, counts, axis=0),
            np.maximum(np.concatenate([item.landmark for item in items]), NO_LANDMARK),
        )


def _check_planar(path: Path, item: stream.RawlogRangeBearing) -> None:
    """Measurements must lie in the plane and be seen from the robot's own pose."""
    place = f"{path}: byte {item.at}: CObservationBearingRange"
    pitch = item.polar[:, 2]
    if not (np.abs(pitch) <= _FLAT_RAD).all():
        worst = float(pitch[~(np.abs(pitch) <= _FLAT_RAD)][0])
        raise InputError(
            f"{place}: a pitch of {worst:.3g} rad, which means landmarks in space, expected "
            "landmarks in the plane"
        )
    level, offset = item.sensor[2, 2], item.sensor[:2, 3]
    if not (level >= _LEVEL and (np.abs(offset) <= 1e-6).all()):
        raise InputError(
            f"{place}: a sensor at {offset[0]:.3g}, {offset[1]:.3g} m with a level of {level:.3g}, "
            "expected one at the robot's pose, upright"
        )


def _scans(path: Path, drive: _Drive) -> tuple[Scans | None, dict[str, str]]:
    """Of the scanner that has most of them: those with its label, its beams and its place."""
    groups: list[_Scanner] = []
    count = 0
    for time, frame in zip(drive.time_s, drive.frames, strict=True):
        sweeps = [item for item in frame.observations if isinstance(item, stream.RawlogScan)]
        count += len(sweeps)
        for item in sweeps:
            if not any(group.take(float(time), item) for group in groups):
                groups.append(_Scanner(float(time), item))
    if not groups:
        return None, {}
    scanner = max(groups, key=lambda group: len(group.sweeps))
    chosen, grid = scanner.sweeps, scanner.grid
    first = chosen[0][1]
    level = first.sensor[2, 2]
    if not abs(level) >= _LEVEL:
        raise InputError(
            f"{path}: byte {first.at}: CObservation2DRangeScan of a scanner with a level of "
            f"{level:.3g}, expected one tilted by 5 degrees at most"
        )
    heading = np.arctan2(first.sensor[1, 0], first.sensor[0, 0])
    with _locating(path, lambda row: chosen[row][1].at):
        scans = Scans(
            time_s=np.array([time for time, _ in chosen]),
            angle_rad=np.sign(level) * grid.angle_rad,
            range_m=np.array([grid.filled(i.angle_rad, i.range_m) for _, i in chosen]),
            intensity=np.array([grid.filled(i.angle_rad, i.intensity, 0.0) for _, i in chosen]),
            mount=Mount(float(first.sensor[0, 3]), float(first.sensor[1, 3]), float(heading)),
        )
    named = shorten(first.label) or "no label"
    lost = count - len(chosen)
    words = f"{len(chosen)} of {count} CObservation2DRangeScan ({named})"
    fewer = grid.words([len(item.angle_rad) for _, item in chosen])
    found = {"scans": words + (fewer and f"; {fewer}")}
    if lost:
        before = drive.provenance.get("left_out")
        cut = f"{lost} scans of another scanner, or repeated"
        found["left_out"] = f"{before}; {cut}" if before else cut
    return scans, found


class _Scanner:
    """Scans of one label, place and row of beams, at most one a frame."""

    def __init__(self, time_s: float, first: stream.RawlogScan) -> None:
        self.grid, self.sweeps = BeamGrid(first.angle_rad), [(time_s, first)]
        self._kind = _label_and_place(first)

    def take(self, time_s: float, item: stream.RawlogScan) -> bool:
        """Add a scan, unless it is of another scanner or repeats the time of the last one."""
        if _label_and_place(item) != self._kind or not self.grid.take(item.angle_rad):
            return False
        if self.sweeps[-1][0] != time_s:
            self.sweeps.append((time_s, item))
        return True


def _label_and_place(item: stream.RawlogScan) -> tuple[object, ...]:
    return item.label, tuple(np.round(item.sensor[:3].ravel(), 3).tolist())


def _truth(path: Path, drive: _Drive) -> Truth:
    """Of the files beside the log, where there are any."""
    poses = landmarks = None
    for base in (path.stem, path.name):
        robot = path.with_name(f"{base}_ground_truth_robot_path.txt")
        if robot.is_file():
            table = _table(robot, _TRUTH_POSE)
            if len(table) != len(drive.time_s):
                raise InputError(
                    f"{robot}: {len(table)} poses, expected {len(drive.time_s)}, one for each "
                    f"frame of {path.name} (rename it to read the log without it)"
                )
            poses = Poses(drive.time_s, table[:, [0, 1, 3]])
        world = path.with_name(f"{base}_ground_truth.txt")
        if world.is_file():
            table = _table(world, _TRUTH_LANDMARK)
            with naming(world):
                ids = whole_numbers("landmarks", "id", table[:, 6])
                landmarks = Landmarks(ids, table[:, :2], np.zeros((len(ids), 2, 2)))
    timed = path.with_name(f"{path.name}.GT.txt")
    if poses is None and drive.first_ticks is not None and timed.is_file():
        table = _table(timed, _TIMED_TRUTH)
        since = table[:, 0] - (drive.first_ticks - _UNIX_TICKS) / _TICKS_PER_S
        with naming(timed):
            poses = Poses(since, table[:, 1:])
    return Truth(poses, landmarks)


def _table(path: Path, columns: tuple[str, ...]) -> Array:
    """(N, columns) numbers; lines that start with % are comments."""
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("%"):
            continue
        if len(words) != len(columns):
            raise InputError(
                f"{path}:{number}: {len(words)} values, expected {len(columns)} "
                f"({', '.join(columns)})"
            )
        rows.append(
            [number_or_fail(w, path, number, c) for w, c in zip(words, columns, strict=True)]
        )
    return np.reshape(np.array(rows, dtype=float), (-1, len(columns)))


@contextmanager
def _locating(path: Path, byte: Callable[[int], int]) -> Iterator[None]:
    """Turn a RecordError about a row into one that names file and byte."""
    try:
        yield
    except RecordError as error:
        place = "" if error.row is None else f" byte {byte(error.row)}:"
        raise InputError(f"{path}:{place} {error.stream}: {error.fault}") from None
