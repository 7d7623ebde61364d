"""Two maps of the same landmarks, each with its covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.accuracy import aligned
from comparisons.estimates.estimate import Estimate
from comparisons.statistics import chi2_quantile

_CHI2_2_99 = float(chi2_quantile(0.99, 2))
MOST_OUTSIDE = 0.05
"""Share of landmarks that may lie beyond their 99 % region before the maps disagree."""


@dataclass(frozen=True)
class Pair:
    """Two maps of the same landmarks.

    rms_m: of the differences, and after the rigid motion that fits best. distance_sigma: (L,) root
    of half the squared Mahalanobis distance of each, by the sum of both covariances, which is more
    than that of the difference where measurements are shared. outside: beyond the 99 % region.
    """

    rms_m: float
    rms_aligned_m: float
    distance_sigma: Array
    outside: int

    @property
    def agrees(self) -> bool:
        """As many landmarks lie inside as chance allows."""
        return self.outside <= max(1.0, MOST_OUTSIDE * len(self.distance_sigma))


def compare_maps(first: Estimate, second: Estimate) -> Pair:
    """Landmarks that both have, by id. Raises ValueError when they share none."""
    _, i, j = np.intersect1d(
        first.landmark_id, second.landmark_id, assume_unique=True, return_indices=True
    )
    if not len(i):
        raise ValueError("the maps share no landmark")
    a, b = first.landmark[i], second.landmark[j]
    total = first.landmark_covariances()[i] + second.landmark_covariances()[j]
    squared = np.einsum("ni,ni->n", a - b, np.linalg.solve(total, (a - b)[:, :, None])[:, :, 0])
    return Pair(
        float(np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1)))),
        float(np.sqrt(np.mean(np.sum((aligned(a, b) - b) ** 2, axis=1)))),
        np.sqrt(squared / 2.0),
        int(np.count_nonzero(~(squared <= _CHI2_2_99))),  # what is no number lies nowhere
    )
