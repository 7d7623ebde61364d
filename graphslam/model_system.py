"""Grade F2 of the frozen smoother: this package's own factors, linearised where the EKF was."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import gtsam
import numpy as np

from graphslam.arrays import Array, Index, wrap_angle
from graphslam.graph_builder import (
    graph_of,
    measurement_factors,
    motion_factors,
    prior_factor,
    to_tangent,
)
from graphslam.layout import POINT, POSE_LANDMARK, LandmarkKind
from graphslam.linear_problem import (
    LinearPositions,
    LinearPrior,
    LinearProblem,
    LinearRelations,
    LinearSurvey,
    times,
    whiten,
)
from graphslam.problem import SlamProblem

BLOCK = 100_000
"""Measurements that gtsam has as factors at once."""
_Rows = tuple[Array, Array, Array]
"""Whitened a: (R, w, 3), c: (R, w, w) and b: (R, w), as in LinearRelations."""


@dataclass(frozen=True)
class RelationPoints:
    """Where R relations between two states were linearised.

    row: (R,) in the problem; a measurement that was fused in parts counts once a part. weight:
    (R,) share of its information. first: (R, 3), the pose, or the landmark that another one is.
    second: (R, w), the landmark. entries: (R, w) one for each entry of the measurement that is
    used there, else zero; None where all are.
    """

    row: Index
    weight: Array
    first: Array
    second: Array
    entries: Array | None = None

    def part(self, rows: slice) -> RelationPoints:
        """Return some of them."""
        entries = None if self.entries is None else self.entries[rows]
        return RelationPoints(
            self.row[rows], self.weight[rows], self.first[rows], self.second[rows], entries
        )


@dataclass(frozen=True, kw_only=True)
class LinearisationPoints:
    """Where the filter linearised this package's factors, for K poses.

    departed: (K, 3) pose when motion left it; for the last, the filter's final pose.
    arrived: (K, 3) pose predicted on arrival; for the first, the prior.
    measurements: of landmarks, by their kind. merges: of landmarks that are one, by their kind.
    For G uses of positions: position: (G,) row in the problem, position_weight: (G,) share of its
    information, position_pose: (G, 3), position_entries: (G, 2) as of RelationPoints.
    own_axes: the filter fuses measurements as points in the vehicle's axes, where they are linear,
    not as range and bearing; F2 then does, too.
    """

    departed: Array
    arrived: Array
    measurements: Mapping[LandmarkKind, RelationPoints]
    merges: Mapping[LandmarkKind, RelationPoints]
    position: Index
    position_weight: Array
    position_pose: Array
    own_axes: bool = False
    position_entries: Array | None = None


class _Model(NamedTuple):
    """What a problem says of relations of one kind: who is related, and the equations at points."""

    first: Index
    second: Index
    rows: Callable[[RelationPoints], _Rows]

    def at(self, points: RelationPoints) -> LinearRelations:
        """Linearised at these."""
        a, c, b = self.rows(points)
        if (used := points.entries) is not None:
            a, c, b = used[:, :, None] * a, used[:, :, None] * c, used * b
        return LinearRelations(
            first=self.first[points.row],
            second=self.second[points.row],
            first_point=points.first,
            second_point=points.second,
            a=a,
            c=c,
            b=b,
        )

    def moved(self, points: RelationPoints, first: Array, second: Array) -> RelationPoints:
        """Linearised at states (n, 3) and (m, w) instead."""
        rows = points.row
        return replace(points, first=first[self.first[rows]], second=second[self.second[rows]])


def model_system(problem: SlamProblem, points: LinearisationPoints) -> LinearProblem:
    """Return F2: what this package's factors say at the filter's points.

    Every factor gets variables of its own, so that one gtsam call linearises each where the
    filter did; gtsam's tangents are then turned into additive global errors.
    """
    start = gtsam.Values()
    start.insert(0, gtsam.Pose2(*problem.prior_pose))
    prior = _linearised([prior_factor(0, problem)], start, 3, 3)[0]
    measurements = _measurement_models(problem, own_axes=points.own_axes)
    merges = _merge_models(problem)
    return LinearProblem(
        prior=LinearPrior(
            problem.prior_pose, prior[:, :3] @ to_tangent(problem.prior_pose[2:3])[0]
        ),
        motion=model_motion(problem, points.departed[:-1], points.arrived[1:]),
        measurements={
            kind: measurements[kind].at(used) for kind, used in points.measurements.items()
        },
        merges={k: merges[k].at(used) for k, used in points.merges.items()},
        positions=_positions(problem, points),
        survey=LinearSurvey(
            problem.surveyed,
            *whiten(
                problem.surveyed_covariance,
                np.broadcast_to(np.eye(2), problem.surveyed_covariance.shape),
            ),
        ),
    )


def model_motion(problem: SlamProblem, departed: Array, arrived: Array) -> LinearRelations:
    """Return a problem's N increments, linearised at poses (N, 3) departed from and arrived at."""
    pose = np.arange(len(departed) + 1)
    motion = _Model(pose[:-1], pose[1:], partial(_increments, problem))
    return motion.at(RelationPoints(pose[:-1], np.ones(len(departed)), departed, arrived))


