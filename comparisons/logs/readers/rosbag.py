"""ROS bags: MCAP files, rosbag2 folders and `.bag` files, through the extra `ros`.

LaserScan messages become scans, PointCloud2 messages clouds, detections and markers measurements,
fixes positions, and the poses of Odometry messages one displacement from each of their times to the
next. Poses rather than velocities, since every driver fills them in, in a known frame. Of several
topics of one type the one that was asked for is read; where none was, they are refused. Markers are
read only when asked for, since most are drawings. Times are the headers', or the recording's
where all headers of a topic say zero.

A sensor's place comes from `/tf_static`, seen from the frame that the odometry moves; where it is
not stated there, a scanner is taken to be at the pose, and points are refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError, naming, printable
from comparisons.logs.from_arrays import LandmarkNumbers
from comparisons.logs.log import LandmarkMeasurements, Log, Positions, Prior
from comparisons.logs.odometry import RelativePoses, instants_of, poses_at
from comparisons.logs.odometry_noise import reckoned_motion
from comparisons.logs.readers import ros_bag, ros_points
from comparisons.logs.readers.beams import BeamGrid
from comparisons.logs.readers.gps_start import LARGEST_RAD, Reckoned, east_north, lay_fixes
from comparisons.logs.readers.ros_messages import (
    LaserScanMessage,
    cloud,
    frame,
    rigid_motion,
    stamp_ns,
    sweep,
)
from comparisons.logs.readers.scan_odometry import PRIOR_SIGMA, no_measurements
from comparisons.logs.scans import Clouds, Mount, Scans

_BASES = ("base_link", "base_footprint")
_MOST_POINTS = 50_000_000
_LEVEL = np.cos(np.deg2rad(5.0))
_OF_ODOMETRY = {
    "measurements": (ros_bag.BOXES, ros_bag.MARKERS, ros_bag.IMAGE_BOXES),
    "positions": (ros_bag.FIX,),
}
"""Types of streams that mean nothing without odometry."""
_MOST_LISTED = 10
_SPOKEN = {
    "Odometry": "odometry",
    "LaserScan": "scans",
    "PointCloud2": "clouds",
    "Detection3DArray": "measurements",
    "Detection2DArray": "measurements",
    "MarkerArray": "measurements",
    "NavSatFix": "positions",
    "topics not read": "topics not read",
    "left_out": "left out",
    "odometry_noise": "odometry's noise",
    "measurements_noise": "measurements' noise",
    "measurements": "measurements",
    "positions": "positions",
}
"""Keys of a log's provenance in the order in which they are told, and what they are of."""

Times = NDArray[np.int64]
_T = TypeVar("_T")


@dataclass(frozen=True)
class _Stream:
    """A topic's messages that have a time of their own: time_ns (N,), N items, one frame."""

    topic: ros_bag.Topic
    time_ns: Times
    items: list[Any]
    frame: str

    def within(self, first_ns: int, last_ns: int) -> _Stream | None:
        """The part between two instants, both included; None where that is empty."""
        rows = np.flatnonzero((self.time_ns >= first_ns) & (self.time_ns <= last_ns)).tolist()
        items = [self.items[row] for row in rows]
        return replace(self, time_ns=self.time_ns[rows], items=items) if rows else None


def recognises(path: Path) -> bool:
    """A bag's file or folder, by its content."""
    return ros_bag.recognise_bag(path) is not None


