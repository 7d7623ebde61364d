"""Which landmark of an estimate's map each measurement of a log without labels is of.

A filter may use measurements that the references, which associate on their own, find ambiguous.
Where its map says what they are of, they become labels, if the optimum by these is plausible.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.motion import CLOCK_S
from comparisons.arrays import Array, Index
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import ExternalEstimate
from comparisons.logs.log import NO_LANDMARK, LandmarkMeasurements
from comparisons.statistics import chi2_quantile, squared_distance
from graphslam.optimum import Optimality

_MOST_SIGMA = 5.0
"""A measurement of a landmark leads to no place farther from it."""
_CLEARLY = 0.5
"""Share of the distance to the next landmark that the nearest may have."""
_MOST_UNCLEAR = 0.1
"""Share of measurements that may be near none, or near two."""

_PLAUSIBLE = 0.999
"""Share of right associations whose optimum, and whose pair of landmarks, is within its band."""

_NEIGHBOURS = 4
"""A landmark, and those nearest to it that it is compared with."""


class MapLabels(NamedTuple):
    """label: (M,) ids of the estimate, further ones where it has none, or NO_LANDMARK.

    by_map: how many its map tells.
    """

    label: NDArray[np.int64]
    by_map: int

    def said(self) -> str:
        """Return it as a remark."""
        return (
            f"the log names no landmarks; the estimate's map tells those of {self.by_map} of "
            f"{len(self.label)} measurements, and references and smoother take them for labels"
        )


def map_labels(
    given: ExternalEstimate, measurements: LandmarkMeasurements, landmark_id: Index
) -> MapLabels | None:
    """Return the labels that an estimate's map implies.

    given: with poses at the measurements' times. own: (M,) landmark indices of the smoother's own
    association, negative where unused, which tells what is of a landmark that the map lacks. None
    where there are no such poses, or where the map leaves many measurements open.
    """
    near, names = _nearest(given, measurements), given.landmark_id
    if near is None or names is None or np.count_nonzero(near < 0) > _MOST_UNCLEAR * len(near):
        return None
    label = np.full(len(near), NO_LANDMARK, dtype=np.int64)
    label[near >= 0] = names[near[near >= 0]]
    lacking = (near < 0) & (landmark_id >= 0) & ~np.isin(landmark_id, landmark_id[near >= 0])
    label[lacking] = int(names.max()) + 1 + landmark_id[lacking]
    return MapLabels(label, int(np.count_nonzero(near >= 0)))


def plausible(optimum: Optimality, estimate: Estimate) -> bool:
    """Whether an association's optimum is: its residuals are, and no two landmarks are the same."""
    fit = optimum.chi_square
    if not optimum.verified or fit.chi2 > chi2_quantile(_PLAUSIBLE, fit.dof):
        return False
    place, count = estimate.landmark, len(estimate.landmark)
    if count < 2:
        return True
    near = _neighbours(place, place, min(_NEIGHBOURS, count))[1][:, 1:]
    first, second = np.repeat(np.arange(count), near.shape[1]), near.ravel()
    points = slice(3, 3 + place.size)
    p = estimate.joint_covariance[points, points].reshape(count, 2, count, 2).swapaxes(1, 2)
    within, across = p[np.arange(count), np.arange(count)], p[first, second]
    spread = within[first] + within[second] - across - across.transpose(0, 2, 1)
    squared = squared_distance(place[first] - place[second], spread)
    return bool((squared > chi2_quantile(_PLAUSIBLE, 2)).all())


def _nearest(given: ExternalEstimate, measurements: LandmarkMeasurements) -> Index | None:
    """The row (M,) of the map's landmark that each measurement leads to, -1 if to none or two."""
    if given.landmark is None or len(given.landmark) < 2:
        return None
    at = np.minimum(
        np.searchsorted(given.time_s, measurements.time_s - CLOCK_S), len(given.time_s) - 1
    )
    if (np.abs(given.time_s[at] - measurements.time_s) > CLOCK_S).any():
        return None
    pose, r = given.pose[at], measurements.range_m
    along = pose[:, 2] + measurements.bearing_rad
    place = pose[:, :2] + r[:, None] * np.column_stack((np.cos(along), np.sin(along)))
    apart, order = _neighbours(given.landmark, place, 2)
    first, second = apart.T
    clear = (first < _CLEARLY * second) & (
        first < _MOST_SIGMA * _sigma(given, measurements, at, order)
    )
    nearest: Index = np.where(clear, order[:, 0], -1)
    return nearest


def _neighbours(places: Array, of: Array, count: int) -> tuple[Array, Index]:
    """Distances (M, count) from points (M, 2) to the nearest places, and which these are."""
    from scipy.spatial import cKDTree

    distance, row = cKDTree(places).query(of, k=count)
    return distance, row


def _sigma(
    given: ExternalEstimate, measurements: LandmarkMeasurements, at: Index, order: Index
) -> Array:
    """Standard deviation (M,) of where measurements lead, against the nearest landmark."""
    r = measurements.range_m
    variance: Array = measurements.sigma_range_m**2 + (r * measurements.sigma_bearing_rad) ** 2
    if given.pose_covariance is not None:
        p = given.pose_covariance[at]
        variance = variance + p[:, 0, 0] + p[:, 1, 1] + r**2 * p[:, 2, 2]
    if given.landmark_covariance is not None:
        variance = variance + np.trace(given.landmark_covariance[order[:, 0]], axis1=1, axis2=2)
    return np.sqrt(variance)
