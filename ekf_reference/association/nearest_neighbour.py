"""Nearest neighbours: gated (Nieto 2005, section 2.4), and in metres (Misono 2007, section 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_reference.association.attributes import NO_ATTRIBUTES, Attributes, same_tail
from ekf_reference.association.distances import (
    indices_of,
    landmarks_around,
    match_in_order,
    normalised_distances,
)
from ekf_reference.core.geometry import Index
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.measurements import Measurements
from ekf_reference.core.state import KalmanState


@dataclass(frozen=True)
class NearestNeighbour:
    """Gated nearest neighbour, each landmark taken at most once in a scan.

    A measurement may join a landmark when its nis (Nieto 2005, eq. 2.58) is within `gate`, the pair
    with the least N (eq. 2.60) first. One whose nis exceeds `new_gate` for every landmark starts a
    new one; between the two gates, or beaten to its landmark, it is ambiguous. The gates are for 2
    degrees of freedom; attributes enter nis and N, and widen the gates to the same probability.
    """

    gate: float = 13.82  # 99.9 %
    new_gate: float = 25.0
    attributes: Attributes = NO_ATTRIBUTES

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Assign by position and attributes."""
        local = landmarks_around(state, model, seen)
        distances = normalised_distances(local, model, seen)
        added = self.attributes.distances(local.landmark_index, seen)
        nis, dof = distances.nis + added.nis, 2 + added.dof
        column = match_in_order(distances.n + added.n, nis <= same_tail(self.gate, dof))
        far = nis > same_tail(self.new_gate, dof)
        return indices_of(column, far, local.landmark_index, state.landmark_count)


@dataclass(frozen=True)
class EuclideanNeighbour:
    """Nearest landmark within d_min of the measurement's place in the map (Misono 2007, eq. 17).

    Eq. 16 is printed with a sign lost; the inverse of the measurement model takes its place.
    A measurement with no landmark within d_min starts a new one; beaten to it, it is ambiguous.
    """

    d_min_m: float = 1.0

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Assign by distance in metres."""
        local = landmarks_around(state, model, seen)
        place = model.invert(local.pose, seen.z).landmark
        distance = np.linalg.norm(place[:, None] - local.landmark[None], axis=2)  # 17
        column = match_in_order(distance, distance < self.d_min_m)
        return indices_of(
            column, distance >= self.d_min_m, local.landmark_index, state.landmark_count
        )
