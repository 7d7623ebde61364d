"""Association by the labels that a log carries."""

from __future__ import annotations

import math
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
    where labels are certain. first_index: where landmarks by label begin in the map.
    """

    gate: float = float("inf")
    index_of: dict[int, int] = field(default_factory=dict)
    first_index: int = 0

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Look the labels up; new ones take the next landmark indices. Unlabelled are rejected."""
        named = [self._index(label) for label in seen.identity.tolist()]
        landmark_indices = np.array(named, dtype=np.intp)
        return reject_beyond(self.gate, landmark_indices, state, model, seen)

    def _index(self, label: int) -> int:
        if label < 0:
            return REJECTED
        return self.index_of.setdefault(label, self.first_index + len(self.index_of))


@dataclass(frozen=True)
class SurveyedLandmarks:
    """Surveyed landmarks go by label, others by a rule (Guivant 2002, section 4.2).

    index_of: of the surveyed, by label. gate: as in KnownAssociation; a wrong measurement of a
    landmark that is known for certain does the most harm.
    """

    rule: Association
    index_of: dict[int, int]
    gate: float = 30.0

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Assign surveyed landmarks first, then the rest by the rule."""
        labels = seen.identity.tolist()
        landmark_indices = np.array(
            [self.index_of.get(label, REJECTED) for label in labels], dtype=np.intp
        )
        others = np.flatnonzero(landmark_indices < 0)
        landmark_indices = reject_beyond(self.gate, landmark_indices, state, model, seen)
        if len(others):
            landmark_indices[others] = self.rule.assign(state, model, seen.take(others))
        return landmark_indices


def reject_beyond(
    gate: float,
    landmark_indices: Index,
    state: KalmanState,
    model: MeasurementModel,
    seen: Measurements,
) -> Index:
    """Reject labels that the gate contradicts, and those of removed landmarks.

    Args:
        gate: Largest normalised innovation squared, infinite to trust every label.
        landmark_indices: (m,) landmark indices that the labels name.
        state: The filter's, after the prediction.
        model: How these landmarks are measured.
        seen: The measurements.

    Returns:
        (m,) landmark indices, REJECTED where one is not used; new landmarks pass.
    """
    first = state.layout.first[seen.kind]
    landmark_indices = landmark_indices.copy()
    mapped = np.flatnonzero((landmark_indices >= 0) & (landmark_indices < len(first)))
    gone = first[landmark_indices[mapped]] == ABSENT
    landmark_indices[mapped[gone]], mapped = REJECTED, mapped[~gone]
    if math.isfinite(gate) and len(mapped):
        local = state.map_of(landmark_indices[mapped])
        nis = normalised_distances(local, model, seen.take(mapped)).nis.diagonal()
        landmark_indices[mapped[nis > gate]] = REJECTED
    return landmark_indices
