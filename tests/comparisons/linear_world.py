"""A linear Gaussian world: a vehicle's pose and two landmarks, many runs at once.

A Kalman filter that knows the world is consistent exactly, and its covariances are the same in
all runs; every wrong belief about the world is a broken variant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.helpers import Array

STEPS = 30
SIZE = 7
_MOTION = np.zeros((SIZE, SIZE))
_MOTION[:3, :3] = np.diag((0.04, 0.04, 0.04))
_PRIOR = np.diag((0.01, 0.01, 0.01, 4.0, 4.0, 4.0, 4.0))
_NOISE = np.diag((0.4, 0.2, 0.4, 0.2))
_MEAN = np.array([0.0, 0.0, 0.0, 5.0, 1.0, 4.0, -3.0])
_H = np.zeros((4, SIZE))
_H[:, :2] = -np.tile(np.eye(2), (2, 1))
_H[:, 2] = (0.5, -2.0, 0.7, 2.0)
_H[:, 3:] = np.eye(4)


@dataclass(frozen=True)
class Runs:
    """truth, filtered, smoothed: (T, R, 7). covariance, smoothed_covariance: (T, 7, 7).

    standard: (T, R, 4) whitened innovations.
    """

    truth: Array
    filtered: Array
    covariance: Array
    standard: Array
    smoothed: Array
    smoothed_covariance: Array


def simulate(
    runs: int,
    seed: int = 2,
    *,
    motion_scale: float = 1.0,
    noise_scale: float = 1.0,
    spoil: Callable[[Array], Array] = lambda covariance: covariance,
) -> Runs:
    """The scales are the filter's beliefs; `spoil` changes its covariance after each update."""
    rng = np.random.default_rng(seed)

    def draw(covariance: Array) -> Array:
        root = np.sqrt(np.diag(covariance))
        return root * rng.standard_normal((runs, len(root)))

    q, r = motion_scale * _MOTION, noise_scale * _NOISE
    truth, mean, p = _MEAN + draw(_PRIOR), np.tile(_MEAN, (runs, 1)), _PRIOR
    kept: list[tuple[Array, ...]] = []
    for _ in range(STEPS):
        truth, p = truth + draw(_MOTION), p + q
        predicted, predicted_p = mean, p
        innovation = truth @ _H.T + draw(_NOISE) - mean @ _H.T
        s = _H @ p @ _H.T + r
        gain = p @ _H.T @ np.linalg.inv(s)
        mean = mean + innovation @ gain.T
        p = p - gain @ s @ gain.T
        p = spoil(0.5 * (p + p.T))
        standard = np.linalg.solve(np.linalg.cholesky(s), innovation.T).T
        kept.append((truth, mean, p, standard, predicted, predicted_p))
    x, m, c, w, x_ahead, c_ahead = (np.array(column) for column in zip(*kept, strict=True))
    return Runs(x, m, c, w, *_smooth(m, c, x_ahead, c_ahead))


def _smooth(mean: Array, p: Array, predicted: Array, predicted_p: Array) -> tuple[Array, Array]:
    """Rauch, Tung and Striebel, the state staying as it is but for noise."""
    mean, p = mean.copy(), p.copy()
    for k in range(len(mean) - 2, -1, -1):
        gain = p[k] @ np.linalg.inv(predicted_p[k + 1])
        mean[k] += (mean[k + 1] - predicted[k + 1]) @ gain.T
        p[k] += gain @ (p[k + 1] - predicted_p[k + 1]) @ gain.T
    return mean, p
