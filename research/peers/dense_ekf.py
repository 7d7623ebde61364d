"""An EKF-SLAM in NumPy as it is mostly written, and our compressed EKF, on Victoria Park.

One array for the mean, one for the covariance; each measurement by itself: a loop over the
landmarks in reach for the nearest neighbour, then an update by an H as wide as the state. Models,
sigmas, gates and the rule for new landmarks are those of ours. Of two ways to write the algebra,
`whole` has it as in textbooks, F P F^T + Q and (I - K H) P with square matrices, cubic in the
landmarks, and is measured on the first minute alone; otherwise the prediction touches the vehicle's
rows alone, and P - K S K^T is one product.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.adapters.filter_loop import run_filter_loop
from comparisons.adapters.time_window import cut_log
from comparisons.adapters.timeline import Timeline, build_timeline
from comparisons.arrays import Array
from comparisons.checks.accuracy import assess_trajectory
from comparisons.config import EkfConfig
from comparisons.logs.log import Log
from comparisons.logs.odometry import SteeringOdometry
from comparisons.logs.readers import victoria_park
from ekf_reference.core.trace import Trace
from research.timing import ROOT, MissingError, TimedPair, here

DATA = ROOT.parent / "shared" / "data" / "victoria_park"
SQUARE_S, STRETCH_S, QUICK_S = 60.0, 240.0, 20.0
GATE, NEW_GATE, REACH_M = 13.82, 25.0, 15.0
CANDIDATES = {"measurements": 5, "age_s": 0.8, "spread_m": 0.5, "join_m": 1.0, "silence_s": 3.0}


@dataclass(eq=False)
class Candidate:
    """A tree that is no landmark yet: where it was seen (2,), and when first and last."""

    places: list[Array]
    first_s: float
    last_s: float

    @property
    def mean(self) -> Array:
        """(2,)."""
        return np.asarray(np.mean(self.places, axis=0))

    @property
    def reliable(self) -> bool:
        """Seen often, for long and at one place."""
        spread = np.mean(np.sum((np.array(self.places) - self.mean) ** 2, axis=1))
        return bool(
            len(self.places) >= CANDIDATES["measurements"]
            and self.last_s - self.first_s >= CANDIDATES["age_s"]
            and spread <= CANDIDATES["spread_m"] ** 2
        )


class DenseEkf:
    """Mean x, y, heading, then the landmarks; whole: square matrices in predict and update."""

    def __init__(self, log: Log, *, whole: bool) -> None:
        """Start at the log's prior. Its odometry is of a car."""
        assert isinstance(log.odometry, SteeringOdometry)
        self.vehicle, self.noise = log.odometry.vehicle, log.odometry.noise
        self.x, self.P, self.whole = log.prior.pose.copy(), log.prior.covariance.copy(), whole
        self.candidates: list[Candidate] = []

    def predict(self, control: Array, covariance: Array, dt: float) -> None:
        """Euler step of the car, seen from its laser."""
        encoder, steering = control
        a, b = self.vehicle.sensor_forward_m, self.vehicle.sensor_left_m
        length, offset = self.vehicle.wheelbase_m, self.vehicle.encoder_offset_m
        c, s, tan = math.cos(self.x[2]), math.sin(self.x[2]), math.tan(steering)
        slip = 1.0 - tan * offset / length
        v, sec2 = encoder / slip, 1.0 + tan**2
        by_steering = v / slip * sec2 * offset / length
        t1, t2 = a * s + b * c, a * c - b * s
        way = np.array([c - tan / length * t1, s + tan / length * t2, tan / length])
        turning = v / length * sec2 * np.array([-t1, t2, 1.0])
        b_u = dt * np.column_stack((way / slip, turning + by_steering * way))
        moved = dt * v * way
        f = np.eye(3)
        f[0, 2], f[1, 2] = -moved[1], moved[0]
        rate = self.noise.variance_rate_position, self.noise.variance_rate_heading
        q = b_u @ covariance @ b_u.T + np.diag((rate[0], rate[0], rate[1])) * dt
        self.x[:3] += moved
        if self.whole:
            n = len(self.x)
            f_all, q_all = np.eye(n), np.zeros((n, n))
            f_all[:3, :3], q_all[:3, :3] = f, q
            self.P = f_all @ self.P @ f_all.T + q_all
        else:
            self.P[:3, 3:] = f @ self.P[:3, 3:]
            self.P[3:, :3] = self.P[:3, 3:].T
            self.P[:3, :3] = symmetric(f @ self.P[:3, :3] @ f.T + q)

    def observe(self, z: Array, sigma: Array, time_s: float) -> None:
        """Fuse the measurements (m, 2) of a scan one by one."""
        silence = CANDIDATES["silence_s"]
        self.candidates = [one for one in self.candidates if time_s - one.last_s <= silence]
        for measured, deviation in zip(z, sigma, strict=True):
            r = np.diag(deviation**2)
            landmark, nis = self.nearest(measured, r)
            if nis <= GATE:
                self.update(measured, r, landmark)
            elif nis > NEW_GATE and self.confirmed(measured, time_s):
                self.add(measured, r)

    def expected(self, landmark: int) -> tuple[Array, Array]:
        """Range and bearing (2,) of a landmark, and the Jacobian (2, 5) by pose and landmark."""
        dx, dy = self.x[3 + 2 * landmark : 5 + 2 * landmark] - self.x[:2]
        q = dx**2 + dy**2
        d = math.sqrt(q)
        h = np.array(
            [[-dx / d, -dy / d, 0, dx / d, dy / d], [dy / q, -dx / q, -1, -dy / q, dx / q]]
        )
        return np.array([d, math.atan2(dy, dx) - self.x[2]]), h

    def nearest(self, z: Array, r: Array) -> tuple[int, float]:
        """The landmark of least normalised innovation squared, and this."""
        best, least = -1, math.inf
        away = np.linalg.norm(self.x[3:].reshape(-1, 2) - self.x[:2], axis=1)
        for landmark in np.flatnonzero(away < z[0] + REACH_M).tolist():
            expected, h = self.expected(landmark)
            which = [0, 1, 2, 3 + 2 * landmark, 4 + 2 * landmark]
            s = h @ self.P[np.ix_(which, which)] @ h.T + r
            nu = innovation(z, expected)
            nis = float(nu @ np.linalg.solve(s, nu))
            if nis < least:
                best, least = landmark, nis
        return best, least

    def update(self, z: Array, r: Array, landmark: int) -> None:
        """Kalman update by one measurement."""
        expected, part = self.expected(landmark)
        h = np.zeros((2, len(self.x)))
        h[:, :3], h[:, 3 + 2 * landmark : 5 + 2 * landmark] = part[:, :3], part[:, 3:]
        cross = self.P @ h.T
        s = h @ cross + r
        gain = cross @ np.linalg.inv(s)
        self.x += gain @ innovation(z, expected)
        if self.whole:
            self.P = (np.eye(len(self.x)) - gain @ h) @ self.P
        else:
            root = gain @ np.linalg.cholesky(s)
            self.P -= root @ root.T

    def place(self, z: Array) -> Array:
        """Where a measurement (2,) puts its tree."""
        at = self.x[2] + z[1]
        place: Array = self.x[:2] + z[0] * np.array([math.cos(at), math.sin(at)])
        return place

    def confirmed(self, z: Array, time_s: float) -> bool:
        """Whether a tree was seen often enough to become a landmark."""
        place = self.place(z)
        near = min(
            self.candidates, key=lambda one: float(np.linalg.norm(one.mean - place)), default=None
        )
        if near is None or np.linalg.norm(near.mean - place) > CANDIDATES["join_m"]:
            self.candidates.append(Candidate([place], time_s, time_s))
            return False
        near.places.append(place)
        near.last_s = time_s
        if near.reliable:
            self.candidates.remove(near)
            return True
        return False

    def add(self, z: Array, r: Array) -> None:
        """Append a landmark."""
        n, at = len(self.x), self.x[2] + z[1]
        c, s = math.cos(at), math.sin(at)
        g_x = np.array([[1.0, 0.0, -z[0] * s], [0.0, 1.0, z[0] * c]])
        g_z = np.array([[c, -z[0] * s], [s, z[0] * c]])
        grown = np.zeros((n + 2, n + 2))
        grown[:n, :n] = self.P
        grown[n:, :n] = g_x @ self.P[:3]
        grown[:n, n:] = grown[n:, :n].T
        grown[n:, n:] = symmetric(g_x @ self.P[:3, :3] @ g_x.T + g_z @ r @ g_z.T)
        self.x, self.P = np.concatenate((self.x, self.place(z))), grown


