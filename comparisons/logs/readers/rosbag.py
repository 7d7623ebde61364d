"""ROS bags: MCAP files, rosbag2 folders and `.bag` files, through the extra `ros`.

LaserScan messages become scans, PointCloud2 messages clouds, and the poses of Odometry messages one
displacement per scan. Poses rather than velocities, since every driver fills them in, in a known
frame. Of several topics of one type the one with the most messages is read. Times are the headers',
or the recording's where all headers of a topic say zero.

A scanner's place comes from `/tf_static`, seen from the frame that the odometry moves; where it is
not told there, the scanner is taken to be at the pose.
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
from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.logs.readers.ros_bag import TRANSFORMS, Bag, Topic, open_bag, recognise_bag
from comparisons.logs.readers.ros_messages import (
    Sweep,
    cloud,
    frame,
    planar_pose,
    rigid_motion,
    stamp_ns,
    sweep,
)
from comparisons.logs.readers.scan_odometry import poses_at, scan_log
from comparisons.logs.scans import Clouds, Mount, Scans

_LASER, _CLOUD, _ODOMETRY = (
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/PointCloud2",
    "nav_msgs/msg/Odometry",
)
_BASES = ("base_link", "base_footprint")
_MOST_POINTS = 50_000_000
_ANGLE_TOLERANCE_RAD = 1e-3
_LEVEL = np.cos(np.deg2rad(5.0))

Times = NDArray[np.int64]
_T = TypeVar("_T")


@dataclass(frozen=True)
class _Stream:
    """A topic's messages that have a time of their own: time_ns (N,), N items, one frame."""

    topic: Topic
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
    return recognise_bag(path) is not None


def read(path: Path, topics: tuple[str, ...] = ()) -> Log:
    """Read a bag; times count from the first scan, poses from the vehicle's there.

    Scans before and after the odometry are left out. Raises InputError naming topic, message, value
    and expectation, and where the package `rosbags` is not installed.
    """
    with open_bag(path) as bag:
        provenance = {"file": path.name}
        laser = _scan_stream(bag, provenance)
        points = _cloud_stream(bag, provenance)
        moved = _stream(bag, _ODOMETRY, planar_pose, lambda m: m.child_frame_id, provenance)
        transforms = _static_transforms(bag)
    found = [stream for stream in (laser, points) if stream is not None]
    if not found:
        raise InputError(f"{path}: no messages of type {_LASER} or {_CLOUD}, expected some")
    if moved is not None:
        first, last = moved.time_ns[[0, -1]].tolist()
        laser, points = (s and s.within(first, last) for s in (laser, points))
    kept = [stream for stream in (laser, points) if stream is not None]
    if not kept:
        raise InputError(f"{path}: no scan lies within the time of the odometry")
    instants = np.unique(np.concatenate([stream.time_ns for stream in kept]))
    start = int(instants[0])
    time_s = (instants - start) / 1e9
    pose = None
    if moved is not None:
        pose = poses_at(time_s, (moved.time_ns - start) / 1e9, np.array(moved.items))
    base = _base(moved, transforms)
    scans = clouds = None
    try:
        if laser is not None:
            place = _place(laser, base, transforms, "scans_mount", provenance)
            scans = _scans(laser, start, place)
        if points is not None:
            place = _place(points, base, transforms, "clouds_mount", provenance)
            clouds = _clouds(points, start, place)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    outside = sum(len(s.items) for s in found) - sum(len(s.items) for s in kept)
    provenance |= {
        "time_origin_s": f"{start // 10**9}.{start % 10**9:09d}",
        "left_out": f"{outside} scans outside the odometry",
    }
    return scan_log(path.stem, "rosbag", time_s, pose, provenance, scans=scans, clouds=clouds)


