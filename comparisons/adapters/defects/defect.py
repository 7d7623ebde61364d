"""What a planted defect is, and the parts that planting takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from comparisons.arrays import Array
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import (
    POINT,
    MeasurementModel,
    NewLandmarks,
    PredictedMeasurements,
)
from ekf_reference.core.state import KalmanState
from ekf_reference.models.motion import MotionModel, MotionStep
from ekf_reference.models.range_bearing import RangeBearing

Plant = Callable[[Ekf], None]


@dataclass(frozen=True)
class Defect:
    """One way in which EKF-SLAM code goes wrong.

    expected_cause: the gap that the report's first cause must name, then words that its evidence
    or hint must hold. plant: puts the defect into a filter that has not started. log: the
    name of one that shows it.
    """

    name: str
    what: str
    expected_cause: tuple[str, ...]
    plant: Plant
    log: str = "loop"


@dataclass
class OtherObservation:
    """An observation model that differs from the sound one in what a subclass overrides."""

    sound: RangeBearing = field(default_factory=RangeBearing)

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """As they come, and R."""
        return self.sound.measured(z, sigma)

    def range_m(self, z: Array) -> Array:
        """(m,) the range."""
        return self.sound.range_m(z)

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Expected measurements."""
        return self.sound.predict(pose, landmarks)

    def innovation(self, z: Array, predicted: Array) -> Array:
        """Difference, wrapped."""
        return self.sound.innovation(z, predicted)

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """Places of new landmarks."""
        return self.sound.invert(pose, z)


@dataclass
class OtherMotion:
    """A motion model made of the sound one by a subclass."""

    sound: MotionModel

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """Predict."""
        return self.sound.step(pose, control, duration_s)


def with_state(state: Callable[[Array, Array], KalmanState]) -> Plant:
    """Another keeper of mean and covariance."""

    def plant(ekf: Ekf) -> None:
        ekf.state = state(ekf.state.pose, np.array(ekf.state.covariance))

    return plant


def with_observation(observation: Callable[[], MeasurementModel]) -> Plant:
    """Another observation model, new for every filter."""

    def plant(ekf: Ekf) -> None:
        ekf.models[POINT] = observation()

    return plant


def with_motion(motion: Callable[[MotionModel], MotionModel]) -> Plant:
    """Another motion model, made of the filter's own."""

    def plant(ekf: Ekf) -> None:
        ekf.motion = motion(ekf.motion)

    return plant


def with_steps(kind: type[Ekf]) -> Plant:
    """Other steps of the filter itself."""

    def plant(ekf: Ekf) -> None:
        ekf.__class__ = type(kind.__name__, (kind, ekf.__class__), {})

    return plant
