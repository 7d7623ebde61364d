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


def previous_interval() -> Plant:
    """A step lasts as long as the one before it."""
    last_s: list[float] = []

    def step(original: Any, pose: Array, control: Array, duration_s: float) -> MotionStep:
        moved: MotionStep = original(pose, control, last_s[0] if last_s else duration_s)
        last_s[:] = [duration_s]
        return moved

    return moving(step)


def applied_twice(original: Any, pose: Array, *args: Any) -> MotionStep:
    """A control moves the vehicle two times."""
    step: MotionStep = original(pose, *args)
    two: MotionStep = original(step.pose, *args)
    by_control = two.jacobian_pose @ step.jacobian_control + two.jacobian_control
    return MotionStep(two.pose, two.jacobian_pose @ step.jacobian_pose, by_control)


def scans_late(count: int) -> Plant:
    """Each scan is fused so many scans later, at the time of that one."""
    waiting: list[tuple[Any, ...]] = []

    def observe(original: Any, *measured: Any) -> Index:
        waiting.append(measured)
        if len(waiting) > count:
            original(*waiting.pop(0))
        return np.full(len(measured[0]), REJECTED)

    return stepping(observe=observe)


def predictions_late(count: int) -> Plant:
    """Each scan is fused after so many more predictions."""
    waiting: list[tuple[int, Any, tuple[Any, ...]]] = []

    def observe(original: Any, *measured: Any) -> Index:
        waiting.append((count, original, measured))
        return np.full(len(measured[0]), REJECTED)

    def predict(original: Any, *args: Any) -> None:
        original(*args)
        due = [(left - 1, observed, measured) for left, observed, measured in waiting]
        waiting[:] = [one for one in due if one[0] > 0]
        for left, observed, measured in due:
            if left <= 0:
                observed(*measured)

    return stepping(observe=observe, predict=predict)


def _fixed_twice(original: Any, *args: Array) -> bool:
    used = original(*args)
    original.__self__.take_numbers("position", -1)
    return bool(original(*args) and used)


def seen_times(count: int) -> Plant:
    """Every scan is used so many times."""

    def observe(original: Any, *measured: Any) -> Index:
        landmark_indices: Index = original(*measured)
        for _ in range(count - 1):
            original.__self__.take_numbers(POINT.name, -len(landmark_indices))
            original(*measured)
        return landmark_indices

    return stepping(observe=observe)


@dataclass
class _InitialisedAgain(KnownAssociation):
    """Landmarks are forgotten when they leave the view, and initialised again on return."""

    last_seen_s: dict[int, float] = field(default_factory=dict)

    def assign(
        self, state: KalmanState, model: MeasurementModel, measurements: Measurements
    ) -> Index:
        """New landmark indices for labels unseen for 5 s."""
        for label in measurements.identity.tolist():
            if measurements.time_s - self.last_seen_s.get(label, measurements.time_s) > 5.0:
                self.index_of.pop(label, None)
            self.last_seen_s[label] = measurements.time_s
        landmark_indices = measurements.identity.astype(np.intp)
        added = state.landmark_count
        for i, label in enumerate(measurements.identity.tolist()):
            if label not in self.index_of:
                self.index_of[label] = added
                added += 1
            landmark_indices[i] = self.index_of[label]
        return landmark_indices


@dataclass
class _SwappedLabels(KnownAssociation):
    """In every tenth scan the first two labels are exchanged."""

    scans: int = 0

    def assign(
        self, state: KalmanState, model: MeasurementModel, measurements: Measurements
    ) -> Index:
        """Exchange, where both landmarks are known."""
        assigned = super().assign(state, model, measurements)
        self.scans += 1
        if self.scans % 10 == 0 and len(assigned) > 1 and assigned[:2].max() < state.landmark_count:
            assigned[:2] = assigned[1::-1]
        return assigned


def by_labels(rule: type[KnownAssociation], **settings: Any) -> Plant:
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

    def predict(original: Any, control: Array, *args: Any) -> None:
        if control.any():
            moved[:] = [True]
        if moved:
            original(control, *args)

    return stepping(predict=predict)


FAULTS = {
    "previous interval": Fault(
        "a step lasts as long as the one before it", remembering(previous_interval)
    ),
    "interval ignored": Fault(
        "every step lasts 25 ms, whatever the stamps say",
        moving(lambda original, pose, control, duration_s: original(pose, control, 0.025)),
    ),
    "control applied twice": Fault(
        "every control moves the vehicle two times", moving(applied_twice)
    ),
    "control applied half": Fault(
        "every control acts for half of its interval",
        moving(
            lambda original, pose, control, duration_s: original(pose, control, 0.5 * duration_s)
        ),
    ),
    "measurement one scan late": Fault(
        "the measurements are fused one scan late, at the time of the next",
        remembering(lambda: scans_late(1)),
    ),
    "measurement one step late": Fault(
        "the measurements are fused one prediction late", remembering(lambda: predictions_late(1))
    ),
    "position fused twice": Fault(
        "every absolute position is used two times", stepping(fix_position=_fixed_twice)
    ),
    "measurement fused twice": Fault("every measurement is used two times", seen_times(2)),
    "landmark initialised again": Fault(
        "a landmark that returns into view becomes another one",
        by_labels(_InitialisedAgain),
    ),
    "labels exchanged": Fault(
        "two labels of every tenth scan are exchanged",
        by_labels(_SwappedLabels),
    ),
    "gate of sigmas": Fault(
        f"the gate compares squared distances with {_GATE_SIGMA:g} sigma",
        by_labels(KnownAssociation, gate=_GATE_SIGMA),
    ),
}
