"""Motion and sensors of many runs at once; the leading axis B counts the runs.

Both sensors see a landmark only through its offset from the robot and the robot's heading, so one
(2, 2) matrix M = dz / d offset says all: H = M [-I, -J offset, I] over position, heading, landmark.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from comparisons.arrays import Array
from ekf_reference.core.geometry import wrap_angle


def turned(vector: Array) -> Array:
    """J v of vectors (..., 2): a quarter turn to the left."""
    return np.stack((-vector[..., 1], vector[..., 0]), axis=-1)


def rotated(angle: Array, vector: Array) -> Array:
    """R(angle) v of vectors (..., 2) by angles (...)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    return np.stack((cos * x - sin * y, sin * x + cos * y), axis=-1)


def unicycle(pose: Array, control: Array, step_s: float) -> Array:
    """Poses (..., 3) after one midpoint step under (v, omega), as ekf_reference's UnicycleModel."""
    middle = pose[..., 2] + 0.5 * step_s * control[..., 1]
    forward = step_s * control[..., 0]
    return np.stack(
        (
            pose[..., 0] + forward * np.cos(middle),
            pose[..., 1] + forward * np.sin(middle),
            pose[..., 2] + step_s * control[..., 1],
        ),
        axis=-1,
    )


def control_jacobian(heading: Array, control: Array, step_s: float) -> Array:
    """(B, 3, 2) derivative of a step by its control (B, 2), departing at a heading (B,)."""
    middle = heading + 0.5 * step_s * control[:, 1]
    cos, sin = np.cos(middle), np.sin(middle)
    half = 0.5 * step_s * control[:, 0]
    jacobian = np.zeros((len(heading), 3, 2))
    jacobian[:, 0, 0], jacobian[:, 0, 1] = cos, -half * sin
    jacobian[:, 1, 0], jacobian[:, 1, 1] = sin, half * cos
    jacobian[:, 2, 1] = 1.0
    jacobian *= step_s
    return jacobian


class BatchSensor(Protocol):
    """Contract of the sensors. Offsets (..., 2) are landmark minus robot, in the world's axes."""

    def predict(self, heading: Array, offset: Array) -> Array:
        """Noise-free z (..., 2) at headings (...)."""
        ...

    def offset(self, heading: Array, z: Array) -> Array:
        """The inverse: offsets (..., 2) of measurements."""
        ...

    def innovation(self, z: Array, predicted: Array) -> Array:
        """Z - predicted (..., 2), angles wrapped."""
        ...

    def by_offset(self, heading: Array, offset: Array) -> Array:
        """M (..., 2, 2), dz / d offset."""
        ...


class RelativePosition:
    """Where the landmark is in the robot's own frame: z = R(heading)^T offset [m, m]."""

    def predict(self, heading: Array, offset: Array) -> Array:
        """The offset, in the robot's axes."""
        return rotated(-heading, offset)

    def offset(self, heading: Array, z: Array) -> Array:
        """The measurement, in the world's axes."""
        return rotated(heading, z)

    def innovation(self, z: Array, predicted: Array) -> Array:
        """A plain difference."""
        return z - predicted

    def by_offset(self, heading: Array, offset: Array) -> Array:
        """R(heading)^T."""
        cos, sin = np.broadcast_arrays(np.cos(heading), np.sin(heading))
        matrix = np.empty((*offset.shape, 2))
        matrix[..., 0, 0] = matrix[..., 1, 1] = cos
        matrix[..., 0, 1], matrix[..., 1, 0] = sin, -sin
        return matrix


class BatchRangeBearing:
    """Range [m] and bearing from straight ahead [rad]."""

    def predict(self, heading: Array, offset: Array) -> Array:
        """Range and bearing, the latter not wrapped."""
        x, y = offset[..., 0], offset[..., 1]
        return np.stack((np.hypot(x, y), np.arctan2(y, x) - heading), axis=-1)

    def offset(self, heading: Array, z: Array) -> Array:
        """Polar to Cartesian, in the world's axes."""
        direction = heading + z[..., 1]
        offset: Array = z[..., :1] * np.stack((np.cos(direction), np.sin(direction)), axis=-1)
        return offset

    def innovation(self, z: Array, predicted: Array) -> Array:
        """The bearing wrapped."""
        difference = z - predicted
        difference[..., 1] = wrap_angle(difference[..., 1])
        return difference

    def by_offset(self, heading: Array, offset: Array) -> Array:
        """Rows: towards the landmark; across, by range."""
        x, y = offset[..., 0], offset[..., 1]
        q = x * x + y * y
        r = np.sqrt(q)
        matrix = np.empty((*offset.shape, 2))
        matrix[..., 0, 0], matrix[..., 0, 1] = x / r, y / r
        matrix[..., 1, 0], matrix[..., 1, 1] = -y / q, x / q
        return matrix
