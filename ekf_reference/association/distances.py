"""From measurements to landmarks: which are near, how far they are, and who gets which."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.measurements import AMBIGUOUS, Measurements
from ekf_reference.core.state import FilterDivergedError, KalmanState, LocalMap

SEARCH_MARGIN_M = 10.0
SEARCH_SIGMAS = 4.0
"""Landmarks are sought this much farther than the longest range of a scan, whichever is more:
metres, or standard deviations of where the vehicle puts the end of that range."""
_UPPER = (0, 0), (0, 1), (1, 1)


class Distances(NamedTuple):
    """Nis (m, L), N = nis + ln |S| (m, L) and innovation (m, L, 2): m measurements, L landmarks."""

    nis: Array
    n: Array
    innovation: Array


def landmarks_around(state: KalmanState, model: MeasurementModel, seen: Measurements) -> LocalMap:
    """Return the landmarks that measurements could be of.

    Args:
        state: The filter's, after the prediction.
        model: How these landmarks are measured.
        seen: At least one measurement.

    Returns:
        Points within the longest range and a margin of the vehicle, without those that `seen`
        closes.

    Raises:
        FilterDivergedError: A variance of the pose is negative.
    """
    longest, variance = float(model.range_m(seen.z).max()), state.pose_covariance.diagonal()
    if variance.min() < 0.0:
        raise FilterDivergedError("a variance of the pose is negative")
    sigma = math.sqrt(variance[:2].sum()) + longest * math.sqrt(variance[2:].sum())
    local = state.local_map(longest + max(SEARCH_MARGIN_M, SEARCH_SIGMAS * sigma))
    if not seen.closed:
        return local
    return local.take(np.flatnonzero(~np.isin(local.landmark_index, seen.closed)))


def normalised_distances(local: LocalMap, model: MeasurementModel, seen: Measurements) -> Distances:
    """Return the distances of all measurements to all landmarks.

    Args:
        local: L landmarks with the joint covariance.
        model: How they are measured.
        seen: m measurements.

    Returns:
        (m, L) normalised innovations squared, N = nis + ln |S|, and innovations, angles wrapped.

    Source: Nieto 2005, eqs. 2.57, 2.58 and 2.60.
    """
    predicted = model.predict(local.pose, local.landmark)
    hv, hl = predicted.jacobian_pose, predicted.jacobian_landmark
    through_pose = hv @ local.vehicle @ hv.transpose(0, 2, 1)
    cross = hv @ local.cross @ hl.transpose(0, 2, 1)
    through_map = hl @ local.own @ hl.transpose(0, 2, 1)
    spread = through_pose + cross + cross.transpose(0, 2, 1) + through_map  # H P H^T, (L, 2, 2)
    nu = model.innovation(seen.z[:, None], predicted.z[None])  # (m, L, 2), 2.57
    s00, s01, s11 = (spread[:, i, j] + seen.noise[:, i, j, None] for i, j in _UPPER)  # S, (m, L)
    nu0, nu1 = nu[..., 0], nu[..., 1]
    determinant = s00 * s11 - s01**2
    nis = (s11 * nu0**2 - 2.0 * s01 * nu0 * nu1 + s00 * nu1**2) / determinant  # 2.58
    return Distances(nis, nis + np.log(determinant), nu)  # 2.60


def match_in_order(cost: Array, allowed: Mask) -> Index:
    """Pair rows with columns: the cheapest pair first, none used twice.

    Args:
        cost: (m, L).
        allowed: (m, L), pairs that may be.

    Returns:
        (m,) column of each row, -1 for none.
    """
    column = np.full(len(cost), -1, dtype=np.intp)
    taken: set[int] = set()
    for i, j in np.argwhere(allowed)[np.argsort(cost[allowed], kind="stable")].tolist():
        if column[i] < 0 and j not in taken:
            column[i] = j
            taken.add(j)
    return column


def indices_of(column: Index, far: Mask, local_index: Index, count: int) -> Index:
    """Return the landmark index of each measurement from its column in a local map.

    Args:
        column: (m,) of the local map, -1 for none.
        far: (m, L), whether a measurement is far enough from a landmark to be of another one.
        local_index: (L,) landmark indices of the local map.
        count: Landmarks in the state so far.

    Returns:
        (m,) landmark indices; from `count` upward what is far from all, AMBIGUOUS for the rest.
    """
    landmark_indices = np.full(len(column), AMBIGUOUS, dtype=np.intp)
    matched = column >= 0
    landmark_indices[matched] = local_index[column[matched]]
    new = np.logical_and.reduce(far, axis=1)
    landmark_indices[new] = count + np.arange(np.count_nonzero(new))
    return landmark_indices
