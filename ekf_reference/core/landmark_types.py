"""Kinds of landmarks: how many entries each has, and how it is measured.

A landmark is a point (x, y) or a pose (x, y, heading). Its kind names it everywhere: in the state's
layout, among the filter's models, which predict and invert its measurements, and in the trace.
Nothing else depends on the kind.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, Self

import numpy as np

from ekf_reference.core.geometry import Array, wrap_angle


@dataclass(frozen=True)
class LandmarkKind:
    """A kind of landmarks. width: entries of each. angles: which of these are angles, unwrapped."""

    name: str
    width: int
    angles: tuple[int, ...] = ()


POINT, POSE = KINDS = (LandmarkKind("point", 2), LandmarkKind("pose", 3, (2,)))
"""A point x, y, and a pose x, y, heading."""


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

    @classmethod
    def independent(cls, landmark: Array, p: int) -> Self:
        """Return landmarks that have nothing to do with the pose; their noise is their own.

        Args:
            landmark: (m, w).
            p: Entries of the pose.

        Returns:
            The same, with Jacobians zero and one.
        """
        count, width = landmark.shape
        own = np.broadcast_to(np.eye(width), (count, width, width))
        return cls(landmark, np.zeros((count, width, p)), own)


class MeasurementModel(Protocol):
    """How landmarks of one kind are measured, as z (m, w), from a pose T_world_vehicle (p,).

    The default methods suit models whose noise is diagonal and whose last entry is an angle.
    """

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """Convert what a sensor measured to the model's own measurements.

        Args:
            z: (m, w) as the sensor has it.
            sigma: (m, w) standard deviations of its entries.

        Returns:
            z (m, w) and R (m, w, w) of the model.
        """
        return z, diagonal_noise(sigma)

    def range_m(self, z: Array) -> Array:
        """Return the distances of what was measured.

        Args:
            z: (m, w).

        Returns:
            (m,) [m].
        """

    def predict(self, T_world_vehicle: Array, landmarks: Array) -> PredictedMeasurements:
        """Predict the measurements of landmarks, with Jacobians at the given state.

        Args:
            T_world_vehicle: (p,) the pose, heading unwrapped.
            landmarks: (m, w).

        Returns:
            Expected measurements, angles not wrapped, and Jacobians by pose and landmark.
        """

    def innovation(self, z: Array, predicted: Array) -> Array:
        """Return z - predicted, its angle wrapped to (-pi, pi].

        Args:
            z: (..., w) measured.
            predicted: (..., w).

        Returns:
            (..., w). Only here an angle is wrapped; states keep theirs unwrapped.

        Source: Nieto 2005, eqs. 2.38, 2.57 and 3.15.
        """
        difference: Array = z - predicted
        difference[..., -1] = wrap_angle(difference[..., -1])
        return difference

    def invert(self, T_world_vehicle: Array, z: Array) -> NewLandmarks:
        """Return the landmarks that measurements imply, with Jacobians for their covariance.

        Args:
            T_world_vehicle: (p,) the pose.
            z: (m, w).

        Returns:
            Landmarks (m, w), and Jacobians by pose and measurement.
        """


def diagonal_noise(sigma: Array) -> Array:
    """Return the covariance of independent errors.

    Args:
        sigma: (m, w) standard deviations.

    Returns:
        (m, w, w), R.

    Source: Nieto 2005, eq. 2.41.
    """
    covariance = np.zeros((*sigma.shape, sigma.shape[1]))
    covariance[:, range(sigma.shape[1]), range(sigma.shape[1])] = sigma**2
    return covariance
