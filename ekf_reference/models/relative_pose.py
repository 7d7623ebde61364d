"""Poses in the frame of another pose, and the inverse.

Matching a scan with a landmark's template measures such a pose, whatever the method.
"""

from __future__ import annotations

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import MeasurementModel, NewLandmarks, PredictedMeasurements


class RelativePose(MeasurementModel):
    """The pose of a landmark's frame as seen from another frame, such as the vehicle's.

    Source: Nieto 2005, eq. 5.15. Measurements are z = (x, y, heading) with noise that is added to
    these three: forward and left of the frame that they are measured from, [m] and [rad].
    """

    def range_m(self, z: Array) -> Array:
        """Return the distances (m,)."""
        return np.hypot(z[:, 0], z[:, 1])

    def predict(self, T_world_vehicle: Array, T_world_landmark: Array) -> PredictedMeasurements:
        """Predict the measurements of poses (m, 3) from a pose (3,)."""
        x, y, heading = T_world_vehicle
        cos, sin = np.cos(heading), np.sin(heading)
        dx, dy = T_world_landmark[:, 0] - x, T_world_landmark[:, 1] - y
        forward, left = dx * cos + dy * sin, -dx * sin + dy * cos
        z = np.column_stack((forward, left, T_world_landmark[:, 2] - heading))
        into = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        by_landmark = np.tile(into, (len(z), 1, 1))
        by_pose = -by_landmark
        by_pose[:, 0, 2] += left
        by_pose[:, 1, 2] -= forward
        return PredictedMeasurements(z, by_pose, by_landmark)

    def invert(self, T_world_vehicle: Array, z: Array) -> NewLandmarks:
        """Return the poses measured as z (m, 3) from a pose (3,): both composed.

        To eq. 5.15 what eqs. 2.50, 2.54 and 2.55 are to range and bearing.
        """
        x, y, heading = T_world_vehicle
        cos, sin = np.cos(heading), np.sin(heading)
        east, north = cos * z[:, 0] - sin * z[:, 1], sin * z[:, 0] + cos * z[:, 1]
        T_world_landmark = np.column_stack((x + east, y + north, heading + z[:, 2]))
        out = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        by_pose = np.tile(np.eye(3), (len(z), 1, 1))
        by_pose[:, 0, 2], by_pose[:, 1, 2] = -north, east
        return NewLandmarks(T_world_landmark, by_pose, np.tile(out, (len(z), 1, 1)))
