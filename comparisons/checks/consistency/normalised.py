"""Squared errors in units of their covariance, and the chi-square bands to hold them against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index
from comparisons.checks.quantiles import chi2_quantile

_OUTSIDE = 0.05
"""Of the figures that a band is for, as many lie outside, half of them on either side."""
WORDS = 0.001
"""Share of sound runs of which words say that they leave a band of NIS, whichever."""
_SKEW = 1e-6
"""Largest asymmetry of a covariance, in units of its sigmas, that rounding explains."""
_LEAST_EIGENVALUE = 1e-13
"""Of the correlation matrix; below it the covariance is singular, or worse."""


class Band(NamedTuple):
    """Where 95 % of a figure lie, half of the rest on either side."""

    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Neither end is passed; never true for NaN."""
        return self.low <= value <= self.high


def mean_band(count: float, dof: float, outside: float = _OUTSIDE) -> Band:
    """Of the mean of `count` independent chi-square variables with `dof` degrees of freedom.

    chi2_quantile(q, R d) / R (Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2). Everything lies
    in the band of none.
    """
    if count * dof == 0:
        return Band(0.0, float("inf"))
    low, high = chi2_quantile((0.5 * outside, 1.0 - 0.5 * outside), count * dof) / count
    return Band(float(low), float(high))


@dataclass(frozen=True)
class Normalised:
    """e^T P^-1 e of errors with `dof` components each.

    row: (n,) which of the errors given these are; squared: (n,) finite numbers. faults: why others
    have none, with how many: `not finite`, `asymmetric`, `not positive definite`.
    """

    dof: int
    row: Index
    squared: Array
    faults: Mapping[str, int]

    @property
    def mean(self) -> float | None:
        """Average of all; `dof` is right. None of none."""
        return float(self.squared.mean()) if len(self.squared) else None

    @property
    def single_band(self) -> Band:
        """Of one value."""
        return mean_band(1, self.dof)

    @property
    def inside(self) -> float | None:
        """Share of the values in the band of one value; 0.95 is right. None of none."""
        low, high = self.single_band
        within = (self.squared >= low) & (self.squared <= high)
        return float(within.mean()) if len(within) else None


def normalise(error: Array, covariance: Array) -> Normalised:
    """Errors (N, d) by covariances (N, d, d), which must be symmetric and positive definite.

    Judged after scaling to correlations, so that metres and radians count alike.
    """
    fault = faults(covariance)
    fault[~np.isfinite(error).all(axis=1)] = "not finite"
    row = np.flatnonzero(fault == "")
    e, p = error[row], covariance[row]
    sigma = np.sqrt(np.einsum("nii->ni", p))
    e, p = e / sigma, p / (sigma[:, :, None] * sigma[:, None])
    squared = np.einsum("ni,ni->n", e, np.linalg.solve(p, e[:, :, None])[:, :, 0])
    return Normalised(error.shape[1], row, squared, counted(fault))


def faults(covariance: Array) -> NDArray[np.str_]:
    """(N,) what is wrong with covariances (N, d, d), empty where nothing is."""
    fault = np.full(len(covariance), "", dtype="<U24")
    diagonal = np.einsum("nii->ni", covariance)
    finite = np.isfinite(covariance).all(axis=(1, 2))
    positive = finite & (diagonal > 0.0).all(axis=1)
    fault[~positive] = "not positive definite"
    fault[~finite] = "not finite"
    row = np.flatnonzero(positive)
    sigma = np.sqrt(diagonal[row])
    scaled = covariance[row] / (sigma[:, :, None] * sigma[:, None])
    turned = scaled.transpose(0, 2, 1)
    some = len(row) and covariance.shape[1]  # of no components nothing is wrong
    least = np.linalg.eigvalsh(0.5 * (scaled + turned))[:, 0] if some else np.ones(len(row))
    fault[row[least <= _LEAST_EIGENVALUE]] = "not positive definite"
    fault[row[np.abs(scaled - turned).max(axis=(1, 2), initial=0.0) > _SKEW]] = "asymmetric"
    return fault


def counted(fault: NDArray[np.str_]) -> dict[str, int]:
    """How many there are of each fault (N,), the empty ones left out."""
    kinds, counts = np.unique(fault[fault != ""], return_counts=True)
    return dict(zip(kinds.tolist(), counts.tolist(), strict=True))
