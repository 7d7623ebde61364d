"""A whole log as linear least squares: poses, landmarks, and whitened relations between them.

Every relation holds around the points where it was linearised, with noise of unit covariance.
Poses have p entries: three, or as many as a filter's own state has. The unknowns are the additive
global errors around a reference, which sets where they are zero, not what the equations say.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY
from graphslam.marginals import Marginal, last_pose_and_landmarks

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class LinearPrior:
    """The first pose: a (x - point) = noise. point: (p,). a: (p, p)."""

    point: Array
    a: Array


@dataclass(frozen=True)
class LinearMotion:
    """From pose k to the next: a (x - departed) + c (x' - arrived) = b + noise, K - 1 of them.

    departed, arrived, b: (K-1, p). a, c: (K-1, p, p).
    """

    departed: Array
    arrived: Array
    a: Array
    c: Array
    b: Array


@dataclass(frozen=True)
class LinearSightings:
    """Of landmark `slot` from pose `node`: a (x - pose) + c (l - landmark) = b + noise.

    node, slot: (M,). pose: (M, p) and landmark: (M, 2), where it was linearised. a: (M, 2, p).
    c: (M, 2, 2). b: (M, 2).
    """

    node: Index
    slot: Index
    pose: Array
    landmark: Array
    a: Array
    c: Array
    b: Array


@dataclass(frozen=True)
class LinearPositions:
    """Of pose `node`: a (x - pose) = b + noise.

    node: (G,). pose: (G, p). a: (G, 2, p). b: (G, 2).
    """

    node: Index
    pose: Array
    a: Array
    b: Array


@dataclass(frozen=True)
class LinearSurvey:
    """Of the first S landmarks: a (l - point) = noise. point: (S, 2). a: (S, 2, 2)."""

    point: Array
    a: Array


@dataclass(frozen=True)
class LinearProblem:
    """All relations of one log."""

    prior: LinearPrior
    motion: LinearMotion
    sightings: LinearSightings
    positions: LinearPositions
    survey: LinearSurvey


def solve(problem: LinearProblem, poses: Array, landmarks: Array) -> Marginal:
    """The last pose and all landmarks, by elimination of the other poses.

    poses: (K, p) and landmarks: (L, 2), the reference. Raises SingularProblemError.
    """
    p = poses.shape[1]
    graph = gtsam.GaussianFactorGraph()
    add, factor = graph.push_back, gtsam.JacobianFactor
    unit = {size: gtsam.noiseModel.Unit.Create(size) for size in {2, p}}
    prior, moves, seen = problem.prior, problem.motion, problem.sightings
    fixes, survey = problem.positions, problem.survey
    add(factor(POSE_KEY, prior.a, prior.a @ (prior.point - poses[0]), unit[p]))
    b = moves.b + times(moves.a, moves.departed - poses[:-1])
    b += times(moves.c, moves.arrived - poses[1:])
    for key, (a_k, c_k, b_k) in enumerate(zip(moves.a, moves.c, b, strict=True), start=POSE_KEY):
        add(factor(key, a_k, key + 1, c_k, b_k, unit[p]))
    b = seen.b + times(seen.a, seen.pose - poses[seen.node])
    b += times(seen.c, seen.landmark - landmarks[seen.slot])
    nodes, slots = (POSE_KEY + seen.node).tolist(), (LANDMARK_KEY + seen.slot).tolist()
    for pose, point, a_k, c_k, b_k in zip(nodes, slots, seen.a, seen.c, b, strict=True):
        add(factor(pose, a_k, point, c_k, b_k, unit[2]))
    b = fixes.b + times(fixes.a, fixes.pose - poses[fixes.node])
    for key, a_k, b_k in zip((POSE_KEY + fixes.node).tolist(), fixes.a, b, strict=True):
        add(factor(key, a_k, b_k, unit[2]))
    b = times(survey.a, survey.point - landmarks[: len(survey.point)])
    for key, (a_k, b_k) in enumerate(zip(survey.a, b, strict=True), start=LANDMARK_KEY):
        add(factor(key, a_k, b_k, unit[2]))
    error = last_pose_and_landmarks(graph, len(poses), len(landmarks), p)
    return Marginal(np.concatenate((poses[-1], landmarks.ravel())) + error.mean, error.covariance)


def times(matrices: Array, vectors: Array) -> Array:
    """Products (n, i) of stacked matrices (n, i, j) and vectors (n, j)."""
    products: Array = np.einsum("nij,nj->ni", matrices, vectors)
    return products


def whiten(covariance: Array, *arrays: NDArray[np.floating]) -> tuple[Array, ...]:
    """L^-1 of each array, (n, d) or (n, d, c), for stacked covariances L L^T (n, d, d)."""
    root = np.linalg.cholesky(covariance)
    whitened = []
    for array in arrays:
        columns = array if array.ndim == 3 else array[..., None]
        result: Array = np.linalg.solve(root, columns).astype(np.float64, copy=False)
        whitened.append(result if array.ndim == 3 else result[..., 0])
    return tuple(whitened)
