"""Defects of what the filter does with the data: intervals, labels, order, counts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.defects.defect import Defect, OtherMotion, with_motion, with_steps
from comparisons.arrays import Array
from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Index
from ekf_reference.core.landmark_types import POINT, MeasurementModel
from ekf_reference.core.measurements import NOT_MEASURED, REJECTED, MeasuredAttributes, Measurements
from ekf_reference.core.state import KalmanState
from ekf_reference.models.motion import MotionStep

_GATE_SIGMA = 2.0


@dataclass
class PreviousInterval(OtherMotion):
    """Every step lasts as long as the one before should have."""

    last_s: float | None = None

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """Late by one."""
        duration, self.last_s = self.last_s or duration_s, duration_s
        return super().step(pose, control, duration)


class ConstantInterval(OtherMotion):
    """Every step lasts 25 ms."""

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """The interval is ignored."""
        return super().step(pose, control, 0.025)


class AppliedTwice(OtherMotion):
    """Every control acts twice."""

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """Two steps in one."""
        one = super().step(pose, control, duration_s)
        two = super().step(one.pose, control, duration_s)
        by_control = two.jacobian_pose @ one.jacobian_control + two.jacobian_control
        return MotionStep(two.pose, two.jacobian_pose @ one.jacobian_pose, by_control)


class AppliedHalf(OtherMotion):
    """Every control acts for half of its interval."""

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """Half the time."""
        return super().step(pose, control, 0.5 * duration_s)


class OneScanLate(Ekf):
    """Measurements wait for the next scan's time."""

    _waiting: tuple[Array, Array, NDArray[np.int64], float, MeasuredAttributes] | None = None

    def observe(
        self,
        z: Array,
        sigma: Array,
        identity: NDArray[np.int64],
        time_s: float = 0.0,
        attributes: MeasuredAttributes = NOT_MEASURED,
    ) -> Index:
        """Fuse the ones before."""
        due, self._waiting = self._waiting, (z, sigma, identity, time_s, attributes)
        if due is not None:
            super().observe(*due)
        return np.full(len(z), REJECTED)


class OneStepLate(Ekf):
    """Measurements are fused after the next prediction."""

    _waiting: tuple[Array, Array, NDArray[np.int64], float, MeasuredAttributes] | None = None

    def observe(
        self,
        z: Array,
        sigma: Array,
        identity: NDArray[np.int64],
        time_s: float = 0.0,
        attributes: MeasuredAttributes = NOT_MEASURED,
    ) -> Index:
        """Wait."""
        self._waiting = (z, sigma, identity, time_s, attributes)
        return np.full(len(z), REJECTED)

    def predict(self, control: Array, covariance: Array, duration_s: float) -> None:
        """Move on, then fuse."""
        super().predict(control, covariance, duration_s)
        due, self._waiting = self._waiting, None
        if due is not None:
            super().observe(*due)


class FixedTwice(Ekf):
    """Every position is fused twice."""

    def fix_position(self, z: Array, covariance: Array) -> bool:
        """Once, and again."""
        used = super().fix_position(z, covariance)
        self.take_numbers("position", -1)
        return super().fix_position(z, covariance) and used


class SeenTwice(Ekf):
    """Every measurement is fused twice."""

    def observe(
        self,
        z: Array,
        sigma: Array,
        identity: NDArray[np.int64],
        time_s: float = 0.0,
        attributes: MeasuredAttributes = NOT_MEASURED,
    ) -> Index:
        """Once, and again."""
        landmark_indices = super().observe(z, sigma, identity, time_s, attributes)
        self.take_numbers(POINT.name, -len(landmark_indices))
        super().observe(z, sigma, identity, time_s, attributes)
        return landmark_indices


@dataclass
class InitialisedAgain(KnownAssociation):
    """Landmarks are forgotten when they leave the view, and initialised again on return."""

    last_seen_s: dict[int, float] = field(default_factory=dict)

    def assign(
        self, state: KalmanState, observation: MeasurementModel, measurements: Measurements
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
class SwappedLabels(KnownAssociation):
    """In every tenth scan the first two labels are exchanged."""

    scans: int = 0

    def assign(
        self, state: KalmanState, observation: MeasurementModel, measurements: Measurements
    ) -> Index:
        """Exchange, where both landmarks are known."""
        landmark_indices = super().assign(state, observation, measurements)
        self.scans += 1
        if (
            self.scans % 10 == 0
            and len(landmark_indices) > 1
            and landmark_indices[:2].max() < state.landmark_count
        ):
            landmark_indices[:2] = landmark_indices[1::-1]
        return landmark_indices


def _begin_anew(ekf: Ekf) -> None:
    ekf.association = InitialisedAgain()


def _swap_labels(ekf: Ekf) -> None:
    ekf.association = SwappedLabels()


def _gate_by_sigma(ekf: Ekf) -> None:
    ekf.association = KnownAssociation(gate=_GATE_SIGMA)


DEFECTS = (
    Defect(
        "previous interval",
        "a step lasts as long as the one before it",
        ("model", "the predicted pose", "the interval of the previous one"),
        with_motion(PreviousInterval),
        "uneven",
    ),
    Defect(
        "interval ignored",
        "every step lasts 25 ms, whatever the stamps say",
        ("model", "the predicted pose", "interval is always 0.025 s"),
        with_motion(ConstantInterval),
        "uneven",
    ),
    Defect(
        "control applied twice",
        "every control moves the vehicle two times",
        ("model", "the predicted pose", "the control is applied twice"),
        with_motion(AppliedTwice),
    ),
    Defect(
        "control applied half",
        "every control acts for half of its interval",
        ("model", "the predicted pose", "0.5 times its interval"),
        with_motion(AppliedHalf),
    ),
    Defect(
        "measurement one scan late",
        "the measurements are fused one scan late, at the time of the next",
        ("data", "measurements", "late"),
        with_steps(OneScanLate),
    ),
    Defect(
        "measurement one step late",
        "the measurements are fused one prediction late",
        ("data", "measurements", "late"),
        with_steps(OneStepLate),
    ),
    Defect(
        "position fused twice",
        "every absolute position is used two times",
        ("data", "positions", "more than once"),
        with_steps(FixedTwice),
        "positions",
    ),
    Defect(
        "measurement fused twice",
        "every measurement is used two times",
        ("data", "measurements", "more than once"),
        with_steps(SeenTwice),
    ),
    Defect(
        "landmark initialised again",
        "a landmark that returns into view becomes another one",
        ("data", "labels", "several landmarks"),
        _begin_anew,
        "closing",
    ),
    Defect(
        "labels exchanged",
        "two labels of every tenth scan are exchanged",
        ("data", "labels", "one landmark"),
        _swap_labels,
    ),
    Defect(
        "gate of sigmas",
        f"the gate compares squared distances with {_GATE_SIGMA:g} sigma",
        ("data", "rejected", "gate"),
        _gate_by_sigma,
    ),
)
