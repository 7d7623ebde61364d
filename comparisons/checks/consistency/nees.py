"""Normalised estimation error squared, against truth.

Errors are estimate minus truth in the log's frame, additive in x, y and heading, the heading's
wrapped, as are the covariances. A wrong start moves them all alike; distances between landmarks,
and from the last pose to landmarks, do not depend on the frame, and are judged beside them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.checks.accuracy import match_truth
from comparisons.estimates.estimate import Estimate, landmark_blocks
from comparisons.figures import Aside, LeftOut
from comparisons.logs.log import Log
from comparisons.plane import pose_difference
from comparisons.statistics import (
    BlockDeparture,
    Normalised,
    SquaredErrors,
    block_departure,
    chi2_quantile,
    normalise,
)
from ekf_reference.core.blocks import block_diagonal
from ekf_reference.core.geometry import wrap_angle

_SHARE = 0.999
"""Of the sound runs that stay within the limit. The errors of one run depend on each other, hence
the limit of one value, not of an average of independent ones."""
_LEAST_SIGMAS = 5.0
"""A distance shorter than so many of its sigmas is not a linear function of the errors."""


@dataclass(frozen=True, kw_only=True)
class PoseErrors:
    """The poses at the epochs within the truth's time, after the prior's.

    time_s: (n,). error: (n, 3) x, y, heading; sigma: (n, 3), NaN where a variance is negative.
    pose, position, heading: of all three, the first two, and the last, per epoch. Their averages
    over one run are autocorrelated: no band holds for them.
    """

    time_s: Array
    error: Array
    sigma: Array
    pose: Normalised
    position: Normalised
    heading: Normalised

    @cached_property
    def departure(self) -> BlockDeparture | None:
        """Block and stretch that are off, where the poses' NEES passes its limit."""
        mean, dof = self.pose.mean, self.pose.dof
        if mean is None or mean / dof <= limit(dof) ** 2:
            return None
        blocks = {"position": self._errors(self.position), "heading": self._errors(self.heading)}
        return block_departure(self._errors(self.pose), blocks)

    def _errors(self, one: Normalised) -> SquaredErrors:
        return SquaredErrors(self.time_s[one.row], one.squared, np.full(len(one.row), one.dof))


@dataclass(frozen=True, kw_only=True)
class TruthConsistency:
    """NEES against truth, of errors in the log's frame, additive in x, y and wrapped heading.

    None where the log has no such truth, or nothing matches.

    Attributes:
        pose: poses over time.
        position: positions over time.
        heading: headings over time.
        landmarks: each landmark alone.
        map: all landmarks jointly.
        whole: all landmarks and the last pose jointly.
        distance: lengths of a spanning tree over landmarks and last pose, which no frame affects,
            each alone.
        distances: the same lengths jointly.
        too_short: lengths that were left out since they are too short.
        departure: block and stretch that are off, where the poses pass the limit of a verdict.
        poses: the errors over time; no part of a result file.
    """

    pose: Normalised | None = None
    position: Normalised | None = None
    heading: Normalised | None = None
    landmarks: Normalised | None = None
    map: Normalised | None = None
    whole: Normalised | None = None
    distance: Normalised | None = None
    distances: Normalised | None = None
    too_short: int = 0
    departure: LeftOut[BlockDeparture | None] = None
    poses: Aside[PoseErrors | None] = None

    @property
    def places(self) -> Normalised | None:
        """What tells whether the map is right: each landmark in the log's frame.

        Distances between landmarks where only landmarks are true, since then nothing tells where
        the log starts in their frame.
        """
        return self.distance if self.poses is None else self.landmarks


def limit(dof: int) -> float:
    """Root of a mean NEES over its degrees of freedom that a sound run hardly passes."""
    return float(np.sqrt(chi2_quantile(_SHARE, dof) / dof))


def against_truth(estimate: Estimate, log: Log, *, labelled: bool) -> TruthConsistency | None:
    """NEES of an estimate, None when the log knows no truth. labelled: see accuracy.assess."""
    poses, mapped = _pose_errors(estimate, log), _map_errors(estimate, log, labelled)
    if poses is None:
        return mapped
    return replace(
        mapped or TruthConsistency(),
        pose=poses.pose,
        position=poses.position,
        heading=poses.heading,
        departure=poses.departure,
        poses=poses,
    )


