"""Faults of what the filter does with the data: intervals, labels, order, counts."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.faults.fault import Fault, Plant, moving, remembering, stepping
from ekf_reference.association.known import KnownAssociation, SurveyedLandmarks
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Index
from ekf_reference.core.landmark_types import POINT, MeasurementModel
from ekf_reference.core.measurements import REJECTED, Measurements
from ekf_reference.core.state import KalmanState
from ekf_reference.models.motion import MotionStep

_GATE_SIGMA = 2.0


def _previous_interval() -> Plant:
    last_s: list[float] = []

    def step(own: Any, pose: Array, control: Array, duration_s: float) -> MotionStep:
        moved: MotionStep = own(pose, control, last_s[0] if last_s else duration_s)
        last_s[:] = [duration_s]
        return moved

    return moving(step)


def _applied_twice(own: Any, pose: Array, *args: Any) -> MotionStep:
    one: MotionStep = own(pose, *args)
    two: MotionStep = own(one.pose, *args)
    by_control = two.jacobian_pose @ one.jacobian_control + two.jacobian_control
    return MotionStep(two.pose, two.jacobian_pose @ one.jacobian_pose, by_control)


def _one_scan_late() -> Plant:
    waiting: list[tuple[Any, ...]] = []

    def observe(own: Any, *seen: Any) -> Index:
        due = waiting.copy()
        waiting[:] = [seen]
        for one in due:
            own(*one)
        return np.full(len(seen[0]), REJECTED)

    return stepping(observe=observe)


def _one_step_late() -> Plant:
    waiting: list[tuple[Any, ...]] = []

    def observe(own: Any, *seen: Any) -> Index:
        waiting[:] = [(own, *seen)]
        return np.full(len(seen[0]), REJECTED)

    def predict(own: Any, *args: Any) -> None:
        own(*args)
        for observed, *seen in waiting:
            observed(*seen)
        waiting.clear()

    return stepping(observe=observe, predict=predict)


def _fixed_twice(own: Any, *args: Array) -> bool:
    used = own(*args)
    own.__self__.take_numbers("position", -1)
    return bool(own(*args) and used)


def _seen_twice(own: Any, *seen: Any) -> Index:
    landmark_indices: Index = own(*seen)
    own.__self__.take_numbers(POINT.name, -len(landmark_indices))
    own(*seen)
    return landmark_indices


@dataclass
class _InitialisedAgain(KnownAssociation):
    """Landmarks are forgotten when they leave the view, and initialised again on return."""

    last_seen_s: dict[int, float] = field(default_factory=dict)

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """New landmark indices for labels unseen for 5 s."""
        for label in seen.identity.tolist():
            if seen.time_s - self.last_seen_s.get(label, seen.time_s) > 5.0:
                self.index_of.pop(label, None)
            self.last_seen_s[label] = seen.time_s
        landmark_indices = seen.identity.astype(np.intp)
        added = state.landmark_count
        for i, label in enumerate(seen.identity.tolist()):
            if label not in self.index_of:
                self.index_of[label] = added
                added += 1
            landmark_indices[i] = self.index_of[label]
        return landmark_indices


@dataclass
class _SwappedLabels(KnownAssociation):
    """In every tenth scan the first two labels are exchanged."""

    scans: int = 0

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Exchange, where both landmarks are known."""
        found = super().assign(state, model, seen)
        self.scans += 1
        if self.scans % 10 == 0 and len(found) > 1 and found[:2].max() < state.landmark_count:
            found[:2] = found[1::-1]
        return found


def _by_labels(rule: type[KnownAssociation], **settings: Any) -> Plant:
    """Another rule by labels; that of surveyed landmarks stays."""

    def plant(ekf: Ekf) -> None:
        sound = ekf.association
        if isinstance(sound, SurveyedLandmarks):
            first_index = len(sound.index_of)
            labelled = rule(first_index=first_index, **settings)
            ekf.association = replace(sound, rule=labelled)
        else:
            ekf.association = rule(**settings)

    return plant


def waiting_for_control() -> Plant:
    """Nothing is predicted before the first control that moves."""
    moved: list[bool] = []

    def predict(own: Any, control: Array, *args: Any) -> None:
        if control.any():
            moved[:] = [True]
        if moved:
            own(control, *args)

    return stepping(predict=predict)


FAULTS = {
    "previous interval": Fault(
        "a step lasts as long as the one before it", remembering(_previous_interval)
    ),
    "interval ignored": Fault(
        "every step lasts 25 ms, whatever the stamps say",
        moving(lambda own, pose, control, duration_s: own(pose, control, 0.025)),
    ),
    "control applied twice": Fault(
        "every control moves the vehicle two times", moving(_applied_twice)
    ),
    "control applied half": Fault(
        "every control acts for half of its interval",
        moving(lambda own, pose, control, duration_s: own(pose, control, 0.5 * duration_s)),
    ),
    "measurement one scan late": Fault(
        "the measurements are fused one scan late, at the time of the next",
        remembering(_one_scan_late),
    ),
    "measurement one step late": Fault(
        "the measurements are fused one prediction late", remembering(_one_step_late)
    ),
    "position fused twice": Fault(
        "every absolute position is used two times", stepping(fix_position=_fixed_twice)
    ),
    "measurement fused twice": Fault(
        "every measurement is used two times", stepping(observe=_seen_twice)
    ),
    "landmark initialised again": Fault(
        "a landmark that returns into view becomes another one",
        _by_labels(_InitialisedAgain),
    ),
    "labels exchanged": Fault(
        "two labels of every tenth scan are exchanged",
        _by_labels(_SwappedLabels),
    ),
    "gate of sigmas": Fault(
        f"the gate compares squared distances with {_GATE_SIGMA:g} sigma",
        _by_labels(KnownAssociation, gate=_GATE_SIGMA),
    ),
}
