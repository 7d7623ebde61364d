"""What a sensor sees of point landmarks, range and bearing, and its inverse."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from ekf_reference.core.geometry import Array, wrap_angle


class PredictedMeasurements(NamedTuple):
    """Expected sightings of m landmarks from one pose.

    z: (m, w), such as range [m] and bearing [rad]; w is 2 for points and 3 for landmarks with a
    direction. jacobian_pose: (m, w, p). jacobian_landmark: (m, w, w).
    """

    z: Array
    jacobian_pose: Array
    jacobian_landmark: Array


class NewLandmarks(NamedTuple):
    """Landmarks computed from m sightings.

    point: (m, w) position [m] and, where w is 3, heading. jacobian_pose: (m, w, p).
    jacobian_sighting: (m, w, w).
    """

    point: Array
    jacobian_pose: Array
    jacobian_sighting: Array


class Observation(Protocol):
    """Contract of all observation models of point landmarks, for a pose of p entries."""

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """The model's own z (m, 2) and R (m, 2, 2) of ranges and bearings (m, 2) with sigmas."""
        ...

    def range_m(self, z: Array) -> Array:
        """(m,) how far away a sighting is."""
        ...

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Expected sightings of landmarks (m, 2) from pose (p,)."""
        ...

    def innovation(self, z: Array, predicted: Array) -> Array:
        """Z - predicted (..., 2), angles wrapped."""
        ...

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """Where landmarks seen at z (m, 2) from pose (p,) are."""
        ...


@dataclass(frozen=True)
class RangeBearing:
    """Range and bearing to a point, the bearing relative to the vehicle's heading.

    Source: Nieto 2005, eqs. 2.8 and 2.40 to 2.44 (A.16 to A.20). Errata: the printed arctangent
    loses the quadrant, and the bearing row of 2.42 is printed with the position terms' signs
    exchanged; atan2 and the corrected row are used.
    """

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """Ranges and bearings as they come, and R."""
        return z, self.noise(sigma)

    def range_m(self, z: Array) -> Array:
        """(m,) the range."""
        return z[:, 0]

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Expected sightings of landmarks (m, 2) from pose (3,)."""
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
        """Innovation z - predicted (..., 2), bearing wrapped (Nieto 2005, eqs. 2.38, 2.57)."""
        difference = z - predicted
        difference[..., 1] = wrap_angle(difference[..., 1])
        return difference

    def noise(self, sigma: Array) -> Array:
        """R of each sighting (m, 2, 2) from sigmas (m, 2) [m, rad] (Nieto 2005, eq. 2.41)."""
        covariance = np.zeros((len(sigma), 2, 2))
        covariance[:, 0, 0] = sigma[:, 0] ** 2
        covariance[:, 1, 1] = sigma[:, 1] ** 2
        return covariance

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """Positions of newly seen landmarks (Nieto 2005, eqs. 2.50, 2.54 and 2.55)."""
        r = z[:, 0]
        cos, sin = np.cos(pose[2] + z[:, 1]), np.sin(pose[2] + z[:, 1])
        point = np.column_stack((pose[0] + r * cos, pose[1] + r * sin))
        jacobian_sighting = np.empty((len(r), 2, 2))
        jacobian_sighting[:, 0, 0] = cos
        jacobian_sighting[:, 1, 0] = sin
        jacobian_sighting[:, 0, 1] = -r * sin
        jacobian_sighting[:, 1, 1] = r * cos
        jacobian_pose = np.zeros((len(r), 2, 3))
        jacobian_pose[:, 0, 0] = jacobian_pose[:, 1, 1] = 1.0
        jacobian_pose[:, :, 2] = jacobian_sighting[:, :, 1]
        return NewLandmarks(point, jacobian_pose, jacobian_sighting)
