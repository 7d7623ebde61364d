"""A whole log as linear least squares: poses, landmarks, and whitened relations between them.

Every relation holds around the points where it was linearised, with noise of unit covariance.
Poses have p entries: three, or as many as a filter's own state has. The unknowns are the additive
global errors around a reference, which sets where they are zero, not what the equations say.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from graphslam.graph_builder import LANDMARK_KEY, ORIENTED_KEY, POSE_KEY
from graphslam.marginals import Marginal, joint_marginal

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


@dataclass(frozen=True, kw_only=True)
class LinearSightings:
    """Of landmark `slot` from pose `node`: a (x - pose) + c (l - landmark) = b + noise.

    node, slot: (M,). pose: (M, p) and landmark: (M, w), where it was linearised. a: (M, w, p).
    c: (M, w, w). b: (M, w). w is 2 for points and 3 for oriented landmarks.
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


@dataclass(frozen=True, kw_only=True)
class LinearTwins:
    """Of two oriented landmarks: a (l - first_place) + c (l' - second_place) = b + noise.

    first, second: (T,) slots. first_place, second_place: (T, 3). a, c: (T, 3, 3). b: (T, 3).
    """

    first: Index
    second: Index
    first_place: Array
    second_place: Array
    a: Array
    c: Array
    b: Array


def no_oriented() -> LinearSightings:
    """No sighting of an oriented landmark."""
    nobody, nothing, square = np.zeros(0, dtype=np.intp), np.zeros((0, 3)), np.zeros((0, 3, 3))
    return LinearSightings(
        node=nobody, slot=nobody, pose=nothing, landmark=nothing, a=square, c=square, b=nothing
    )


def no_twins() -> LinearTwins:
    """No two landmarks are one."""
    nobody, nothing, square = np.zeros(0, dtype=np.intp), np.zeros((0, 3)), np.zeros((0, 3, 3))
    return LinearTwins(
        first=nobody,
        second=nobody,
        first_place=nothing,
        second_place=nothing,
        a=square,
        c=square,
        b=nothing,
    )


@dataclass(frozen=True, kw_only=True)
class LinearProblem:
    """All relations of one log. sightings: of points. oriented: of oriented landmarks."""

    prior: LinearPrior
    motion: LinearMotion
    sightings: LinearSightings
    positions: LinearPositions
    survey: LinearSurvey
    oriented: LinearSightings = field(default_factory=no_oriented)
    twins: LinearTwins = field(default_factory=no_twins)


def solve(
    problem: LinearProblem, poses: Array, landmarks: Array, oriented: Array | None = None
) -> Marginal:
    """The last pose and the landmarks, points first, by elimination of everything else.

    poses: (K, p), landmarks: (L, 2) and oriented: (Q, 3), the reference. A landmark that is NaN
    there is eliminated, too: it was removed on the way. Raises SingularProblemError.
    """
    p = poses.shape[1]
    graph = gtsam.GaussianFactorGraph()
    add, factor = graph.push_back, gtsam.JacobianFactor
    unit = {size: gtsam.noiseModel.Unit.Create(size) for size in {2, 3, p}}
    prior, moves, fixes, survey = problem.prior, problem.motion, problem.positions, problem.survey
    twins = problem.twins
    frames = np.zeros((0, 3)) if oriented is None else oriented
    points = _filled(landmarks, problem.sightings, survey.point)
    frame = _filled(frames, problem.oriented)
    add(factor(POSE_KEY, prior.a, prior.a @ (prior.point - poses[0]), unit[p]))
    b = moves.b + times(moves.a, moves.departed - poses[:-1])
    b += times(moves.c, moves.arrived - poses[1:])
    for key, (a_k, c_k, b_k) in enumerate(zip(moves.a, moves.c, b, strict=True), start=POSE_KEY):
        add(factor(key, a_k, key + 1, c_k, b_k, unit[p]))
    for first_key, places, seen in (
        (LANDMARK_KEY, points, problem.sightings),
        (ORIENTED_KEY, frame, problem.oriented),
    ):
        b = seen.b + times(seen.a, seen.pose - poses[seen.node])
        b += times(seen.c, seen.landmark - places[seen.slot])
        nodes, slots = (POSE_KEY + seen.node).tolist(), (first_key + seen.slot).tolist()
        for pose, place, a_k, c_k, b_k in zip(nodes, slots, seen.a, seen.c, b, strict=True):
            add(factor(pose, a_k, place, c_k, b_k, unit[len(b_k)]))
    b = twins.b + times(twins.a, twins.first_place - frame[twins.first])
    b += times(twins.c, twins.second_place - frame[twins.second])
    keys = (ORIENTED_KEY + twins.first).tolist(), (ORIENTED_KEY + twins.second).tolist()
    for first, second, a_k, c_k, b_k in zip(*keys, twins.a, twins.c, b, strict=True):
        add(factor(first, a_k, second, c_k, b_k, unit[3]))
    b = fixes.b + times(fixes.a, fixes.pose - poses[fixes.node])
    for key, a_k, b_k in zip((POSE_KEY + fixes.node).tolist(), fixes.a, b, strict=True):
        add(factor(key, a_k, b_k, unit[2]))
    b = times(survey.a, survey.point - points[: len(survey.point)])
    for key, (a_k, b_k) in enumerate(zip(survey.a, b, strict=True), start=LANDMARK_KEY):
        add(factor(key, a_k, b_k, unit[2]))
    kept, kept_frames = _there(landmarks), _there(frames)
    keys_kept = [
        POSE_KEY + len(poses) - 1,
        *(LANDMARK_KEY + kept).tolist(),
        *(ORIENTED_KEY + kept_frames).tolist(),
    ]
    start = np.concatenate((poses[-1], landmarks[kept].ravel(), frames[kept_frames].ravel()))
    error = joint_marginal(graph, keys_kept, len(start))
    return Marginal(start + error.mean, error.covariance)


def _there(reference: Array) -> Index:
    """Landmarks (n, w) that were not removed."""
    return np.flatnonzero(~np.isnan(reference[:, 0]))


def _filled(reference: Array, seen: LinearSightings, begun: Array | None = None) -> Array:
    """Landmarks (n, w), those that were removed at a place where one of their relations is.

    begun: (s, w) where the first ones were surveyed.
    """
    places = reference.copy()
    if begun is not None:
        first = places[: len(begun)]
        first[np.isnan(first)] = begun[np.isnan(first)]
    gone = np.isnan(places[seen.slot, 0])
    places[seen.slot[gone]] = seen.landmark[gone]
    return places


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