def read(path: Path, topics: tuple[str, ...] = ()) -> Log:
    """Read a bag; times count from the first record, poses from the vehicle's there.

    topics: names of those that a user asked for. Records before and after the odometry are left
    out. Raises InputError naming topic, message, value and expectation, and where the package
    `rosbags` is not installed.
    """
    with ros_bag.open_bag(path, topics) as bag:
        provenance = {"file": path.name}
        moves = bag.topic(ros_bag.ODOMETRY) is not None
        for kind in (
            ros_bag.LASER,
            ros_bag.CLOUD,
            *((ros_bag.FIX, ros_bag.BOXES) if moves else ()),
        ):
            bag.topic(kind)  # before the long work
        read = {
            "scans": _scan_stream(bag, provenance),
            "clouds": _cloud_stream(bag, provenance),
        }
        if moves:
            read["measurements"] = _point_stream(bag, provenance)
            read["positions"] = _stream(bag, ros_bag.FIX, ros_points.fix, provenance)
        else:  # nothing says where the vehicle was
            for name, kinds in _OF_ODOMETRY.items():
                if any(map(bag.topics, kinds)):
                    provenance[name] = f"left out: no messages of type {ros_bag.ODOMETRY}"
        moved = _stream(
            bag, ros_bag.ODOMETRY, ros_points.moved, provenance, lambda m: m.child_frame_id
        )
        _list_unread(bag, provenance)
        transforms = _static_transforms(bag)
    found = {name: stream for name, stream in read.items() if stream is not None}
    if not found.keys() - {"positions"}:
        raise InputError(
            f"{path}: no messages of type {ros_bag.LASER} or {ros_bag.CLOUD}, nor, with odometry, "
            f"of {ros_bag.BOXES}, expected some "
            f"({ros_bag.MARKERS} is read when asked for by --topic)"
        )
    kept, start, time_s = _instants(path, found, moved, provenance)
    base = _base(moved, transforms)
    with naming(path):
        where = _Frame(start, base, transforms, provenance)
        _check_placed(kept, where, topics)
        return _log(path, kept, where, _Drive(moved, time_s))


def streams_of(log: Log) -> list[str]:
    """Return what a log was read from, a line for each stream: topic, count, and what is left out.

    log: of `read`.
    """
    return [
        f"{stream}: {log.provenance[key]}"
        for key, stream in _SPOKEN.items()
        if key in log.provenance
    ]


def _instants(
    path: Path, found: dict[str, _Stream], moved: _Stream | None, provenance: dict[str, str]
) -> tuple[dict[str, _Stream], int, Array]:
    """The streams within the odometry, the log's start [ns], and all their times after it [s]."""
    kept = dict(found)
    if moved is not None:
        first, last = moved.time_ns[[0, -1]].tolist()
        cut = {name: stream.within(first, last) for name, stream in found.items()}
        kept = {name: stream for name, stream in cut.items() if stream is not None}
    if not kept.keys() - {"positions"}:
        raise InputError(f"{path}: no scan lies within the time of the odometry")
    instants = np.unique(np.concatenate([stream.time_ns for stream in kept.values()]))
    if moved is not None and "measurements" in kept:  # may be rare, while the vehicle drives on
        start = int(moved.time_ns[0])
        wanted, sampled = ((ns - start) / 1e9 for ns in (instants, moved.time_ns))
        reported = instants_of(wanted, sampled)
        both = np.concatenate((instants, moved.time_ns))
        instants = np.unique(both[np.isin(np.concatenate((wanted, sampled)), reported)])
    start = int(instants[0])
    provenance |= {
        "time_origin_s": f"{start // 10**9}.{start % 10**9:09d}",
        "left_out": _outside(found, kept),
    }
    time_s = np.asarray((instants - start) / 1e9, dtype=np.float64)
    return kept, start, time_s


def _outside(found: dict[str, _Stream], kept: dict[str, _Stream]) -> str:
    """How many records of each stream lie before or after the odometry."""
    whole = {name: len(stream.items) for name, stream in found.items()}
    cut = {
        name: count - (len(kept[name].items) if name in kept else 0)
        for name, count in whole.items()
    }
    of_each = ", ".join(f"{n} of {whole[name]} {name}" for name, n in cut.items() if n)
    return f"{sum(cut.values())} records outside the odometry" + (of_each and f" ({of_each})")


def _list_unread(bag: ros_bag.Bag, provenance: dict[str, str]) -> None:
    """Name the topics of types that are not read, besides transforms."""
    known = (ros_bag.TRANSFORMS, *(kind for kind in ros_bag.READ if _key(kind) in provenance))
    names = [f"{name} ({kind})" for name, kind in sorted(bag.kinds().items()) if kind not in known]
    if names:
        more = f" and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else ""
        provenance["topics not read"] = printable(", ".join(names[:_MOST_LISTED]) + more)


