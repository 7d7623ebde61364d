"""Covariances out of a Gaussian factor graph, by gtsam's elimination."""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY, to_tangent

Array = NDArray[np.float64]


class SingularProblemError(ArithmeticError):
    """The measurements leave some direction of the state without information."""


class Marginal(NamedTuple):
    """Mean (n,) and covariance (n, n) of the last pose and all landmarks, in that order."""

    mean: Array
    covariance: Array


def last_pose_and_landmarks(
    graph: gtsam.GaussianFactorGraph, pose_count: int, landmark_count: int
) -> Marginal:
    """Eliminate all other poses and invert what remains.

    The result is in the coordinates of the graph's own increments. Raises SingularProblemError
    when the remaining information is not positive definite.
    """
    eliminated = list(range(POSE_KEY, POSE_KEY + pose_count - 1))
    kept = [POSE_KEY + pose_count - 1]
    kept += range(LANDMARK_KEY, LANDMARK_KEY + landmark_count)
    try:
        remaining = graph
        if eliminated:
            _, remaining = graph.eliminatePartialMultifrontal(eliminated)
        information, vector = remaining.hessian(gtsam.Ordering(kept))
        if len(information) != 3 + 2 * landmark_count or not _regular(information):
            raise np.linalg.LinAlgError
        factor = cho_factor(information, lower=True)
    except (RuntimeError, np.linalg.LinAlgError) as error:
        raise SingularProblemError(
            "the measurements do not fix the last pose and every landmark"
        ) from error
    covariance = cho_solve(factor, np.eye(len(information)))
    return Marginal(cho_solve(factor, vector.ravel()), 0.5 * (covariance + covariance.T))


def _regular(information: Array) -> bool:
    """Whether the information, each entry in units of its own, is positive beyond rounding."""
    scale = np.sqrt(np.diag(information))
    if not (np.isfinite(scale).all() and (scale > 0.0).all()):
        return False
    least = float(np.linalg.eigvalsh(information / np.outer(scale, scale))[0])
    return least > len(scale) * float(np.finfo(float).eps)


def to_global(covariance: Array, heading_rad: float) -> Array:
    """Turn the pose's part of a joint covariance (n, n), pose first, into the global error.

    P_global = blkdiag(R, I) P_local blkdiag(R, I)^T, R the pose's rotation.
    """
    turn = np.eye(len(covariance))
    turn[:3, :3] = to_tangent(np.array([heading_rad]))[0].T
    return turn @ covariance @ turn.T


def pose_covariances(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, headings_rad: Array
) -> Array:
    """Covariance (K, 3, 3) of every pose on its own, additive global error."""
    marginals = gtsam.Marginals(graph, values)
    local = np.array([marginals.marginalCovariance(POSE_KEY + k) for k in range(len(headings_rad))])
    turn = to_tangent(headings_rad).transpose(0, 2, 1)
    result: Array = turn @ local @ turn.transpose(0, 2, 1)
    return result
