"""filterpy's ExtendedKalmanFilter: a target is tracked by a radar with a bias, and by its GPS.

State: position (m), velocity (m/s), and the radar's bias in range (m) and bearing (rad).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from comparisons.arrays import Array
from examples.audit import faults
from examples.audit.faults import Bug, Fault, Planted, Step, where
from slamcheck import Recorder

Model = Callable[[Array], Array]

BLOCKS = {"position": 2, "velocity": 2, "bias": 2}
ALL = tuple(BLOCKS)
STEPS, PERIOD_S, GPS_EVERY = 120, 0.5, 4

FAULTS = {
    "cross-stale": Fault(
        "the cross-covariance of velocity and bias is not updated",
        *("radar", 40, ("velocity", "bias"), faults.stale),
    ),
    "cross-dropped": Fault(
        "the cross-covariance of position and bias is set to zero",
        *("radar", 55, ("position", "bias"), faults.dropped),
    ),
    "block-stale": Fault(
        "the covariance of the bias is not updated", "gps", 9, ("bias",), faults.stale
    ),
    "twice": Fault("P is updated twice", "gps", 12, ALL, faults.twice),
    "no-noise": Fault(
        "Q of the velocity is left out once", "predict", 70, ("velocity",), faults.without_noise
    ),
    "double-noise": Fault(
        "Q is added twice from one step on", "predict", 30, ALL, faults.double_noise, lasting=True
    ),
    "sigma": Fault("R holds sigmas in the gain of P", "radar", 60, ALL, faults.by_sigma),
    "half-gain": Fault(
        "half the gain, P by the short form", "radar", 80, ALL, faults.short_form, faults.half
    ),
    "wrong-sign": Fault(
        "the bias is corrected with the wrong sign",
        *("radar", 90, ("bias",)),
        correction=faults.wrong_sign,
    ),
    "noisy-radar": Fault("the radar's R is too small by 4", "radar", 50, noise=2.0, lasting=True),
}


class Ekf(ExtendedKalmanFilter):  # type: ignore[misc]  # filterpy has no types
    """filterpy's filter, with a bug or none."""

    x: Array
    P: Array
    K: Array

    def __init__(self, bug: Bug) -> None:
        """Of a six-entry state and measurements of two."""
        super().__init__(dim_x=6, dim_z=2)
        self.bug = bug

    def predict(self) -> None:
        """Predict as filterpy does."""
        before = self.P
        super().predict()
        self.P = self.bug.covariance("predict", Step(before, self.P, self.F, self.Q))

    def update(self, sensor: str, z: Array, h: Model, jacobian: Model, r: Array) -> None:
        """Update as filterpy does."""
        x, p = self.x, self.P
        super().update(z, jacobian, h, R=r)
        step = Step(p, self.P, jacobian(x), r, self.K)
        self.K, correction, self.P = self.bug.update(sensor, step, self.y)
        self.x = x + correction


def record(path: Path, seed: int, fault: str | None = None, snapshots: int = 1) -> Planted | None:
    """Simulate, filter and record into a new file. fault: one of FAULTS.

    snapshots: one is taken after every so many predictions and updates.
    """
    rng = np.random.default_rng(seed)
    chosen = None if fault is None else FAULTS[fault]
    bug = Bug(chosen, BLOCKS)
    ekf = Ekf(bug)
    ekf.x = np.array([800.0, 300.0, -12.0, 8.0, 0.0, 0.0])
    ekf.P = np.diag([20.0, 20.0, 2.0, 2.0, 15.0, 5e-3]) ** 2
    ekf.F, ekf.Q = motion()
    truth = ekf.x + rng.multivariate_normal(np.zeros(6), ekf.P)
    with Recorder(path, components={"radar": ["range", "bearing"], "gps": ["x", "y"]}) as trace:
        due = itertools.cycle([False] * (snapshots - 1) + [True])
        trace.prior(BLOCKS, ekf.P)
        for k in range(STEPS):
            trace.at(PERIOD_S * k)
            truth = ekf.F @ truth + rng.multivariate_normal(np.zeros(6), ekf.Q)
            ekf.predict()
            trace.predict(ekf.F, ekf.Q)
            if next(due):
                trace.snapshot(ekf.P, mean=ekf.x, error=truth - ekf.x)
            for sensor in ("radar",) if k % GPS_EVERY else ("radar", "gps"):
                h, jacobian, sigmas = SENSORS[sensor]
                z = h(truth) + bug.noise(sensor, sigmas, rng.standard_normal(2))
                x, r = ekf.x, np.diag(sigmas**2)
                ekf.update(sensor, z, h, jacobian, r)
                trace.update(sensor, ekf.y, jacobian(x), r, correction=ekf.x - x, gain=ekf.K)
                if next(due):
                    trace.snapshot(ekf.P, mean=ekf.x, error=truth - ekf.x)
    return where(path, chosen)


def motion() -> tuple[Array, Array]:
    """F and Q (6, 6): constant velocity but for white acceleration; the bias walks."""
    f = np.eye(6)
    f[:2, 2:4] = PERIOD_S * np.eye(2)
    by_noise = np.zeros((6, 4))
    by_noise[:2, :2], by_noise[2:4, :2] = 0.5 * PERIOD_S**2 * np.eye(2), PERIOD_S * np.eye(2)
    by_noise[4:, 2:] = np.eye(2)
    q = by_noise @ np.diag([0.5, 0.5, 0.05, 2e-5]) ** 2 @ by_noise.T
    return f, q


def radar(x: Array) -> Array:
    """Return range and bearing from the origin, with their bias."""
    return np.array([np.hypot(x[0], x[1]) + x[4], np.arctan2(x[1], x[0]) + x[5]])


def radar_jacobian(x: Array) -> Array:
    """Return the derivative of `radar` (2, 6)."""
    d, e = x[0], x[1]
    square = d * d + e * e
    h = np.zeros((2, 6))
    h[:, :2] = [[d, e] / np.sqrt(square), [-e / square, d / square]]
    h[:, 4:] = np.eye(2)
    return h


def gps(x: Array) -> Array:
    """Return the position."""
    return x[:2]


def gps_jacobian(x: Array) -> Array:
    """Return the derivative of `gps` (2, 6)."""
    return np.eye(2, 6)


SENSORS = {
    "radar": (radar, radar_jacobian, np.array([5.0, 2e-3])),
    "gps": (gps, gps_jacobian, np.array([10.0, 10.0])),
}