def symmetric(a: Array) -> Array:
    """Return the symmetric part; rounding makes the rest, which grows over 50,000 updates."""
    half: Array = 0.5 * (a + a.T)
    return half


def innovation(z: Array, expected: Array) -> Array:
    """Return z - h(x), the bearing wrapped."""
    nu = z - expected
    nu[1] = (nu[1] + math.pi) % (2.0 * math.pi) - math.pi
    return nu


def dense(log: Log, timeline: Timeline, *, whole: bool) -> tuple[Array, int]:
    """Poses (K, 3) of the dense filter, and how many landmarks it has."""
    ekf, seen = DenseEkf(log, whole=whole), log.measurements
    z = np.column_stack((seen.range_m, seen.bearing_rad))
    sigma = np.column_stack((seen.sigma_range_m, seen.sigma_bearing_rad))
    steps, first, done, poses = timeline.steps_until(), timeline.measurements_until(), 0, []
    for k, time_s in enumerate(timeline.epoch_time_s.tolist()):
        for i in range(done, int(steps[k])):
            duration = float(timeline.step_duration_s[i])
            ekf.predict(timeline.control[i], timeline.control_covariance[i], duration)
        done = int(steps[k])
        rows = slice(int(first[k]), int(first[k + 1]))
        ekf.observe(z[rows], sigma[rows], time_s)
        poses.append(ekf.x[:3].copy())
    return np.array(poses), (len(ekf.x) - 3) // 2


