"""Gated nearest neighbour (Nieto 2005, section 2.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_reference.association.attributes import NO_ATTRIBUTES, Attributes, same_tail
from ekf_reference.association.distances import (
    landmarks_around,
    match_in_order,
    normalised_distances,
    slots_of,
)
from ekf_reference.core.geometry import Index
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.measurements import Measurements
from ekf_reference.core.state import KalmanState


@dataclass(frozen=True)
class NearestNeighbour:
    """Gated nearest neighbour, each landmark taken at most once in a scan.

    A measurement may join a landmark when its normalised innovation squared (Nieto 2005, eq. 2.58)
    is within `gate`; among those the least N (eq. 2.60) wins, over the whole scan in order of N.
    A measurement whose nis exceeds `new_gate` for every landmark starts a new one; between the two
    gates, or beaten to its landmark, it is ambiguous.

    gate, new_gate: bounds of the chi-square variable with 2 degrees of freedom; with attributes,
    which enter both nis and N, those of the same probability with as many more.
    """

    gate: float = 13.82  # 99.9 %
    new_gate: float = 25.0
    attributes: Attributes = NO_ATTRIBUTES

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Assign by position and attributes; labels are not used."""
        local = landmarks_around(state, model, seen)
        distances = normalised_distances(local, model, seen)
        added = self.attributes.distances(local.slot, seen)
        nis, dof = distances.nis + added.nis, 2 + added.dof
        column = match_in_order(distances.n + added.n, nis <= same_tail(self.gate, dof))
        new = np.logical_and.reduce(nis > same_tail(self.new_gate, dof), axis=1)
        return slots_of(column, new, local.slot, state.landmark_count)
