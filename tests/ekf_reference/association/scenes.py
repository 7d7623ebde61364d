"""Maps of points that are known each on its own, and measurements of points from a pose."""

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import NewLandmarks, diagonal_noise
from ekf_reference.core.measurements import Measurements
from ekf_reference.core.state import KalmanState
from ekf_reference.models.range_bearing import RangeBearing

Points = list[tuple[float, float]]


def mapped(points: Points, pose_covariance: Array, sigma_m: float | list[float]) -> KalmanState:
    """A vehicle at the origin, and points known to a sigma, or to one each."""
    state = KalmanState(np.zeros(3), pose_covariance)
    sigmas = np.broadcast_to(sigma_m, len(points))
    for point, sigma in zip(points, sigmas, strict=True):
        new = NewLandmarks.independent(np.array([point]), 3)
        state.augment(new, sigma**2 * np.eye(2)[None])
    return state


def measurements(z: Array, sigma: tuple[float, float]) -> Measurements:
    """Of z (m, 2), by nobody knows what."""
    return Measurements(z, diagonal_noise(np.tile(sigma, (len(z), 1))), np.full(len(z), -1))


def seen(points: Points, sigma: tuple[float, float], heading: float = 0.0) -> Measurements:
    """Points from the origin, without noise."""
    z = RangeBearing().predict(np.array((0.0, 0.0, heading)), np.array(points)).z
    return measurements(z, sigma)