def _check_placed(kept: dict[str, _Stream], where: _Frame, topics: tuple[str, ...]) -> None:
    """Leave out points that nothing places on the vehicle; refuse those that were asked for."""
    if (stream := kept.get("measurements")) is None or where.knows(stream):
        return
    fault = (
        f"{stream.topic.name}: frame is {stream.frame or 'empty'}, expected the vehicle's "
        f"{where.base or 'frame'} or one that /tf_static places on it"
    )
    if stream.topic.name in topics or not kept.keys() - {"measurements", "positions"}:
        raise InputError(fault)
    del kept["measurements"]
    where.provenance["measurements"] = f"left out: {fault}"


@dataclass(frozen=True)
class _Frame:
    """What places a stream: the log's start [ns], the frame it moves, and the bag's frames."""

    start: int
    base: str
    transforms: dict[str, tuple[str, Array]]
    provenance: dict[str, str]

    def seconds(self, stream: _Stream) -> Array:
        """(N,) after the log's start."""
        return np.asarray((stream.time_ns - self.start) / 1e9, dtype=np.float64)

    def knows(self, stream: _Stream) -> bool:
        """Whether the place of the stream's frame is known."""
        return _motion(stream.frame, self.base, self.transforms) is not None

    def place(self, stream: _Stream, key: str) -> Array:
        """(4, 4) from the stream's frame into the base's; the identity where that is unknown."""
        motion = _motion(stream.frame, self.base, self.transforms)
        if motion is None:
            reported = f"unknown ({stream.frame} from {self.base or 'the base'}), taken as the pose"
            self.provenance[key] = reported
            return np.eye(4)
        self.provenance[key] = f"{stream.frame} seen from {self.base}"
        return motion


@dataclass(frozen=True)
class _Drive:
    """Odometry's messages, if any, and (N,) the instants at which a pose is needed."""

    moved: _Stream | None
    time_s: Array

    def poses(self, start: int) -> Array:
        """(N, 3) from the odometry, the origin where there is none."""
        if self.moved is None:
            return np.zeros((len(self.time_s), 3))
        sample_s = (self.moved.time_ns - start) / 1e9
        return poses_at(self.time_s, sample_s, np.array(self.moved.items)[:, :3])

    def motion(self, start: int) -> tuple[RelativePoses, str]:
        """From each instant to the next, and where its covariances are from."""
        if self.moved is None:
            none = RelativePoses(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))
            return none, "no odometry"
        sample_s = (self.moved.time_ns - start) / 1e9
        rows, unusable = ros_points.planar_rows(np.array(self.moved.items))
        return reckoned_motion(self.time_s, sample_s, rows, unusable)


def _log(path: Path, kept: dict[str, _Stream], where: _Frame, drive: _Drive) -> Log:
    odometry, noise = drive.motion(where.start)
    prior = Prior(0.0, np.zeros(3), PRIOR_SIGMA**2 * np.eye(3))
    scans = clouds = positions = None
    measurements = no_measurements()
    if "scans" in kept:
        scans = _scans(kept["scans"], where)
    if "clouds" in kept:
        clouds = _clouds(kept["clouds"], where)
    if "measurements" in kept:
        measurements = _measurements(kept["measurements"], where)
    if "positions" in kept:
        prior, positions = _positions(kept["positions"], where, drive, prior)
    return Log(
        name=path.stem,
        format="rosbag",
        prior=prior,
        odometry=odometry,
        measurements=measurements,
        positions=positions,
        scans=scans,
        clouds=clouds,
        provenance={**where.provenance, "odometry_noise": noise},
    )


