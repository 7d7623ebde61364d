"""A pose whose direction is a cosine and a sine, and what moves and sees it (Misono 2007).

The pose is x, y, xi, eta with xi = cos(heading) and eta = sin(heading) (eq. 3). Motion is linear
in it and sightings in the vehicle's own axes are bilinear, so nothing needs a trigonometric
function of the state. The price is a fourth number where three are free: the pair belongs on the
unit circle, and nothing in the published filter keeps it there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.models.motion import MotionModel, MotionStep
from ekf_reference.models.range_bearing import NewLandmarks, PredictedMeasurements


def from_heading(pose: Array) -> Array:
    """(4,) x, y, xi, eta of (3,) x, y, heading."""
    return np.array([pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])])


def along_circle(pose: Array) -> Array:
    """(4, 3) d(x, y, xi, eta) / d(x, y, heading) where the pair (4,) is."""
    jacobian = np.zeros((4, 3))
    jacobian[0, 0] = jacobian[1, 1] = 1.0
    jacobian[2, 2], jacobian[3, 2] = -pose[3], pose[2]
    return jacobian


def to_heading(pose: Array) -> Array:
    """(3, 4) d(x, y, heading) / d(x, y, xi, eta), of atan2(eta, xi), on the circle or off it."""
    square = pose[2] ** 2 + pose[3] ** 2
    jacobian = np.zeros((3, 4))
    jacobian[0, 0] = jacobian[1, 1] = 1.0
    jacobian[2, 2], jacobian[2, 3] = -pose[3] / square, pose[2] / square
    return jacobian


@dataclass(frozen=True)
class DirectionCosineMotion:
    """Any vehicle model on this pose: x' = F x + B n (Misono 2007, eqs. 2 to 6).

    `motion` says how far the vehicle goes in its own frame: dx, dy and a turn. Eq. 4 is the case
    of a turn first and the way afterwards, dx = d cos(turn), dy = d sin(turn), where dx and dy
    stand beside xi and eta. Erratum: eq. 5 prints xi(k), eta(k) in B where the direction of
    arrival, k + 1, holds; the two differ by the turn.
    """

    motion: MotionModel

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        """The pose (4,) after a control; jacobian_pose is F, jacobian_control is B."""
        own = self.motion.step(np.zeros(3), control, duration_s)
        dx, dy, turn = own.pose.tolist()
        cos, sin = math.cos(turn), math.sin(turn)
        f = np.array(
            [[1.0, 0.0, dx, -dy], [0.0, 1.0, dy, dx], [0.0, 0.0, cos, -sin], [0.0, 0.0, sin, cos]]
        )  # 4
        arrived = f @ pose
        b = along_circle(arrived) @ own.jacobian_control  # 5, the turn's part
        xi, eta = pose[2], pose[3]
        b[:2] = np.array([[xi, -eta], [eta, xi]]) @ own.jacobian_control[:2]  # 5, the way's part
        return MotionStep(arrived, f, b)


@dataclass(frozen=True)
class OwnAxesObservation:
    """A landmark in the vehicle's own axes, x to the right, y ahead (Misono 2007, eqs. 8, 9, 12).

    full_jacobian: eq. 9 has zeros for xi and eta, which makes the published filter a pseudo-linear
    one; true gives the columns that the bilinear measurement has.
    """

    full_jacobian: bool = True

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """Range and bearing in the vehicle's axes: (m, 2) [m], R (m, 2, 2) [m^2]."""
        r, sin, cos = z[:, 0], np.sin(z[:, 1]), np.cos(z[:, 1])
        polar = np.empty((len(r), 2, 2))
        polar[:, 0, 0], polar[:, 0, 1] = -sin, -r * cos
        polar[:, 1, 0], polar[:, 1, 1] = cos, -r * sin
        noise = np.einsum("mij,mj,mkj->mik", polar, sigma**2, polar)
        return np.column_stack((-r * sin, r * cos)), noise

    def range_m(self, z: Array) -> Array:
        """(m,) distance from the vehicle."""
        distance: Array = np.hypot(z[:, 0], z[:, 1])
        return distance

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """H x and H for landmarks (m, 2) from pose (4,) (eqs. 9 and 12)."""
        x, y, xi, eta = pose.tolist()
        dx, dy = landmarks[:, 0] - x, landmarks[:, 1] - y
        z = np.column_stack((eta * dx - xi * dy, xi * dx + eta * dy))
        turn = np.array([[eta, -xi], [xi, eta]])
        jacobian_pose = np.zeros((len(z), 2, 4))
        jacobian_pose[:, :, :2] = -turn
        if self.full_jacobian:
            jacobian_pose[:, 0, 2], jacobian_pose[:, 0, 3] = -dy, dx
            jacobian_pose[:, 1, 2], jacobian_pose[:, 1, 3] = dx, dy
        return PredictedMeasurements(z, jacobian_pose, np.broadcast_to(turn, (len(z), 2, 2)))

    def innovation(self, z: Array, predicted: Array) -> Array:
        """Innovation of eq. 14; no angle, nothing to wrap."""
        return z - predicted

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """Places in the map of what is seen at z (m, 2) (eq. 16, its first row corrected).

        Erratum: the first row is printed (eta, -xi, ...), which is no inverse of eq. 9. The
        Jacobians, which the paper leaves out, are those of Nieto 2005, eq. 2.53.
        """
        x, y, xi, eta = pose.tolist()
        right, ahead = z[:, 0], z[:, 1]
        point = np.column_stack((x + eta * right + xi * ahead, y - xi * right + eta * ahead))
        jacobian_pose = np.zeros((len(z), 2, 4))
        jacobian_pose[:, 0, 0] = jacobian_pose[:, 1, 1] = 1.0
        jacobian_pose[:, 0, 2], jacobian_pose[:, 0, 3] = ahead, right
        jacobian_pose[:, 1, 2], jacobian_pose[:, 1, 3] = -right, ahead
        jacobian_sighting = np.broadcast_to(np.array([[eta, xi], [-xi, eta]]), (len(z), 2, 2))
        return NewLandmarks(point, jacobian_pose, jacobian_sighting)


@dataclass(frozen=True)
class DirectionCosinePosition:
    """An antenna at `lever_m` (forward, left): on this pose an absolute position is linear."""

    lever_m: tuple[float, float] = (0.0, 0.0)

    def predict(self, pose: Array) -> tuple[Array, Array]:
        """Expected position (2,) and its Jacobian (2, 4)."""
        forward, left = self.lever_m
        jacobian = np.array([[1.0, 0.0, forward, -left], [0.0, 1.0, left, forward]])
        return jacobian @ pose, jacobian
