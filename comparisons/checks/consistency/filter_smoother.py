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
from comparisons.figures import Aside, LeftOut, Less, Nominal, Share95
from comparisons.plane import pose_difference
from comparisons.statistics import (
    Averaged,
    Band,
    BlockDeparture,
    SquaredErrors,
    averaged,
    block_departure,
    counted,
    faults,
    inside,
    normalised_difference,
)

LEAST_RATIO = 0.95**2
"""Of the filter's variance to the smoother's, 5 % in sigma. Relinearising alone moves variances: of
the sound filter on Nieto's loop the least ratio of a drive is 0.92 to 0.99."""

BLOCKS = {"position": slice(0, 2), "heading": slice(2, 3)}
"""Of a pose."""


@dataclass(frozen=True, kw_only=True)
class FilterAgainstSmoother:
    """Filtered poses compared with smoothed ones.

    Epochs share their future: averages have no plain band.

    Attributes:
        epochs: poses that were compared.
        squared_per_dof: squared difference over its degrees of freedom, by P_filter - P_smoother; 1
            is right; None where no direction is clear.
        band: 95 % band of it, by the effective number of independent epochs.
        inside: share of the epochs in their single 95 % band.
        least_ratio: least variance of the filter over the smoother's, of all directions and epochs.
        least_ratio_s: time of that epoch.
        overconfident_epochs: epochs with a ratio clearly below 1: there the filter is
            overconfident.
        overconfident_since_s: time of the first one.
        unusable: epochs that could not be compared, by reason.
        departure: block and stretch that are off, where squared_per_dof leaves its band.
        time_s: (n,) of the epochs that can be used; no part of a result file, as what follows.
        error: (n, 3) e = x_E - x_S, additive, heading wrapped.
        sigma: (n, 3) of the diagonal of P_E - P_S, zero where that is negative.
        squared: (n,) e^T (P_E - P_S)^-1 e in the directions in which P_E - P_S is clearly positive.
        dof: (n,) how many directions these are.
        ratio: (n,) least P_E over P_S of all directions; below 1 the filter is overconfident.
        overconfident: the epochs at which it clearly is.
    """

    epochs: int
    squared_per_dof: Nominal[float | None]
    band: Band | None = None
    inside: Share95[float | None]
    least_ratio: Nominal[float | None]
    least_ratio_s: LeftOut[float | None]
    overconfident_epochs: Less[int]
    overconfident_since_s: LeftOut[float | None]
    unusable: Mapping[str, int]
    departure: LeftOut[BlockDeparture | None] = None
    time_s: Aside[Array]
    error: Aside[Array]
    sigma: Aside[Array]
    squared: Aside[Array]
    dof: Aside[Index]
    ratio: Aside[Array]
    overconfident: Aside[Index]


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
    e = pose_difference(filtered[row], smoothed[row])
    gap = filtered_covariance[row] - smoothed_covariance[row]
    squared, dof, ratio = normalised_difference(
        e, filtered_covariance[row], smoothed_covariance[row]
    )
    clear, average = dof > 0, averaged(squared, dof, np.arange(len(dof)))
    within = inside(squared[clear], dof[clear])
    overconfident = np.flatnonzero(ratio < LEAST_RATIO)
    worst = int(np.argmin(ratio)) if len(ratio) else None
    return FilterAgainstSmoother(
        epochs=len(row),
        squared_per_dof=float(squared.sum() / dof.sum()) if clear.any() else None,
        band=None if average is None else average.band,
        inside=float(np.mean(within)) if clear.any() else None,
        least_ratio=None if worst is None else float(ratio[worst]),
        least_ratio_s=None if worst is None else float(time_s[row[worst]]),
        overconfident_epochs=len(overconfident),
        overconfident_since_s=float(time_s[row[overconfident[0]]]) if len(overconfident) else None,
        unusable=counted(fault),
        departure=_departure(
            average,
            time_s[row],
            (e, filtered_covariance[row], smoothed_covariance[row]),
            (squared, dof),
        ),
        time_s=time_s[row],
        error=e,
        sigma=np.sqrt(np.maximum(np.einsum("nii->ni", gap), 0.0)),
        squared=squared,
        dof=dof,
        ratio=ratio,
        overconfident=overconfident,
    )


def _departure(
    average: Averaged | None,
    time_s: Array,
    compared: tuple[Array, Array, Array],
    whole: tuple[Array, Index],
) -> BlockDeparture | None:
    """Return block and stretch, where the average is out of its band.

    compared: difference, filtered and smoothed covariance of the poses. whole: squared, dof.
    """
    if average is None or average.band.holds(average.mean):
        return None
    e, filtered, smoothed = compared
    blocks = {
        name: SquaredErrors(
            time_s,
            *normalised_difference(e[:, part], filtered[:, part, part], smoothed[:, part, part])[
                :2
            ],
        )
        for name, part in BLOCKS.items()
    }
    return block_departure(SquaredErrors(time_s, *whole), blocks)