def _measurements(stream: _Stream, where: _Frame) -> LandmarkMeasurements:
    """Points as ranges and bearings from the pose, with labels as whole numbers."""
    place = where.place(stream, "measurements_mount")
    messages: list[ros_points.MessagePoints] = stream.items
    with naming(stream.topic.name):
        found, sigma = zip(*(ros_points.range_bearing(one, place) for one in messages), strict=True)
    z, sigmas = np.concatenate(found), np.concatenate(sigma)
    stated = np.isnan(sigmas[:, 0])
    sigmas[stated] = (ros_points.SIGMA_RANGE_M, ros_points.SIGMA_BEARING_RAD)
    if stated.any():
        where.provenance["measurements_noise"] = (
            f"stated for {int(stated.sum())} of {len(z)}: {ros_points.SIGMA_RANGE_M:g} m and "
            f"{ros_points.SIGMA_BEARING_RAD:.4g} rad"
        )
    labels, message = ros_points.labels_of(messages)
    numbers = LandmarkNumbers(labels)
    if numbers.by_text:
        where.provenance["labels"] = numbers.text()
    return LandmarkMeasurements.of(where.seconds(stream)[message], z, sigmas, numbers.of(labels))


def _positions(
    stream: _Stream, where: _Frame, drive: _Drive, prior: Prior
) -> tuple[Prior, Positions | None]:
    """Fixes in the log's frame, and how well that is known.

    As many of the first as show the start's heading are laid onto the odometry, and spent on that:
    what they know, less the odometry's noise on the way, is in the prior. Those behind are left.
    """
    rows, time_s = np.array(stream.items), where.seconds(stream)
    altitude = np.where(np.isfinite(rows[:, 2]), rows[:, 2], 0.0)
    covariance = rows[:, 3:].reshape(-1, 2, 2).copy()
    stated = np.isnan(covariance[:, 0, 0])
    covariance[stated] = ros_points.SIGMA_FIX_M**2 * np.eye(2)
    antenna = where.place(stream, "antenna")[:2, 3]
    at = (float(antenna[0]), float(antenna[1]))
    plane = Positions(time_s, east_north(rows[:, 0], rows[:, 1], altitude), covariance, at)
    pose = drive.poses(where.start)
    turned = np.exp(-1j * pose[0, 2])
    pose -= pose[0]  # its heading, too: from the origin
    path = (pose[:, 0] + 1j * pose[:, 1]) * turned
    pose[:, :2] = np.column_stack((path.real, path.imag))
    path = path + complex(*antenna) * np.exp(1j * pose[:, 2])
    moved = Reckoned(drive.time_s, pose, path, drive.motion(where.start)[0].covariance)
    laid = lay_fixes(moved, plane)
    if laid is None:
        where.provenance["positions"] = (
            f"left out: {len(time_s)} fixes along the odometry, expected more than show the "
            f"heading to {np.degrees(LARGEST_RAD):.0f} degrees"
        )
        return prior, None
    where.provenance["positions"] = (
        f"WGS 84 about the first fix; {laid.spent + 1} fixes up to {time_s[laid.spent]:g} s laid "
        f"onto the odometry, used for the prior; {int(stated.sum())} of {len(rows)} without "
        f"covariance, stated {ros_points.SIGMA_FIX_M:g} m"
    )
    return Prior(0.0, prior.pose, prior.covariance + laid.covariance), laid.positions


def _key(kind: str) -> str:
    """Of a type in a log's provenance."""
    return kind.rpartition("/")[2]


