"""Chi-square and F quantiles from scipy.special; scipy.stats takes 0.3 s to load.

Each is the expression that scipy.stats itself evaluates, so the values are equal to the bit.
"""

from __future__ import annotations

from typing import Any

from scipy.special import chdtrc, fdtri, gammaincinv


def chi2_quantile(probability: Any, dof: Any) -> Any:
    """Value that a chi-square variable stays below with a probability; arrays broadcast.

    Twice the inverse of the regularised lower incomplete gamma function of dof / 2.
    """
    return 2 * gammaincinv(0.5 * dof, probability)


def chi2_tail(value: float, dof: int) -> float:
    """Probability that a chi-square variable exceeds a value of at least 0."""
    return float(chdtrc(dof, value))


def f_quantile(probability: float, dof: float, dof_below: float) -> float:
    """Value that an F variable stays below with a probability. dof_below: of the denominator."""
    return float(fdtri(dof, dof_below, probability))
