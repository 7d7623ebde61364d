"""The restricted likelihood of an optimum: what compares one problem with other noises of it.

Chi-square cannot, for a larger noise always leaves less. The density of what the state does not
absorb of the measurements, of covariance V and with the whitened Jacobian J, is to a constant

    deviance = r^T r + log det V + log det J^T J        (twice its negative logarithm)
"""

from __future__ import annotations

import gtsam
import numpy as np

from graphslam.arrays import Array
from graphslam.graph_builder import row_components
from graphslam.problem import SlamProblem
from graphslam.sparse_system import column_lengths, normal_factors, scaled_columns, sparse_system


def restricted_deviance(
    problem: SlamProblem, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> float:
    """Return the deviance of an optimum, to a constant that all noises of a problem share.

    Args:
        problem: What is known.
        graph: Its graph, without a robust kernel.
        values: Its optimum.

    Returns:
        Less is likelier.

    Raises:
        RuntimeError: The state is not determined.
    """
    jacobian, right = sparse_system(graph, values, len(row_components(problem)))
    lengths = column_lengths(jacobian)
    jacobian = scaled_columns(jacobian, lengths)
    factors = normal_factors(jacobian)
    information = np.log(np.abs(factors.U.diagonal())).sum() + 2.0 * np.log(lengths).sum()
    return float(right @ right + _log_noise(problem) + information)


def _log_noise(problem: SlamProblem) -> float:
    """Logarithm of the determinant of all stated covariances but the priors'."""
    covariances: tuple[Array, ...] = (
        problem.increment_covariance[problem.steps],
        problem.position_covariance,
        problem.pose_landmarks.covariance,
        problem.loop_closures.covariance,
    )
    of_matrices = sum(float(np.linalg.slogdet(one)[1].sum()) for one in covariances if len(one))
    return of_matrices + 2.0 * float(np.log(problem.sigma).sum())
