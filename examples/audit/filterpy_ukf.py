"""filterpy's UnscentedKalmanFilter, recorded by its statistical linearisation.

A vehicle with a gyroscope measures ranges to three beacons, and its speed. State: position (m),
heading (rad), speed (m/s), and the gyroscope's bias (rad/s).

A UKF has no Jacobians, but its sigma points imply them. Of a step y = g(x) with sigma points of
covariances P, P_xy, P_yy, the regression of y on x is A = P_xy' P^-1, and what it leaves over,
P_yy - A P A', acts as noise (Lefebvre, Bruyninckx and De Schutter 2002). So F = A and
Q = P_yy - F P F' of a prediction, with the process noise in P_yy; H = A and R = P_yy - H P H' of an
update, with the sensor's noise in P_yy: then the UKF's equations are a Kalman filter's.

filterpy's `predict` draws its points anew when it is done, so those that it has moved are made
again here. Its `update` takes the points that are there, out of date after another update;
`compute_process_sigmas(0.0)` draws them anew, as its documentation advises. Left out, the second
sensor's matrices would be of a covariance that the filter no longer has.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from comparisons.arrays import Array
from examples.audit import faults
from examples.audit.faults import Bug, Fault, Planted, Step, where
from slamcheck import Recorder

BLOCKS = {"position": 2, "heading": 1, "speed": 1, "gyro bias": 1}
ALL = tuple(BLOCKS)
STEPS, PERIOD_S, RANGES_EVERY = 150, 0.2, 2
BEACONS = np.array([[40.0, 0.0], [-25.0, 45.0], [-30.0, -40.0]])
SIGMA_RANGE_M, SIGMA_SPEED_MPS = 0.3, 0.1
Q = np.diag([0.01, 0.01, 0.01, 0.05, 5e-4]) ** 2

FAULTS = {
    "cross-stale": Fault(
        "the cross-covariance of heading and gyro bias is not updated",
        *("ranges", 30, ("heading", "gyro bias"), faults.stale),
    ),
    "cross-dropped": Fault(
        "the cross-covariance of position and heading is set to zero",
        *("predict", 100, ("position", "heading"), faults.dropped),
    ),
    "block-stale": Fault(
        "the covariance of the speed is not updated", "speed", 6, ("speed",), faults.stale
    ),
    "not-updated": Fault("P is not updated at all", "ranges", 50, ALL, faults.not_updated),
    "twice": Fault("P is updated twice", "speed", 60, ALL, faults.twice),
    "no-noise": Fault("Q is left out once", "predict", 45, ALL, faults.without_noise),
    "sigma": Fault("R holds sigmas in the gain of P", "ranges", 20, ALL, faults.by_sigma),
    "one-sided": Fault(
        "half of the cross-covariance of position and speed is updated: P is not symmetric",
        *("ranges", 40, ("position", "speed"), faults.one_sided),
    ),
    "not-applied": Fault(
        "the gyro bias is not corrected",
        *("ranges", 35, ("gyro bias",)),
        correction=faults.not_applied,
    ),
    "range-bias": Fault("all ranges are 1.5 sigmas too long", "ranges", 30, bias=1.5, lasting=True),
}


class Ukf(UnscentedKalmanFilter):  # type: ignore[misc]  # filterpy has no types
    """filterpy's filter, with a bug or none.

    F, Q_left, H, R_left: the last step's statistical linearisation and what it leaves over.
    """

    x: Array
    P: Array
    K: Array

    def __init__(self, bug: Bug) -> None:
        """Of five entries and three ranges, by 2 n + 1 points of unit scale."""
        points = MerweScaledSigmaPoints(5, alpha=1.0, beta=2.0, kappa=0.0)
        super().__init__(5, 3, PERIOD_S, hx=ranges, fx=move, points=points)
        self.Q, self.bug = Q, bug

    def predict(self, turn_rate_radps: float) -> None:
        """Predict as filterpy does."""
        x, p = self.x, self.P
        points = self.points_fn.sigma_points(x, p)
        moved = np.array([move(point, PERIOD_S, turn_rate_radps) for point in points])
        super().predict(turn_rate_radps=turn_rate_radps)
        cross = (points - x).T @ np.diag(self.Wc) @ (moved - self.x)
        self.F, self.Q_left = regression(p, cross, self.P)
        self.P = self.bug.covariance("predict", Step(p, self.P, self.F, self.Q_left))

    def update(self, sensor: str, z: Array, h: Callable[[Array], Array], r: Array) -> None:
        """Update as filterpy does, by points of the present covariance."""
        x, p = self.x, self.P
        self.compute_process_sigmas(0.0, turn_rate_radps=0.0)
        super().update(z, R=r, hx=h)
        self.H, self.R_left = regression(p, self.K @ self.S, self.S)
        step = Step(p, self.P, self.H, self.R_left, self.K)
        self.K, correction, self.P = self.bug.update(sensor, step, self.y)
        self.x = x + correction


def record(path: Path, seed: int, fault: str | None = None, snapshots: int = 1) -> Planted | None:
    """Simulate, filter and record into a new file. fault: one of FAULTS.

    snapshots: one is taken after every so many predictions and updates.
    """
    rng = np.random.default_rng(seed)
    chosen = None if fault is None else FAULTS[fault]
    bug = Bug(chosen, BLOCKS)
    ukf = Ukf(bug)
    ukf.x = np.array([10.0, 0.0, 1.5, 2.0, 0.0])
    ukf.P = np.diag([1.0, 1.0, 0.1, 0.3, 0.02]) ** 2
    truth = ukf.x + rng.multivariate_normal(np.zeros(5), ukf.P)
    with Recorder(path) as trace:
        due = itertools.cycle([False] * (snapshots - 1) + [True])
        trace.prior(BLOCKS, ukf.P)
        for k in range(STEPS):
            trace.at(PERIOD_S * k)
            turn_rate_radps = 0.2 * np.cos(0.02 * k) + truth[4]
            truth = move(truth, PERIOD_S, turn_rate_radps) + rng.multivariate_normal(np.zeros(5), Q)
            ukf.predict(turn_rate_radps)
            trace.predict(ukf.F, ukf.Q_left)
            if next(due):
                trace.snapshot(ukf.P, mean=ukf.x, error=truth - ukf.x)
            for sensor in ("speed",) if k % RANGES_EVERY else ("speed", "ranges"):
                h, r = SENSORS[sensor]
                draw = rng.standard_normal(len(r))
                z = h(truth) + bug.noise(sensor, np.sqrt(np.diag(r)), draw)
                x = ukf.x
                ukf.update(sensor, z, h, r)
                trace.update(sensor, ukf.y, ukf.H, ukf.R_left, correction=ukf.x - x, gain=ukf.K)
                if next(due):
                    trace.snapshot(ukf.P, mean=ukf.x, error=truth - ukf.x)
    return where(path, chosen)


def regression(p: Array, cross: Array, covariance: Array) -> tuple[Array, Array]:
    """Return A = P_xy' P^-1 and P_yy - A P A' of P, P_xy and P_yy."""
    slope = np.asarray(np.linalg.solve(p, cross).T, dtype=np.float64)
    left = covariance - slope @ cross
    return slope, 0.5 * (left + left.T)


def move(x: Array, period_s: float, turn_rate_radps: float) -> Array:
    """Return the state after a period; the heading is never wrapped: points are averaged."""
    heading = x[2] + 0.5 * period_s * (turn_rate_radps - x[4])
    step = period_s * x[3] * np.array([np.cos(heading), np.sin(heading)])
    turn = period_s * (turn_rate_radps - x[4])
    return np.concatenate([x[:2] + step, [x[2] + turn], x[3:]])


def ranges(x: Array) -> Array:
    """Return distances from the beacons."""
    return np.asarray(np.linalg.norm(BEACONS - x[:2], axis=1))


def speed(x: Array) -> Array:
    """Return the speed."""
    return x[3:4]


SENSORS = {
    "speed": (speed, SIGMA_SPEED_MPS**2 * np.eye(1)),
    "ranges": (ranges, SIGMA_RANGE_M**2 * np.eye(3)),
}
