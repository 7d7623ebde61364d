"""Kinds of landmarks: how many entries each has, and how it is measured.

A landmark is a point (x, y) or a pose (x, y, heading). Its width names its kind everywhere: in the
state's layout, among the filter's models, and in the trace. Nothing else depends on the kind.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from ekf_reference.core.geometry import Array

POINT = 2
"""Entries of a landmark that is a point: x, y."""
POSE = 3
"""Entries of a landmark that is a pose: x, y, heading."""
WIDTHS = (POINT, POSE)


class PredictedMeasurements(NamedTuple):
    """Expected measurements z (m, w) of m landmarks, with Jacobians.

    jacobian_pose: (m, w, p) by the pose. jacobian_landmark: (m, w, w) by the landmark.
    """

    z: Array
    jacobian_pose: Array
    jacobian_landmark: Array


class NewLandmarks(NamedTuple):
    """Landmarks (m, w) computed from m measurements, with Jacobians.

    jacobian_pose: (m, w, p) by the pose. jacobian_z: (m, w, w) by the measurement.
    """

    landmark: Array
    jacobian_pose: Array
    jacobian_z: Array


class MeasurementModel(Protocol):
    """How landmarks of one kind are measured from a pose of p entries."""

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """Return the model's own z (m, w) and R (m, w, w) of what a sensor measured with sigmas."""
        ...

    def range_m(self, z: Array) -> Array:
        """Return the distances (m,) of measurements (m, w) [m]."""
        ...

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        """Predict the measurements of landmarks (m, w) from a pose (p,)."""
        ...

    def innovation(self, z: Array, predicted: Array) -> Array:
        """Return z - predicted (..., w), angles wrapped."""
        ...

    def invert(self, pose: Array, z: Array) -> NewLandmarks:
        """Return the landmarks that are measured as z (m, w) from a pose (p,)."""
        ...


def diagonal_noise(sigma: Array) -> Array:
    """Return R (m, w, w) of m measurements with independent errors of sigmas (m, w)."""
    count, width = sigma.shape
    covariance = np.zeros((count, width, width))
    covariance[:, range(width), range(width)] = sigma**2
    return covariance
