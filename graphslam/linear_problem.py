"""A whole log as linear least squares: poses, landmarks, and whitened relations between them.

Every relation holds around the points where it was linearised, with noise of unit covariance.
Poses have p entries: three, or as many as a filter's own state has. The unknowns are the additive
global errors around a reference, which sets where they are zero, not what the equations say.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from graphslam.arrays import Array, Index, Marginal
from graphslam.graph_builder import POSE_KEY
from graphslam.layout import POINT, LandmarkKind
from graphslam.marginals import joint_marginal


@dataclass(frozen=True)
class LinearPrior:
    """The first pose: a (x - point) = noise.

    point: (p,). a: (p, p). sigma: (p,) as in LinearRelations.
    """

    point: Array
    a: Array
    sigma: Array | None = None


@dataclass(frozen=True, kw_only=True)
class LinearRelations:
    """Between two states: a (x - first_point) + c (y - second_point) = b + noise, M of them.

    x is a pose of p entries, or a landmark where two landmarks are one. y is the next pose, or a
    landmark of w entries.

    first, second: (M,) indices of x and y. first_point: (M, p) and second_point: (M, w), where
    the relation was linearised. a: (M, w, p). c: (M, w, w). b: (M, w). sigma: (M, w) of the noise
    of each row: one, or zero where the row holds exactly; None where all are one.
    """

    first: Index
    second: Index
    first_point: Array
    second_point: Array
    a: Array
    c: Array
    b: Array
    sigma: Array | None = None


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
class LinearProblem:
    """All relations of one log.

    motion: from each pose to the next. measurements: of landmarks from poses, by the landmarks'
    kind. merges: of two landmarks that are one, by their kind.
    """

    prior: LinearPrior
    motion: LinearRelations
    measurements: Mapping[LandmarkKind, LinearRelations]
    merges: Mapping[LandmarkKind, LinearRelations]
    positions: LinearPositions
    survey: LinearSurvey


class _States(NamedTuple):
    """Poses or landmarks of a kind: the key of the first, and the reference (n, w) of all."""

    key: int
    reference: Array


def solve(
    problem: LinearProblem, poses: Array, landmarks: Mapping[LandmarkKind, Array]
) -> Marginal:
    """Return the joint marginal of the last pose and all landmarks.

    Args:
        problem: the relations.
        poses: (K, p) reference.
        landmarks: (n, w) reference of every kind of landmarks, in the order of the result. A
            landmark that is NaN was removed on the way, and is eliminated, too.

    Raises:
        SingularProblemError: some direction is left without information, or without noise.
    """
    prior, fixes, survey = problem.prior, problem.positions, problem.survey
    chain = _States(POSE_KEY, poses)
    kinds = {
        kind: _States(kind.key, _filled(reference, kind, problem))
        for kind, reference in landmarks.items()
    }
    graph = gtsam.GaussianFactorGraph()
    b = prior.a @ (prior.point - poses[0])
    (model,) = _noises(prior.sigma, 1, len(b))
    graph.push_back(gtsam.JacobianFactor(POSE_KEY, prior.a, b, model))
    _add_relations(graph, problem.motion, chain, chain)
    for kind, seen in problem.measurements.items():
        _add_relations(graph, seen, chain, kinds[kind])
    for kind, merged in problem.merges.items():
        _add_relations(graph, merged, kinds[kind], kinds[kind])
    b = fixes.b + times(fixes.a, fixes.pose - poses[fixes.node])
    _add_unary(graph, POSE_KEY + fixes.node, fixes.a, b)
    surveyed = np.arange(len(survey.point))
    b = times(survey.a, survey.point - kinds[POINT].reference[surveyed])
    _add_unary(graph, kinds[POINT].key + surveyed, survey.a, b)
    keys, start = [POSE_KEY + len(poses) - 1], [poses[-1]]
    for kind, reference in landmarks.items():
        kept = np.flatnonzero(~np.isnan(reference[:, 0]))
        keys += (kind.key + kept).tolist()
        start.append(reference[kept].ravel())
    mean = np.concatenate(start)
    exact = any(one.sigma is not None for one in (prior, problem.motion))
    error = joint_marginal(graph, keys, len(mean), exact=exact)
    return Marginal(mean + error.mean, error.covariance)


def _add_relations(
    graph: gtsam.GaussianFactorGraph, relations: LinearRelations, first: _States, second: _States
) -> None:
    """Add factors in the errors around the references."""
    r = relations
    b = r.b + times(r.a, r.first_point - first.reference[r.first])
    b += times(r.c, r.second_point - second.reference[r.second])
    keys = (first.key + r.first).tolist(), (second.key + r.second).tolist()
    models = _noises(r.sigma, *b.shape)
    for i, j, a_k, c_k, b_k, model in zip(*keys, r.a, r.c, b, models, strict=True):
        graph.push_back(gtsam.JacobianFactor(i, a_k, j, c_k, b_k, model))


def _add_unary(graph: gtsam.GaussianFactorGraph, keys: Index, a: Array, b: Array) -> None:
    """Add a error = b + noise for the states with keys (N,). a: (N, w, p). b: (N, w)."""
    unit = _unit(b.shape[1])
    for key, a_k, b_k in zip(keys.tolist(), a, b, strict=True):
        graph.push_back(gtsam.JacobianFactor(key, a_k, b_k, unit))


def _noises(sigma: Array | None, count: int, size: int) -> list[gtsam.noiseModel.Diagonal]:
    """Of `count` factors of `size` rows each, those that hold exactly as constraints."""
    unit = _unit(size)
    if sigma is None:
        return [unit] * count
    return [
        unit if one.all() else gtsam.noiseModel.Constrained.MixedSigmas(1.0, one)
        for one in sigma.reshape(count, size)
    ]


def _unit(size: int) -> gtsam.noiseModel.Unit:
    return gtsam.noiseModel.Unit.Create(size)


def _filled(reference: Array, kind: LandmarkKind, problem: LinearProblem) -> Array:
    """Landmarks (n, w), those that were removed at a place where one of their relations is."""
    places, known = reference.copy(), []
    if kind == POINT:
        known.append((np.arange(len(problem.survey.point)), problem.survey.point))
    if kind in problem.measurements:
        seen = problem.measurements[kind]
        known.append((seen.second, seen.second_point))
    for landmark, point in known:
        gone = np.isnan(places[landmark, 0])
        places[landmark[gone]] = point[gone]
    return places


def times(matrices: Array, vectors: Array) -> Array:
    """Products (n, i) of stacked matrices (n, i, j) and vectors (n, j)."""
    products: Array = np.einsum("nij,nj->ni", matrices, vectors)
    return products


def whiten(covariance: Array, *arrays: NDArray[np.floating]) -> tuple[Array, ...]:
    """L^-1 of each array, (n, d) or (n, d, c), for stacked covariances L L^T (n, d, d)."""
    return divided(np.linalg.cholesky(covariance), *arrays)


def divided(root: NDArray[np.floating], *arrays: NDArray[np.floating]) -> tuple[Array, ...]:
    """A^-1 of each array, (n, d) or (n, d, c), for stacked matrices A (n, d, d)."""
    found = []
    for array in arrays:
        columns = array if array.ndim == 3 else array[..., None]
        result: Array = np.linalg.solve(root, columns).astype(np.float64, copy=False)
        found.append(result if array.ndim == 3 else result[..., 0])
    return tuple(found)
