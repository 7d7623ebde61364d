"""The SLAM problem as a gtsam factor graph."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain

import gtsam
import numpy as np

from graphslam.arrays import Array, Index
from graphslam.layout import POINT, POSE_LANDMARK
from graphslam.problem import PoseLandmarkMeasurements, SlamProblem

POSE_KEY, LANDMARK_KEY, POSE_LANDMARK_KEY = gtsam.symbol("x", 0), POINT.key, POSE_LANDMARK.key
KERNELS = ("none", "huber", "cauchy")
COMPONENTS = ("odometry", "bearing", "range", "position", "pose landmark", "loop closure")
"""Kinds of measurements, each with noise of its own."""


def gaussian(covariance: Array) -> gtsam.noiseModel.Gaussian:
    """Return a noise model with all correlations.

    Args:
        covariance: (n, n), positive definite, in gtsam's order of the residual.

    Returns:
        A full Gaussian.
    """
    return gtsam.noiseModel.Gaussian.Covariance(covariance, False)


def prior_factor(key: int, problem: SlamProblem) -> gtsam.PriorFactorPose2:
    """Return the prior of the first pose, its covariance turned into gtsam's tangent there.

    Args:
        key: Of the pose.
        problem: Has the prior, of the additive global error.

    Returns:
        The factor.
    """
    turn = to_tangent(problem.prior_pose[2:3])[0]
    noise = gaussian(turn @ problem.prior_covariance @ turn.T)
    return gtsam.PriorFactorPose2(key, gtsam.Pose2(*problem.prior_pose), noise)


def motion_factors(
    first: Index, second: Index, motion: Array, covariance: Array, kernel: str = "none"
) -> list[gtsam.BetweenFactorPose2]:
    """Return a factor for each motion between two poses or pose landmarks.

    Args:
        first: (N,) keys.
        second: (N,) keys.
        motion: (N, 3) of the second in the first's frame.
        covariance: (N, 3, 3) of the right perturbation, as gtsam takes it.
        kernel: Of KERNELS.

    Returns:
        N factors.
    """
    return [
        gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*m), robust(gaussian(c), kernel))
        for i, j, m, c in zip(
            first.tolist(), second.tolist(), motion.tolist(), covariance, strict=True
        )
    ]


def measurement_factors(
    poses: Index, landmarks: Index, z: Array, sigma: Array, kernel: str = "none"
) -> list[gtsam.BearingRangeFactor2D]:
    """Return a factor for each measurement of a point; gtsam wants the bearing first.

    Those of equal sigmas share a noise model: a long log's graph takes 0.4 of the memory.

    Args:
        poses: (M,) keys.
        landmarks: (M,) keys.
        z: (M, 2) range and bearing.
        sigma: (M, 2) of these.
        kernel: Of KERNELS.

    Returns:
        M factors.
    """
    diagonal = gtsam.noiseModel.Diagonal.Sigmas
    sigmas, kind = np.unique(sigma[:, ::-1], axis=0, return_inverse=True)
    noise = [robust(diagonal(s), kernel) for s in sigmas]
    return [
        gtsam.BearingRangeFactor2D(i, j, gtsam.Rot2(bearing), r, noise[k])
        for i, j, (r, bearing), k in zip(
            poses.tolist(), landmarks.tolist(), z.tolist(), kind.ravel().tolist(), strict=True
        )
    ]


def position_factor(
    key: int, z: Array, covariance: Array, lever_m: tuple[float, float], kernel: str = "none"
) -> gtsam.NonlinearFactor:
    """Return the factor of an absolute position; our own one only where there is a lever arm.

    Args:
        key: Of the pose.
        z: (2,) of the antenna, east, north [m].
        covariance: (2, 2) [m^2].
        lever_m: The antenna, forward and left of the pose.
        kernel: Of KERNELS.

    Returns:
        The factor; a custom one is slow.
    """
    noise = robust(gaussian(covariance), kernel)
    if lever_m == (0.0, 0.0):
        return gtsam.PoseTranslationPrior2D(key, z, noise)

    def error(
        factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None
    ) -> Array:
        pose = values.atPose2(key)
        rotation = pose.rotation().matrix()
        if jacobians is not None:  # in the pose's tangent: the antenna moves by v + w x lever
            swing = np.array([[1.0, 0.0, -lever_m[1]], [0.0, 1.0, lever_m[0]]])
            jacobians[0] = np.asfortranarray(rotation @ swing)
        difference: Array = pose.translation() + rotation @ np.array(lever_m) - z
        return difference

    return gtsam.CustomFactor(noise, [key], error)


def position_factors(
    problem: SlamProblem, rows: Index, kernel: str = "none"
) -> Iterator[gtsam.NonlinearFactor]:
    """Make the factors of some of a problem's positions.

    Args:
        problem: Whose they are.
        rows: (n,) of them.
        kernel: Of KERNELS.

    Yields:
        n factors.
    """
    p = problem
    for row in rows.tolist():
        key, z, covariance = int(p.position_pose[row]), p.position[row], p.position_covariance[row]
        yield position_factor(POSE_KEY + key, z, covariance, p.lever_m, kernel)


def robust(noise: gtsam.noiseModel.Base, kernel: str) -> gtsam.noiseModel.Base:
    """Return a noise model under a robust kernel, with its usual constant (95 % efficiency).

    Args:
        noise: A Gaussian.
        kernel: Of KERNELS.

    Returns:
        The noise itself for `none`.

    Raises:
        ValueError: There is no such kernel.
    """
    if kernel == "none":
        return noise
    estimator = gtsam.noiseModel.mEstimator
    if kernel == "huber":
        return gtsam.noiseModel.Robust.Create(estimator.Huber.Create(1.345), noise)
    if kernel == "cauchy":
        return gtsam.noiseModel.Robust.Create(estimator.Cauchy.Create(2.385), noise)
    raise ValueError(f"kernel is '{kernel}', expected one of {', '.join(KERNELS)}")


def build_graph(problem: SlamProblem, kernel: str = "none") -> gtsam.NonlinearFactorGraph:
    """Return the graph of a whole problem.

    Pose k has key POSE_KEY + k, point landmark j LANDMARK_KEY + j, pose landmark j
    POSE_LANDMARK_KEY + j.

    Args:
        problem: What is known.
        kernel: Of KERNELS, for all but prior, increments and surveyed landmarks.

    Returns:
        The graph, its factors in the order that `last_poses` describes.
    """
    return graph_of(chain.from_iterable(_factors(problem, kernel)))


def graph_of(factors: Iterable[gtsam.NonlinearFactor]) -> gtsam.NonlinearFactorGraph:
    """Return a graph of factors.

    Args:
        factors: In their order.

    Returns:
        The graph.
    """
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.push_back(factor)
    return graph


def _factors(problem: SlamProblem, kernel: str) -> Iterator[Iterable[gtsam.NonlinearFactor]]:
    """The factors of a problem, kind by kind."""
    p, steps = problem, problem.steps
    first = POSE_KEY + steps
    yield [prior_factor(POSE_KEY, p)]
    yield motion_factors(first, first + 1, p.increment[steps], p.increment_covariance[steps])
    poses, landmarks = POSE_KEY + p.measurement_pose, LANDMARK_KEY + p.measurement_landmark
    yield measurement_factors(poses, landmarks, p.z, p.sigma, kernel)
    yield position_factors(p, np.arange(len(p.position)), kernel)
    yield (
        gtsam.PriorFactorPoint2(key, place, gaussian(covariance))
        for key, (place, covariance) in enumerate(
            zip(p.surveyed, p.surveyed_covariance, strict=True), start=LANDMARK_KEY
        )
    )
    seen, closed, merged = p.pose_landmarks, p.loop_closures, p.pose_landmarks.merges
    first, second = POSE_KEY + seen.pose, POSE_LANDMARK_KEY + seen.landmark
    yield motion_factors(first, second, seen.measured, seen.covariance, kernel)
    own = closed.kernel if kernel == "none" else kernel
    first, second = POSE_KEY + closed.first, POSE_KEY + closed.second
    yield motion_factors(first, second, closed.motion, closed.covariance, own)
    first, second = POSE_LANDMARK_KEY + merged.first, POSE_LANDMARK_KEY + merged.second
    yield motion_factors(first, second, merged.measured, merged.covariance, kernel)


def pieces(
    problem: SlamProblem, graph: gtsam.NonlinearFactorGraph
) -> Callable[[int, int], gtsam.NonlinearFactorGraph]:
    """Cut a graph into pieces.

    Args:
        problem: The graph's.
        graph: One of `build_graph`.

    Returns:
        What gives the factors whose last pose is one of first to end - 1.
    """
    last = last_poses(problem)
    order = np.argsort(last, kind="stable")
    last = last[order]

    def piece(first: int, end: int) -> gtsam.NonlinearFactorGraph:
        rows = order[np.searchsorted(last, first) : np.searchsorted(last, end)]
        return graph_of(map(graph.at, rows.tolist()))

    return piece


def last_poses(problem: SlamProblem) -> Index:
    """Return the last pose that each factor of `build_graph` touches.

    Args:
        problem: The graph's.

    Returns:
        (F,) indices of poses, 0 for priors of landmarks.
    """
    return np.concatenate(
        (
            [0],
            problem.steps + 1,
            problem.measurement_pose,
            problem.position_pose,
            np.zeros(len(problem.surveyed), dtype=np.intp),
            problem.pose_landmarks.pose,
            problem.loop_closures.last,
            problem.pose_landmarks.merges.pose,
        )
    )


def row_components(problem: SlamProblem) -> Index:
    """Return whose noise each scalar row of `build_graph` has, once it is linearised.

    Args:
        problem: The graph's.

    Returns:
        (m,) rows of COMPONENTS, -1 for what is known beforehand (priors) or inferred (merges).
    """
    odometry, bearing, range_, position, template, closure = range(len(COMPONENTS))
    seen = problem.pose_landmarks
    return np.concatenate(
        (
            np.full(3, -1),
            np.full(3 * len(problem.steps), odometry),
            np.tile((bearing, range_), len(problem.z)),
            np.full(2 * len(problem.position), position),
            np.full(2 * len(problem.surveyed), -1),
            np.full(3 * len(seen.measured), template),
            np.full(3 * len(problem.loop_closures.motion), closure),
            np.full(3 * len(seen.merges.measured), -1),
        )
    )


def to_tangent(heading_rad: Array) -> Array:
    """Return the matrices that take additive global pose errors into the pose's own tangent.

    Args:
        heading_rad: (N,) of the poses.

    Returns:
        (N, 3, 3), blkdiag(R^T, 1).
    """
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    turn = np.zeros((len(cos), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = cos
    turn[:, 0, 1] = sin
    turn[:, 1, 0] = -sin
    turn[:, 2, 2] = 1.0
    return turn


def right_perturbation(measured: Array, covariance: Array) -> Array:
    """Return covariances of what is added to x, y, heading as of the right perturbation.

    To first order: from the frame that something is seen from into its own.

    Args:
        measured: (N, 3) x, y, heading in the frame that it is seen from.
        covariance: (N, 3, 3) of the error added to these.

    Returns:
        (N, 3, 3), in the frame of what is measured.
    """
    turn = to_tangent(measured[:, 2])
    return turn @ covariance @ turn.transpose(0, 2, 1)


def to_values(
    poses: Array,
    landmarks: Array,
    seen: Index,
    pose_landmarks: PoseLandmarkMeasurements | None = None,
) -> gtsam.Values:
    """Return gtsam's values of poses and landmarks.

    Args:
        poses: (K, 3).
        landmarks: (L, 2).
        seen: Which landmarks have a value; others must not be in the graph.
        pose_landmarks: Measurements of pose landmarks, which are put where they were first seen.

    Returns:
        The values, with the keys of `build_graph`.
    """
    values = gtsam.Values()
    for key, pose in enumerate(poses.tolist(), start=POSE_KEY):
        values.insert(key, gtsam.Pose2(*pose))
    for landmark_index in seen.tolist():
        values.insert(LANDMARK_KEY + landmark_index, landmarks[landmark_index])
    measured = pose_landmarks or PoseLandmarkMeasurements()
    for row in np.argsort(measured.pose, kind="stable").tolist():
        key = POSE_LANDMARK_KEY + int(measured.landmark[row])
        if not values.exists(key):
            pose = values.atPose2(POSE_KEY + int(measured.pose[row]))
            values.insert(key, pose.compose(gtsam.Pose2(*measured.measured[row])))
    return values


def unwrap(poses: Array, problem: SlamProblem) -> None:
    """Unwrap the headings of poses along the odometry, in place.

    Args:
        poses: (K, 3), changed.
        problem: Has the prior and the increments; a pose's turn is taken within pi of its
            increment's.
    """
    expected = np.concatenate((problem.prior_pose[2:], problem.increment[:, 2]))
    excess = np.diff(poses[:, 2], prepend=0.0) - expected
    poses[:, 2] = np.cumsum(expected + excess - 2.0 * np.pi * np.round(excess / (2.0 * np.pi)))


def from_values(values: gtsam.Values, problem: SlamProblem) -> tuple[Array, Array]:
    """Return poses and points of a solution.

    gtsam wraps headings; they are unwrapped along the odometry, so that a whole turn between two
    poses counts.

    Args:
        values: The solution, with the keys of `build_graph`.
        problem: What was solved.

    Returns:
        Poses (K, 3) and points (L, 2), NaN where a landmark is absent.
    """
    poses = np.array(
        [
            (p.x(), p.y(), p.theta())
            for p in (values.atPose2(POSE_KEY + k) for k in range(problem.pose_count))
        ]
    )
    unwrap(poses, problem)
    landmarks = np.full((problem.landmark_count, 2), np.nan)
    for landmark_index in range(problem.landmark_count):
        if values.exists(LANDMARK_KEY + landmark_index):
            landmarks[landmark_index] = values.atPoint2(LANDMARK_KEY + landmark_index)
    return poses, landmarks


def pose_landmarks_from(values: gtsam.Values, problem: SlamProblem) -> Array:
    """Return the pose landmarks of a solution.

    Args:
        values: The solution, with the keys of `build_graph`.
        problem: What was solved.

    Returns:
        (Q, 3) x, y, heading, wrapped.
    """
    poses = [values.atPose2(POSE_LANDMARK_KEY + j) for j in range(problem.pose_landmarks.count)]
    return np.array([(p.x(), p.y(), p.theta()) for p in poses]).reshape(-1, 3)
