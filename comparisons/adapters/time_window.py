"""A part of a log, by seconds from its start."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from comparisons.adapters.motion import motion_between
from comparisons.errors import InputError
from comparisons.logs.log import Log, LoopClosures, Poses, Prior
from comparisons.logs.odometry import Odometry, RelativePoses
from comparisons.logs.scans import Clouds
from comparisons.logs.schema import STREAMS
from graphslam.scan.planar import compose, rotation


def cut_log(log: Log, start_s: float | None = None, end_s: float | None = None) -> Log:
    """Return what lies between two times, the second one excluded, counted from the log's start.

    Times of the records stay. A sample of wheel odometry that holds at the new start begins there;
    of relative poses the part starts at the first pose in it. The prior moves to the new start:
    its pose is the truth's; without truth the one of dead reckoning, and its covariance grown by
    it, where the log has positions or known landmarks, whose frame stays; else the prior's own
    figures hold there, since the frame is free. Raises InputError where nothing is left.
    """
    if not start_s and end_s is None:
        return log
    origin = log.prior.time_s
    first_s = origin + (start_s or 0.0)
    part = f"{start_s or 0.0:g} s " + ("on" if end_s is None else f"to {end_s:g} s")
    last_s = np.inf if end_s is None else origin + end_s
    if first_s >= min(log.end_s, last_s):
        raise InputError(
            f"{log.name}: nothing lies from {part}, expected a part of its {log.duration_s:.3f} s"
        )
    if isinstance(log.odometry, RelativePoses):
        poses = np.concatenate(([origin], log.odometry.time_s))
        first_s = float(poses[min(int(np.searchsorted(poses, first_s)), len(poses) - 1)])
    try:
        return _part(log, first_s, last_s, cut_s=first_s if start_s else -np.inf)
    except InputError as error:
        raise InputError(f"{error} in the part from {part}") from None


def _part(log: Log, first_s: float, last_s: float, *, cut_s: float) -> Log:
    """The records from cut_s to last_s, with a prior at first_s."""
    streams = [stream for stream in STREAMS if not stream.is_truth]
    return replace(
        log,
        prior=_prior(log, first_s),
        **{stream.field: _cut(getattr(log, stream.field), cut_s, last_s) for stream in streams},
        truth=replace(log.truth, poses=log.truth.poses and _around(log.truth.poses, cut_s, last_s)),
        provenance={
            **log.provenance,
            "part": f"{first_s - log.prior.time_s:g} to "
            f"{min(last_s, log.end_s) - log.prior.time_s:g} s of the log",
        },
    )


def _prior(log: Log, first_s: float) -> Prior:
    prior, truth = log.prior, log.truth.poses
    if first_s <= prior.time_s:
        return prior
    if truth is not None and truth.time_s[0] <= first_s <= truth.time_s[-1]:
        return Prior(first_s, truth.at(np.array([first_s]))[0], prior.covariance)
    if log.positions is None and log.known_landmarks is None:
        return Prior(first_s, prior.pose, prior.covariance)
    motion = motion_between(log, np.array([first_s]))
    pose = compose(prior.pose, motion.displacement[0])
    departed = np.eye(3)
    departed[:2, 2] = (prior.pose[1] - pose[1], pose[0] - prior.pose[0])
    arrived = rotation(pose[2])  # the motion's covariance is of the arriving frame
    covariance = departed @ prior.covariance @ departed.T
    covariance += arrived @ motion.covariance[0] @ arrived.T
    return Prior(first_s, pose, (covariance + covariance.T) / 2)


def _odometry(odometry: Odometry, first_s: float, last_s: float) -> Odometry:
    time_s = odometry.time_s
    if isinstance(odometry, RelativePoses):
        return odometry.chosen((time_s > first_s) & (time_s < last_s))
    holding = max(int(np.searchsorted(time_s, first_s, side="right")) - 1, 0)
    kept = odometry.chosen(np.arange(holding, int(np.searchsorted(time_s, last_s))))
    return replace(kept, time_s=np.maximum(kept.time_s, first_s))


def _cut(record: Any, first_s: float, last_s: float) -> Any:
    """A stream's records; all of one without times."""
    if record is None or not record.table.times:
        return record
    if isinstance(record, Odometry):
        return _odometry(record, first_s, last_s)
    if isinstance(record, LoopClosures):
        return _loop_closures(record, first_s, last_s)
    if isinstance(record, Clouds):
        return _clouds(record, first_s, last_s)
    return record.chosen((record.time_s >= first_s) & (record.time_s < last_s))


def _loop_closures(
    loop_closures: LoopClosures, first_s: float, last_s: float
) -> LoopClosures | None:
    """Those both of whose poses are left."""
    ends = np.column_stack((loop_closures.from_s, loop_closures.to_s))
    kept = np.asarray(((ends >= first_s) & (ends < last_s)).all(axis=1))
    return loop_closures.chosen(kept) if kept.any() else None


def _clouds(clouds: Clouds, first_s: float, last_s: float) -> Clouds:
    begin, end = np.searchsorted(clouds.time_s, (first_s, last_s)).tolist()
    first = clouds.first[begin : end + 1]
    points = slice(int(first[0]), int(first[-1]))
    return Clouds(
        clouds.time_s[begin:end], first - first[0], clouds.point_m[points], clouds.point_s[points]
    )


def _around(poses: Poses, first_s: float, last_s: float) -> Poses:
    """With the poses next to both ends, between which the truth there is interpolated."""
    begin = max(int(np.searchsorted(poses.time_s, first_s, side="right")) - 1, 0)
    end = int(np.searchsorted(poses.time_s, last_s)) + 1
    return Poses(poses.time_s[begin:end], poses.pose[begin:end])
