"""Covariances out of a Gaussian factor graph, by gtsam's elimination."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from scipy.linalg import solve_triangular

from graphslam.arrays import Array
from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY, POSE_LANDMARK_KEY, to_tangent

PARTS_BEYOND = 2000
"""Numbers to be kept beyond which a graph is eliminated in parts; see elimination."""
_ROUNDING = 1e-13
_UNFIXED = "the measurements do not fix the last pose and every landmark"


class SingularProblemError(ArithmeticError):
    """The measurements leave some direction of the state without information."""


class Marginal(NamedTuple):
    """Mean (n,) and covariance (n, n) of the last pose and all landmarks, points first."""

    mean: Array
    covariance: Array


def eliminate(graph: gtsam.GaussianFactorGraph) -> gtsam.GaussianBayesTree:
    """Eliminate all variables by QR; raises RuntimeError when the graph is singular."""
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(graph)
    return graph.eliminateMultifrontal(ordering, gtsam.EliminateQR)


def last_pose_and_landmarks(
    graph: gtsam.GaussianFactorGraph,
    pose_count: int,
    landmark_count: int,
    pose_landmark_count: int = 0,
) -> Marginal:
    """The joint marginal of the last pose, points and pose landmarks. See joint_marginal."""
    kept = [
        POSE_KEY + pose_count - 1,
        *range(LANDMARK_KEY, LANDMARK_KEY + landmark_count),
        *range(POSE_LANDMARK_KEY, POSE_LANDMARK_KEY + pose_landmark_count),
    ]
    return joint_marginal(graph, kept, 3 + 2 * landmark_count + 3 * pose_landmark_count)


def joint_marginal(graph: gtsam.GaussianFactorGraph, kept: Sequence[int], size: int) -> Marginal:
    """Eliminate all other variables and invert what remains of `kept`, `size` numbers.

    By QR: gtsam's default, Cholesky, squares the condition number, and two measurements a
    millisecond apart would cost half the digits. The result is in the coordinates of the graph's
    own increments. Raises SingularProblemError when some direction is left without information.
    """
    try:
        if size > PARTS_BEYOND:
            from graphslam.elimination import remaining_rows

            jacobian, residual = remaining_rows(graph, kept)
        else:
            jacobian, residual = _remaining(graph, kept)
    except (RuntimeError, ValueError) as error:  # singular, or a landmark never seen
        raise SingularProblemError(_UNFIXED) from error
    if jacobian.shape[1] != size or len(jacobian) < size:
        raise SingularProblemError(_UNFIXED)
    root: Array = np.asarray(np.linalg.qr(np.column_stack((jacobian, residual)), mode="r"))
    r, d = root[:size, :size], root[:size, size]
    scale = np.linalg.norm(r, axis=0)
    if not np.isfinite(root).all() or (np.abs(np.diag(r)) <= _ROUNDING * scale).any():
        raise SingularProblemError(_UNFIXED)
    inverse = solve_triangular(r, np.eye(size))
    return Marginal(inverse @ d, inverse @ inverse.T)


def _remaining(graph: gtsam.GaussianFactorGraph, kept: Sequence[int]) -> tuple[Array, Array]:
    """Return J (m, n) and b (m,) of what remains of `kept`, all else eliminated at once."""
    wanted = set(kept)
    eliminated = [key for key in graph.keyVector() if key not in wanted]
    remaining = graph
    if eliminated:
        _, remaining = graph.eliminatePartialMultifrontal(eliminated, gtsam.EliminateQR)
    jacobian, residual = remaining.jacobian(gtsam.Ordering(list(kept)))
    return jacobian, residual


def to_global(covariance: Array, heading_rad: float, oriented_rad: Array | None = None) -> Array:
    """Turn poses in a joint covariance (n, n) into the global error.

    The pose at `heading_rad` comes first, pose landmarks at headings (Q,) last. See turned.
    """
    last = np.zeros(0) if oriented_rad is None else oriented_rad
    return turned(covariance, (0, np.array([heading_rad])), (len(covariance) - 3 * len(last), last))


def turned(covariance: Array, *groups: tuple[int, Array]) -> Array:
    """Return a joint covariance (n, n) of local errors as that of global ones.

    P_global = blkdiag(R, I, ...) P_local blkdiag(R, I, ...)^T, R a pose's rotation. groups: where
    poses or pose landmarks begin that follow each other, and their headings (m,).
    """
    turn = np.eye(len(covariance))
    for start, headings in groups:
        for i, block in enumerate(to_tangent(headings)):
            own = slice(start + 3 * i, start + 3 * i + 3)
            turn[own, own] = block.T
    result: Array = turn @ covariance @ turn.T
    return result


def pose_covariances(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, headings_rad: Array
) -> Array:
    """Covariance (K, 3, 3) of every pose on its own, additive global error.

    Raises SingularProblemError when some direction is left without information.
    """
    try:
        tree = eliminate(graph.linearize(values))
        local = np.array([tree.marginalCovariance(POSE_KEY + k) for k in range(len(headings_rad))])
    except RuntimeError as error:
        raise SingularProblemError("the measurements do not fix every pose") from error
    turn = to_tangent(headings_rad).transpose(0, 2, 1)
    result: Array = turn @ local @ turn.transpose(0, 2, 1)
    return result
