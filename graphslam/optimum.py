"""Is a result the optimum? Evidence that can be checked, and what it amounts to."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
from scipy.special import gammainc, gammaincc, gammainccinv

from graphslam.marginals import eliminate

DECREMENT_LIMIT = 1e-5
"""A full Gauss-Newton step must not promise to lower the error by more than this.

It moves no unknown by more than 4.5e-3 sigma. gtsam's BetweenFactorPose2 leaves the derivative of
the logarithm out of its Jacobian, so that large residuals of motion promise 1e-6 at the minimum.
"""

AGREEMENT = 1e-6
"""Errors are equal when they differ by less than this, relative to 1 + error."""

TIE = 1e-6, 1e-12
"""Errors tie that differ by less: what a last step leaves, and rounding relative to the error."""

EXTREME = 1e-20
"""A chi-square as far out by chance is no matter of noise that is somewhat larger or smaller."""

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
        """`plausible`, `too high` or `too low`; without degrees of freedom there is no test."""
        if self.dof <= 0:
            return "plausible"
        if self.chi2 > self.upper:
            return "too high"
        return "too low" if self.chi2 < self.lower else "plausible"

    @property
    def extreme(self) -> bool:
        """Whether no chance makes it so high or low."""
        tails = (tail(0.5 * self.dof, 0.5 * self.chi2) for tail in (gammainc, gammaincc))
        return self.dof > 0 and bool(min(tails) <= EXTREME)


def chi_square_test(error: float, dof: int) -> ChiSquareTest:
    """Test the error at an optimum by chi-square.

    Args:
        error: Half the squared norm of the whitened residuals.
        dof: Scalar measurements, the prior's among them, less scalar unknowns.

    Returns:
        chi2 = 2 error with its two-sided band.
    """
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
    """Examine the first and second order conditions at a point.

    Args:
        graph: The problem.
        values: The point.

    Returns:
        The Newton decrement, and whether the linear problem is positive definite: its elimination
        fails unless it is.
    """
    linear = graph.linearize(values)
    try:
        step = eliminate(linear).optimize()
    except RuntimeError:
        return Stationarity(float("nan"), definite=False)
    return Stationarity(linear.error(values.zeroVectors()) - linear.error(step), definite=True)


@dataclass(frozen=True, kw_only=True)
class Minimum:
    """One of the minima that were found.

    starts: attempts and hops that ended there. pose, landmark: where it differs most from the
    lowest one, and by how much; landmark is -1 where there is none.
    """

    error: float
    starts: int
    pose: int
    pose_m: float
    landmark: int
    landmark_m: float

    @property
    def furthest_m(self) -> float:
        """The larger of both distances."""
        return max(self.pose_m, self.landmark_m)


@dataclass(frozen=True)
class Exploration:
    """What a search looked at beside its starts.

    minima: the distinct ones, lowest first. hops: alternatives tried. draws: random starts; missed:
    the chance that so many miss a basin as wide as the lowest one's, 0 where none were needed.
    complete: everything that was to be tried was tried within the budget.
    """

    minima: tuple[Minimum, ...] = ()
    hops: int = 0
    draws: int = 0
    missed: float = 0.0
    complete: bool = True


def same_error(one: float, other: float) -> bool:
    """Return whether two errors are equal as far as the optimisers settle.

    Args:
        one: Half the squared norm of whitened residuals.
        other: Of another point, in the same units.

    Returns:
        Whether they differ by at most AGREEMENT, relative to one more than the smaller.
    """
    return abs(one - other) <= AGREEMENT * (1.0 + min(one, other))


@dataclass(frozen=True, kw_only=True)
class Optimality:
    """The evidence that a result is the global optimum; evidence, not a certificate.

    agreeing: starts that ended at the lowest error. agreed: at least two of them are independent by
    construction. distance_sigma: how far the estimate is from that point, where it is an
    incremental smoother's. accept_misfit: a chi-square that is too high does not count.
    """

    stationarity: Stationarity
    chi_square: ChiSquareTest
    agreeing: tuple[str, ...]
    agreed: bool
    exploration: Exploration = Exploration()
    distance_sigma: float = 0.0
    accept_misfit: bool = False

    @property
    def verified(self) -> bool:
        """Nothing is lacking."""
        return not self.lacks

    @property
    def lacks(self) -> str:
        """The first condition that does not hold, in words; empty when all do."""
        test, explored = self.chi_square, self.exploration
        if not self.stationarity.holds:
            return "the smoother did not end at a strict local minimum"
        if self.distance_sigma > DISTANCE_LIMIT:
            return (
                f"the running estimate is {self.distance_sigma:.2g} sigma from the optimum, "
                f"expected at most {DISTANCE_LIMIT}"
            )
        if test.reading == "too high" and not self.accept_misfit:
            return (
                f"chi-square {test.chi2:.0f} lies above {test.upper:.0f} for {test.dof} degrees "
                "of freedom"
            )
        if not explored.complete:
            return (
                f"the search for other minima reached its limit with {len(explored.minima)} "
                "minima found by "
                f"{explored.hops} hops and {explored.draws} random starts"
            )
        if len(explored.minima) > 1 and same_error(*(m.error for m in explored.minima[:2])):
            other = explored.minima[1]
            return f"another minimum, {other.furthest_m:.3g} m away, has the same error"
        if not self.agreed:
            return (
                f"only the start {', '.join(self.agreeing)} reached the lowest error, "
                "expected independent starts"
            )
        return ""
