"""GTSAM's NavStateImuEKF: an IMU with position fixes and velocities in the vehicle's frame.

The error is GTSAM's: attitude (rad), position (m) and velocity (m/s), all in the vehicle's frame,
truth = estimate.retract(error). After a correction GTSAM expresses the covariance at the new
estimate (`performReset`), by the derivative of `retract` for the state: recorded as a reset.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import gtsam
import numpy as np

from comparisons.arrays import Array
from examples.audit import faults
from examples.audit.faults import Bug, Fault, Planted, Step, kalman_gain, updated, where
from slamcheck import Recorder

BLOCKS = {"attitude": 3, "position": 3, "velocity": 3}
ALL = tuple(BLOCKS)
STEPS, PERIOD_S, DVL_EVERY, GPS_EVERY = 160, 0.05, 2, 5
SIGMAS = {"gps": 0.3, "dvl": 0.05}
PRIOR_SIGMAS = np.repeat([0.05, 0.5, 0.1], 3)

FAULTS = {
    "no-reset": Fault("the reset is left out", "reset", 2, ALL, faults.not_updated),
    "cross-predicted": Fault(
        "F is not applied to the cross-covariance of attitude and velocity",
        *("predict", 70, ("attitude", "velocity"), faults.stale),
    ),
    "cross-stale": Fault(
        "the cross-covariance of attitude and position is not updated",
        *("gps", 12, ("attitude", "position"), faults.stale),
    ),
    "block-stale": Fault(
        "the covariance of the velocity is not updated", "dvl", 30, ("velocity",), faults.stale
    ),
    "not-updated": Fault("P is not updated at all", "gps", 20, ALL, faults.not_updated),
    "twice": Fault("P is updated twice", "dvl", 50, ALL, faults.twice),
    "no-noise": Fault(
        "Q of the velocity is left out from one step on",
        *("predict", 40, ("velocity",), faults.without_noise),
        lasting=True,
    ),
    "transposed": Fault("P = F' P F + Q", "predict", 90, ALL, faults.transposed),
    "wrong-sign": Fault(
        "the attitude is corrected with the wrong sign",
        *("gps", 6, ("attitude",)),
        correction=faults.wrong_sign,
    ),
    "noisy-gps": Fault("the GPS's R is too small by 9", "gps", 12, noise=3.0, lasting=True),
}


class ImuEkf:
    """GTSAM's filter, with a bug or none: a filter with another covariance takes its place.

    F, Q: of the last prediction. correction, J: the last update's, and its reset's Jacobian.
    """

    def __init__(self, state: gtsam.NavState, p: Array, bug: Bug) -> None:
        """With gravity along -z, and white noise of gyroscope and accelerometer."""
        self.params = gtsam.PreintegrationParams.MakeSharedU(9.81)
        self.params.setGyroscopeCovariance(1e-5 * np.eye(3))
        self.params.setAccelerometerCovariance(1e-3 * np.eye(3))
        self.params.setIntegrationCovariance(1e-4 * np.eye(3))
        self.filter = gtsam.NavStateImuEKF(state, p, self.params)
        self.bug = bug

    def dynamics(self, state: gtsam.NavState, turn: Array, force: Array) -> gtsam.NavState:
        """Return the state after a period; F (9, 9) is its derivative."""
        self.F, gravity = np.zeros((9, 9), order="F"), self.filter.gravity()
        return gtsam.NavStateImuEKF.Dynamics(gravity, state, turn, force, PERIOD_S, self.F)

    def predict(self, turn: Array, force: Array) -> None:
        """Predict as GTSAM does."""
        before = self.filter.covariance().copy()
        self.dynamics(self.filter.state(), turn, force)
        self.Q = PERIOD_S * self.filter.processNoise()
        self.filter.predict(turn, force, PERIOD_S)
        struck = self.bug.strikes("predict")
        step = Step(before, self.filter.covariance(), self.F, self.Q)
        p = self.bug.covariance("predict", step)
        if struck:
            self.filter = gtsam.NavStateImuEKF(self.filter.state(), p, self.params)

    def update(self, sensor: str, z: Array, expected: Array, h: Array, r: Array) -> None:
        """Update and reset as GTSAM does."""
        x, p = copied(self.filter.state()), self.filter.covariance().copy()
        self.filter.updateWithVector(expected, h, z, r, performReset=True)
        self.correction = x.localCoordinates(self.filter.state())
        struck, in_reset = self.bug.strikes(sensor), self.bug.strikes("reset")
        step = Step(p, updated(p, h, r), h, r, kalman_gain(p, h, r))
        _, correction, p = self.bug.update(sensor, step, z - expected)
        if struck:
            self.correction = correction
        self.J, other = np.zeros((9, 9), order="F"), np.zeros((9, 9), order="F")
        state = x.retract(self.correction, self.J, other)
        p = self.bug.covariance("reset", Step(p, self.J @ p @ self.J.T, self.J, np.zeros((9, 9))))
        if struck or in_reset:
            self.filter = gtsam.NavStateImuEKF(state, p, self.params)


def record(path: Path, seed: int, fault: str | None = None, snapshots: int = 1) -> Planted | None:
    """Simulate, filter and record into a new file. fault: one of FAULTS.

    snapshots: one is taken after every so many predictions and updates.
    """
    rng = np.random.default_rng(seed)
    chosen = None if fault is None else FAULTS[fault]
    bug = Bug(chosen, BLOCKS)
    start = gtsam.NavState(gtsam.Rot3(), np.zeros(3), np.array([3.0, 0.0, 0.0]))
    ekf = ImuEkf(start, np.diag(PRIOR_SIGMAS**2), bug)
    truth = start.retract(PRIOR_SIGMAS * rng.standard_normal(9))
    with Recorder(path) as trace:
        due = itertools.cycle([False] * (snapshots - 1) + [True])
        trace.prior(BLOCKS, ekf.filter.covariance())
        for k in range(STEPS):
            trace.at(PERIOD_S * k)
            turn, force = imu(truth, PERIOD_S * k)
            moved = ekf.dynamics(truth, turn, force)
            ekf.predict(turn, force)
            truth = moved.retract(np.sqrt(np.diag(ekf.Q)) * rng.standard_normal(9))
            trace.predict(ekf.F, ekf.Q)
            if next(due):
                trace.snapshot(ekf.filter.covariance(), error=error(truth, ekf))
            for sensor in [
                s for s, every in (("dvl", DVL_EVERY), ("gps", GPS_EVERY)) if not k % every
            ]:
                measure, sigma = SENSORS[sensor], SIGMAS[sensor]
                z = measure(truth)[0] + bug.noise(sensor, sigma, rng.standard_normal(3))
                (expected, h), r = measure(ekf.filter.state()), sigma**2 * np.eye(3)
                ekf.update(sensor, z, expected, h, r)
                trace.update(sensor, z - expected, h, r, correction=ekf.correction)
                trace.reset(ekf.J)
                if next(due):
                    trace.snapshot(ekf.filter.covariance(), error=error(truth, ekf))
    return where(path, chosen)


def copied(state: gtsam.NavState) -> gtsam.NavState:
    """Return a copy; what `state()` returns changes with the filter."""
    return gtsam.NavState(state.attitude(), state.position(), state.velocity())


def error(truth: gtsam.NavState, ekf: ImuEkf) -> Array:
    """Return the true error (9,) in GTSAM's coordinates."""
    return np.asarray(ekf.filter.state().localCoordinates(truth))


