"""Reject measurements of what moves, and landmarks there (Nieto 2005, section 6.5).

Measurements from dynamic regions are discarded, and landmarks in them are deactivated: their
landmark indices are closed for good. The other states are estimated as if these had been
marginalised out. They stay in the state, so that the compressed filter still equals the full one.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ekf_reference.association.distances import landmarks_around
from ekf_reference.core.geometry import Index
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.measurements import DYNAMIC, Association, DynamicGuard, Measurements
from ekf_reference.core.state import KalmanState


@dataclass
class DynamicRejection:
    """Wraps an association rule: it sees neither dynamic measurements nor deactivated landmarks.

    deactivated: landmark indices that are closed. What was fused before a region was found to be
    dynamic stays fused. Only landmarks within reach of the measurements are asked about, so that a
    compressed filter, whose other landmarks are not up to date, deactivates the same ones at the
    same time.
    """

    rule: Association
    guard: DynamicGuard
    deactivated: set[int] = field(default_factory=set)

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Assign by the rule; DYNAMIC: in a dynamic region, or of a closed landmark index."""
        landmark_indices = np.full(len(seen), DYNAMIC, dtype=np.intp)
        around = landmarks_around(state, model, seen)
        self.deactivated.update(
            around.landmark_index[self.guard.is_dynamic(around.landmark)].tolist()
        )
        closed = tuple(sorted(self.deactivated))
        still = np.flatnonzero(~self.guard.is_dynamic(model.invert(around.pose, seen.z).landmark))
        if len(still):
            rest = replace(seen.take(still), closed=closed)
            landmark_indices[still] = self.rule.assign(state, model, rest)
            landmark_indices[np.isin(landmark_indices, closed)] = DYNAMIC
        return landmark_indices
