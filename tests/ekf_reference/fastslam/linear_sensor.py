"""A sensor for which the Kalman filter is exact, and clouds that begin at the origin."""

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import MeasurementModel, NewLandmarks, PredictedMeasurements
from ekf_reference.fastslam.filter import FastSlam, FastSlamOptions
from ekf_reference.models.motion import RelativePoseModel


def standing(options: FastSlamOptions, seed: int = 0) -> FastSlam:
    """A cloud at the origin, exactly."""
    generator = np.random.default_rng(seed)
    return FastSlam(RelativePoseModel(), np.zeros(3), np.zeros((3, 3)), generator, options)


class PlaceDifference(MeasurementModel):
    """Place of a point relative to the vehicle: linear while the heading is zero."""

    def range_m(self, z: Array) -> Array:
        found: Array = np.hypot(z[:, 0], z[:, 1])
        return found

    def predict(self, T_world_vehicle: Array, landmarks: Array) -> PredictedMeasurements:  # noqa: N803
        m = len(landmarks)
        by_pose = np.tile(-np.eye(2, 3), (m, 1, 1))
        return PredictedMeasurements(
            landmarks - T_world_vehicle[:2], by_pose, np.tile(np.eye(2), (m, 1, 1))
        )

    def innovation(self, z: Array, predicted: Array) -> Array:
        return z - predicted

    def invert(self, T_world_vehicle: Array, z: Array) -> NewLandmarks:  # noqa: N803
        eye = np.eye(2, 3)
        return NewLandmarks(
            z + T_world_vehicle[:2],
            np.tile(eye, (len(z), 1, 1)),
            np.tile(eye[:, :2], (len(z), 1, 1)),
        )