def moved_to(
    points: LinearisationPoints,
    problem: SlamProblem,
    poses: Array,
    landmarks: Mapping[LandmarkKind, Array],
) -> LinearisationPoints:
    """Return the same uses of measurements, linearised at one estimate.

    Args:
        points: where the filter linearised them.
        problem: of which they are.
        poses: (K, 3).
        landmarks: (n, w) of each kind, merged ones among them.
    """
    measurements = _measurement_models(problem, own_axes=points.own_axes)
    merges = _merge_models(problem)
    return replace(
        points,
        departed=poses,
        arrived=poses,
        measurements={
            kind: measurements[kind].moved(used, poses, landmarks[kind])
            for kind, used in points.measurements.items()
        },
        merges={
            kind: merges[kind].moved(used, landmarks[kind], landmarks[kind])
            for kind, used in points.merges.items()
        },
        position_pose=poses[problem.position_pose[points.position]],
    )


def _measurement_models(problem: SlamProblem, *, own_axes: bool) -> dict[LandmarkKind, _Model]:
    """Of each kind of landmark."""
    seen = problem.pose_landmarks
    return {
        POINT: _Model(
            problem.measurement_pose,
            problem.measurement_landmark,
            partial(_in_blocks, partial(_in_own_axes if own_axes else _range_bearing, problem)),
        ),
        POSE_LANDMARK: _Model(
            seen.pose, seen.landmark, partial(_pose_in_pose, seen.measured, seen.covariance)
        ),
    }


def _merge_models(problem: SlamProblem) -> dict[LandmarkKind, _Model]:
    """Of each kind of landmark that can be merged."""
    same = problem.pose_landmarks.merges
    return {
        POSE_LANDMARK: _Model(
            same.first, same.second, partial(_pose_in_pose, same.measured, same.covariance)
        )
    }


def _increments(problem: SlamProblem, at: RelationPoints) -> _Rows:
    first = 2 * np.arange(len(at.row))
    factors = motion_factors(first, first + 1, problem.increment, problem.increment_covariance)
    rows = _linearised_pairs(factors, at.first, at.second)
    a = rows[:, :, :3] @ to_tangent(at.first[:, 2])
    c = rows[:, :, 3:6] @ to_tangent(at.second[:, 2])
    return a, c, rows[:, :, 6]


def _in_blocks(rows: Callable[[RelationPoints], _Rows], at: RelationPoints) -> _Rows:
    """The same as rows(at), of BLOCK measurements at a time."""
    if len(at.row) <= BLOCK:
        return rows(at)
    parts = [
        rows(at.part(part)) for part in (slice(i, i + BLOCK) for i in range(0, len(at.row), BLOCK))
    ]
    a, c, b = (np.concatenate(column) for column in zip(*parts, strict=True))
    return a, c, b


def _range_bearing(problem: SlamProblem, at: RelationPoints) -> _Rows:
    """Measurements of points as range and bearing."""
    sigma = problem.sigma[at.row] / np.sqrt(at.weight)[:, None]
    first = 2 * np.arange(len(at.row))
    factors = measurement_factors(first, first + 1, problem.z[at.row], sigma)
    rows = _linearised_pairs(factors, at.first, at.second, POINT)
    if at.entries is not None:
        rows = rows[:, ::-1]  # gtsam's have the bearing first
    return rows[:, :, :3] @ to_tangent(at.first[:, 2]), rows[:, :, 3:5], rows[:, :, 5]


def _in_own_axes(problem: SlamProblem, at: RelationPoints) -> _Rows:
    """Measurements as points in the vehicle's axes, in closed form: residual z - R^T (l - p).

    The noise is that of range and bearing, carried over at the measurement.
    """
    r, bearing = problem.z[at.row].T
    cos, sin = np.cos(bearing), np.sin(bearing)
    sigma_range, sigma_bearing = (problem.sigma[at.row] / np.sqrt(at.weight)[:, None]).T
    root = np.empty((len(r), 2, 2))  # of the noise: its columns along and across the ray
    root[:, 0, 0], root[:, 1, 0] = cos * sigma_range, sin * sigma_range
    root[:, 0, 1], root[:, 1, 1] = -r * sin * sigma_bearing, r * cos * sigma_bearing
    heading = at.first[:, 2]
    into = np.empty_like(root)  # R^T, global to forward and left
    into[:, 0, 0] = into[:, 1, 1] = np.cos(heading)
    into[:, 0, 1], into[:, 1, 0] = np.sin(heading), -np.sin(heading)
    expected = times(into, at.second - at.first[:, :2])
    by_pose = np.empty((len(r), 2, 3))
    by_pose[:, :, :2] = -into
    by_pose[:, 0, 2], by_pose[:, 1, 2] = expected[:, 1], -expected[:, 0]
    residual = np.column_stack((r * cos, r * sin)) - expected
    whitened = np.linalg.solve(root, np.concatenate((by_pose, into, residual[..., None]), axis=2))
    rows: Array = whitened.astype(np.float64, copy=False)
    return rows[:, :, :3], rows[:, :, 3:5], rows[:, :, 5]


