"""Range and bearing of points, and the inverse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_reference.core.geometry import Array, wrap_angle
from ekf_reference.core.landmark_types import (
    NewLandmarks,
    PredictedMeasurements,
    diagonal_noise,
)


@dataclass(frozen=True)
class RangeBearing:
    """Range and bearing to a point, the bearing relative to the vehicle's heading.

    Source: Nieto 2005, eqs. 2.8 and 2.40 to 2.44 (A.16 to A.20). Errata: the printed arctangent
    loses the quadrant, and the bearing row of 2.42 is printed with the position terms' signs
    exchanged; atan2 and the corrected row are used.
    """

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """Return ranges and bearings (m, 2) as they come, and R (m, 2, 2)."""
        return z, self.noise(sigma)

    def range_m(self, z: Array) -> Array:
        """Return the ranges (m,)."""
        return z[:, 0]

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Predict range and bearing of points (m, 2) from a pose (3,).

        Source: Guivant 2002, eqs. 2 and 9; Nieto 2005, eqs. 2.7, 2.8, 2.37, 2.40 to 2.44, 3.13 and
        3.17 to 3.20.
        """
        dx = landmarks[:, 0] - pose[0]
        dy = landmarks[:, 1] - pose[1]
        q = dx * dx + dy * dy
        r = np.sqrt(q)
        z = np.column_stack((r, np.arctan2(dy, dx) - pose[2]))
        jacobian_landmark = np.empty((len(r), 2, 2))
        jacobian_landmark[:, 0, 0] = dx / r
        jacobian_landmark[:, 0, 1] = dy / r
        jacobian_landmark[:, 1, 0] = -dy / q
        jacobian_landmark[:, 1, 1] = dx / q
        jacobian_pose = np.zeros((len(r), 2, 3))
        jacobian_pose[:, :, :2] = -jacobian_landmark
        jacobian_pose[:, 1, 2] = -1.0
        return PredictedMeasurements(z, jacobian_pose, jacobian_landmark)

    def innovation(self, z: Array, predicted: Array) -> Array:
        """Return z - predicted (..., 2), bearing wrapped (Nieto 2005, eqs. 2.38, 2.57, 3.15)."""
        difference = z - predicted
        difference[..., 1] = wrap_angle(difference[..., 1])
        return difference

    def noise(self, sigma: Array) -> Array:
        """Return R (m, 2, 2) from sigmas (m, 2) [m, rad] (Nieto 2005, eq. 2.41)."""
        return diagonal_noise(sigma)

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """Return the points measured as z (m, 2) (Nieto 2005, eqs. 2.50, 2.54 and 2.55)."""
        r = z[:, 0]
        cos, sin = np.cos(pose[2] + z[:, 1]), np.sin(pose[2] + z[:, 1])
        point = np.column_stack((pose[0] + r * cos, pose[1] + r * sin))
        jacobian_z = np.empty((len(r), 2, 2))
        jacobian_z[:, 0, 0] = cos
        jacobian_z[:, 1, 0] = sin
        jacobian_z[:, 0, 1] = -r * sin
        jacobian_z[:, 1, 1] = r * cos
        jacobian_pose = np.zeros((len(r), 2, 3))
        jacobian_pose[:, 0, 0] = jacobian_pose[:, 1, 1] = 1.0
        jacobian_pose[:, :, 2] = jacobian_z[:, :, 1]
        return NewLandmarks(point, jacobian_pose, jacobian_z)
