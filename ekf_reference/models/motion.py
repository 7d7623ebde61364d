"""Vehicle models: the mean and the Jacobians of one prediction step.

Every model is SE(2)-equivariant (moving the start moves the result alike), which is what lets a
smoother compose the same steps into one body-frame increment without losing information.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, Self

import numpy as np

from ekf_reference.core.geometry import Array

Integration = Literal["euler", "middle", "arc"] | int | float
"""Where a step's displacement leads: along the heading at its start, along that in its middle, or
on the circle that constant speed and turn describe. A whole number: in so many equal Euler steps;
any other: in equal ones of at most so many seconds."""


class MotionStep(NamedTuple):
    """One prediction of the vehicle.

    pose: (3,) x, y, heading [m, m, rad], heading unwrapped. jacobian_pose: (3, 3) df/dx_v, global
    additive errors on both sides. jacobian_control: (3, m) df/du.
    """

    pose: Array
    jacobian_pose: Array
    jacobian_control: Array

    @classmethod
    def by(
        cls, pose: Array, east: float, north: float, turn: float, jacobian_control: Array
    ) -> Self:
        """Return the step that moves and turns a pose by known amounts.

        Args:
            pose: (3,) x, y, heading at the departure.
            east: Displacement in the map [m].
            north: Displacement in the map [m].
            turn: [rad], added without wrapping.
            jacobian_control: (3, m), df/du.

        Returns:
            The step, with the Jacobian by the pose that every SE(2)-equivariant model has.
        """
        by_pose = pose_jacobian(east, north)
        return cls(pose + (east, north, turn), by_pose, jacobian_control)


def pose_jacobian(east: float, north: float) -> Array:
    """Return the Jacobian by the pose of a step that is the same everywhere in the vehicle's frame.

    Args:
        east: Displacement in the map [m].
        north: Displacement in the map [m].

    Returns:
        (3, 3), df/dx of the additive global error.
    """
    return np.array([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 1.0]])


class MotionModel(Protocol):
    """Contract of all vehicle models."""

    def step(self, T_world_vehicle: Array, control: Array, duration_s: float) -> MotionStep:
        """Predict the pose after a step.

        Args:
            T_world_vehicle: (p,) pose at the departure, heading unwrapped.
            control: (m,) in the model's units, constant during the step.
            duration_s: The step's [s].

        Returns:
            The pose, its heading unwrapped, and the Jacobians by pose and control.
        """


@dataclass(frozen=True)
class AckermannModel:
    """Car-like vehicle, pose at the laser, speed from an encoder on the rear left wheel.

    Control: (encoder speed v_e [m/s], steering alpha [rad], positive to the left).
    Without offsets it is the bicycle of eq. 2.6, pose and speed at the middle of the rear axle.
    Source: Nieto 2005, eqs. A.3 to A.15; Guivant 2002, eq. 1. Errata: A.7, A.9 and A.11 print the
    first term without dt, and A.9 prints it with a minus; the corrected form is used.

    wheelbase_m: L. encoder_offset_m: H, half the rear track. sensor_forward_m, sensor_left_m:
    a, b, the laser seen from the middle of the rear axle.
    """

    wheelbase_m: float
    encoder_offset_m: float = 0.0
    sensor_forward_m: float = 0.0
    sensor_left_m: float = 0.0

    def step(self, T_world_vehicle: Array, control: Array, duration_s: float) -> MotionStep:
        """Euler step of Nieto 2005, eqs. 2.5 and A.1 to A.4, with Jacobians 2.35 and A.5 to A.15.

        Guivant 2002, eq. 9 is the Jacobian by the pose.
        """
        heading, (speed_encoder, steering) = float(T_world_vehicle[2]), control.tolist()
        a, b = self.sensor_forward_m, self.sensor_left_m
        cos, sin, tan = math.cos(heading), math.sin(heading), math.tan(steering)
        sec2 = 1.0 + tan * tan
        slip = 1.0 - tan * self.encoder_offset_m / self.wheelbase_m
        speed = speed_encoder / slip  # A.3
        by_encoder = 1.0 / slip
        by_steering = speed / slip * sec2 * self.encoder_offset_m / self.wheelbase_m
        curvature = tan / self.wheelbase_m
        t1 = a * sin + b * cos  # A.13
        t2 = a * cos - b * sin  # A.14
        east = cos - curvature * t1  # displacement per metre of the rear axle, east
        north = sin + curvature * t2
        turn = speed / self.wheelbase_m * sec2
        jacobian_control = duration_s * np.array(
            [
                [east * by_encoder, -t1 * turn + east * by_steering],  # A.6, A.7
                [north * by_encoder, t2 * turn + north * by_steering],  # A.8, A.9
                [curvature * by_encoder, turn + curvature * by_steering],  # A.10, A.11
            ]
        )
        way = duration_s * speed
        moved = way * east, way * north, way * curvature
        return MotionStep.by(T_world_vehicle, *moved, jacobian_control)  # A.4, A.15


@dataclass(frozen=True)
class UnicycleModel:
    """Differential drive. Control: (speed v [m/s], yaw rate omega [rad/s]).

    Nieto 2005, eq. 2.6 with omega for v tan(alpha) / L, evaluated at the heading in the middle
    of the step (second order in the duration).
    """

    def step(self, T_world_vehicle: Array, control: Array, duration_s: float) -> MotionStep:
        """Midpoint step and its Jacobians."""
        speed, yaw_rate = control.tolist()
        forward, turn = duration_s * speed, duration_s * yaw_rate
        middle = float(T_world_vehicle[2]) + 0.5 * duration_s * yaw_rate
        cos, sin = math.cos(middle), math.sin(middle)
        jacobian_control = duration_s * np.array(
            [[cos, -0.5 * forward * sin], [sin, 0.5 * forward * cos], [0.0, 1.0]]
        )
        return MotionStep.by(T_world_vehicle, forward * cos, forward * sin, turn, jacobian_control)


@dataclass(frozen=True)
class RelativePoseModel:
    """Measured displacements. Control: (dx [m], dy [m], dheading [rad]) in the departing frame.

    The control's covariance is of the error seen in the frame of arrival (the convention of g2o
    and gtsam files), so jacobian_control turns that frame into the global one. The duration
    plays no part.
    """

    def step(self, T_world_vehicle: Array, control: Array, duration_s: float) -> MotionStep:
        """Compose the pose with the displacement."""
        heading, (dx, dy, turn) = float(T_world_vehicle[2]), control.tolist()
        cos, sin = math.cos(heading), math.sin(heading)
        c, s = math.cos(heading + turn), math.sin(heading + turn)
        jacobian_control = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        moved = cos * dx - sin * dy, sin * dx + cos * dy, turn
        return MotionStep.by(T_world_vehicle, *moved, jacobian_control)


@dataclass(frozen=True)
class IntegratedModel:
    """A vehicle model integrated in another way, at constant speed and turn.

    model: the sound one. own: how it integrates. integration: how to integrate in its place.
    With the turn t of a step the displacement d becomes s(t) R(k t) d, k the difference of the
    shares of the turn, s the chord over its arc, sin(t / 2) / (t / 2), of an arc, s(t) / s(t / n)
    of n Euler steps, and 1 otherwise.
    """

    model: MotionModel
    own: Integration
    integration: Integration

    def step(self, T_world_vehicle: Array, control: Array, duration_s: float) -> MotionStep:
        """Turn and shorten the model's displacement, and the Jacobians with it."""
        _, by_pose, by_control = step = self.model.step(T_world_vehicle, control, duration_s)
        turn = float(step.pose[2] - T_world_vehicle[2])
        asked = self.integration
        if isinstance(asked, float):
            asked = max(1, math.ceil(duration_s / asked - 1e-9))
        share = _heading_at(asked) - _heading_at(self.own)
        chord, by_turn = _shortened(turn, asked)
        cos, sin = math.cos(share * turn), math.sin(share * turn)
        rotation = np.array([[cos, -sin], [sin, cos]])
        way = rotation @ (by_pose[1, 2], -by_pose[0, 2])
        moved = chord * way
        across = by_turn * way + share * np.array((-moved[1], moved[0]))
        jacobian = by_control.copy()
        jacobian[:2] = chord * rotation @ by_control[:2] + np.outer(across, by_control[2])
        east, north = moved.tolist()
        return MotionStep.by(T_world_vehicle, east, north, turn, jacobian)


def _heading_at(integration: Integration) -> float:
    """Return the share of the turn after which the displacement's heading is taken."""
    if isinstance(integration, int):
        return 0.5 - 0.5 / integration
    return 0.0 if integration == "euler" else 0.5


def _shortened(turn: float, integration: Integration) -> tuple[float, float]:
    """Return what is left of a displacement's length, and its derivative by the turn."""
    if integration in ("euler", "middle"):
        return 1.0, 0.0
    chord, by_turn = _chord(turn)
    if isinstance(integration, int):
        part, by_part = _chord(turn / integration)
        chord /= part
        by_turn = (by_turn - chord * by_part / integration) / part
    return chord, by_turn


def _chord(turn: float) -> tuple[float, float]:
    """Chord over arc, and its derivative by the turn; series where differences have no digits."""
    if abs(turn) < 1e-2:
        square = turn * turn
        return 1.0 - square / 24.0 * (1.0 - square / 80.0), -turn / 12.0 * (1.0 - square / 40.0)
    chord = math.sin(0.5 * turn) / (0.5 * turn)
    return chord, (math.cos(0.5 * turn) - chord) / turn