def _stream(
    bag: Bag,
    kind: str,
    convert: Callable[[Any, str], _T],
    frame_of: Callable[[Any], str],
    provenance: dict[str, str],
) -> _Stream | None:
    """The messages of the topic that has the most, repeated times left out."""
    topics = bag.topics(kind)
    if not topics:
        return None
    topic = topics[0]
    others = ", ".join(f"{t.name} ({t.count})" for t in topics[1:10])
    told = f"{topic.name}, {topic.count} messages" + (f"; not read: {others}" if others else "")
    items, stamps, recorded, frames = [], [], [], []
    for place, recorded_ns, message in bag.messages(topic):
        items.append(convert(message, place))
        stamps.append(stamp_ns(message))
        recorded.append(recorded_ns)
        frames.append(frame(frame_of(message)))
        if frames[-1] != frames[0]:
            raise InputError(
                f"{place}: frame is {frames[-1]}, expected {frames[0]} as in the first"
            )
    if not items:
        return None
    if not any(stamps):
        stamps, told = recorded, told + "; times of recording, the headers hold none"
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
        told += f"; {len(items) - len(fresh)} with a repeated time left out"
    provenance[kind.rsplit("/", 1)[1]] = told
    return _Stream(
        topic,
        np.array([stamps[row] for row in fresh], dtype=np.int64),
        [items[row] for row in fresh],
        frames[0],
    )


def _scan_stream(bag: Bag, provenance: dict[str, str]) -> _Stream | None:
    """LaserScan messages, whose beams must not change."""
    first: list[Sweep] = []

    def convert(message: Any, place: str) -> Sweep:
        found = sweep(message, place)
        if not first:
            first.append(found)
        angle, expected = found.angle_rad, first[0].angle_rad
        ends = (0, -1)
        if len(angle) != len(expected) or any(
            abs(angle[i] - expected[i]) > _ANGLE_TOLERANCE_RAD for i in ends
        ):
            raise InputError(
                f"{place}: {len(angle)} beams from {angle[0]:.4g} to {angle[-1]:.4g} rad, expected "
                f"{len(expected)} from {expected[0]:.4g} to {expected[-1]:.4g} as in the first"
            )
        return found

    return _stream(bag, _LASER, convert, lambda m: m.header.frame_id, provenance)


def _cloud_stream(bag: Bag, provenance: dict[str, str]) -> _Stream | None:
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

    return _stream(bag, _CLOUD, convert, lambda m: m.header.frame_id, provenance)


def _scans(stream: _Stream, start: int, place: Array) -> Scans:
    """With the scanner's place (4, 4) seen from the pose; upside down turns the beams' order."""
    level = place[2, 2]
    if abs(level) < _LEVEL:
        tilt = np.degrees(np.arccos(abs(level)))
        raise InputError(
            f"{stream.topic.name}: mounted at a tilt of {tilt:.1f} degrees, expected at most 5"
        )
    sweeps: list[Sweep] = stream.items
    return Scans(
        time_s=(stream.time_ns - start) / 1e9,
        angle_rad=np.sign(level) * sweeps[0].angle_rad,
        range_m=np.array([s.range_m for s in sweeps]),
        intensity=np.array([s.intensity for s in sweeps]),
        mount=Mount(
            float(place[0, 3]), float(place[1, 3]), float(np.arctan2(place[1, 0], place[0, 0]))
        ),
        beam_s=float(np.median([s.beam_s for s in sweeps])),
    )


def _clouds(stream: _Stream, start: int, place: Array) -> Clouds:
    """All points in the pose's frame."""
    parts: list[tuple[Array, Array]] = stream.items
    points = np.concatenate([points for points, _ in parts])
    return Clouds(
        (stream.time_ns - start) / 1e9,
        np.concatenate(([0], np.cumsum([len(points) for points, _ in parts], dtype=np.int64))),
        points @ place[:3, :3].T + place[:3, 3],
        np.concatenate([seconds for _, seconds in parts]),
    )


def _static_transforms(bag: Bag) -> dict[str, tuple[str, Array]]:
    """Each frame's parent, and the motion (4, 4) from the frame into the parent's."""
    found: dict[str, tuple[str, Array]] = {}
    for topic in bag.topics(TRANSFORMS):
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


def _place(
    stream: _Stream,
    base: str,
    transforms: dict[str, tuple[str, Array]],
    key: str,
    provenance: dict[str, str],
) -> Array:
    """(4, 4) from the scanner's frame into the base's; the identity where that is not told."""
    up, down = _upward(stream.frame, transforms), _upward(base, transforms)
    common = next((name for name in up if name in down), None)
    if common is None:
        provenance[key] = f"unknown ({stream.frame} from {base or 'the base'}), taken as the pose"
        return np.eye(4)
    provenance[key] = f"{stream.frame} seen from {base}"
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
