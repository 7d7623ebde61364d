"""How well the loops of a graph close: what its odometry says beside what closes them.

For every closure, and for every two measurements of a landmark, the residual is whitened by the
covariance of both sides, the odometry's along its way included: about standard normal where the
graph is right, however far it drifts. No optimum is needed, so that many graphs can be compared.
"""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array, Index, rotations
from comparisons.faults.edges import (
    LANDMARKS,
    POSITIONS,
    EdgeSlot,
    columns,
    inverse,
)
from comparisons.plane import in_own_axes, turned
from graphslam.increments import dead_reckoned, inverse_adjoint
from graphslam.problem import SlamProblem

_UNKNOWN = 1e4
"""Variance of a motion that nothing measured [m^2, rad^2]."""
_MEDIANS = {3: 2.366, 2: 1.386}
"""Of chi-square, by degrees of freedom."""


def loop_sizes(problem: SlamProblem) -> Array:
    """Return medians (k,) of squared residuals by kind of loop, over those of the noise."""
    every = [part for part in _residuals(problem) if len(part)]
    medians = [np.median(np.sum(part**2, axis=1)) / _MEDIANS[part.shape[1]] for part in every]
    return np.array(medians, dtype=float)


def loop_distances(problem: SlamProblem, kinds: tuple[str, ...]) -> Array:
    """Return the residuals (M, 3) of the loops that edges of some kinds close, whitened.

    Args:
        problem: The graph.
        kinds: Of LANDMARKS, POSITIONS and others, as a slot has them.
    """
    closures, landmarks, positions = _residuals(problem)
    if kinds[0] == LANDMARKS:
        some = [landmarks]
    elif kinds[0] == POSITIONS:
        some = [positions]
    else:
        some = [closures, landmarks, positions]
    padded = [np.pad(one, ((0, 0), (0, 3 - one.shape[1]))) for one in some if len(one)]
    return np.concatenate(padded) if padded else np.zeros((0, 3))


def _residuals(problem: SlamProblem) -> tuple[Array, Array, Array]:
    """Whitened residuals of closures (N, 3), landmarks (M, 2), positions (G, 2)."""
    way = _Way(problem)
    return _of_closures(problem, way), _of_landmarks(problem, way), _of_positions(problem, way)


class _Way:
    """Where the odometry leads, and how surely."""

    def __init__(self, problem: SlamProblem) -> None:
        motion, spread = problem.increment, problem.increment_covariance.copy()
        spread[~np.isfinite(spread[:, 0, 0])] = _UNKNOWN * np.eye(3)
        self.poses = dead_reckoned(problem.prior_pose, motion)
        turn = inverse_adjoint(*inverse(self.poses[1:]).T)
        summed = np.cumsum(turn @ spread @ turn.mT, axis=0)
        self._summed = np.concatenate((np.zeros((1, 3, 3)), summed))

    def between(self, first: Index, second: Index) -> tuple[Array, Array]:
        """Motions (N, 3) between poses, and covariances (N, 3, 3) of right perturbations."""
        motion = in_own_axes(self.poses[first], self.poses[second])
        sign = np.where(second >= first, 1.0, -1.0)[:, None, None]
        back = inverse_adjoint(*self.poses[second].T)
        return motion, back @ (sign * (self._summed[second] - self._summed[first])) @ back.mT


def _whitened(residual: Array, covariance: Array) -> Array:
    size = residual.shape[1]
    spread = 0.5 * (covariance + covariance.mT)
    values, axes = np.linalg.eigh(spread)
    scale = np.maximum(values, 1e-12 * np.maximum(values[:, -1:], 1e-300))
    white: Array = np.einsum("nji,nj->ni", axes, residual) / np.sqrt(scale)
    return white.reshape(-1, size)


def _of_closures(problem: SlamProblem, way: _Way) -> Array:
    closed = problem.loop_closures
    motion, spread = way.between(closed.first, closed.second)
    apart = in_own_axes(closed.motion, motion)
    apart[:, 2] = np.angle(np.exp(1j * apart[:, 2]))
    return _whitened(apart, spread + closed.covariance)


def _of_landmarks(problem: SlamProblem, way: _Way) -> Array:
    edges = columns(problem, EdgeSlot("", (LANDMARKS,)))
    order = np.lexsort((edges.first, edges.second))
    landmark = edges.second[order]
    begins = np.flatnonzero(np.diff(landmark, prepend=-1))
    run = np.cumsum(np.diff(landmark, prepend=-1) != 0) - 1
    one, other = order[begins[run]], order
    later = edges.first[other] > edges.first[one]
    one, other = one[later], other[later]
    motion, spread = way.between(edges.first[one], edges.first[other])
    x, y = edges.z[other].T
    apart = edges.z[one] - (motion[:, :2] + turned(edges.z[other], motion[:, 2]))
    rotation = rotations(motion[:, 2])
    slope = np.zeros((len(x), 2, 3))
    slope[:, 0, 0] = slope[:, 1, 1] = 1.0
    slope[:, 0, 2], slope[:, 1, 2] = -y, x
    slope = rotation @ slope
    noise = edges.covariance[one] + rotation @ edges.covariance[other] @ rotation.mT
    return _whitened(apart, noise + slope @ spread @ slope.mT)


def _of_positions(problem: SlamProblem, way: _Way) -> Array:
    at = problem.position_pose
    if problem.open_prior:
        return np.zeros((0, 2))
    _, spread = way.between(np.zeros_like(at), at)
    rotation = rotations(way.poses[at, 2])
    noise = problem.position_covariance + rotation @ spread[:, :2, :2] @ rotation.mT
    noise = noise + problem.prior_covariance[:2, :2]
    return _whitened(problem.position - way.poses[at, :2], noise)
