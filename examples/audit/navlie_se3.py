"""navlie's ExtendedKalmanFilter on SE(3): a vehicle with a biased gyroscope among landmarks.

State: a pose, perturbed from the right, and the gyroscope's bias (rad/s). The error is navlie's
`truth.minus(estimate)`: attitude (rad) and position (m) in the vehicle's frame, and bias. navlie
does not express the covariance anew after a correction, so no reset is recorded. Its gate lets 99 %
of sound measurements pass.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from comparisons.arrays import Array
from examples.audit import faults
from examples.audit.faults import Bug, Fault, Planted, Step, kalman_gain, where
from examples.audit.navlie_groups import navlie_with_groups
from slamcheck import Recorder

nav = navlie_with_groups()
ProcessModel: Any = nav.ProcessModel
ExtendedKalmanFilter: Any = nav.ExtendedKalmanFilter

BLOCKS = {"attitude": 3, "position": 3, "gyro bias": 3}
ALL = tuple(BLOCKS)
STEPS, PERIOD_S, GPS_EVERY = 150, 0.1, 5
LANDMARKS = np.array([[8.0, 2.0, 1.0], [-4.0, 7.0, -2.0], [2.0, -6.0, 3.0]])
SIGMA_GPS_M, SIGMA_LANDMARK_M, GATE = 0.3, 0.15, 0.99
PRIOR_SIGMAS = np.repeat([0.05, 0.3, 0.02], 3)
TWIST_NOISE = np.repeat([0.03, 0.15], 3) ** 2
BIAS_NOISE = 0.002**2

FAULTS = {
    "cross-stale": Fault(
        "the cross-covariance of attitude and gyroscope's bias is not updated",
        *("landmark", 35, ("attitude", "gyro bias"), faults.stale),
    ),
    "cross-dropped": Fault(
        "the cross-covariance of position and gyroscope's bias is set to zero",
        *("gps", 14, ("position", "gyro bias"), faults.dropped),
    ),
    "block-stale": Fault(
        "the covariance of the position is not updated", "landmark", 60, ("position",), faults.stale
    ),
    "not-updated": Fault("P is not updated at all", "gps", 20, ALL, faults.not_updated),
    "transposed": Fault("P = F' P F + Q", "predict", 80, ALL, faults.transposed),
    "no-noise": Fault(
        "Q of the attitude is left out from one step on",
        *("predict", 30, ("attitude",), faults.without_noise),
        lasting=True,
    ),
    "half-gain": Fault(
        "half the gain, P by the short form", "landmark", 90, ALL, faults.short_form, faults.half
    ),
    "no-krk": Fault(
        "Joseph's form without K R K'", "landmark", 20, ALL, faults.without_noise_of_gain
    ),
    "wrong-sign": Fault(
        "the position is corrected with the wrong sign",
        *("gps", 8, ("position",)),
        correction=faults.wrong_sign,
    ),
    "tight-gate": Fault("the gate lets 70 % pass", "landmark", 47, gate=0.7, lasting=True),
}


class BiasedVelocity(ProcessModel):  # type: ignore[misc]  # navlie has no types
    """T' = T Exp((u - b) dt) of a pose T and the bias b of the turn rates in u."""

    def evaluate(self, x: Any, u: Any, dt: float) -> Any:
        """Return the state after dt."""
        x = x.copy()
        x.value[0].value = x.value[0].value @ nav.lib.SE3State.group.Exp(dt * twist(x, u))
        return x

    def jacobian(self, x: Any, u: Any, dt: float) -> Array:
        """Return F (9, 9), errors from the right."""
        group, xi = nav.lib.SE3State.group, dt * twist(x, u)
        f = np.eye(9)
        f[:6, :6] = group.adjoint(group.Exp(-xi))
        f[:6, 6:] = -dt * group.left_jacobian(-xi)[:, :3]
        return f

    def covariance(self, x: Any, u: Any, dt: float) -> Array:
        """Return Q (9, 9)."""
        by_twist = dt * nav.lib.SE3State.group.left_jacobian(-dt * twist(x, u))
        q = BIAS_NOISE * dt * np.eye(9)
        q[:6, :6] = by_twist @ np.diag(TWIST_NOISE) @ by_twist.T
        return q


