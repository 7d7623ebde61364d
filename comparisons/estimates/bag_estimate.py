"""The poses of a topic of a ROS bag as an estimate: Odometry, or stamped poses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError, shorten
from comparisons.logs.odometry_noise import pose_fault
from comparisons.logs.readers import ros_bag
from comparisons.logs.readers.ros_messages import frame, planar_pose, stamp_ns
from comparisons.logs.readers.ros_points import PLANAR, slots_fault
from comparisons.logs.stamps import Nanoseconds

POSES = "geometry_msgs/msg/PoseWithCovarianceStamped"
KINDS = (ros_bag.ODOMETRY, POSES, "geometry_msgs/msg/PoseStamped")
"""Types of messages that may be an estimate."""


class BagEstimate(NamedTuple):
    """time_ns: (K,) since 1970. pose: (K, 3), headings unwrapped. covariance: (K, 3, 3).

    source: topic, type and count. left_out: what was not read or is not used, and why.
    """

    time_ns: Nanoseconds
    pose: Array
    covariance: Array | None
    source: str
    left_out: str


def is_bag(path: Path) -> bool:
    """Return whether a path is a ROS bag, by its content."""
    return ros_bag.recognise_bag(path) is not None


def split_topics(
    estimate: Path, log: Path, topics: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return which of the topics that a user named are of the log, and which of the estimate.

    The last that may be an estimate is the estimate's, if that is a bag. The only other odometry of
    a log in the same bag is then the log's. Raises InputError for a bag that cannot be read.
    """
    if not topics or not is_bag(estimate):
        return topics, ()
    if not is_bag(log):
        return (), topics
    with ros_bag.open_bag(estimate) as bag:
        kinds = bag.kinds()
    chosen = [name for name in topics if kinds.get(name) in KINDS][-1:]
    rest = tuple(name for name in topics if name not in chosen)
    with ros_bag.open_bag(log) as bag:
        moving = [topic.name for topic in bag.topics(ros_bag.ODOMETRY)]
    others = [name for name in moving if name not in chosen]
    if len(moving) > 1 and len(others) == 1 and others[0] not in rest:
        rest = (*rest, others[0])
    return rest, tuple(chosen)


def read_bag_estimate(path: Path, topics: Sequence[str] = ()) -> BagEstimate:
    """Read the poses of a topic. topics: what a user asked for, at most one.

    Raises InputError where the bag has no such topic, or several and none is asked for, and naming
    topic, message, value and expectation.
    """
    with ros_bag.open_bag(path, tuple(topics), KINDS) as bag:
        topic = _topic(bag, path)
        stamps, poses, spreads, frames = [], [], [], set()
        for place, _, message in bag.messages(topic):
            stamps.append(stamp_ns(message))
            poses.append(planar_pose(_pose(message), place))
            spreads.append(getattr(message.pose, "covariance", None))
            frames.add(frame(message.header.frame_id))
            if len(frames) > 1:
                raise InputError(f"{place}: frame is {shorten(frame(message.header.frame_id))}, "
                                 "expected that of the first")  # fmt: skip
    time_ns = np.array(stamps, dtype=np.int64)
    if (np.diff(time_ns) < 0).any():
        row = int(np.flatnonzero(np.diff(time_ns) < 0)[0]) + 1
        raise InputError(f"{path}: {topic.name}, message {row}: expected times that increase")
    if not time_ns.any():
        raise InputError(f"{path}: {topic.name}: the headers hold no times, expected some")
    fresh = np.diff(time_ns, prepend=-1) > 0
    covariance, fault = _covariances(spreads, fresh)
    reported = []
    if not fresh.all():
        count = int((~fresh).sum())
        reported.append(f"{count} of {len(fresh)} poses of {topic.name} repeat the time of the one "
                        "before and were left out")  # fmt: skip
    if fault:
        reported.append(f"pose covariances of {topic.name} {fault}, and are not used")
    pose = np.array(poses)[fresh]
    pose[:, 2] = np.unwrap(pose[:, 2])
    source = f"{topic.name}, {topic.count} messages of {topic.kind}"
    return BagEstimate(time_ns[fresh], pose, covariance, source, "; ".join(reported))


def _topic(bag: ros_bag.Bag, path: Path) -> ros_bag.Topic:
    topics = [topic for kind in KINDS for topic in bag.topics(kind)]
    chosen = [topic for topic in topics if bag.is_chosen(topic)] or topics
    if len(chosen) == 1:
        return chosen[0]
    names = ", ".join(f"{topic.name} ({topic.kind}, {topic.count})" for topic in chosen)
    if not chosen:
        raise InputError(f"{path}: no messages of type {', '.join(KINDS)}, expected an estimate")
    raise InputError(
        f"{path}: {len(chosen)} topics that may be the estimate: {shorten(names, 2000)}; say which "
        "by --topic NAME"
    )


def _pose(message: Any) -> Any:
    """A message's pose without what stands beside it."""
    return getattr(message.pose, "pose", message.pose)


def _covariances(spreads: list[Any], fresh: NDArray[np.bool_]) -> tuple[Array | None, str]:
    """Covariances (K, 3, 3) of the poses that are read, or why there are none."""
    if spreads[0] is None:
        return None, ""
    six = np.array(spreads, dtype=float).reshape(-1, 6, 6)[fresh]
    block = six[:, PLANAR][:, :, PLANAR]
    if fault := slots_fault(six) or pose_fault(block):
        return None, fault
    block = (block + block.transpose(0, 2, 1)) / 2
    singular = int((np.linalg.eigvalsh(block)[:, 0] <= 0.0).sum())
    if singular:
        return None, f"are not positive definite in {singular} of {len(block)}"
    return block, ""