def imu(truth: gtsam.NavState, time_s: float) -> tuple[Array, Array]:
    """Return turn rate and specific force (3,) that keep the vehicle on a wavy course at 3 m/s."""
    course = np.array([np.cos(0.8 * time_s), np.sin(0.8 * time_s), 0.2 * np.cos(time_s)])
    acceleration = 2.0 * (3.0 * course - truth.velocity()) + np.array([0.0, 0.0, 9.81])
    turn = np.array([0.2 * np.cos(2.0 * time_s), 0.2 * np.sin(1.5 * time_s), 0.8])
    return turn, truth.attitude().unrotate(acceleration)


def gps(state: gtsam.NavState) -> tuple[Array, Array]:
    """Return the position and its derivative (3, 9)."""
    h = np.zeros((3, 9))
    h[:, 3:6] = state.attitude().matrix()
    return state.position(), h


def dvl(state: gtsam.NavState) -> tuple[Array, Array]:
    """Return the velocity in the vehicle's frame and its derivative (3, 9)."""
    velocity = state.attitude().unrotate(state.velocity())
    h = np.zeros((3, 9))
    h[:, :3], h[:, 6:] = gtsam.Rot3.Hat(velocity), np.eye(3)
    return velocity, h


SENSORS = {"gps": gps, "dvl": dvl}
