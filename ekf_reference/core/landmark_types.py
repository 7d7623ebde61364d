"""Kinds of landmarks: how many entries each has, and how it is measured.

A landmark is a point (x, y) or a pose (x, y, heading). Its width names its kind everywhere: in the
state's layout, among the filter's models, and in the trace. Nothing else depends on the kind.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from ekf_reference.core.geometry import Array, wrap_angle

POINT, POSE = WIDTHS = (2, 3)
"""Entries of a landmark that is a point, x, y, and of one that is a pose, x, y, heading."""


class PredictedMeasurements(NamedTuple):
    """Expected measurements (m, w); Jacobians by the pose (m, w, p) and the landmark (m, w, w)."""

    z: Array
    jacobian_pose: Array
    jacobian_landmark: Array


class NewLandmarks(NamedTuple):
    """Landmarks (m, w) of measurements z; Jacobians by the pose (m, w, p) and by z (m, w, w)."""

    landmark: Array
    jacobian_pose: Array
    jacobian_z: Array


class MeasurementModel(Protocol):
    """How landmarks of one kind are measured, as z (m, w), from a pose T_world_vehicle (p,).

    The default methods suit models whose noise is diagonal and whose last entry is an angle.
    """

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """Convert what a sensor measured, with sigmas (m, w), to the model's z and R (m, w, w)."""
        return z, diagonal_noise(sigma)

    def range_m(self, z: Array) -> Array:
        """Return the distances (m,) of what was measured [m]."""

    def predict(self, T_world_vehicle: Array, landmarks: Array) -> PredictedMeasurements:
        """Predict the measurements of landmarks (m, w)."""

    def innovation(self, z: Array, predicted: Array) -> Array:
        """Return z - predicted (..., w), wrapped (Nieto 2005, eqs. 2.38, 2.57 and 3.15)."""
        difference: Array = z - predicted
        difference[..., -1] = wrap_angle(difference[..., -1])
        return difference

    def invert(self, T_world_vehicle: Array, z: Array) -> NewLandmarks:
        """Return the landmarks that are measured as z."""


def diagonal_noise(sigma: Array) -> Array:
    """Return R (m, w, w) of independent errors with sigmas (m, w) (Nieto 2005, eq. 2.41)."""
    covariance = np.zeros((*sigma.shape, sigma.shape[1]))
    covariance[:, range(sigma.shape[1]), range(sigma.shape[1])] = sigma**2
    return covariance
