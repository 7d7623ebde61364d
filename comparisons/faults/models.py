"""Faults of the models: predictions, expected measurements, their Jacobians, new landmarks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.faults.fault import Fault, Plant, moving, observing, remembering, with_motion
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import NewLandmarks, PredictedMeasurements
from ekf_reference.models.motion import AckermannModel, IntegratedModel, MotionModel, MotionStep
from ekf_reference.models.position import PositionModel

_DRIFT_RADPS = 0.01
_BEARING_ROW, _HEADING_COLUMN = np.s_[:, 1], np.s_[:, :, 2]


def h_times(factor: float, *, pose: Any = None, landmark: Any = None) -> Plant:
    """Some entries of H times a factor, by the pose (m, 2, 3) and by the landmark (m, 2, 2)."""

    def predict(original: Any, *args: Array) -> PredictedMeasurements:
        measurements: PredictedMeasurements = original(*args)
        if pose is not None:
            measurements.jacobian_pose[pose] *= factor
        if landmark is not None:
            measurements.jacobian_landmark[landmark] *= factor
        return measurements

    return observing(predict=predict)


def gx_times(factor: float) -> Plant:
    """The heading's column of G_x times a factor."""

    def invert(original: Any, *args: Array) -> NewLandmarks:
        landmarks: NewLandmarks = original(*args)
        landmarks.jacobian_pose[_HEADING_COLUMN] *= factor
        return landmarks

    return observing(invert=invert)


def _unrotated(original: Any, *args: Array) -> NewLandmarks:
    new: NewLandmarks = original(*args)
    return new._replace(jacobian_z=np.broadcast_to(np.eye(2), new.jacobian_z.shape))


def _clockwise(original: Any, z: Array, sigma: Array) -> tuple[Array, Array]:
    z, noise = original(z, sigma)
    return z * (1.0, -1.0), noise


def wrong_quadrant(original: Any, pose: Array, z: Array) -> NewLandmarks:
    """New landmarks by atan of the direction where atan2 belongs. own: makes them of a pose."""
    turned = np.arctan(np.tan(pose[2] + z[:, 1])) - pose[2]
    new: NewLandmarks = original(pose, np.column_stack((z[:, 0], turned)))
    return new


def _stale_jacobian() -> Plant:
    last: list[Array] = []

    def predict(original: Any, pose: Array, landmarks: Array) -> PredictedMeasurements:
        now, then = original(pose, landmarks), original(last[0] if last else pose, landmarks)
        last[:] = [np.array(pose)]
        return PredictedMeasurements(now.z, then.jacobian_pose, then.jacobian_landmark)

    return observing(predict=predict)


def _from_old_pose() -> Plant:
    last: list[Array] = []

    def predict(original: Any, pose: Array, landmarks: Array) -> PredictedMeasurements:
        last[:] = [np.array(pose)]
        measurements: PredictedMeasurements = original(pose, landmarks)
        return measurements

    def invert(original: Any, pose: Array, z: Array) -> NewLandmarks:
        new: NewLandmarks = original(last[0] if last else pose, z)
        return new

    return observing(predict=predict, invert=invert)


def _steering_sign(original: Any, pose: Array, control: Array, duration_s: float) -> MotionStep:
    step: MotionStep = original(pose, control * (1.0, -1.0), duration_s)
    return step._replace(jacobian_control=step.jacobian_control * (1.0, -1.0))


def _without_interval(original: Any, pose: Array, control: Array, duration_s: float) -> MotionStep:
    step: MotionStep = original(pose, control, duration_s)
    return step._replace(jacobian_control=step.jacobian_control / duration_s)


def noise_by_interval(original: Any, pose: Array, control: Array, duration_s: float) -> MotionStep:
    """The sigmas of speed and turn as densities, of white noise over the interval."""
    step: MotionStep = original(pose, control, duration_s)
    return step._replace(jacobian_control=step.jacobian_control / np.sqrt(duration_s))


def _drift(original: Any, pose: Array, control: Array, duration_s: float) -> MotionStep:
    step: MotionStep = original(pose, control, duration_s)
    step.pose[2] += _DRIFT_RADPS * duration_s
    return step


def _opposite_column(original: Any, *args: Any) -> MotionStep:
    step: MotionStep = original(*args)
    step.jacobian_pose[:2, 2] *= -1.0
    return step


def _vehicle(change: Callable[[AckermannModel], AckermannModel], lacks: str) -> Plant:
    """Another car. lacks: what a vehicle that is none does not have."""

    def other(motion: MotionModel) -> MotionModel:
        if isinstance(motion, IntegratedModel):
            return replace(motion, model=other(motion.model))
        if not isinstance(motion, AckermannModel):
            raise TypeError(f"{type(motion).__name__} has no {lacks}")
        return change(motion)

    return with_motion(other)


def _no_lever(ekf: Ekf) -> None:
    ekf.fixes = replace(ekf.fixes, model=PositionModel())


FAULTS = {
    "bearing Jacobian as printed": Fault(
        "Nieto's eq. 2.42 with the bearing row's position terms as printed",
        h_times(-1.0, pose=np.s_[:, 1, :2], landmark=_BEARING_ROW),
    ),
    "no heading column": Fault(
        "the measurement's Jacobian has zeros where the heading belongs",
        h_times(0.0, pose=_HEADING_COLUMN),
    ),
    "range only": Fault(
        "the bearing's row of the Jacobian is zero",
        h_times(0.0, pose=_BEARING_ROW, landmark=_BEARING_ROW),
    ),
    "innovation not wrapped": Fault(
        "the innovation z - h(x) is not wrapped at the cut of the bearing",
        observing(innovation=lambda original, z, predicted: z - predicted),
    ),
    "bearing clockwise": Fault(
        "the bearings are counted clockwise, positive to the right", observing(measured=_clockwise)
    ),
    "stale Jacobian": Fault("H is linearised at the scan before", remembering(_stale_jacobian)),
    "R not rotated by G_z": Fault(
        "a new landmark gets R of range and bearing as its own, without G_z",
        observing(invert=_unrotated),
    ),
    "no heading at augmentation": Fault("G_x has zeros where the heading belongs", gx_times(0.0)),
    "landmark from the old pose": Fault(
        "a landmark is initialised at the pose before the update", remembering(_from_old_pose)
    ),
    "wrong quadrant": Fault(
        "a new landmark's direction by atan where atan2 belongs", observing(invert=wrong_quadrant)
    ),
    "steering sign": Fault("steering counted positive to the right", moving(_steering_sign)),
    "wheelbase wrong": Fault(
        "a wheelbase longer by a tenth",
        _vehicle(lambda car: replace(car, wheelbase_m=1.1 * car.wheelbase_m), "wheelbase"),
    ),
    "sensor's place left out": Fault(
        "the sensor is taken to be at the middle of the rear axle",
        _vehicle(lambda car: replace(car, sensor_forward_m=0.0, sensor_left_m=0.0), "sensor"),
    ),
    "F the identity": Fault(
        "P is predicted without the motion's Jacobian",
        moving(lambda original, *args: original(*args)._replace(jacobian_pose=np.eye(3))),
    ),
    "B without dt": Fault(
        "the Jacobian by the control is not multiplied by the interval", moving(_without_interval)
    ),
    "heading drift": Fault(f"every step turns {_DRIFT_RADPS} rad/s too far", moving(_drift)),
    "F's position terms' sign": Fault(
        "the motion's Jacobian by heading has the opposite sign", moving(_opposite_column)
    ),
    "lever arm left out": Fault(
        "positions are taken for those of the vehicle, not of its antenna", _no_lever
    ),
}
