"""Nearest neighbour in metres (Misono 2007, section 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_reference.association.distances import landmarks_around, match_in_order, slots_of
from ekf_reference.core.geometry import Index
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.measurements import Measurements
from ekf_reference.core.state import KalmanState


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
        new = distance.min(axis=1, initial=np.inf) >= self.d_min_m
        return slots_of(column, new, local.slot, state.landmark_count)
