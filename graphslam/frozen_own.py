"""Grade F2 of the frozen smoother: this package's own factors, linearised where the EKF was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from graphslam.graph_builder import (
    increment_factors,
    prior_factor,
    sighting_factors,
    to_tangent,
)
from graphslam.linear_problem import (
    LinearMotion,
    LinearPositions,
    LinearPrior,
    LinearProblem,
    LinearSightings,
    LinearSurvey,
    LinearTwins,
    times,
    whiten,
)
from graphslam.problem import OrientedSightings, SlamProblem, Twins

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class FrozenPairs:
    """Where R relations between two frames were linearised.

    row: (R,) in the problem. weight: (R,) share of its information. first, second: (R, 3), the
    frame that is seen from and the one that is seen.
    """

    row: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    weight: Array = field(default_factory=lambda: np.zeros(0))
    first: Array = field(default_factory=lambda: np.zeros((0, 3)))
    second: Array = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass(frozen=True, kw_only=True)
class FrozenPoints:
    """Where the filter linearised this package's factors, for K poses.

    departed: (K, 3) pose when motion left it; for the last, the filter's final pose.
    arrived: (K, 3) pose predicted on arrival; for the first, the prior.
    For R uses of sightings, a sighting fused in parts counting once a part: sighting: (R,) row in
    the problem, sighting_weight: (R,) share of its information, sighting_pose: (R, 3) and
    sighting_landmark: (R, 2). For positions alike: position, position_weight, position_pose.
    oriented: the same for oriented landmarks, and twins: for those that are one.
    """

    departed: Array
    arrived: Array
    sighting: Index
    sighting_weight: Array
    sighting_pose: Array
    sighting_landmark: Array
    position: Index
    position_weight: Array
    position_pose: Array
    oriented: FrozenPairs = field(default_factory=FrozenPairs)
    twins: FrozenPairs = field(default_factory=FrozenPairs)


def own_problem(problem: SlamProblem, points: FrozenPoints) -> LinearProblem:
    """F2: what this package's factors say at the filter's points.

    Every factor gets variables of its own, so that one gtsam call linearises each where the
    filter did; gtsam's tangents are then turned into additive global errors.
    """
    start = gtsam.Values()
    start.insert(0, gtsam.Pose2(*problem.prior_pose))
    prior = _linearised([prior_factor(0, problem)], start, 3, 3)[0]
    return LinearProblem(
        prior=LinearPrior(
            problem.prior_pose, prior[:, :3] @ to_tangent(problem.prior_pose[2:3])[0]
        ),
        motion=_own_motion(problem, points),
        sightings=_own_sightings(problem, points),
        positions=_own_positions(problem, points),
        survey=LinearSurvey(
            problem.surveyed,
            *whiten(
                problem.surveyed_covariance,
                np.broadcast_to(np.eye(2), problem.surveyed_covariance.shape),
            ),
        ),
        oriented=_own_oriented(problem.oriented, points.oriented),
        twins=_own_twins(problem.oriented.twins, points.twins),
    )


def _own_motion(problem: SlamProblem, points: FrozenPoints) -> LinearMotion:
    departed, arrived = points.departed[:-1], points.arrived[1:]
    first, values = list(range(0, 2 * len(departed), 2)), gtsam.Values()
    for key, before, after in zip(first, departed.tolist(), arrived.tolist(), strict=True):
        values.insert(key, gtsam.Pose2(*before))
        values.insert(key + 1, gtsam.Pose2(*after))
    factors = increment_factors(first, [key + 1 for key in first], problem)
    rows = _linearised(factors, values, 3, 6)
    a, c = rows[:, :, :3] @ to_tangent(departed[:, 2]), rows[:, :, 3:6] @ to_tangent(arrived[:, 2])
    return LinearMotion(departed, arrived, a, c, rows[:, :, 6])


def _own_sightings(problem: SlamProblem, points: FrozenPoints) -> LinearSightings:
    chosen, pose = points.sighting, points.sighting_pose
    sigma = problem.sigma[chosen] / np.sqrt(points.sighting_weight)[:, None]
    used = replace(problem, z=problem.z[chosen], sigma=sigma)
    if problem.own_axes:
        a, c, b = _in_own_axes(used, points)
    else:
        first, values = list(range(0, 2 * len(pose), 2)), gtsam.Values()
        for key, seen_from, landmark in zip(
            first, pose.tolist(), points.sighting_landmark, strict=True
        ):
            values.insert(key, gtsam.Pose2(*seen_from))
            values.insert(key + 1, landmark)
        factors = sighting_factors(first, [key + 1 for key in first], used)
        rows = _linearised(factors, values, 2, 5)
        a, c, b = rows[:, :, :3] @ to_tangent(pose[:, 2]), rows[:, :, 3:5], rows[:, :, 5]
    node, slot = problem.sighting_pose[chosen], problem.sighting_landmark[chosen]
    return LinearSightings(
        node=node, slot=slot, pose=pose, landmark=points.sighting_landmark, a=a, c=c, b=b
    )


def _linearised(
    factors: Sequence[gtsam.NonlinearFactor], values: gtsam.Values, height: int, span: int
) -> Array:
    """(N, height, span + 1) whitened rows of equal factors, right-hand side last.

    Each factor has variables of its own, `span` numbers, with keys in the factors' order.
    """
    rows = np.zeros((len(factors), height, span + 1))
    if not factors:
        return rows
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.push_back(factor)
    entries = graph.linearize(values).sparseJacobian_()
    row, column = entries[:2].astype(np.intp) - 1
    which, local = np.divmod(row, height)
    place = np.where(column == span * len(factors), span, column - span * which)
    rows[which, local, place] = entries[2]
    return rows


def _in_own_axes(used: SlamProblem, points: FrozenPoints) -> tuple[Array, Array, Array]:
    """Sightings as points in the vehicle's axes, in closed form: residual z - R^T (l - p).

    The noise is that of range and bearing, carried over at the measurement.
    """
    r, cos, sin = used.z[:, 0], np.cos(used.z[:, 1]), np.sin(used.z[:, 1])
    root = np.empty((len(r), 2, 2))  # of the noise: its columns along and across the ray
    root[:, 0, 0], root[:, 1, 0] = cos * used.sigma[:, 0], sin * used.sigma[:, 0]
    root[:, 0, 1], root[:, 1, 1] = -r * sin * used.sigma[:, 1], r * cos * used.sigma[:, 1]
    heading = points.sighting_pose[:, 2]
    into = np.empty_like(root)  # R^T, global to forward and left
    into[:, 0, 0] = into[:, 1, 1] = np.cos(heading)
    into[:, 0, 1], into[:, 1, 0] = np.sin(heading), -np.sin(heading)
    expected = times(into, points.sighting_landmark - points.sighting_pose[:, :2])
    by_pose = np.empty((len(r), 2, 3))
    by_pose[:, :, :2] = -into
    by_pose[:, 0, 2], by_pose[:, 1, 2] = expected[:, 1], -expected[:, 0]
    residual = np.column_stack((r * cos, r * sin)) - expected
    whitened = np.linalg.solve(root, np.concatenate((by_pose, into, residual[..., None]), axis=2))
    rows: Array = whitened.astype(np.float64, copy=False)
    return rows[:, :, :3], rows[:, :, 3:5], rows[:, :, 5]


def _own_positions(problem: SlamProblem, points: FrozenPoints) -> LinearPositions:
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
    return LinearPositions(
        problem.position_pose[points.position],
        points.position_pose,
        *whiten(covariance, jacobian, residual),
    )


def _own_oriented(seen: OrientedSightings, at: FrozenPairs) -> LinearSightings:
    """Sightings of oriented landmarks."""
    a, c, b = _frame_in_frame(seen.measured, seen.covariance, at)
    return LinearSightings(
        node=seen.pose[at.row],
        slot=seen.landmark[at.row],
        pose=at.first,
        landmark=at.second,
        a=a,
        c=c,
        b=b,
    )


def _own_twins(twins: Twins, at: FrozenPairs) -> LinearTwins:
    """Oriented landmarks that are one."""
    a, c, b = _frame_in_frame(twins.measured, twins.covariance, at)
    return LinearTwins(
        first=twins.first[at.row],
        second=twins.second[at.row],
        first_place=at.first,
        second_place=at.second,
        a=a,
        c=c,
        b=b,
    )


def _frame_in_frame(measured: Array, covariance: Array, at: FrozenPairs) -> tuple[Array, ...]:
    """Whitened (R, 3, 3), (R, 3, 3) and (R, 3) of relations between two frames.

    The residual is the difference of x, y, heading, as a filter has it. gtsam's is the logarithm
    of the motion in between; both have the same derivative where there is no residual, so gtsam
    is asked there and its tangent turned. covariance: (N, 3, 3) of the right perturbation.
    """
    expected = np.empty_like(at.first)
    values, factors = gtsam.Values(), []
    unit = gtsam.noiseModel.Unit.Create(3)
    for i, (first, second) in enumerate(zip(at.first.tolist(), at.second.tolist(), strict=True)):
        pair = gtsam.Pose2(*first), gtsam.Pose2(*second)
        between = pair[0].between(pair[1])
        expected[i] = between.x(), between.y(), between.theta()
        values.insert(2 * i, pair[0])
        values.insert(2 * i + 1, pair[1])
        factors.append(gtsam.BetweenFactorPose2(2 * i, 2 * i + 1, between, unit))
    rows = _linearised(factors, values, 3, 6)
    out = to_tangent(expected[:, 2]).transpose(0, 2, 1)
    by_first = out @ rows[:, :, :3] @ to_tangent(at.first[:, 2])
    by_second = out @ rows[:, :, 3:6] @ to_tangent(at.second[:, 2])
    residual = measured[at.row] - expected
    residual[:, 2] = np.pi - np.mod(np.pi - residual[:, 2], 2.0 * np.pi)
    back = to_tangent(measured[at.row, 2]).transpose(0, 2, 1)
    added = back @ covariance[at.row] @ back.transpose(0, 2, 1) / at.weight[:, None, None]
    return whiten(added, by_first, by_second, residual)
