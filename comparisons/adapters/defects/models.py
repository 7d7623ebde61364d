"""Defects of the models: predictions, expected measurements, their Jacobians, new landmarks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from comparisons.adapters.defects.defect import (
    Defect,
    OtherMotion,
    OtherObservation,
    with_motion,
    with_observation,
)
from comparisons.arrays import Array
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import NewLandmarks, PredictedMeasurements
from ekf_reference.models.motion import AckermannModel, IntegratedModel, MotionModel, MotionStep
from ekf_reference.models.position import PositionModel
from ekf_reference.models.range_bearing import RangeBearing

_DRIFT_RADPS = 0.01


class PrintedBearingRow(RangeBearing):
    """N 2.42 as printed."""

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Position terms of the bearing with signs exchanged."""
        z, jacobian_pose, jacobian_landmark = super().predict(pose, landmarks)
        jacobian_pose[:, 1, :2] *= -1.0
        jacobian_landmark[:, 1] *= -1.0
        return PredictedMeasurements(z, jacobian_pose, jacobian_landmark)


class UnwrappedInnovation(RangeBearing):
    """z - z_hat as numbers."""

    def innovation(self, z: Array, predicted: Array) -> Array:
        """Not wrapped."""
        return z - predicted


class Clockwise(RangeBearing):
    """Bearings counted clockwise, as a compass does."""

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """With the bearing's sign exchanged."""
        z, noise = super().measured(z, sigma)
        return z * (1.0, -1.0), noise


class NoHeadingColumn(RangeBearing):
    """The bearing's Jacobian forgets that the vehicle turns."""

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Without the column."""
        z, jacobian_pose, jacobian_landmark = super().predict(pose, landmarks)
        jacobian_pose[:, :, 2] = 0.0
        return PredictedMeasurements(z, jacobian_pose, jacobian_landmark)


class RangeOnly(RangeBearing):
    """The bearing's row is empty, so that only ranges inform."""

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Without the row."""
        z, jacobian_pose, jacobian_landmark = super().predict(pose, landmarks)
        jacobian_pose[:, 1] = 0.0
        jacobian_landmark[:, 1] = 0.0
        return PredictedMeasurements(z, jacobian_pose, jacobian_landmark)


class NoiseNotTurned(RangeBearing):
    """R is added to a new landmark as it is, without G_z."""

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """G_z is the identity."""
        new = super().invert(pose, z)
        own = np.broadcast_to(np.eye(2), new.jacobian_z.shape)
        return NewLandmarks(new.landmark, new.jacobian_pose, own)


class NoHeadingAtAugmentation(RangeBearing):
    """A new landmark does not swing with the heading's error."""

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """G_x without its last column."""
        new = super().invert(pose, z)
        new.jacobian_pose[:, :, 2] = 0.0
        return new


class WrongQuadrant(RangeBearing):
    """A new landmark's direction by atan, which knows half of the circle."""

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """Right for directions to the east only."""
        turned = np.arctan(np.tan(pose[2] + z[:, 1])) - pose[2]
        return super().invert(pose, np.column_stack((z[:, 0], turned)))


@dataclass
class StaleJacobian(OtherObservation):
    """Jacobians of the scan before."""

    pose: Array | None = None

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Z of now, the rest of then."""
        now = super().predict(pose, landmarks)
        then = super().predict(pose if self.pose is None else self.pose, landmarks)
        self.pose = np.array(pose)
        return PredictedMeasurements(now.z, then.jacobian_pose, then.jacobian_landmark)


@dataclass
class FromOldPose(OtherObservation):
    """New landmarks are seen from where the vehicle was thought before the update."""

    pose: Array | None = None

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Remember the pose."""
        self.pose = np.array(pose)
        return super().predict(pose, landmarks)

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """From the remembered pose."""
        return super().invert(pose if self.pose is None else self.pose, z)


class SteeringSign(OtherMotion):
    """Steering positive to the right."""

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """The other way round."""
        step = super().step(pose, control * (1.0, -1.0), duration_s)
        return MotionStep(step.pose, step.jacobian_pose, step.jacobian_control * (1.0, -1.0))


class HeadingColumnSign(OtherMotion):
    """The position terms of F by heading have the wrong sign."""

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """Exchange them."""
        step = super().step(pose, control, duration_s)
        step.jacobian_pose[:2, 2] *= -1.0
        return step


class IdentityF(OtherMotion):
    """The motion's Jacobian is forgotten."""

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """F is the identity."""
        step = super().step(pose, control, duration_s)
        return MotionStep(step.pose, np.eye(3), step.jacobian_control)


class ControlWithoutInterval(OtherMotion):
    """The Jacobian by the control is that of a rate."""

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """B without dt."""
        step = super().step(pose, control, duration_s)
        return MotionStep(step.pose, step.jacobian_pose, step.jacobian_control / duration_s)


