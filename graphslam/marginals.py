"""Covariances out of a Gaussian factor graph, by gtsam's elimination."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from scipy.linalg import solve_triangular

from graphslam.arrays import Array, Index, Marginal
from graphslam.clique_covariances import variable_covariances
from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY, POSE_LANDMARK_KEY, to_tangent
from graphslam.layout import POINT, Layout

PARTS_BEYOND = 2000
"""Numbers to be kept beyond which a graph is eliminated in parts; see elimination."""
_ROUNDING = 1e-13
_KNOWN = "the last pose or a landmark is known exactly in some direction, and has no covariance"
_UNFIXED = "the measurements do not fix the last pose and every landmark"


class SingularProblemError(ArithmeticError):
    """The measurements leave some direction of the state without information."""


def eliminate(graph: gtsam.GaussianFactorGraph) -> gtsam.GaussianBayesTree:
    """Eliminate all variables by QR.

    Args:
        graph: A linear problem.

    Returns:
        gtsam's Bayes tree, for solution and marginals.

    Raises:
        RuntimeError: The graph is singular (gtsam's own exception, of many lines).
    """
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(graph)
    return graph.eliminateMultifrontal(ordering, gtsam.EliminateQR)


def last_pose_and_landmarks(
    graph: gtsam.GaussianFactorGraph,
    pose_count: int,
    landmark_count: int,
    pose_landmark_count: int = 0,
) -> Marginal:
    """Return the joint marginal of the last pose, points and pose landmarks.

    Args:
        graph: A linear problem, with the keys of graph_builder.build_graph.
        pose_count: K poses.
        landmark_count: L points.
        pose_landmark_count: Q pose landmarks.

    Returns:
        Mean and covariance of 3 + 2 L + 3 Q numbers, in the graph's own local increments.

    Raises:
        SingularProblemError: Some direction is left without information.
    """
    kept = [
        POSE_KEY + pose_count - 1,
        *range(LANDMARK_KEY, LANDMARK_KEY + landmark_count),
        *range(POSE_LANDMARK_KEY, POSE_LANDMARK_KEY + pose_landmark_count),
    ]
    size = Layout(1, landmark_count, pose_landmark_count).size
    return joint_marginal(graph, kept, size)


def joint_marginal(
    graph: gtsam.GaussianFactorGraph, kept: Sequence[int], size: int, *, exact: bool = False
) -> Marginal:
    """Return the joint marginal of some variables of a linear problem.

    By QR: gtsam's default, Cholesky, squares the condition number, and two measurements a
    millisecond apart would cost half the digits.

    Args:
        graph: The linear problem.
        kept: Keys of the variables, in the order of the result.
        size: Numbers that they have together.
        exact: Whether some of the graph's rows hold without noise.

    Returns:
        Mean (size,) and covariance (size, size), in the coordinates of the graph's own increments:
        of poses in their own tangent, not yet of the global error.

    Raises:
        SingularProblemError: Some direction is left without information, or without noise.
    """
    try:
        if size > PARTS_BEYOND and not exact:  # rows without noise would lose that in the joins
            from graphslam.elimination import remaining_rows

            jacobian, residual = remaining_rows(graph, kept)
        else:
            jacobian, residual = _remaining(graph, kept, exact=exact)
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


def _remaining(
    graph: gtsam.GaussianFactorGraph, kept: Sequence[int], *, exact: bool
) -> tuple[Array, Array]:
    """Return J (m, n) and b (m,) of what remains of `kept`, all else eliminated at once.

    Raises SingularProblemError where a row remains that has no noise.
    """
    wanted = set(kept)
    eliminated = [key for key in graph.keyVector() if key not in wanted]
    remaining = graph
    if eliminated:
        _, remaining = graph.eliminatePartialMultifrontal(eliminated, gtsam.EliminateQR)
    if exact:
        left = [remaining.at(i) for i in range(remaining.size())]
        models = [one.get_model() for one in left if isinstance(one, gtsam.JacobianFactor)]
        if any(one.isConstrained() and not one.sigmas().all() for one in models):
            raise SingularProblemError(_KNOWN)
    jacobian, residual = remaining.jacobian(gtsam.Ordering(list(kept)))
    return jacobian, residual


def to_global(covariance: Array, heading_rad: float, oriented_rad: Array | None = None) -> Array:
    """Turn poses in a joint covariance from their own tangent into the global error.

    Args:
        covariance: (n, n), the pose's three numbers first, pose landmarks last.
        heading_rad: Of the pose.
        oriented_rad: (Q,) headings of the pose landmarks; none by default.

    Returns:
        (n, n) of the additive global error.
    """
    frames = np.concatenate(([heading_rad], [] if oriented_rad is None else oriented_rad))
    points = (len(covariance) - Layout(len(frames)).size) // POINT.width
    return turned(covariance, Layout(1, points, len(frames) - 1).frame, frames)


def turned(covariance: Array, frame: Index, heading_rad: Array) -> Array:
    """Return a joint covariance of local errors as that of global ones.

    P_global = blkdiag(R, I, ...) P_local blkdiag(R, I, ...)^T, R a pose's rotation.

    Args:
        covariance: (n, n).
        frame: (m,) first entries of all poses and pose landmarks.
        heading_rad: (m,) of these.

    Returns:
        (n, n).
    """
    turn = np.eye(len(covariance))
    for first, block in zip(frame.tolist(), to_tangent(heading_rad), strict=True):
        own = slice(first, first + len(block))
        turn[own, own] = block.T
    return turn @ covariance @ turn.T


def pose_covariances(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, headings_rad: Array
) -> Array:
    """Return the covariance of every pose on its own.

    Args:
        graph: The problem.
        values: Its solution.
        headings_rad: (K,) of the solution's poses.

    Returns:
        (K, 3, 3) of the additive global error.

    Raises:
        SingularProblemError: Some direction is left without information.
    """
    try:
        tree = eliminate(graph.linearize(values))
        blocks = variable_covariances(tree)
    except (RuntimeError, np.linalg.LinAlgError) as error:
        raise SingularProblemError("the measurements do not fix every pose") from error
    local = np.array([blocks[POSE_KEY + k] for k in range(len(headings_rad))])
    turn = to_tangent(headings_rad).transpose(0, 2, 1)
    result: Array = turn @ local @ turn.transpose(0, 2, 1)
    return result
