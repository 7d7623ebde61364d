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
        distance: Array = np.hypot(z[:, 0], z[:, 1])
        return distance

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Predict the measurements of poses (m, 3) from a pose (3,)."""
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        dx, dy = landmarks[:, 0] - pose[0], landmarks[:, 1] - pose[1]
        forward, left = dx * cos + dy * sin, -dx * sin + dy * cos
        z = np.column_stack((forward, left, landmarks[:, 2] - pose[2]))
        into = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        by_landmark = np.tile(into, (len(z), 1, 1))
        by_pose = -by_landmark
        by_pose[:, 0, 2] += left
        by_pose[:, 1, 2] -= forward
        return PredictedMeasurements(z, by_pose, by_landmark)

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """Return the poses measured as z (m, 3) from a pose (3,): both composed.

        To eq. 5.15 what eqs. 2.50, 2.54 and 2.55 are to range and bearing.
        """
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        east, north = cos * z[:, 0] - sin * z[:, 1], sin * z[:, 0] + cos * z[:, 1]
        place = np.column_stack((pose[0] + east, pose[1] + north, pose[2] + z[:, 2]))
        out = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        by_pose = np.tile(np.eye(3), (len(z), 1, 1))
        by_pose[:, 0, 2], by_pose[:, 1, 2] = -north, east
        return NewLandmarks(place, by_pose, np.tile(out, (len(z), 1, 1)))
