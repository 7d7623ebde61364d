"""Association by the labels that a log carries."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ekf_reference.association.distances import normalised_distances
from ekf_reference.core.geometry import Index
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.layout import ABSENT
from ekf_reference.core.measurements import REJECTED, Association, Measurements
from ekf_reference.core.state import KalmanState


@dataclass
class KnownAssociation:
    """Takes the labels that the log carries; the n-th new label becomes the n-th landmark.

    gate: nis beyond which a label is taken for a misread (Nieto 2005, section 2.4.1); infinite
    where labels are certain. first_slot: where landmarks by label begin in the map.
    """

    gate: float = float("inf")
    slot_of: dict[int, int] = field(default_factory=dict)
    first_slot: int = 0

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Look the labels up, giving new ones the next slots. Unlabelled are rejected."""
        slots = np.full(len(seen), REJECTED, dtype=np.intp)
        for k, label in enumerate(seen.identity.tolist()):
            if label >= 0:
                slots[k] = self.slot_of.setdefault(label, self.first_slot + len(self.slot_of))
        return reject_beyond(self.gate, slots, state, model, seen)


@dataclass(frozen=True)
class SurveyedLandmarks:
    """Surveyed landmarks go by label, others by a rule (Guivant 2002, section 4.2).

    slot_of: of the surveyed, by label. gate: as in KnownAssociation; a wrong measurement of a
    landmark that is known for certain does the most harm.
    """

    rule: Association
    slot_of: dict[int, int]
    gate: float = 30.0

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Assign surveyed landmarks first, then the rest by the rule."""
        labels = seen.identity.tolist()
        slots = np.array([self.slot_of.get(label, REJECTED) for label in labels], dtype=np.intp)
        others = np.flatnonzero(slots < 0)
        slots = reject_beyond(self.gate, slots, state, model, seen)
        if len(others):
            slots[others] = self.rule.assign(state, model, seen.take(others))
        return slots


def reject_beyond(
    gate: float, slots: Index, state: KalmanState, model: MeasurementModel, seen: Measurements
) -> Index:
    """Return the slots, REJECTED where a landmark was removed or its nis exceeds the gate."""
    slots = slots.copy()
    mapped = np.flatnonzero((slots >= 0) & (slots < state.landmark_count))
    gone = state.layout.first[seen.width][slots[mapped]] == ABSENT
    slots[mapped[gone]], mapped = REJECTED, mapped[~gone]
    if np.isfinite(gate) and len(mapped):
        local = state.map_of(slots[mapped])
        nis = normalised_distances(local, model, seen.take(mapped)).nis.diagonal()
        slots[mapped[nis > gate]] = REJECTED
    return slots