def _pose_in_pose(measured: Array, covariance: Array, at: RelationPoints) -> _Rows:
    """Relations between two poses, or pose landmarks.

    The residual is the difference of x, y, heading, as a filter has it. gtsam's is the logarithm
    of the motion in between; both have the same derivative where there is no residual, so gtsam
    is asked there and its tangent turned. covariance: (N, 3, 3) of the right perturbation.
    """
    expected, factors = np.empty_like(at.first), []
    unit = gtsam.noiseModel.Unit.Create(3)
    for i, (first, second) in enumerate(zip(at.first.tolist(), at.second.tolist(), strict=True)):
        between = gtsam.Pose2(*first).between(gtsam.Pose2(*second))
        expected[i] = between.x(), between.y(), between.theta()
        factors.append(gtsam.BetweenFactorPose2(2 * i, 2 * i + 1, between, unit))
    rows = _linearised_pairs(factors, at.first, at.second)
    out = to_tangent(expected[:, 2]).transpose(0, 2, 1)
    by_first = out @ rows[:, :, :3] @ to_tangent(at.first[:, 2])
    by_second = out @ rows[:, :, 3:6] @ to_tangent(at.second[:, 2])
    residual = measured[at.row] - expected
    residual[:, 2] = wrap_angle(residual[:, 2])
    back = to_tangent(measured[at.row, 2]).transpose(0, 2, 1)
    added = back @ covariance[at.row] @ back.transpose(0, 2, 1) / at.weight[:, None, None]
    a, c, b = whiten(added, by_first, by_second, residual)
    return a, c, b


def _positions(problem: SlamProblem, points: LinearisationPoints) -> LinearPositions:
    """Position fixes, in closed form: the antenna is at p + R lever."""
    forward, left = problem.lever_m
    cos, sin = np.cos(points.position_pose[:, 2]), np.sin(points.position_pose[:, 2])
    arm = np.column_stack((cos * forward - sin * left, sin * forward + cos * left))
    jacobian = np.zeros((len(arm), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -arm[:, 1], arm[:, 0]
    residual = problem.position[points.position] - points.position_pose[:, :2] - arm
    covariance = problem.position_covariance[points.position]
    covariance = covariance / points.position_weight[:, None, None]
    if (used := points.position_entries) is not None:
        jacobian, residual = used[:, :, None] * jacobian, used * residual
        off = used[:, :, None] * used[:, None, :]
        covariance = np.where(off > 0.0, covariance, np.eye(2))
    return LinearPositions(
        problem.position_pose[points.position],
        points.position_pose,
        *whiten(covariance, jacobian, residual),
    )


def _linearised_pairs(
    factors: Sequence[gtsam.NonlinearFactor],
    first: Array,
    second: Array,
    kind: LandmarkKind = POSE_LANDMARK,
) -> Array:
    """(N, w, 3 + w + 1) whitened rows of factors i between keys 2 i and 2 i + 1, as _linearised.

    first: (N, 3) poses. second: (N, w) poses, or landmarks of the kind.
    """
    values = gtsam.Values()
    for i, (pose, other) in enumerate(zip(first.tolist(), second, strict=True)):
        values.insert(2 * i, gtsam.Pose2(*pose))
        values.insert(2 * i + 1, other if kind == POINT else gtsam.Pose2(*other.tolist()))
    return _linearised(factors, values, kind.width, 3 + kind.width)


def _linearised(
    factors: Sequence[gtsam.NonlinearFactor], values: gtsam.Values, height: int, span: int
) -> Array:
    """(N, height, span + 1) whitened rows of equal factors, right-hand side last.

    Each factor has variables of its own, `span` numbers, with keys in the factors' order.
    """
    rows = np.zeros((len(factors), height, span + 1))
    if not factors:
        return rows
    entries = graph_of(factors).linearize(values).sparseJacobian_()
    row, column = entries[:2].astype(np.intp) - 1
    which, local = np.divmod(row, height)
    place = np.where(column == span * len(factors), span, column - span * which)
    rows[which, local, place] = entries[2]
    return rows
