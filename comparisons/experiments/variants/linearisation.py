"""The ideal filter's linearisation: at the true state. The others are the core filter's own."""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array, Index
from ekf_reference.core.landmark_types import LandmarkKind
from ekf_reference.core.linearisation import Linearisation, MeanState, Points


class AtTruth(Linearisation):
    """The ideal EKF: at the true state. It cannot be built; it shows what linearising has cost."""

    def __init__(self, pose: Array, control: Array, landmark: Array) -> None:
        """Keep the truth.

        Args:
            pose: (K + 1, 3) of every step, the start's first.
            control: (K, 2).
            landmark: (L, 2) in the order in which the filter will initialise them.
        """
        self._pose, self._control, self._landmark = pose, control, landmark
        self._now = 0

    def start(self, pose: Array) -> None:
        """Begin at the first pose."""
        self._now = 0

    def control(self, state: MeanState, control: Array) -> Points | None:
        """Return the true heading and control, of all runs."""
        return self._like(state, self._pose[self._now]), self._like(state, self._control[self._now])

    def step(self, state: MeanState, arrived: Array) -> Array | None:
        """Return the true way."""
        before, after = self._pose[self._now : self._now + 2]
        self._now += 1
        return self._like(state, after[:2] - before[:2])

    def measurement(
        self, state: MeanState, landmark_index: Index, kind: LandmarkKind
    ) -> Points | None:
        """Return where pose and landmarks are."""
        places = self._like(state, self._landmark[landmark_index])
        return self._like(state, self._pose[self._now]), places

    def initialisation(self, state: MeanState, place: Array, kind: LandmarkKind) -> Points | None:
        """Return where pose and the next landmarks are."""
        count = state.places(kind).shape[-2]
        return self.measurement(state, count + np.arange(place.shape[-2]), kind)

    @staticmethod
    def _like(state: MeanState, one: Array) -> Array:
        """Repeat an array for each of the runs of a state."""
        return np.tile(one, (*state.pose.shape[:-1], *(1,) * one.ndim))
