"""Range and bearing of points, and the inverse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import MeasurementModel, NewLandmarks, PredictedMeasurements


@dataclass(frozen=True)
class RangeBearing(MeasurementModel):
    """Range [m] and bearing [rad] to a point, the bearing relative to the vehicle's heading.

    Source: Nieto 2005, eqs. 2.8 and 2.40 to 2.44 (A.16 to A.20). Errata: the printed arctangent
    loses the quadrant, and the bearing row of 2.42 is printed with the position terms' signs
    exchanged; atan2 and the corrected row are used.
    """

    def range_m(self, z: Array) -> Array:
        """Return the ranges (m,)."""
        return z[:, 0]

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Predict range and bearing of points (m, 2) from a pose (3,).

        Source: Guivant 2002, eqs. 2 and 9; Nieto 2005, eqs. 2.7, 2.8, 2.37, 2.40 to 2.44, 3.13 and
        3.17 to 3.20.
        """
        dx, dy = landmarks[:, 0] - pose[0], landmarks[:, 1] - pose[1]
        q = dx * dx + dy * dy
        r = np.sqrt(q)
        z = np.column_stack((r, np.arctan2(dy, dx) - pose[2]))
        jacobian_landmark = np.column_stack((dx / r, dy / r, -dy / q, dx / q)).reshape(-1, 2, 2)
        jacobian_pose = np.zeros((len(r), 2, 3))
        jacobian_pose[:, :, :2] = -jacobian_landmark
        jacobian_pose[:, 1, 2] = -1.0
        return PredictedMeasurements(z, jacobian_pose, jacobian_landmark)

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """Return the points measured as z (m, 2) (Nieto 2005, eqs. 2.50, 2.54 and 2.55)."""
        r, cos, sin = z[:, 0], np.cos(pose[2] + z[:, 1]), np.sin(pose[2] + z[:, 1])
        point = np.column_stack((pose[0] + r * cos, pose[1] + r * sin))
        jacobian_z = np.column_stack((cos, -r * sin, sin, r * cos)).reshape(-1, 2, 2)
        jacobian_pose = np.tile(np.eye(2, 3), (len(r), 1, 1))
        jacobian_pose[:, :, 2] = jacobian_z[:, :, 1]
        return NewLandmarks(point, jacobian_pose, jacobian_z)
