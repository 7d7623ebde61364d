"""Maps of points that are known each on its own, and measurements of points from a pose."""

from collections.abc import Callable
from itertools import product

import numpy as np
from scipy.stats import chi2

from ekf_reference.core.blocks import stack
from ekf_reference.core.geometry import Array, Mask
from ekf_reference.core.landmark_types import NewLandmarks, diagonal_noise
from ekf_reference.core.measurements import Measurements
from ekf_reference.core.state import KalmanState
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.numerics import point_columns

Points = list[tuple[float, float]]
Pairs = tuple[tuple[int, int], ...]
"""Measurement and landmark of each."""


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


def joint_nis(state: KalmanState, seen: Measurements, pairs: Pairs) -> float:
    """Of the positions, by the whole S."""
    rows, landmarks = (np.array(column) for column in zip(*pairs, strict=True))
    predicted = RangeBearing().predict(state.pose, state.landmarks[landmarks])
    columns = point_columns(landmarks)
    h = stack(predicted.jacobian_pose, predicted.jacobian_landmark)
    s = h @ state.covariance[np.ix_(columns, columns)] @ h.T
    for k, row in enumerate(rows):
        s[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += seen.noise[row]
    nu = RangeBearing().innovation(seen.z[rows], predicted.z).ravel()
    return float(nu @ np.linalg.solve(s, nu))


def best_pairs(allowed: Mask, judge: Callable[[Pairs], tuple[float, float, int]]) -> list[int]:
    """The largest set of allowed pairs that passes its gate, the least in cost, by trying all.

    allowed: (m, L). judge: nis, cost and degrees of freedom of a set. Returns the landmark of each
    measurement, -1 for none.
    """
    count, landmarks = allowed.shape
    best: tuple[int, float, tuple[int, ...]] = (0, 0.0, (-1,) * count)
    for choice in product(range(-1, landmarks), repeat=count):
        pairs = tuple((i, j) for i, j in enumerate(choice) if j >= 0)
        if pairs and len({j for _, j in pairs}) == len(pairs) and all(allowed[p] for p in pairs):
            nis, cost, dof = judge(pairs)
            if nis <= chi2.ppf(0.999, dof):
                best = max(best, (len(pairs), -cost, choice))
    return list(best[2])
