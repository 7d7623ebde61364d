"""Which landmark of an estimate's map each measurement of a log without labels is of.

A filter may use measurements that the references, which associate on their own, find ambiguous.
Where its map says what they are of, and the smoother's own association agrees, they become labels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index
from comparisons.estimates.external import ExternalEstimate
from comparisons.logs.log import NO_LANDMARK, LandmarkMeasurements

_MOST_SIGMA = 5.0
"""A measurement of a landmark leads to no place farther from it."""
_CLEARLY = 0.5
"""Share of the distance to the next landmark that the nearest may have."""
_MOST_UNCLEAR = 0.1
"""Share of measurements that may be near none, or near two."""


class MapLabels(NamedTuple):
    """label: (M,) ids of the estimate, further ones where it has none, or NO_LANDMARK.

    by_map: how many its map tells.
    """

    label: NDArray[np.int64]
    by_map: int

    def said(self) -> str:
        """Return it as a remark."""
        return (
            f"the log names no landmarks; by the estimate's map {self.by_map} of "
            f"{len(self.label)} measurements are of one landmark, as in the smoother's own "
            "association; references and smoother take them for labels"
        )


def map_labels(given: ExternalEstimate, seen: LandmarkMeasurements, own: Index) -> MapLabels | None:
    """Return the labels that an estimate's map implies.

    given: with poses at the measurements' times. own: (M,) landmark indices of the smoother's own
    association, negative where unused. None where there are no such poses, where the map leaves
    many measurements open, or where it joins or parts what the smoother's association does not.
    """
    near = _nearest(given, seen)
    if near is None or np.count_nonzero(near < 0) > _MOST_UNCLEAR * len(near):
        return None
    both = (near >= 0) & (own >= 0)
    pairs = np.unique(np.column_stack((own[both], near[both])), axis=0)
    if any(len(np.unique(column)) < len(pairs) for column in pairs.T):
        return None
    names = given.landmark_id
    if names is None:
        return None
    free = int(max(names.max(initial=0), 0)) + 1
    label_of = {k: free + k for k in np.unique(own[own >= 0]).tolist()}
    label_of |= {k: int(names[row]) for k, row in pairs.tolist()}
    label = np.full(len(near), NO_LANDMARK, dtype=np.int64)
    label[near >= 0] = names[near[near >= 0]]
    rest = np.flatnonzero((near < 0) & (own >= 0))
    label[rest] = [label_of[k] for k in own[rest].tolist()]
    return MapLabels(label, int(np.count_nonzero(near >= 0)))


def _nearest(given: ExternalEstimate, seen: LandmarkMeasurements) -> Index | None:
    """The row (M,) of the map's landmark that each measurement leads to, -1 if to none or two."""
    if given.landmark is None or len(given.landmark) < 2:
        return None
    at = np.minimum(np.searchsorted(given.time_s, seen.time_s), len(given.time_s) - 1)
    if (given.time_s[at] != seen.time_s).any():
        return None
    pose, r = given.pose[at], seen.range_m
    along = pose[:, 2] + seen.bearing_rad
    place = pose[:, :2] + r[:, None] * np.column_stack((np.cos(along), np.sin(along)))
    apart = np.linalg.norm(place[:, None] - given.landmark, axis=2)
    order = np.argsort(apart, axis=1)[:, :2]
    first, second = np.take_along_axis(apart, order, axis=1).T
    clear = (first < _CLEARLY * second) & (first < _MOST_SIGMA * _sigma(given, seen, at, order))
    found: Index = np.where(clear, order[:, 0], -1)
    return found


def _sigma(given: ExternalEstimate, seen: LandmarkMeasurements, at: Index, order: Index) -> Array:
    """Standard deviation (M,) of where measurements lead, against the nearest landmark."""
    r = seen.range_m
    variance: Array = seen.sigma_range_m**2 + (r * seen.sigma_bearing_rad) ** 2
    if given.pose_covariance is not None:
        p = given.pose_covariance[at]
        variance = variance + p[:, 0, 0] + p[:, 1, 1] + r**2 * p[:, 2, 2]
    if given.landmark_covariance is not None:
        variance = variance + np.trace(given.landmark_covariance[order[:, 0]], axis1=1, axis2=2)
    return np.sqrt(variance)
