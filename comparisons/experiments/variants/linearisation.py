"""Where a filter linearises: at its estimate, at first estimates, under a constraint, at the truth.

The frame of the map is not observable: the Jacobians must not see a common shift or turn of robot
and landmarks, N = [I, J c; 0, 1; I, J l_1; I, J l_2; ...]. That holds for all time when every Phi
turns about the travel of c and every H uses the offset l - c, for one fixed l per landmark.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.experiments.variants.batch_state import BatchState


class StepPoints(NamedTuple):
    """travel: (B, 2) of Phi = [[I, J travel], [0, 1]]. heading (B,), control (B, 2): of dx / du."""

    travel: Array
    heading: Array
    control: Array


class MeasuredPoints(NamedTuple):
    """heading: (B,). offset: (B, m, 2), landmark minus robot."""

    heading: Array
    offset: Array


class Linearisation(Protocol):
    """Interface: each method is called before its event changes the state."""

    def start(self, state: BatchState) -> None:
        """The state before the first step."""
        ...

    def predicted(self, state: BatchState, arrival: Array, control: Array) -> StepPoints:
        """The state departs; it will arrive at (B, 3)."""
        ...

    def measured(self, state: BatchState, label: Index, landmark_index: Index) -> MeasuredPoints:
        """Landmarks (m,) of the map are seen."""
        ...

    def initialised(self, state: BatchState, label: Index, point: Array) -> MeasuredPoints:
        """Landmarks at (B, k, 2) will be appended."""
        ...


class AtEstimate:
    """The standard EKF: always at the newest estimate."""

    def start(self, state: BatchState) -> None:
        """Nothing to keep."""

    def predicted(self, state: BatchState, arrival: Array, control: Array) -> StepPoints:
        """From the updated to the predicted position."""
        return StepPoints(arrival[:, :2] - state.pose[:, :2], state.pose[:, 2], control)

    def measured(self, state: BatchState, label: Index, landmark_index: Index) -> MeasuredPoints:
        """As it is believed now."""
        return MeasuredPoints(
            state.pose[:, 2].copy(), state.landmarks[:, landmark_index] - state.pose[:, None, :2]
        )

    def initialised(self, state: BatchState, label: Index, point: Array) -> MeasuredPoints:
        """As it is believed now."""
        return MeasuredPoints(state.pose[:, 2].copy(), point - state.pose[:, None, :2])


class AtFirstEstimate:
    """FEJ-EKF (Huang, Mourikis, Roumeliotis 2008): c is the predicted position, l the first one."""

    def start(self, state: BatchState) -> None:
        """No landmarks yet."""
        self._before = state.pose.copy()
        self._first = np.zeros((len(self._before), 0, 2))

    def predicted(self, state: BatchState, arrival: Array, control: Array) -> StepPoints:
        """From the predicted position before the update to the next."""
        travel = arrival[:, :2] - self._before[:, :2]
        self._before = arrival
        return StepPoints(travel, state.pose[:, 2], control)

    def measured(self, state: BatchState, label: Index, landmark_index: Index) -> MeasuredPoints:
        """The first estimates of the landmarks, from the predicted pose."""
        return MeasuredPoints(
            self._before[:, 2], self._first[:, landmark_index] - self._before[:, None, :2]
        )

    def initialised(self, state: BatchState, label: Index, point: Array) -> MeasuredPoints:
        """From the predicted pose, like the measurements of this instant."""
        self._first = np.concatenate((self._first, point), axis=1)
        return MeasuredPoints(self._before[:, 2], point - self._before[:, None, :2])


class ObservabilityConstrained:
    """OC-EKF (Huang, Mourikis, Roumeliotis 2010): that constraint, near the estimate.

    The points of the robot p* and of the landmarks l* at one time may all be moved by a common
    shift u against c and l. The shift is the least-squares one: the mean of what robot and all
    mapped landmarks have moved by; u comes with each prediction, for the measurements that follow.
    """

    def start(self, state: BatchState) -> None:
        """No landmarks yet."""
        self._anchor = state.pose[:, :2].copy()
        self._first = np.zeros((len(self._anchor), 0, 2))

    def predicted(self, state: BatchState, arrival: Array, control: Array) -> StepPoints:
        """From p* = c + u to the predicted position, which becomes the new c + u."""
        robot = state.pose[:, :2] - self._anchor
        moved = np.concatenate((robot[:, None], state.landmarks - self._first), axis=1)
        shift = moved.mean(axis=1)
        travel = arrival[:, :2] - (self._anchor + shift)
        self._anchor = arrival[:, :2] - shift
        return StepPoints(travel, state.pose[:, 2], control)

    def measured(self, state: BatchState, label: Index, landmark_index: Index) -> MeasuredPoints:
        """L* - p*, which is l - c."""
        offset = self._first[:, landmark_index] - self._anchor[:, None]
        return MeasuredPoints(state.pose[:, 2].copy(), offset)

    def initialised(self, state: BatchState, label: Index, point: Array) -> MeasuredPoints:
        """As it is believed now; l is put where that offset is right from c."""
        offset = point - state.pose[:, None, :2]
        first = self._anchor[:, None] + offset
        self._first = np.concatenate((self._first, first), axis=1)
        return MeasuredPoints(state.pose[:, 2].copy(), offset)


class AtTruth:
    """The ideal EKF: at the true state. It cannot be built; it shows what linearising has cost."""

    def __init__(self, pose: Array, control: Array, landmark: Array) -> None:
        """pose: (K + 1, 3), control: (K, 2), landmark: (L, 2) by label."""
        self._pose, self._control, self._landmark = pose, control, landmark
        self._now = 0

    def start(self, state: BatchState) -> None:
        """At the first pose."""
        self._now = 0

    def predicted(self, state: BatchState, arrival: Array, control: Array) -> StepPoints:
        """Along the true step."""
        before, after = self._pose[self._now : self._now + 2]
        steps, runs = self._control[self._now], len(arrival)
        self._now += 1
        return StepPoints(
            np.tile(after[:2] - before[:2], (runs, 1)),
            np.full(runs, before[2]),
            np.tile(steps, (runs, 1)),
        )

    def measured(self, state: BatchState, label: Index, landmark_index: Index) -> MeasuredPoints:
        """Where the landmarks are."""
        return self._offset(label, len(state.pose))

    def initialised(self, state: BatchState, label: Index, point: Array) -> MeasuredPoints:
        """Where the landmarks are."""
        return self._offset(label, len(state.pose))

    def _offset(self, label: Index, runs: int) -> MeasuredPoints:
        x, y, heading = self._pose[self._now]
        offset = self._landmark[label] - (x, y)
        return MeasuredPoints(np.full(runs, heading), np.tile(offset, (runs, 1, 1)))
