"""What the residuals of an optimum say of each sensor's stated noise, and how surely.

The variance of every component (odometry, ranges, bearings, ...) is its stated one times an unknown
factor. Residuals r = W e of the errors e, W = I - J (J^T J)^-1 J^T, mix all components. Quadratic
forms of r have the expectations

    E |r_g|^2 = sum_h |W_gh|^2 factor_h        (Frobenius norms of W's blocks)

for whatever factors, so that solving these for the factors is unbiased (Rao's MINQUE), and is the
restricted maximum likelihood once the weights are those of the factors found. Twice the inverse of
the matrix of norms is their covariance there: a component that the others could explain as well, or
that leaves no residuals, is known badly, and the interval says so.
"""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags
from scipy.special import gammaincinv

from graphslam.arrays import Array, Index
from graphslam.graph_builder import COMPONENTS, row_components
from graphslam.problem import SlamProblem
from graphslam.smoother import SmootherEvidence
from graphslam.sparse_system import column_lengths, normal_factors, scaled_columns, sparse_system

_DRAWS = 6
"""Random signs with which the norms of W's blocks are estimated: 41 % of one value, over a block of
n rows 41 % / sqrt(n)."""
_ROUNDS = 6
_SETTLED = 0.3
"""Natural logarithm of the last change of a variance; the weights need to be no nearer."""
_FAR = 2.0
"""Times: a solution that moves a variance farther at once is not trusted."""
_MOST = 1e6
"""Times the stated variance, or its inverse: data without noise have a millionth."""


class Component(NamedTuple):
    """How a sensor's noise compares with what is stated.

    name: of COMPONENTS. factor: its standard deviation over the stated one. dof: equivalent degrees
    of freedom; that many independent errors would tell as much. settled: the rounds ended, for all
    components; else the factors are on their way.
    """

    name: str
    factor: float
    dof: float
    settled: bool

    def interval(self, outside: float = 0.05) -> tuple[float, float]:
        """Return where the factor lies, but for a share `outside` of such intervals."""
        if not self.dof > 0.0:
            return 0.0, np.inf
        half = 0.5 * self.dof
        low, high = (
            self.factor * np.sqrt(half / gammaincinv(half, share))
            for share in (1.0 - 0.5 * outside, 0.5 * outside)
        )
        return float(low), float(high)


def variance_components(result: SmootherEvidence) -> tuple[Component, ...]:
    """Return every component that the problem has.

    Args:
        result: Of a batch smoother without a robust kernel; its graph is linearised once.

    Returns:
        In the order of COMPONENTS.
    """
    return components_of(result.problem, result.graph, result.values)


def components_of(
    problem: SlamProblem, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> tuple[Component, ...]:
    """Return every component of a problem.

    Args:
        problem: What is known.
        graph: Its graph, without a robust kernel.
        values: Its optimum.

    Returns:
        In the order of COMPONENTS.
    """
    component = row_components(problem)
    jacobian, residual = sparse_system(graph, values, len(component))
    return estimate_components(jacobian, residual, component)


def estimate_components(
    jacobian: csr_matrix, residual: Array, component: Index
) -> tuple[Component, ...]:
    """Return how each component's noise compares with the stated one.

    Args:
        jacobian: (m, n), of full column rank, its rows whitened as stated.
        residual: (m,) right-hand side, whitened as stated.
        component: (m,) rows of COMPONENTS; -1 is right as stated.

    Returns:
        One for each that occurs.
    """
    names, group = np.unique(component, return_inverse=True)
    free = names >= 0
    signs = np.random.default_rng(0).choice((-1.0, 1.0), size=(len(residual), _DRAWS))
    variance = np.ones(len(names))
    for _ in range(_ROUNDS):
        weight, before = 1.0 / np.sqrt(variance[group]), variance
        change, dof = _changes(diags(weight) @ jacobian, weight * residual, group, signs, free)
        variance = np.clip(variance * change, 1.0 / _MOST, _MOST)
        settled = (np.abs(np.log(variance / before)) < _SETTLED).all()
        if settled:
            break
    return tuple(
        Component(COMPONENTS[name], float(np.sqrt(factor)), float(known), bool(settled))
        for name, factor, known in zip(names, variance, dof, strict=True)
        if name >= 0
    )


def _changes(
    jacobian: csr_matrix, residual: Array, group: Index, signs: Array, free: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """(g,) factors of the groups' variances, and their equivalent degrees of freedom."""
    jacobian = scaled_columns(jacobian, column_lengths(jacobian))
    solve = normal_factors(jacobian).solve

    def left(errors: Array) -> Array:
        rest: Array = errors - jacobian @ solve(jacobian.T @ errors)
        return rest

    count = len(free)
    norms, redundancy = np.zeros((count, count)), np.zeros(count)
    for one in range(count):
        drawn = np.where((group == one)[:, None], signs, 0.0)
        rest = left(drawn)
        redundancy[one] = np.sum(rest * drawn) / signs.shape[1]
        norms[one] = np.bincount(group, np.sum(rest**2, axis=1), count) / signs.shape[1]
    norms = 0.5 * (norms + norms.T)
    squared = np.bincount(group, left(residual) ** 2, count)
    # What leaves less than one error's worth of residuals says nothing, and stays as stated.
    asked = free & (redundancy >= 1.0)
    inverse = np.linalg.inv(norms[np.ix_(asked, asked)])
    solved = inverse @ (squared[asked] - norms[np.ix_(asked, ~asked)].sum(axis=1))
    # Always positive, and right where the solution is; it moves less at once.
    plain = squared[asked] / redundancy[asked]
    change, known = np.ones(count), np.zeros(count)
    change[asked] = np.where((solved > 1.0 / _FAR) & (solved < _FAR), solved, plain)
    known[asked] = np.maximum(1.0 / np.diag(inverse), 0.0)
    return change, known
