"""Faults of external estimates that leave no trace: of the export, and of what a filter was fed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.checks.grade import joint_rows
from comparisons.estimates.estimate import landmark_blocks
from comparisons.estimates.external import ExternalEstimate
from comparisons.faults.columns import odometry_columns
from comparisons.faults.fault import Feed
from comparisons.faults.tried import TriedFaults
from comparisons.logs.log import LandmarkMeasurements, Log
from graphslam.scan import planar
from research.script import present

Export = Callable[[ExternalEstimate], ExternalEstimate]


def with_joint(given: ExternalEstimate, joint: Array) -> ExternalEstimate:
    """The same with another joint covariance, and the landmarks' own from it."""
    return replace(given, joint_covariance=joint, landmark_covariance=landmark_blocks(joint))


def with_landmarks(given: ExternalEstimate, chosen: NDArray[np.intp]) -> ExternalEstimate:
    """The same with some of the landmarks, in another order."""
    rows, joint = joint_rows(chosen), present(given.joint_covariance)
    ids, places = present(given.landmark_id)[chosen], present(given.landmark)[chosen]
    return with_joint(replace(given, landmark_id=ids, landmark=places), joint[np.ix_(rows, rows)])


def with_poses(given: ExternalEstimate, chosen: NDArray[np.intp]) -> ExternalEstimate:
    """The same with some of the poses."""
    return replace(
        given,
        time_s=given.time_s[chosen],
        pose=given.pose[chosen],
        pose_covariance=present(given.pose_covariance)[chosen],
    )


def of_poses(change: Callable[[Array], Array]) -> Export:
    """Other covariances of the poses (K, 3, 3), those of the map left alone."""
    return lambda given: replace(given, pose_covariance=change(present(given.pose_covariance)))


def of_joint(change: Callable[[Array], Array]) -> Export:
    """Another covariance (n, n) of last pose and map."""
    return lambda given: with_joint(given, change(present(given.joint_covariance).copy()))


def of_path(change: Callable[[Array], Array]) -> Export:
    """Other poses (K, 3)."""
    return lambda given: replace(given, pose=change(given.pose.copy()))


def of_map(change: Callable[[Array], Array]) -> Export:
    """Other landmarks (L, 2)."""
    return lambda given: replace(given, landmark=change(present(given.landmark).copy()))


def cut(part: Callable[[int], slice]) -> Export:
    """Some of the poses only, by their number."""
    return lambda given: with_poses(given, np.arange(len(given.time_s))[part(len(given.time_s))])


def scaled(factor: float) -> Export:
    """All covariances times a factor."""
    poses, joint = of_poses(lambda p: factor * p), of_joint(lambda p: factor * p)
    return lambda given: poses(joint(given))


def late(delay_s: float) -> Export:
    """Stamps that are late."""
    return lambda given: replace(given, time_s=given.time_s + delay_s)


def about_start(change: Callable[[Array], Array], turn: float = 0.0) -> Export:
    """Other places (N, 2) of path and map, as seen from the start, and headings turned."""

    def export(given: ExternalEstimate) -> ExternalEstimate:
        start = given.pose[0, :2]
        place = start + change(given.pose[:, :2] - start)
        landmark = start + change(present(given.landmark) - start)
        pose = np.column_stack((place, given.pose[:, 2] + turn))
        return replace(given, pose=pose, landmark=landmark)

    return export


def body_frame(given: ExternalEstimate) -> ExternalEstimate:
    """Pose covariances in the body's frame, as gtsam's marginals are."""
    turn = np.array([planar.rotation(heading) for heading in given.pose[:, 2]])
    return of_poses(lambda p: turn.transpose(0, 2, 1) @ p @ turn)(given)


def _deviations(poses: Array) -> Array:
    found: Array = np.sqrt(np.diagonal(poses, 0, 1, 2))[:, :, None] * np.eye(poses.shape[1])
    return found


def _inverse(covariance: Array) -> Array:
    return np.asarray(np.linalg.inv(covariance), dtype=float)