def compressed(log: Log, timeline: Timeline) -> tuple[Array, int]:
    """The same of our compressed EKF."""
    ekf = build_ekf(log, settle(EkfConfig(filter="compressed"), log), Trace())
    poses = np.array([ekf.read_pose().pose for _ in run_filter_loop(ekf, log, timeline)])
    return poses, ekf.state.landmark_count


def rows(*, quick: bool) -> list[TimedPair]:
    """Return the pairs. Raises MissingError without the public log."""
    if not victoria_park.recognises(DATA):
        raise MissingError(
            f"no {DATA.relative_to(ROOT.parent)} (Victoria Park's detections) beside the project"
        )
    log = victoria_park.read(DATA)
    square, stretch = (cut_log(log, None, QUICK_S if quick else s) for s in (SQUARE_S, STRETCH_S))
    pairs = [
        _pair("dense EKF, square matrices", square, whole=True, goal=None),
        _pair("dense EKF, a stretch", stretch, whole=False, goal=None),
    ]
    return pairs if quick else [*pairs, _pair("dense EKF", log, whole=False, goal=0.1, repeat=1)]


def _pair(
    name: str, log: Log, *, whole: bool, goal: float | None, repeat: int | None = None
) -> TimedPair:
    timeline = build_timeline(log)
    found: dict[str, tuple[Array, int]] = {}

    def side(who: str, call: Callable[[], tuple[Array, int]]) -> Callable[[], None]:
        return lambda: found.update({who: call()})

    def notes() -> list[str]:
        reported = []
        for who, (poses, landmarks) in found.items():
            accuracy = assess_trajectory(timeline.epoch_time_s, poses, log)
            assert accuracy is not None
            away = accuracy.gps_median_aligned_m
            reported.append(f"{who} {landmarks} landmarks, {away:.2f} m from GPS (median, aligned)")
        return ["; ".join(reported)]

    length = float(timeline.epoch_time_s[-1] - timeline.epoch_time_s[0])
    measurements = len(timeline.measurement_epoch)
    return TimedPair(
        name=f"{name}: compressed EKF",
        work=f"{measurements} detections in {length:.0f} s of Victoria Park",
        ours=here(side("ours", lambda: compressed(log, timeline))),
        theirs=here(side("dense", lambda: dense(log, timeline, whole=whole))),
        goal=goal,
        repeat=repeat,
        notes=notes,
    )
