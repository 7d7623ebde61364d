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
    """Return the points within the longest range and a margin, without those that `seen` closes.

    state: the filter's, after the prediction. model: how these landmarks are measured. seen: at
    least one measurement. Raises FilterDivergedError where a variance of the pose is negative.
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
    """Return nis, N = nis + ln |S| and innovations, angles wrapped, of all pairs (m, L).

    local: L landmarks with the joint covariance. model: how they are measured. seen: m
    measurements. Source: Nieto 2005, eqs. 2.57, 2.58 and 2.60.
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
    """Return the column (m,) of each row, -1 for none: the cheapest pair first, none used twice.

    cost: (m, L). allowed: (m, L), pairs that may be.
    """
    column = np.full(len(cost), -1, dtype=np.intp)
    taken: set[int] = set()
    for i, j in np.argwhere(allowed)[np.argsort(cost[allowed], kind="stable")].tolist():
        if column[i] < 0 and j not in taken:
            column[i] = j
            taken.add(j)
    return column


def indices_of(column: Index, far: Mask, local_index: Index, count: int) -> Index:
    """Return the landmark index (m,) of each measurement from its column in a local map.

    column: (m,), -1 for none. far: (m, L), whether a measurement is far enough from a landmark to
    be of another one. local_index: (L,) landmark indices of the local map. count: landmarks in the
    state so far; from there upward is what is far from all, AMBIGUOUS the rest.
    """
    landmark_indices = np.full(len(column), AMBIGUOUS, dtype=np.intp)
    matched = column >= 0
    landmark_indices[matched] = local_index[column[matched]]
    new = np.logical_and.reduce(far, axis=1)
    landmark_indices[new] = count + np.arange(np.count_nonzero(new))
    return landmark_indices
