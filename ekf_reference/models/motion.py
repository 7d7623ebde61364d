"""Vehicle models: the mean and the Jacobians of one prediction step.

Every model is SE(2)-equivariant (moving the start moves the result alike), which is what lets a
smoother compose the same steps into one body-frame increment without losing information.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from ekf_reference.core.geometry import Array


class MotionStep(NamedTuple):
    """One prediction of the vehicle.

    pose: (3,) predicted x, y, heading [m, m, rad], heading unwrapped.
    jacobian_pose: (3, 3) df/dx_v, global additive errors on both sides.
    jacobian_control: (3, m) df/du.
    """

    pose: Array
    jacobian_pose: Array
    jacobian_control: Array


class MotionModel(Protocol):
    """Contract of all vehicle models."""

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """Predict the pose after `duration_s` under a constant control (m,)."""
        ...


@dataclass(frozen=True)
class AckermannModel:
    """Car-like vehicle, pose at the laser, speed from an encoder on the rear left wheel.

    Control: (encoder speed v_e [m/s], steering alpha [rad], positive to the left).
    Source: Nieto 2005, eqs. A.3 to A.15; Guivant 2002, eq. 1. Errata: A.7, A.9 and A.11 print the
    first term without dt, and A.9 prints -T1 where +T2 holds; the corrected form is used.

    wheelbase_m: L. encoder_offset_m: H, half the rear track. sensor_forward_m, sensor_left_m:
    a, b, the laser seen from the middle of the rear axle.
    """

    wheelbase_m: float
    encoder_offset_m: float = 0.0
    sensor_forward_m: float = 0.0
    sensor_left_m: float = 0.0

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """Euler step of Nieto 2005, eqs. 2.5 and A.1 to A.4, with Jacobians 2.35 and A.5 to A.15.

        Guivant 2002, eq. 9 is the Jacobian by the pose.
        """
        x, y, heading = pose.tolist()
        speed_encoder, steering = control.tolist()
        a, b, dt = self.sensor_forward_m, self.sensor_left_m, duration_s
        cos, sin, tan = math.cos(heading), math.sin(heading), math.tan(steering)
        sec2 = 1.0 + tan * tan
        slip = 1.0 - tan * self.encoder_offset_m / self.wheelbase_m
        speed = speed_encoder / slip  # A.3
        dspeed_dencoder = 1.0 / slip
        dspeed_dsteering = speed / slip * sec2 * self.encoder_offset_m / self.wheelbase_m
        curvature = tan / self.wheelbase_m
        t1 = a * sin + b * cos  # A.13
        t2 = a * cos - b * sin  # A.14
        east = cos - curvature * t1  # displacement per metre of the rear axle, east
        north = sin + curvature * t2
        turn = speed / self.wheelbase_m * sec2

        predicted = np.array(
            [x + dt * speed * east, y + dt * speed * north, heading + dt * speed * curvature]
        )  # A.4
        jacobian_pose = np.array(
            [[1.0, 0.0, -dt * speed * north], [0.0, 1.0, dt * speed * east], [0.0, 0.0, 1.0]]
        )  # A.15
        jacobian_control = dt * np.array(
            [
                [east * dspeed_dencoder, -t1 * turn + east * dspeed_dsteering],  # A.6, A.7
                [north * dspeed_dencoder, t2 * turn + north * dspeed_dsteering],  # A.8, A.9
                [curvature * dspeed_dencoder, turn + curvature * dspeed_dsteering],  # A.10, A.11
            ]
        )
        return MotionStep(predicted, jacobian_pose, jacobian_control)


def bicycle_model(wheelbase_m: float) -> AckermannModel:
    """The classic bicycle, pose and speed at the rear axle (Nieto 2005, eq. 2.6).

    It is the car-like model with the sensor and the encoder at the middle of the rear axle.
    """
    return AckermannModel(wheelbase_m)


@dataclass(frozen=True)
class UnicycleModel:
    """Differential drive. Control: (speed v [m/s], yaw rate omega [rad/s]).

    Nieto 2005, eq. 2.6 with omega for v tan(alpha) / L, evaluated at the heading in the middle
    of the step (second order in the duration).
    """

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """Midpoint step and its Jacobians."""
        x, y, heading = pose.tolist()
        speed, yaw_rate = control.tolist()
        dt = duration_s
        middle = heading + 0.5 * dt * yaw_rate
        cos, sin = math.cos(middle), math.sin(middle)
        forward = dt * speed
        predicted = np.array([x + forward * cos, y + forward * sin, heading + dt * yaw_rate])
        jacobian_pose = np.array(
            [[1.0, 0.0, -forward * sin], [0.0, 1.0, forward * cos], [0.0, 0.0, 1.0]]
        )
        jacobian_control = dt * np.array(
            [[cos, -0.5 * forward * sin], [sin, 0.5 * forward * cos], [0.0, 1.0]]
        )
        return MotionStep(predicted, jacobian_pose, jacobian_control)


@dataclass(frozen=True)
class RelativePoseModel:
    """Measured displacements. Control: (dx [m], dy [m], dheading [rad]) in the departing frame.

    The control's covariance is of the error seen in the frame of arrival (the convention of g2o
    and gtsam files), so jacobian_control turns that frame into the global one. The duration
    plays no part.
    """

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """Compose the pose with the displacement."""
        x, y, heading = pose.tolist()
        dx, dy, turn = control.tolist()
        cos, sin = math.cos(heading), math.sin(heading)
        east, north = cos * dx - sin * dy, sin * dx + cos * dy
        predicted = np.array([x + east, y + north, heading + turn])
        jacobian_pose = np.array([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 1.0]])
        cos, sin = math.cos(heading + turn), math.sin(heading + turn)
        jacobian_control = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return MotionStep(predicted, jacobian_pose, jacobian_control)
