"""Is a result the optimum? Evidence that can be checked, and what it amounts to."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
from scipy.special import gammainccinv

from graphslam.marginals import eliminate

DECREMENT_LIMIT = 1e-6
"""A full Newton step must not promise to lower the error by more than this."""

DISTANCE_LIMIT = 0.05
"""An incremental estimate must not be farther from the optimum than this, in sigma."""


@dataclass(frozen=True)
class ChiSquareTest:
    """chi2 = 2 error against its two-sided 99.8 % band for `dof` degrees of freedom.

    Above the band the noise is larger than stated, the model is wrong, or the minimum is only
    local; below it the stated noise is conservative.
    """

    chi2: float
    dof: int
    lower: float
    upper: float

    @property
    def reading(self) -> str:
        """`plausible`, `too high` or `too low`; without degrees of freedom nothing can be told."""
        if self.dof <= 0:
            return "plausible"
        if self.chi2 > self.upper:
            return "too high"
        return "too low" if self.chi2 < self.lower else "plausible"


def chi_square_test(error: float, dof: int) -> ChiSquareTest:
    """Test a least-squares error (half the squared norm) against its degrees of freedom."""
    tail = 1e-3
    lower, upper = (
        (2.0 * float(gammainccinv(0.5 * dof, p)) for p in (1.0 - tail, tail))
        if dof > 0
        else (0.0, 0.0)
    )
    return ChiSquareTest(2.0 * error, dof, lower, upper)


@dataclass(frozen=True)
class Stationarity:
    """First and second order conditions at a point.

    decrement: what a full Newton step promises to take off the error (half g^T H^-1 g), free of
    units; NaN where H is singular. definite: H is positive definite, of full rank.
    """

    decrement: float
    definite: bool

    @property
    def holds(self) -> bool:
        """The point is a strict local minimum, to rounding."""
        return self.definite and self.decrement <= DECREMENT_LIMIT


def stationarity(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Stationarity:
    """Examine the linear problem at `values`; elimination fails unless it is definite."""
    linear = graph.linearize(values)
    try:
        step = eliminate(linear).optimize()
    except RuntimeError:
        return Stationarity(float("nan"), definite=False)
    return Stationarity(linear.error(values.zeroVectors()) - linear.error(step), definite=True)


@dataclass(frozen=True)
class Optimality:
    """The case for a result being the global optimum.

    agreeing: starts that ended at the lowest error. distance_sigma: how far the estimate is from
    that point, where it is an incremental smoother's. It is verified when the point is a strict
    local minimum, the estimate is there, and either two starts agree on it or its chi-square is
    not too high, which a wrong minimum's is.
    """

    stationarity: Stationarity
    chi_square: ChiSquareTest
    agreeing: tuple[str, ...]
    distance_sigma: float = 0.0

    @property
    def verified(self) -> bool:
        """Whether the evidence suffices."""
        independent = len(self.agreeing) >= 2
        return (
            self.stationarity.holds
            and self.distance_sigma <= DISTANCE_LIMIT
            and (independent or self.chi_square.chi2 <= self.chi_square.upper)
        )