def _stream(
    bag: ros_bag.Bag,
    kind: str,
    convert: Callable[[Any, str], _T | None],
    provenance: dict[str, str],
    frame_of: Callable[[Any], str] = lambda message: str(message.header.frame_id),
) -> _Stream | None:
    """The messages of the topic to read, repeated times left out.

    convert: None for a message that holds nothing.
    """
    topic = bag.topic(kind)
    if topic is None:
        return None
    others = ", ".join(f"{t.name} ({t.count})" for t in bag.topics(kind)[1:10])
    reported = f"{topic.name}, {topic.count} messages" + (f"; not read: {others}" if others else "")
    items, stamps, recorded, frames = [], [], [], []
    empty = 0
    for place, recorded_ns, message in bag.messages(topic):
        if (item := convert(message, place)) is None:
            empty += 1
            continue
        items.append(item)
        one = ros_points.headed(message)
        stamps.append(stamp_ns(one))
        recorded.append(recorded_ns)
        frames.append(frame(frame_of(one)))
        if frames[-1] != frames[0]:
            raise InputError(
                f"{place}: frame is {frames[-1]}, expected {frames[0]} as in the first"
            )
    reported += f"; {empty} that are empty" if empty else ""
    provenance[_key(kind)] = reported
    if not items:
        return None
    if not any(stamps):
        stamps, reported = recorded, reported + "; times of recording, since the headers have none"
    steps = [later - earlier for earlier, later in pairwise(stamps)]
    for row, step in enumerate(steps, start=1):
        if step < 0:
            raise InputError(
                f"{bag.path}: {topic.name}, message {row}: time {stamps[row] / 1e9:.6f} s follows "
                f"{stamps[row - 1] / 1e9:.6f} s, expected times to increase"
            )
    if not 0 <= stamps[0] <= stamps[-1] < 2**63:
        raise InputError(f"{bag.path}: {topic.name}: times from {stamps[0]} to {stamps[-1]} ns")
    fresh = [0, *(row for row, step in enumerate(steps, start=1) if step)]
    if len(fresh) < len(items):
        reported += f"; {len(items) - len(fresh)} with a repeated time left out"
    provenance[_key(kind)] = reported
    return _Stream(
        topic,
        np.array([stamps[row] for row in fresh], dtype=np.int64),
        [items[row] for row in fresh],
        frames[0],
    )


def _scan_stream(bag: ros_bag.Bag, provenance: dict[str, str]) -> _Stream | None:
    """LaserScan messages, whose beams are those of the widest, or some of them in a row."""
    grids: list[BeamGrid] = []
    before: list[Array] = []

    def convert(message: Any, place: str) -> LaserScanMessage:
        found = sweep(message, place)
        angle = found.angle_rad
        if not grids:
            grids.append(BeamGrid(angle))
        if not grids[0].take(angle):
            expected = grids[0].angle_rad
            raise InputError(
                f"{place}: {len(angle)} beams from {angle[0]:.4g} to {angle[-1]:.4g} rad, expected "
                f"{len(expected)} from {expected[0]:.4g} to {expected[-1]:.4g} as in the first, or "
                "some of them in a row"
            )
        same = next((one for one in before if len(one) == len(angle)), None)
        if same is None:
            before.append(angle)
        return found if same is None else replace(found, angle_rad=same)  # bags are long

    stream = _stream(bag, ros_bag.LASER, convert, provenance)
    if stream is None:
        return None
    words = grids[0].words([len(one.angle_rad) for one in stream.items])
    if words:
        provenance[_key(ros_bag.LASER)] += f"; {words}"
    items = [_filled(grids[0], one) for one in stream.items]
    return replace(stream, items=items)


def _filled(grid: BeamGrid, message: LaserScanMessage) -> LaserScanMessage:
    """A sweep with all beams of the grid."""
    if len(message.angle_rad) == len(grid.angle_rad):
        return message
    angle = message.angle_rad
    return replace(
        message,
        angle_rad=grid.angle_rad,
        range_m=grid.filled(angle, message.range_m),
        intensity=grid.filled(angle, message.intensity, 0.0),
    )


def _point_stream(bag: ros_bag.Bag, provenance: dict[str, str]) -> _Stream | None:
    """Detections, or markers that were asked for; what was asked for comes first."""
    chosen = [
        kind
        for kind in (ros_bag.MARKERS, ros_bag.BOXES, ros_bag.IMAGE_BOXES)
        if (topics := bag.topics(kind)) and bag.is_chosen(topics[0])
    ]
    for kind in (*chosen, ros_bag.BOXES):
        if bag.topics(kind) and not bag.knows(kind):
            fault = f"{bag.topics(kind)[0].name}: the bag holds no usable definition of {kind}"
            if kind in chosen:
                raise InputError(f"{bag.path}: {fault}, expected one, as .mcap files have it")
            provenance["measurements"] = f"left out: {fault}"
            return None
        convert = ros_points.markers if kind == ros_bag.MARKERS else ros_points.detections
        stream = _stream(bag, kind, convert, provenance)
        if stream is not None:
            return stream
        if kind in chosen:
            raise InputError(
                f"{bag.path}: {bag.topics(kind)[0].name}: no message holds a point with a position"
            )
    return None