def _crossed(joint: Array, *, pose: float = 1.0, landmarks: float = 1.0) -> Array:
    """Times numbers: covariances of the pose with landmarks, of landmarks with each other."""
    where = np.concatenate(([0, 0, 0], 1 + np.arange(len(joint) - 3) // 2))
    other = where[:, None] != where
    vehicle = (where == 0)[:, None] | (where == 0)
    joint[other & vehicle] *= pose
    joint[other & ~vehicle] *= landmarks
    return joint


def _reordered(joint: Array) -> Array:
    rows = joint_rows(np.roll(np.arange((len(joint) - 3) // 2), 1))
    found: Array = joint[np.ix_(rows, rows)]
    return found


def _averaged(pose: Array) -> Array:
    kernel = np.ones(5) / 5.0
    padded = np.pad(pose, ((2, 2), (0, 0)), mode="edge")
    return np.column_stack([np.convolve(padded[:, i], kernel, "valid") for i in range(3)])


def _course(pose: Array) -> Array:
    step = np.diff(pose[:, :2], axis=0, append=pose[-1:, :2] + np.diff(pose[-2:, :2], axis=0))
    pose[:, 2] = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    return pose


def _at_axle(pose: Array) -> Array:
    pose[:, :2] -= 0.3 * np.column_stack((np.cos(pose[:, 2]), np.sin(pose[:, 2])))
    return pose


def _wander(pose: Array) -> Array:
    pose[:, :2] += 0.02 * np.random.default_rng(0).standard_normal((len(pose), 2))
    return pose


def _added(values: Array, where: Any, amount: Any) -> Array:
    values[where] += amount
    return values


def _exchanged(landmark: Array) -> Array:
    landmark[[1, 4]] = landmark[[4, 1]]
    return landmark


_DEGREE = float(np.deg2rad(1.0))
EXPORTS: dict[str, Export] = {
    "all covariances 3 times": scaled(3.0),
    "all covariances a third": scaled(1.0 / 3.0),
    "all covariances 1.5 times": scaled(1.5),
    "all covariances two thirds": scaled(1.0 / 1.5),
    "all covariances 1.1 times": scaled(1.1),
    "pose covariances 3 times": of_poses(lambda p: 3.0 * p),
    "pose covariances a third": of_poses(lambda p: p / 3.0),
    "pose covariances in the body's frame": body_frame,
    "pose covariances 10 times, all but the last": of_poses(
        lambda p: np.concatenate((10.0 * p[:-1], p[-1:]))
    ),
    "pose covariances a tenth, all but the last": of_poses(
        lambda p: np.concatenate((0.1 * p[:-1], p[-1:]))
    ),
    "pose covariances without correlations": of_poses(lambda p: p * np.eye(3)),
    "sigmas for variances of poses": of_poses(_deviations),
    "variances of poses squared": of_poses(lambda p: _deviations(p) ** 4),
    "information of poses": of_poses(_inverse),
    "pose covariances in the order heading, x, y": of_poses(
        lambda p: p[:, [2, 0, 1]][:, :, [2, 0, 1]]
    ),
    "pose covariances in the order y, x, heading": of_poses(
        lambda p: p[:, [1, 0, 2]][:, :, [1, 0, 2]]
    ),
    "heading's covariance in degrees": of_poses(
        lambda p: p * np.outer((1.0, 1.0, 57.2958), (1.0, 1.0, 57.2958))
    ),
    "heading's variance 4 times": of_poses(
        lambda p: p * np.outer((1.0, 1.0, 2.0), (1.0, 1.0, 2.0))
    ),
    "pose covariances one scan late": of_poses(lambda p: np.concatenate((p[:1], p[:-1]))),
    "pose covariances ten scans late": of_poses(lambda p: np.concatenate((p[:10], p[:-10]))),
    "the last covariance for all poses": of_poses(lambda p: np.repeat(p[-1:], len(p), axis=0)),
    "the first covariance for all poses": of_poses(lambda p: np.repeat(p[:1], len(p), axis=0)),
    "every tenth pose covariance held": of_poses(lambda p: p[np.arange(len(p)) // 10 * 10]),
    "pose covariances with a floor": of_poses(lambda p: p + np.diag((1e-3, 1e-3, 1e-5))),
    "pose covariances' upper triangle": of_poses(np.triu),
    "pose covariances negative": of_poses(np.negative),
    "landmark covariances 3 times": of_joint(
        lambda p: p * np.outer(*[np.where(np.arange(len(p)) < 3, 1.0, 3.0**0.5)] * 2)
    ),
    "covariances of pose and map dropped": of_joint(lambda p: _crossed(p, pose=0.0)),
    "covariances between landmarks dropped": of_joint(lambda p: _crossed(p, landmarks=0.0)),
    "all cross-covariances dropped": of_joint(lambda p: _crossed(p, pose=0.0, landmarks=0.0)),
    "covariances of pose and map negated": of_joint(lambda p: _crossed(p, pose=-1.0)),
    "landmark covariances in another order": of_joint(_reordered),
    "sigmas for variances of the map": of_joint(lambda p: np.diag(np.sqrt(np.diag(p)))),
    "information of the map": of_joint(_inverse),
    "correlations for covariances": of_joint(
        lambda p: p / np.sqrt(np.outer(np.diag(p), np.diag(p)))
    ),
    "frame shifted by 0.1 m": about_start(lambda p: p + 0.1),
    "frame turned by 0.5 degrees": about_start(
        lambda p: planar.moved(np.array((0.0, 0.0, 0.5 * _DEGREE)), p), 0.5 * _DEGREE
    ),
    "headings off by 1 degree": of_path(lambda p: _added(p, np.s_[:, 2], _DEGREE)),
    "headings clockwise": of_path(lambda p: p * (1.0, 1.0, -1.0)),
    "headings from the course": of_path(_course),
    "x and y exchanged": of_path(lambda p: p[:, [1, 0, 2]]),
    "mirrored path": of_path(lambda p: p * (1.0, -1.0, -1.0)),
    "stamps one sample late": late(0.025),
    "stamps one scan late": late(0.2),
    "path 0.5 % too large": about_start(lambda p: 1.005 * p),
    "path 0.1 % too large": about_start(lambda p: 1.001 * p),
    "path of another point": of_path(_at_axle),
    "path averaged over five poses": of_path(_averaged),
    "path rounded to 0.1 m": of_path(lambda p: np.round(p, 1)),
    "path in half precision": of_path(lambda p: p.astype(np.float16).astype(float)),
    "one pose off by 0.5 m": of_path(lambda p: _added(p, (len(p) // 2, 0), 0.5)),
    "2 cm of noise on the path": of_path(_wander),
    "path cut at 60 %": cut(lambda n: slice(0, 6 * n // 10)),
    "path starts at 40 %": cut(lambda n: slice(4 * n // 10, n)),
    "two landmarks exchanged": of_map(_exchanged),
    "landmarks' ids off by one": of_map(lambda m: np.roll(m, 1, axis=0)),
    "one landmark off by 0.2 m": of_map(lambda m: _added(m, (2, 0), 0.2)),
    "map shifted by 0.1 m": of_map(lambda m: m + 0.1),
    "a third of the map missing": lambda given: with_landmarks(
        given, np.arange(2 * len(present(given.landmark)) // 3)
    ),
}
"""What exports do to a sound filter's estimate."""


def planted(words: str, number: float | None = None) -> Feed:
    """A fault that is searched for, by how its words begin, or one of those with a number."""

    def feed(log: Log) -> Log:
        if number is None:
            fault = TriedFaults(log).named(words)
        else:
            fault = TriedFaults(log).family(words).member(number)
        return present(fault.feed)(log)

    return feed


def turned(change: Callable[[Array], Array]) -> Feed:
    """Other yaw rates, steering angles, or turns between poses."""
    return lambda log: odometry_columns(log)[-1].changed(log, change)


def kept(rows: Callable[[LandmarkMeasurements], NDArray[np.bool_]]) -> Feed:
    """Some of the measurements only."""
    return lambda log: replace(log, measurements=log.measurements.chosen(rows(log.measurements)))


FEEDS: dict[str, Feed] = {
    "R 3 times": planted("R is", 3.0),
    "R a third": planted("R is", 1.0 / 3.0),
    "the range's sigma doubled": planted("R of the range is", 4.0),
    "Q 3 times": planted("the controls' part of Q is", 3.0),
    "Q a third": planted("the controls' part of Q is", 1.0 / 3.0),
    "every second measurement left out": planted(
        "of the measurements every second, from the second on, is left out"
    ),
    "one landmark ignored": kept(lambda seen: seen.landmark != seen.landmark.min()),
    "measurements of the last 5 s left out": kept(lambda seen: seen.time_s < seen.time_s[-1] - 5.0),
    "measurements beyond 15 m left out": kept(lambda seen: seen.range_m < 15.0),
    "range 1 % too long": planted("the range is", 1.01),
    "range 5 cm too long": planted("the range has a bias", 0.05),
    "bearing off by 0.5 degrees": planted("the bearing has a bias", 0.5 * _DEGREE),
    "speed 1 % too high": planted("the speed is", 1.01),
    "turn 2 % too strong": turned(lambda turn: 1.02 * turn),
    "turn off by 0.2 degrees": turned(lambda turn: turn + 0.2 * _DEGREE),
    "odometry two samples late": planted("the odometry is used 2 samples late, the first twice"),
    "prior's covariance 100 times": planted("the prior's covariance is", 100.0),
    "prior's heading off by 1 degree": lambda log: replace(
        log, prior=replace(log.prior, pose=log.prior.pose + (0.0, 0.0, _DEGREE))
    ),
}
"""What a sound filter may be fed in place of the log."""