class Ekf(ExtendedKalmanFilter):  # type: ignore[misc]
    """navlie's filter, with a bug or none."""

    def __init__(self, bug: Bug) -> None:
        """With navlie's gate."""
        super().__init__(BiasedVelocity(), reject_outliers=True)
        self.bug = bug

    def predict(self, x: Any, u: Any, dt: float) -> Any:
        """Predict as navlie does; return state and details."""
        before = x.covariance
        x, details = super().predict(x, u, dt, output_details=True)
        step = Step(before, x.covariance, details["A"], details["Q"])
        x.covariance = self.bug.covariance("predict", step)
        return x, details

    def correct(self, sensor: str, x: Any, y: Any) -> Any:
        """Correct as navlie does; return state and details."""
        h, r = y.model.jacobian(x.state), y.model.covariance(x.state)
        gate, struck = self.bug.gate(sensor, GATE), self.bug.strikes(sensor)
        after, details = super().correct(x, y, None, output_details=True)
        z, s = details["z"].ravel(), details["S"]
        if gate < GATE and z @ np.linalg.solve(s, z) > chi2.ppf(gate, len(z)):
            after, details["is_outlier"] = x, True
        step = Step(x.covariance, after.covariance, h, r, kalman_gain(x.covariance, h, r))
        _, correction, p = self.bug.update(sensor, step, z)
        if struck and not details["is_outlier"]:
            after.state, after.covariance = x.state.plus(correction), p
        return after, details


def record(path: Path, seed: int, fault: str | None = None, snapshots: int = 1) -> Planted | None:
    """Simulate, filter and record into a new file. fault: one of FAULTS.

    snapshots: one is taken after every so many predictions and updates.
    """
    rng = np.random.default_rng(seed)
    chosen = None if fault is None else FAULTS[fault]
    bug = Bug(chosen, BLOCKS)
    ekf, x = Ekf(bug), nav.StateWithCovariance(start(), np.diag(PRIOR_SIGMAS**2))
    truth = start().plus(PRIOR_SIGMAS * rng.standard_normal(9))
    with Recorder(path, gates={"gps": GATE, "landmark": GATE}) as trace:
        due = itertools.cycle([False] * (snapshots - 1) + [True])
        trace.prior(BLOCKS, x.covariance)
        for k in range(STEPS):
            trace.at(PERIOD_S * k)
            u = velocity(truth, PERIOD_S * k)
            truth = moved(truth, u, rng)
            x, details = ekf.predict(x, u, PERIOD_S)
            trace.predict(details["A"], details["Q"])
            if next(due):
                trace.snapshot(x.covariance, error=truth.minus(x.state).ravel())
            for sensor in ("landmark",) if k % GPS_EVERY else ("landmark", "gps"):
                model, sigma = model_of(sensor, k)
                noise = bug.noise(sensor, sigma, rng.standard_normal(3))
                y = nav.Measurement(model.evaluate(truth).ravel() + noise, model=model)
                before = x.state
                x, details = ekf.correct(sensor, x, y)
                h, r, z = model.jacobian(before), model.covariance(before), details["z"].ravel()
                if details["is_outlier"]:
                    trace.reject(sensor, z, h, r)
                else:
                    correction = x.state.minus(before).ravel()
                    trace.update(sensor, z, h, r, correction=correction)
                if next(due):
                    trace.snapshot(x.covariance, error=truth.minus(x.state).ravel())
    return where(path, chosen)


def start() -> Any:
    """Return the first estimate: at the origin, without bias."""
    pose = nav.lib.SE3State(np.eye(4), stamp=0.0, state_id="pose")
    bias = nav.lib.VectorState(np.zeros(3), stamp=0.0, state_id="bias")
    return nav.lib.CompositeState([pose, bias], stamp=0.0)


def twist(x: Any, u: Any) -> Array:
    """Return turn rate and velocity (6,) without the bias."""
    found = u.value.copy()
    found[:3] -= x.value[1].value
    return np.asarray(found)


def velocity(truth: Any, time_s: float) -> Any:
    """Return what gyroscope and odometer measure on a wavy circle, bias included."""
    value = np.array([0.2 * np.cos(time_s), 0.1 * np.sin(time_s), 0.5, 2.0, 0.0, 0.0])
    value[:3] += truth.value[1].value
    return nav.StampedValue(value)


def moved(truth: Any, u: Any, rng: np.random.Generator) -> Any:
    """Return the true state after a period, with process noise."""
    noise = np.sqrt(TWIST_NOISE) * rng.standard_normal(6)
    truth = BiasedVelocity().evaluate(truth, nav.StampedValue(u.value + noise), PERIOD_S)
    truth.value[1].value = truth.value[1].value + np.sqrt(
        BIAS_NOISE * PERIOD_S
    ) * rng.standard_normal(3)
    return truth


def model_of(sensor: str, k: int) -> tuple[Any, float]:
    """Return a sensor's model in step k, on the pose, and its sigma in m."""
    if sensor == "gps":
        model, sigma = nav.lib.GlobalPosition(SIGMA_GPS_M**2 * np.eye(3)), SIGMA_GPS_M
    else:
        r = SIGMA_LANDMARK_M**2 * np.eye(3)
        model, sigma = nav.lib.models.PointRelativePosition(LANDMARKS[k % 3], r), SIGMA_LANDMARK_M
    return nav.lib.models.CompositeMeasurementModel(model, "pose"), sigma