class HeadingDrift(OtherMotion):
    """A bias in the turn."""

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """Turn a little farther."""
        step = super().step(pose, control, duration_s)
        step.pose[2] += _DRIFT_RADPS * duration_s
        return step


def _longer(motion: MotionModel) -> MotionModel:
    if isinstance(motion, IntegratedModel):
        return replace(motion, model=_longer(motion.model))
    if not isinstance(motion, AckermannModel):
        raise TypeError(f"{type(motion).__name__} has no wheelbase")
    return replace(motion, wheelbase_m=1.1 * motion.wheelbase_m)


def _sensor_at_axle(motion: MotionModel) -> MotionModel:
    if isinstance(motion, IntegratedModel):
        return replace(motion, model=_sensor_at_axle(motion.model))
    if not isinstance(motion, AckermannModel):
        raise TypeError(f"{type(motion).__name__} has no sensor")
    return replace(motion, sensor_forward_m=0.0, sensor_left_m=0.0)


def _no_lever(ekf: Ekf) -> None:
    ekf.fixes = replace(ekf.fixes, model=PositionModel())


DEFECTS = (
    Defect(
        "bearing Jacobian as printed",
        "Nieto's eq. 2.42 with the bearing row's position terms as printed",
        ("model", "bearing row", "opposite sign"),
        with_observation(PrintedBearingRow),
    ),
    Defect(
        "no heading column",
        "the measurement's Jacobian has zeros where the heading belongs",
        ("model", "the Jacobian with respect to heading is missing"),
        with_observation(NoHeadingColumn),
    ),
    Defect(
        "range only",
        "the bearing's row of the Jacobian is zero",
        ("model", "bearing row", "zero"),
        with_observation(RangeOnly),
    ),
    Defect(
        "innovation not wrapped",
        "the innovation z - h(x) is not wrapped at the cut of the bearing",
        ("model", "the innovation", "not wrapped"),
        with_observation(UnwrappedInnovation),
    ),
    Defect(
        "bearing clockwise",
        "the bearings are counted clockwise, positive to the right",
        ("model", "the innovation", "clockwise"),
        with_observation(Clockwise),
    ),
    Defect(
        "stale Jacobian",
        "H is linearised at the scan before",
        ("model", "the Jacobian", "the previous scan"),
        with_observation(StaleJacobian),
    ),
    Defect(
        "R not rotated by G_z",
        "a new landmark gets R of range and bearing as its own, without G_z",
        ("model", "G_z is the identity"),
        with_observation(NoiseNotTurned),
    ),
    Defect(
        "no heading at augmentation",
        "G_x has zeros where the heading belongs",
        ("model", "landmark initialisations", "the Jacobian with respect to heading is missing"),
        with_observation(NoHeadingAtAugmentation),
    ),
    Defect(
        "landmark from the old pose",
        "a landmark is initialised at the pose before the update",
        ("model", "landmark initialisations", "pose before the update"),
        with_observation(FromOldPose),
    ),
    Defect(
        "wrong quadrant",
        "a new landmark's direction by atan where atan2 belongs",
        ("model", "landmark initialisations", "quadrant"),
        with_observation(WrongQuadrant),
    ),
    Defect(
        "steering sign",
        "steering counted positive to the right",
        ("model", "the predicted pose", "steering angle has the opposite sign"),
        with_motion(SteeringSign),
    ),
    Defect(
        "wheelbase wrong",
        "a wheelbase longer by a tenth",
        ("model", "the predicted pose", "wheelbase"),
        with_motion(_longer),
    ),
    Defect(
        "sensor's place left out",
        "the sensor is taken to be at the middle of the rear axle",
        ("model", "the predicted pose", "sensor's position"),
        with_motion(_sensor_at_axle),
    ),
    Defect(
        "F the identity",
        "P is predicted without the motion's Jacobian",
        ("model", "the Jacobian with respect to heading", "F is the identity"),
        with_motion(IdentityF),
    ),
    Defect(
        "B without dt",
        "the Jacobian by the control is not multiplied by the interval",
        ("model", "the noise covariance", "not multiplied by the interval"),
        with_motion(ControlWithoutInterval),
    ),
    Defect(
        "heading drift",
        f"every step turns {_DRIFT_RADPS} rad/s too far",
        ("model", "the predicted pose", "yaw rate has a bias"),
        with_motion(HeadingDrift),
    ),
    Defect(
        "F's position terms' sign",
        "the motion's Jacobian by heading has the opposite sign",
        ("model", "the Jacobian with respect to heading", "opposite sign"),
        with_motion(HeadingColumnSign),
    ),
    Defect(
        "lever arm left out",
        "positions are taken for those of the vehicle, not of its antenna",
        ("model", "position updates", "lever arm"),
        _no_lever,
        "positions",
    ),
)
