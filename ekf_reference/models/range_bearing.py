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

    def predict(self, T_world_vehicle: Array, p_landmark_world: Array) -> PredictedMeasurements:
        """Predict range and bearing of points (m, 2) from a pose (3,).

        Source: Guivant 2002, eqs. 2 and 9; Nieto 2005, eqs. 2.7, 2.8, 2.37, 2.40 to 2.44, 3.13 and
        3.17 to 3.20.
        """
        x, y, heading = T_world_vehicle
        dx, dy = p_landmark_world[:, 0] - x, p_landmark_world[:, 1] - y
        q = dx * dx + dy * dy
        r = np.sqrt(q)
        z = np.array((r, np.arctan2(dy, dx) - heading)).T
        jacobian_landmark = np.array((dx / r, dy / r, -dy / q, dx / q)).T.reshape(-1, 2, 2)
        jacobian_pose = np.zeros((len(r), 2, 3))
        np.negative(jacobian_landmark, out=jacobian_pose[:, :, :2])
        jacobian_pose[:, 1, 2] = -1.0
        return PredictedMeasurements(z, jacobian_pose, jacobian_landmark)

    def invert(self, T_world_vehicle: Array, z: Array) -> NewLandmarks:
        """Return the points measured as z (m, 2) (Nieto 2005, eqs. 2.50, 2.54 and 2.55)."""
        x, y, heading = T_world_vehicle
        r, cos, sin = z[:, 0], np.cos(heading + z[:, 1]), np.sin(heading + z[:, 1])
        p_landmark_world = np.column_stack((x + r * cos, y + r * sin))
        jacobian_z = np.column_stack((cos, -r * sin, sin, r * cos)).reshape(-1, 2, 2)
        jacobian_pose = np.tile(np.eye(2, 3), (len(r), 1, 1))
        jacobian_pose[:, :, 2] = jacobian_z[:, :, 1]
        return NewLandmarks(p_landmark_world, jacobian_pose, jacobian_z)
