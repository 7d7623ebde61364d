"""The frozen smoother: all states of a log in one linear problem, linearised where the EKF was.

Grade F1 takes the matrices that a filter recorded; grade F2 takes this package's own factors at
the filter's points. An EKF is the exact recursive solution of such a problem, so F1 must equal
the filter and F2 must equal F1, to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
    times,
    whiten,
)
from graphslam.problem import SlamProblem

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class RecordedSteps:
    """N predictions x' = arrived + f (x - departed) + w, w ~ N(0, q), one after the other.

    departed, arrived: (N, p). f, q: (N, p, p).
    """

    departed: Array
    arrived: Array
    f: Array
    q: Array


@dataclass(frozen=True)
class RecordedSightings:
    """M relations residual = jacobian_pose (x - pose) + jacobian_landmark (l - landmark) + v.

    node: (M,) pose and slot: (M,) landmark. pose: (M, p). landmark, residual: (M, 2).
    jacobian_pose: (M, 2, p). jacobian_landmark: (M, 2, 2). covariance: (M, 2, 2) of v.
    """

    node: Index
    slot: Index
    pose: Array
    landmark: Array
    residual: Array
    jacobian_pose: Array
    jacobian_landmark: Array
    covariance: Array


@dataclass(frozen=True)
class RecordedPositions:
    """G relations residual = jacobian_pose (x - pose) + v.

    node: (G,) pose. pose: (G, p). residual: (G, 2). jacobian_pose: (G, 2, p). covariance:
    (G, 2, 2) of v.
    """

    node: Index
    pose: Array
    residual: Array
    jacobian_pose: Array
    covariance: Array


@dataclass(frozen=True)
class FrozenPoints:
    """Where the filter linearised this package's factors, for K poses.

    departed: (K, 3) pose when motion left it; for the last, the filter's final pose.
    arrived: (K, 3) pose predicted on arrival; for the first, the prior.
    For R uses of sightings, a sighting fused in parts counting once a part: sighting: (R,) row in
    the problem, sighting_weight: (R,) share of its information, sighting_pose: (R, 3) and
    sighting_landmark: (R, 2). For positions alike: position, position_weight, position_pose.
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


def recorded_problem(
    prior_pose: Array,
    prior_covariance: Array,
    steps: RecordedSteps,
    until: Index,
    sightings: RecordedSightings,
    positions: RecordedPositions,
) -> LinearProblem:
    """F1: what the filter's own recorded matrices say.

    prior_pose: (p,). prior_covariance: (p, p). until: (K,) steps made when each pose is reached,
    ascending from 0.
    """
    chain = _compose(steps, until)
    p = len(prior_pose)
    identity = np.broadcast_to(np.eye(p), (len(chain.f) + 1, p, p))
    before, after = whiten(chain.q, -chain.f, identity[1:])
    return LinearProblem(
        LinearPrior(prior_pose, whiten(prior_covariance[None], identity[:1])[0][0]),
        LinearMotion(
            chain.departed,
            chain.arrived,
            before,
            after,
            np.zeros_like(chain.arrived),
        ),
        LinearSightings(
            sightings.node,
            sightings.slot,
            sightings.pose,
            sightings.landmark,
            *whiten(
                sightings.covariance,
                sightings.jacobian_pose,
                sightings.jacobian_landmark,
                sightings.residual,
            ),
        ),
        LinearPositions(
            positions.node,
            positions.pose,
            *whiten(positions.covariance, positions.jacobian_pose, positions.residual),
        ),
        LinearSurvey(np.zeros((0, 2)), np.zeros((0, 2, 2))),
    )


def own_problem(problem: SlamProblem, points: FrozenPoints) -> LinearProblem:
    """F2: what this package's factors say at the filter's points.

    Every factor gets variables of its own, so that one gtsam call linearises each where the
    filter did; gtsam's tangents are then turned into additive global errors.
    """
    start = gtsam.Values()
    start.insert(0, gtsam.Pose2(*problem.prior_pose))
    prior = _linearised([prior_factor(0, problem)], start, 3, 3)[0]
    return LinearProblem(
        LinearPrior(problem.prior_pose, prior[:, :3] @ to_tangent(problem.prior_pose[2:3])[0]),
        _own_motion(problem, points),
        _own_sightings(problem, points),
        _own_positions(problem, points),
        LinearSurvey(
            problem.surveyed,
            *whiten(
                problem.surveyed_covariance,
                np.broadcast_to(np.eye(2), problem.surveyed_covariance.shape),
            ),
        ),
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
    return LinearSightings(node, slot, pose, points.sighting_landmark, a, c, b)


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


def _compose(steps: RecordedSteps, until: Index) -> RecordedSteps:
    """Chain the steps between consecutive poses; exact, as nothing is observed in between."""
    count, p = len(until) - 1, steps.departed.shape[1]
    departed, arrived = np.empty((count, p)), np.empty((count, p))
    f, q = np.empty((count, p, p)), np.empty((count, p, p))
    for i in range(count):
        begin, end = int(until[i]), int(until[i + 1])
        total_f, total_q = steps.f[begin], steps.q[begin]
        offset = np.zeros(p)
        for k in range(begin + 1, end):
            step = steps.f[k]
            offset = step @ (offset + steps.arrived[k - 1] - steps.departed[k])
            total_f = step @ total_f
            total_q = step @ total_q @ step.T + steps.q[k]
        departed[i], arrived[i] = steps.departed[begin], steps.arrived[end - 1] + offset
        f[i], q[i] = total_f, total_q
    return RecordedSteps(departed, arrived, f, q)
