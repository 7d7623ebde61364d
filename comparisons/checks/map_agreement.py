"""Two maps of the same landmarks, each with its covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.accuracy import aligned
from comparisons.estimates.estimate import Estimate
from comparisons.figures import Less
from comparisons.plane import rms
from comparisons.statistics import chi2_quantile, squared_distance

_CHI2_2_99 = float(chi2_quantile(0.99, 2))
MOST_OUTSIDE = 0.05
"""Share of landmarks that may lie beyond their 99 % region before the maps disagree."""


@dataclass(frozen=True, kw_only=True)
class MapPair:
    """Two maps of the same landmarks.

    Sigma is of the sum of both covariances, which is more than that of the difference where
    measurements are shared.

    Attributes:
        rms_m: root mean square distance of the landmarks.
        rms_aligned_m: the same after the best rigid alignment.
        distance_sigma_median: median distance of a landmark, in sigma of the difference.
        outside: landmarks beyond their 99 % region.
        landmarks: landmarks that both have.
        agrees: whether the maps agree.
    """

    rms_m: Less[float]
    rms_aligned_m: Less[float]
    distance_sigma_median: Less[float | None]
    outside: Less[int]
    landmarks: int
    agrees: bool

    @classmethod
    def of(
        cls, rms_m: float, rms_aligned_m: float, squared: Array, dof: int, outside: int
    ) -> MapPair:
        """Return it from squared Mahalanobis distances (L,), each of so many degrees of freedom."""
        median = float(np.median(np.sqrt(squared / dof))) if len(squared) else None
        agrees = outside <= max(1.0, MOST_OUTSIDE * len(squared))
        return cls(
            rms_m=rms_m,
            rms_aligned_m=rms_aligned_m,
            distance_sigma_median=median,
            outside=outside,
            landmarks=len(squared),
            agrees=agrees,
        )


def compare_maps(first: Estimate, second: Estimate) -> MapPair:
    """Landmarks that both have, by id. Raises ValueError when they share none."""
    _, i, j = np.intersect1d(
        first.landmark_id, second.landmark_id, assume_unique=True, return_indices=True
    )
    if not len(i):
        raise ValueError("the maps share no landmark")
    a, b = first.landmark[i], second.landmark[j]
    total = first.landmark_covariances()[i] + second.landmark_covariances()[j]
    squared = squared_distance(a - b, total)
    return MapPair.of(
        rms(a - b),
        rms(aligned(a, b) - b),
        squared,
        2,
        int(np.count_nonzero(~(squared <= _CHI2_2_99))),  # what is no number lies nowhere
    )