def _cloud_stream(bag: ros_bag.Bag, provenance: dict[str, str]) -> _Stream | None:
    """PointCloud2 messages, up to what fits into memory."""
    total = 0

    def convert(message: Any, place: str) -> tuple[Array, Array]:
        nonlocal total
        found = cloud(message, place)
        total += len(found[0])
        if total > _MOST_POINTS:
            raise InputError(
                f"{place}: more than {_MOST_POINTS:,} points so far, expected fewer (cut the bag)"
            )
        return found

    return _stream(bag, ros_bag.CLOUD, convert, provenance)


def _scans(stream: _Stream, where: _Frame) -> Scans:
    """With the scanner's place seen from the pose; upside down turns the beams' order."""
    place = where.place(stream, "scans_mount")
    level = place[2, 2]
    if abs(level) < _LEVEL:
        tilt = np.degrees(np.arccos(abs(level)))
        raise InputError(
            f"{stream.topic.name}: mounted at a tilt of {tilt:.1f} degrees, expected at most 5"
        )
    sweeps: list[LaserScanMessage] = stream.items
    heading = np.arctan2(place[1, 0], place[0, 0])
    return Scans(
        time_s=where.seconds(stream),
        angle_rad=np.sign(level) * sweeps[0].angle_rad,
        range_m=np.array([s.range_m for s in sweeps]),
        intensity=np.array([s.intensity for s in sweeps]),
        mount=Mount(*map(float, (place[0, 3], place[1, 3], heading))),
        beam_s=float(np.median([s.beam_s for s in sweeps])),
    )


def _clouds(stream: _Stream, where: _Frame) -> Clouds:
    """All points in the pose's frame."""
    place = where.place(stream, "clouds_mount")
    parts: list[tuple[Array, Array]] = stream.items
    points = np.concatenate([points for points, _ in parts])
    return Clouds(
        where.seconds(stream),
        np.concatenate(([0], np.cumsum([len(points) for points, _ in parts], dtype=np.int64))),
        points @ place[:3, :3].T + place[:3, 3],
        np.concatenate([seconds for _, seconds in parts]),
    )


def _static_transforms(bag: ros_bag.Bag) -> dict[str, tuple[str, Array]]:
    """Each frame's parent, and the motion (4, 4) from the frame into the parent's."""
    found: dict[str, tuple[str, Array]] = {}
    for topic in bag.topics(ros_bag.TRANSFORMS):
        if frame(topic.name).endswith("tf_static"):
            for place, _, message in bag.messages(topic):
                for entry in message.transforms:
                    child = frame(entry.child_frame_id)
                    motion = rigid_motion(entry.transform, place)
                    found[child] = (frame(entry.header.frame_id), motion)
    return found


def _base(moved: _Stream | None, transforms: dict[str, tuple[str, Array]]) -> str:
    """The frame whose pose the log holds."""
    if moved is not None and moved.frame:
        return moved.frame
    known = {*transforms, *(parent for parent, _ in transforms.values())}
    return next((name for name in _BASES if name in known), "")


def _motion(name: str, base: str, transforms: dict[str, tuple[str, Array]]) -> Array | None:
    """(4, 4) from a frame into the base's; None where that is unknown."""
    up, down = _upward(name, transforms), _upward(base, transforms)
    common = next((name for name in up if name in down), None)
    if common is None:
        return None
    return np.asarray(np.linalg.solve(down[common], up[common]), dtype=np.float64)


def _upward(name: str, transforms: dict[str, tuple[str, Array]]) -> dict[str, Array]:
    """The frame and its ancestors in order, each with the motion (4, 4) from the frame into it."""
    chain = {name: np.eye(4)}
    while name in transforms:
        parent, motion = transforms[name]
        if parent in chain:
            break
        chain[parent] = motion @ chain[name]
        name = parent
    return chain
