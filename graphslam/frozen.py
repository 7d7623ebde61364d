"""The frozen smoother: all states of a log in one linear problem, linearised where the EKF was.

Grade F1 takes the matrices that a filter recorded; grade F2 takes this package's own factors at
the filter's points. An EKF is the exact recursive solution of such a problem, so F1 must equal
the filter and F2 must equal F1, to rounding.

State: pose nodes, then landmarks; unknowns are the additive global errors around a reference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from graphslam.graph_builder import (
    LANDMARK_KEY,
    POSE_KEY,
    SlamProblem,
    increment_factors,
    prior_factor,
    sighting_factors,
    to_tangent,
)
from graphslam.marginals import Marginal, last_pose_and_landmarks

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class LinearSightings:
    """M relations residual = jacobian_pose (x - point_pose) + jacobian_landmark (l - point) + v.

    step: (M,) motion steps before each. slot: (M,) landmark.
    point_pose: (M, 3). point_landmark, residual: (M, 2). jacobian_pose: (M, 2, 3).
    jacobian_landmark: (M, 2, 2). covariance: (M, 2, 2) of v.
    """

    step: Index
    slot: Index
    point_pose: Array
    point_landmark: Array
    residual: Array
    jacobian_pose: Array
    jacobian_landmark: Array
    covariance: Array


@dataclass(frozen=True)
class LinearPositions:
    """G relations residual = jacobian_pose (x - point_pose) + v.

    step: (G,) motion steps before each. point_pose: (G, 3). residual: (G, 2). jacobian_pose:
    (G, 2, 3). covariance: (G, 2, 2) of v.
    """

    step: Index
    point_pose: Array
    residual: Array
    jacobian_pose: Array
    covariance: Array


@dataclass(frozen=True)
class LinearMotion:
    """N relations x' = arrived + f (x - departed) + w, w ~ N(0, q), one after the other.

    departed, arrived: (N, 3). f, q: (N, 3, 3).
    """

    departed: Array
    arrived: Array
    f: Array
    q: Array


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


def solve_recorded(
    prior_pose: Array,
    prior_covariance: Array,
    motion: LinearMotion,
    sightings: LinearSightings,
    positions: LinearPositions,
    final_pose: Array,
    landmarks: Array,
) -> Marginal:
    """F1: the estimate that the filter's own recorded matrices imply.

    final_pose: (3,) and landmarks: (L, 2), the filter's result, serve as reference only: they
    set where the unknowns are zero, not what the equations say.
    """
    nodes = np.unique(np.concatenate(([0], sightings.step, positions.step, [len(motion.f)])))
    reference = np.vstack((motion.departed, final_pose))[nodes]
    chain = _compose(motion, nodes)
    factors = _Factors(len(nodes), len(landmarks))
    root = np.linalg.cholesky(prior_covariance)
    factors.add_prior(
        _whiten(root[None], np.eye(3)[None])[0],
        _whiten(root[None], (prior_pose - reference[0])[None])[0],
    )
    root = np.linalg.cholesky(chain.q)
    constant = chain.arrived - reference[1:] + _times(chain.f, reference[:-1] - chain.departed)
    factors.add_motion(
        _whiten(root, -chain.f),
        _whiten(root, np.broadcast_to(np.eye(3), chain.f.shape)),
        _whiten(root, constant),
    )
    node = np.searchsorted(nodes, sightings.step)
    root = np.linalg.cholesky(sightings.covariance)
    h_pose, h_landmark = sightings.jacobian_pose, sightings.jacobian_landmark
    constant = (
        sightings.residual
        + _times(h_pose, sightings.point_pose - reference[node])
        + _times(h_landmark, sightings.point_landmark - landmarks[sightings.slot])
    )
    factors.add_sightings(
        node,
        sightings.slot,
        _whiten(root, h_pose),
        _whiten(root, h_landmark),
        _whiten(root, constant),
    )
    node = np.searchsorted(nodes, positions.step)
    root = np.linalg.cholesky(positions.covariance)
    offset = positions.point_pose - reference[node]
    constant = positions.residual + _times(positions.jacobian_pose, offset)
    factors.add_positions(node, _whiten(root, positions.jacobian_pose), _whiten(root, constant))
    return factors.solve(reference[-1], landmarks)


def solve_own_factors(problem: SlamProblem, points: FrozenPoints, landmarks: Array) -> Marginal:
    """F2: the estimate that this package's factors imply at the filter's points.

    Every factor gets variables of its own, so that one gtsam call linearises each where the
    filter did; gtsam's tangents are then turned into additive global errors, and the copies of a
    variable are joined again. landmarks: (L, 2) reference, as in solve_recorded.
    """
    k, m = problem.pose_count, len(points.sighting)
    moves = k - 1
    used = replace(
        problem,
        z=problem.z[points.sighting],
        sigma=problem.sigma[points.sighting] / np.sqrt(points.sighting_weight)[:, None],
    )
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(prior_factor(0, problem))
    values.insert(0, gtsam.Pose2(*problem.prior_pose))
    first = list(range(1, 1 + 2 * moves, 2))
    for between in increment_factors(first, [key + 1 for key in first], problem):
        graph.push_back(between)
    for key, departed, arrived in zip(
        first, points.departed[:-1].tolist(), points.arrived[1:].tolist(), strict=True
    ):
        values.insert(key, gtsam.Pose2(*departed))
        values.insert(key + 1, gtsam.Pose2(*arrived))
    first = list(range(1 + 2 * moves, 1 + 2 * moves + 2 * m, 2))
    for sighting in sighting_factors(first, [key + 1 for key in first], used):
        graph.push_back(sighting)
    for key, pose, landmark in zip(
        first, points.sighting_pose.tolist(), points.sighting_landmark, strict=True
    ):
        values.insert(key, gtsam.Pose2(*pose))
        values.insert(key + 1, landmark)

    entries = graph.linearize(values).sparseJacobian_()
    row, column = entries[:2].astype(np.intp) - 1
    value = entries[2]
    width = 3 + 6 * moves + 5 * m  # unknowns; the next column is the right-hand side
    moved, seen = 3, 3 + 3 * moves  # first rows of the increments and of the sightings

    def block(rows: tuple[int, int], columns: tuple[int, int], height: int, span: int) -> Array:
        """Rows of one kind of factor as (factors, height, span + 1), right-hand side last."""
        inside = (row >= rows[0]) & (row < rows[1])
        factor, local = np.divmod(row[inside] - rows[0], height)
        position = np.where(
            column[inside] == width, span, column[inside] - columns[0] - span * factor
        )
        result = np.zeros(((rows[1] - rows[0]) // height, height, span + 1))
        result[factor, local, position] = value[inside]
        return result

    prior = block((0, 3), (0, 3), 3, 3)[0]
    motion = block((moved, seen), (3, 3 + 6 * moves), 3, 6)
    sightings = block((seen, seen + 2 * m), (3 + 6 * moves, width), 2, 5)

    reference, node = points.departed, problem.sighting_pose[points.sighting]
    slot = problem.sighting_landmark[points.sighting]
    factors = _Factors(k, problem.landmark_count)
    a = prior[:, :3] @ to_tangent(problem.prior_pose[2:3])[0]
    factors.add_prior(a, prior[:, 3] + a @ (problem.prior_pose - reference[0]))
    a = motion[:, :, :3] @ to_tangent(points.departed[:-1, 2])
    c = motion[:, :, 3:6] @ to_tangent(points.arrived[1:, 2])
    offset = _times(c, points.arrived[1:] - reference[1:])
    factors.add_motion(a, c, motion[:, :, 6] + offset)
    a = sightings[:, :, :3] @ to_tangent(points.sighting_pose[:, 2])
    c = sightings[:, :, 3:5]
    offset = _times(a, points.sighting_pose - reference[node]) + _times(
        c, points.sighting_landmark - landmarks[slot]
    )
    factors.add_sightings(node, slot, a, c, sightings[:, :, 5] + offset)
    _add_positions(factors, problem, points)
    root = np.linalg.cholesky(problem.surveyed_covariance)
    factors.add_surveyed(
        _whiten(root, np.broadcast_to(np.eye(2), root.shape)),
        _whiten(root, problem.surveyed - landmarks[: len(problem.surveyed)]),
    )
    return factors.solve(reference[-1], landmarks)


def _add_positions(factors: _Factors, problem: SlamProblem, points: FrozenPoints) -> None:
    """Position fixes, in closed form: the antenna is at p + R lever."""
    forward, left = problem.lever_m
    cos, sin = np.cos(points.position_pose[:, 2]), np.sin(points.position_pose[:, 2])
    arm = np.column_stack((cos * forward - sin * left, sin * forward + cos * left))
    jacobian = np.zeros((len(arm), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -arm[:, 1], arm[:, 0]
    node = problem.position_pose[points.position]
    residual = problem.position[points.position] - points.position_pose[:, :2] - arm
    residual = residual + _times(jacobian, points.position_pose - points.departed[node])
    covariance = problem.position_covariance[points.position]
    root = np.linalg.cholesky(covariance / points.position_weight[:, None, None])
    factors.add_positions(node, _whiten(root, jacobian), _whiten(root, residual))


class _Factors:
    """Whitened linear factors on poses 0..K-1 and landmarks 0..L-1, solved by elimination."""

    def __init__(self, pose_count: int, landmark_count: int) -> None:
        self._poses, self._landmarks = pose_count, landmark_count
        self._graph = gtsam.GaussianFactorGraph()
        self._unit = {size: gtsam.noiseModel.Unit.Create(size) for size in (2, 3)}

    def add_prior(self, a: Array, b: Array) -> None:
        self._graph.push_back(gtsam.JacobianFactor(POSE_KEY, a, b, self._unit[3]))

    def add_motion(self, a: Array, c: Array, b: Array) -> None:
        unit, factor, add = self._unit[3], gtsam.JacobianFactor, self._graph.push_back
        for key, (a_k, c_k, b_k) in enumerate(zip(a, c, b, strict=True), start=POSE_KEY):
            add(factor(key, a_k, key + 1, c_k, b_k, unit))

    def add_sightings(self, node: Index, slot: Index, a: Array, c: Array, b: Array) -> None:
        unit, factor, add = self._unit[2], gtsam.JacobianFactor, self._graph.push_back
        poses, points = (POSE_KEY + node).tolist(), (LANDMARK_KEY + slot).tolist()
        for pose, point, a_k, c_k, b_k in zip(poses, points, a, c, b, strict=True):
            add(factor(pose, a_k, point, c_k, b_k, unit))

    def add_positions(self, node: Index, a: Array, b: Array) -> None:
        for pose, a_k, b_k in zip((POSE_KEY + node).tolist(), a, b, strict=True):
            self._graph.push_back(gtsam.JacobianFactor(pose, a_k, b_k, self._unit[2]))

    def add_surveyed(self, a: Array, b: Array) -> None:
        for key, (a_k, b_k) in enumerate(zip(a, b, strict=True), start=LANDMARK_KEY):
            self._graph.push_back(gtsam.JacobianFactor(key, a_k, b_k, self._unit[2]))

    def solve(self, last_pose: Array, landmarks: Array) -> Marginal:
        """The marginal, its mean in absolute coordinates around the reference given."""
        error = last_pose_and_landmarks(self._graph, self._poses, self._landmarks)
        return Marginal(
            np.concatenate((last_pose, landmarks.ravel())) + error.mean, error.covariance
        )


def _compose(motion: LinearMotion, nodes: Index) -> LinearMotion:
    """Chain the steps between consecutive nodes; exact, as nothing is observed in between."""
    count = len(nodes) - 1
    departed, arrived = np.empty((count, 3)), np.empty((count, 3))
    f, q = np.empty((count, 3, 3)), np.empty((count, 3, 3))
    for i in range(count):
        begin, end = int(nodes[i]), int(nodes[i + 1])
        total_f, total_q = motion.f[begin], motion.q[begin]
        offset = np.zeros(3)
        for k in range(begin + 1, end):
            step = motion.f[k]
            offset = step @ (offset + motion.arrived[k - 1] - motion.departed[k])
            total_f = step @ total_f
            total_q = step @ total_q @ step.T + motion.q[k]
        departed[i], arrived[i] = motion.departed[begin], motion.arrived[end - 1] + offset
        f[i], q[i] = total_f, total_q
    return LinearMotion(departed, arrived, f, q)


def _times(matrices: Array, vectors: Array) -> Array:
    """Products (n, i) of stacked matrices (n, i, j) and vectors (n, j)."""
    products: Array = np.einsum("nij,nj->ni", matrices, vectors)
    return products


def _whiten(root: NDArray[np.floating], array: NDArray[np.floating]) -> Array:
    """L^-1 array for stacked lower-triangular roots (n, d, d) and arrays (n, d) or (n, d, c)."""
    columns = array if array.ndim == 3 else array[..., None]
    result: Array = np.linalg.solve(root, columns).astype(np.float64, copy=False)
    return result if array.ndim == 3 else result[..., 0]