def pose_errors(time_s: Array, pose: Array, covariance: Array, true: Array) -> PoseErrors:
    """Poses (n, 3) with covariances (n, 3, 3) against true poses (n, 3)."""
    error = pose_difference(pose, true)
    variance = np.einsum("nii->ni", covariance)
    sigma = np.sqrt(np.where(variance >= 0.0, variance, np.nan))
    parts = (slice(0, 3), slice(0, 2), slice(2, 3))
    whole, position, heading = (normalise(error[:, p], covariance[:, p, p]) for p in parts)
    return PoseErrors(
        time_s=time_s, error=error, sigma=sigma, pose=whole, position=position, heading=heading
    )


def map_errors(
    mean: Array, covariance: Array, true: Array, doubt: Array, *, with_pose: bool
) -> TruthConsistency:
    """The last pose and L landmarks (3 + 2 L,) with their covariance against the truth's.

    doubt: (3 + 2 L, 3 + 2 L) covariance of the truth. with_pose: whether its pose is known.
    """
    error, total = mean - true, covariance + doubt
    error[2] = wrap_angle(error[2])
    places = np.concatenate((mean[None, :2], mean[3:].reshape(-1, 2)))
    ends = spanning_tree(places if with_pose else places[1:]) + (0 if with_pose else 1)
    at, jacobian = distances(mean, ends)
    spread = jacobian @ total @ jacobian.T
    kept = np.flatnonzero(~(at**2 < _LEAST_SIGMAS**2 * np.diag(spread)))
    apart = (at - distances(true, ends)[0])[kept]
    spread = spread[np.ix_(kept, kept)]
    return TruthConsistency(
        landmarks=normalise(error[3:].reshape(-1, 2), landmark_blocks(total)),
        map=normalise(error[None, 3:], total[None, 3:, 3:]),
        whole=normalise(error[None], total[None]) if with_pose else None,
        distance=normalise(apart[:, None], np.diag(spread)[:, None, None]),
        distances=normalise(apart[None], spread[None]) if len(kept) else None,
        too_short=len(at) - len(kept),
    )


def spanning_tree(places: Array) -> Index:
    """(N - 1, 2) ends of the shortest edges that hold places (N, 2) together."""
    from scipy.sparse.csgraph import minimum_spanning_tree  # takes long to load

    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    tree = minimum_spanning_tree(np.maximum(apart, 1e-12)).tocoo()
    return np.column_stack((tree.row, tree.col)).astype(np.intp)


def distances(state: Array, ends: Index) -> tuple[Array, Array]:
    """Distances (E,) between places of a state (3 + 2 L,) and their Jacobian (E, 3 + 2 L).

    ends: (E, 2), 0 for the pose, 1 to L for landmarks.
    """
    column = np.where(ends == 0, 0, 1 + 2 * ends)
    apart = state[column[:, 1, None] + (0, 1)] - state[column[:, 0, None] + (0, 1)]
    length = np.linalg.norm(apart, axis=1)
    along = apart / np.maximum(length, 1e-300)[:, None]
    jacobian, edge = np.zeros((len(ends), len(state))), np.arange(len(ends))
    for axis in (0, 1):
        jacobian[edge, column[:, 0] + axis] = -along[:, axis]
        jacobian[edge, column[:, 1] + axis] = along[:, axis]
    return length, jacobian


def _pose_errors(estimate: Estimate, log: Log) -> PoseErrors | None:
    poses, t = log.truth.poses, estimate.time_s
    if poses is None:
        return None
    initialised = (t >= poses.time_s[0]) & (t > log.prior.time_s)  # the prior itself is no estimate
    known = np.flatnonzero(initialised & (t <= poses.time_s[-1]))
    if not len(known):
        return None
    at, covariance = poses.at(t[known]), estimate.pose_covariance[known]
    return pose_errors(t[known], estimate.pose[known], covariance, at)


def _map_errors(estimate: Estimate, log: Log, labelled: bool) -> TruthConsistency | None:
    table, poses, end_s = log.truth.landmarks, log.truth.poses, estimate.time_s[-1]
    if table is None:
        return None
    ours, theirs = match_truth(estimate, table, labelled=labelled)
    if not len(ours):
        return None
    with_pose = poses is not None and bool(poses.time_s[0] <= end_s <= poses.time_s[-1])
    last = estimate.pose[-1]
    if poses is not None and with_pose:
        last = poses.at(np.array([end_s]))[0]
    state = estimate.layout.columns(ours)
    doubt = np.zeros((len(state), len(state)))
    doubt[3:, 3:] = block_diagonal(table.covariance[theirs])
    return map_errors(
        estimate.joint_mean[state],
        estimate.joint_covariance[np.ix_(state, state)],
        np.concatenate((last, table.position_m[theirs].ravel())),
        doubt,
        with_pose=with_pose,
    )
