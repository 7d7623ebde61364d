"""The filter's poses against the smoother's, which needs no truth.

For a linear Gaussian problem and the same data, the smoothed pose is what the filtered one becomes
when the rest of the log is added, so Cov(filtered - smoothed) = P_filtered - P_smoothed. That
difference is positive semidefinite; where it is not, the filter is more certain of a pose than the
smoother that knows the future as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.statistics import (
    Band,
    averaged,
    chi2_quantile,
    counted,
    faults,
    normalised_difference,
)
from ekf_reference.core.geometry import wrap_angle

LEAST_RATIO = 0.95**2
"""Of the filter's variance to the smoother's, 5 % in sigma. Relinearising alone moves variances: of
the sound filter on Nieto's loop the least ratio of a drive is 0.92 to 0.99."""


@dataclass(frozen=True, kw_only=True)
class FilterAgainstSmoother:
    """Per epoch; those whose covariances cannot be used are left out and counted in faults.

    time_s: (n,). error: (n, 3) e. sigma: (n, 3) of the diagonal of P_E - P_S, zero where that is
    negative. squared: (n,) e^T (P_E - P_S)^-1 e over the dof (n,) directions in which the
    difference is clearly positive, e = x_E - x_S, additive, heading wrapped. ratio: (n,) least
    P_E over P_S of all directions; below 1 the filter is overconfident. Epochs share
    their future: averages have no plain band.
    """

    time_s: Array
    error: Array
    sigma: Array
    squared: Array
    dof: Index
    ratio: Array
    faults: Mapping[str, int]

    @property
    def mean_per_dof(self) -> float | None:
        """1 is right. None where no direction is clear."""
        return float(self.squared.sum() / self.dof.sum()) if self.dof.any() else None

    @property
    def band(self) -> Band | None:
        """95 % of mean_per_dof, by the effective number of independent epochs."""
        found = averaged(self.squared, self.dof, np.arange(len(self.dof)))
        return None if found is None else found.band

    @property
    def inside(self) -> float | None:
        """Share of the epochs with clear directions in their single 95 % band."""
        squared, dof = self.squared[self.dof > 0], self.dof[self.dof > 0]
        if not len(dof):
            return None
        low, high = chi2_quantile(0.025, dof), chi2_quantile(0.975, dof)
        return float(np.mean((squared >= low) & (squared <= high)))

    @property
    def overconfident(self) -> Index:
        """Epochs at which the filter is clearly more certain than the smoother."""
        return np.flatnonzero(self.ratio < LEAST_RATIO)


def filter_against_smoother(
    time_s: Array,
    filtered: Array,
    filtered_covariance: Array,
    smoothed: Array,
    smoothed_covariance: Array,
) -> FilterAgainstSmoother:
    """Poses (K, 3) and covariances (K, 3, 3) of both, at times (K,)."""
    fault = faults(filtered_covariance)
    other = faults(smoothed_covariance)
    fault = np.where(fault == "", np.where(other == "", "", "smoother's " + other), fault)
    row = np.flatnonzero(fault == "")
    e = filtered[row] - smoothed[row]
    e[:, 2] = wrap_angle(e[:, 2])
    gap = filtered_covariance[row] - smoothed_covariance[row]
    squared, dof, ratio = normalised_difference(
        e, filtered_covariance[row], smoothed_covariance[row]
    )
    return FilterAgainstSmoother(
        time_s=time_s[row],
        error=e,
        sigma=np.sqrt(np.maximum(np.einsum("nii->ni", gap), 0.0)),
        squared=squared,
        dof=dof,
        ratio=ratio,
        faults=counted(fault),
    )
