"""A small multi-state constraint Kalman filter in the plane (Mourikis and Roumeliotis 2007).

A vehicle with odometry and gyroscope sees points by their bearing, and has a position fix now and
then. State: pose (x m, y m, heading rad), the gyroscope's bias (rad/s), the odometer's scale error,
and clones of the pose at the last images. A point that has been seen in several images is
triangulated, and its error taken out of the measurement by projection onto the null space of its
Jacobian; the point never enters the state. All errors are additive: nothing is reset.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from pathlib import Path

import numpy as np

from comparisons.arrays import Array
from examples.audit import faults
from examples.audit.faults import Bug, Fault, Planted, Step, kalman_gain, where
from slamcheck import Recorder

MOVING = ("pose", "gyro bias", "scale")
BLOCKS = {"pose": 3, "gyro bias": 1, "scale": 1}
ALL = tuple(BLOCKS)
STEPS, PERIOD_S, IMAGE_EVERY, GPS_EVERY = 150, 0.2, 3, 20
SPEED_MPS, TURN_RATE_RADPS = 1.5, 0.15
CLONES, FEWEST, FARTHEST_M, WIDEST_RAD = 5, 4, 15.0, 1.2
SIGMA_BEARING_RAD, SIGMA_GPS_M = 4e-3, 0.3
PRIOR_SIGMAS = np.array([0.2, 0.2, 0.05, 0.01, 0.02])
NOISE_SIGMAS = np.array([0.02, 0.02, 0.004, 2e-4, 5e-4])
DIRECTIONS = dict(zip(("east", "north", "heading"), np.eye(3), strict=True))
"""A shift and a turn of everything, at the origin: points of unknown place cannot tell them."""


def without_clones(step: Step, at: list[slice]) -> Array:
    """F is not applied to the cross-covariance with the clones."""
    moving = sum(BLOCKS.values())
    after = step.after.copy()
    after[:moving, moving:] = step.before[:moving, moving:]
    after[moving:, :moving] = step.before[moving:, :moving]
    return after


FAULTS = {
    "lone-clone": Fault(
        "a clone is made without its cross-covariance",
        *("clone", 12, ("clone 12",), faults.isolated),
    ),
    "conditioned": Fault(
        "a clone is removed by conditioning on it",
        *("remove", 10, ("clone 10", *ALL), faults.conditioned),
    ),
    "wrong-removed": Fault(
        "the newest clone's rows are removed in place of the oldest's",
        *("remove", 20, tuple(f"clone {k}" for k in range(20, 25)), faults.last_removed),
    ),
    "cross-predicted": Fault(
        "F is not applied to the cross-covariance with the clones",
        *("predict", 60, ("pose",), without_clones),
    ),
    "block-stale": Fault(
        "the covariance of the gyroscope's bias is not updated",
        *("camera", 8, ("gyro bias",), faults.stale),
    ),
    "twice": Fault("P is updated twice", "camera", 20, ALL, faults.twice),
    "no-krk": Fault("Joseph's form without K R K'", "gps", 3, ALL, faults.without_noise_of_gain),
    "no-noise": Fault("Q is left out once", "predict", 90, ALL, faults.without_noise),
    "not-applied": Fault(
        "the scale is not corrected", "camera", 15, ("scale",), correction=faults.not_applied
    ),
    "noisy-camera": Fault(
        "the camera's R is too small by 6.25", "camera", 15, noise=2.5, lasting=True
    ),
}


class Msckf:
    """The filter. x: (n,) the estimate; P: its covariance; blocks: names and dimensions."""

    def __init__(self, x: Array, p: Array, bug: Bug) -> None:
        """Bug: what it gets wrong."""
        self.x, self.P, self.blocks, self.bug = x, p, bug.blocks, bug

    def at(self, name: str) -> slice:
        """Where a block stands."""
        names = list(self.blocks)
        start = sum(self.blocks[one] for one in names[: names.index(name)])
        return slice(start, start + self.blocks[name])

    def predict(self, turn_rate_radps: float) -> tuple[Array, Array]:
        """Move by odometry and gyroscope; return F and Q (5, 5) of the blocks that move."""
        moved, f = move(self.x[:5], turn_rate_radps)
        q = np.diag(NOISE_SIGMAS**2)
        whole, noise = np.eye(len(self.x)), np.zeros_like(self.P)
        whole[:5, :5], noise[:5, :5] = f, q
        self.x = np.concatenate([moved, self.x[5:]])
        after = whole @ self.P @ whole.T + noise
        self.P = self.bug.covariance("predict", Step(self.P, after, whole, noise))
        return f, q

    def clone(self, name: str) -> None:
        """Append a copy of the pose."""
        n = len(self.x)
        copies = np.vstack([np.eye(n), np.eye(3, n)])
        self.x = copies @ self.x
        self.blocks[name] = 3
        step = Step(self.P, copies @ self.P @ copies.T, copies, np.zeros((n + 3, n + 3)))
        self.P = self.bug.covariance("clone", step)

    def remove(self, name: str) -> None:
        """Marginalise a block out."""
        kept = np.delete(np.eye(len(self.x)), self.at(name), axis=0)
        self.x = kept @ self.x
        del self.blocks[name]
        step = Step(self.P, kept @ self.P @ kept.T, kept, np.zeros((len(kept), len(kept))))
        self.P = self.bug.covariance("remove", step)

    def update(self, sensor: str, residual: Array, h: Array, r: Array) -> tuple[Array, Array]:
        """Update by H (m, n), with Joseph's form; return gain and correction."""
        gain = kalman_gain(self.P, h, r)
        left = np.eye(len(self.x)) - gain @ h
        after = left @ self.P @ left.T + gain @ r @ gain.T
        step = Step(self.P, after, h, r, gain)
        gain, correction, self.P = self.bug.update(sensor, step, residual)
        self.x = self.x + correction
        return gain, correction

    def constraint(self, tracks: list[dict[str, float]]) -> tuple[Array, Array] | None:
        """Return residual (m,) and H (m, n) of points' bearings by clone, without the points.

        None where no point can be triangulated.
        """
        rows = [found for track in tracks if (found := self._of_point(track)) is not None]
        if not rows:
            return None
        residual = np.concatenate([r for r, _ in rows])
        h = np.concatenate([h for _, h in rows])
        if len(h) > len(self.x):
            q, h = np.linalg.qr(h)
            residual = q.T @ residual
        return residual, h

    def _of_point(self, track: dict[str, float]) -> tuple[Array, Array] | None:
        """One point's residual and H, projected onto the left null space of its Jacobian."""
        poses = np.array([self.x[self.at(name)] for name in track])
        bearings = np.array(list(track.values()))
        point = triangulated(poses, bearings)
        if point is None:
            return None
        expected, by_pose, by_point = bearings_of(poses, point)
        h = np.zeros((len(track), len(self.x)))
        for row, name in enumerate(track):
            h[row, self.at(name)] = by_pose[row]
        null = np.linalg.qr(by_point, mode="complete")[0][:, 2:]
        return null.T @ wrapped(bearings - expected), null.T @ h


class Run:
    """A drive that is filtered and recorded as it goes."""

    def __init__(self, trace: Recorder, seed: int, fault: Fault | None, snapshots: int) -> None:
        """Start at the origin."""
        self.trace, self.world = trace, World(np.random.default_rng(seed))
        self.bug = Bug(fault, dict(BLOCKS))
        self.ekf = Msckf(np.zeros(5), np.diag(PRIOR_SIGMAS**2), self.bug)
        self.tracks: defaultdict[int, dict[str, float]] = defaultdict(dict)
        self.due = itertools.cycle([False] * (snapshots - 1) + [True])
        trace.prior(BLOCKS, self.ekf.P)
        trace.directions(DIRECTIONS, blind=["camera"], blocks=["pose"])

    def move(self) -> None:
        """Predict."""
        f, q = self.ekf.predict(self.world.move())
        self.trace.predict(f, q, MOVING)
        self._snapshot()

    def fix(self) -> None:
        """Update by a position."""
        noise = self.bug.noise("gps", SIGMA_GPS_M, self.world.rng.standard_normal(2))
        residual = self.world.truth[:2] + noise - self.ekf.x[:2]
        self._update("gps", residual, np.eye(2, len(self.ekf.x)), SIGMA_GPS_M)

    def image(self, name: str) -> None:
        """Clone the pose, update by points whose track is complete, remove the oldest clone."""
        bearings = self.world.image(name, self.bug)
        self.ekf.clone(name)
        self.trace.clone("pose", name)
        self._snapshot()
        for point, bearing in bearings.items():
            self.tracks[point][name] = bearing
        complete = [
            p for p, track in self.tracks.items() if name not in track or len(track) == CLONES
        ]
        tracks = [self.tracks.pop(point) for point in complete]
        constraint = self.ekf.constraint([track for track in tracks if len(track) >= FEWEST])
        if constraint is not None:
            self._update("camera", *constraint, SIGMA_BEARING_RAD)
        if len(self.world.clones) == CLONES:
            self._remove(next(iter(self.world.clones)))

    def _update(self, sensor: str, residual: Array, h: Array, sigma: float) -> None:
        r = sigma**2 * np.eye(len(residual))
        gain, correction = self.ekf.update(sensor, residual, h, r)
        self.trace.update(sensor, residual, h, r, correction=correction, gain=gain)
        self._snapshot()

    def _remove(self, oldest: str) -> None:
        for track in self.tracks.values():
            track.pop(oldest, None)
        del self.world.clones[oldest]
        self.ekf.remove(oldest)
        self.trace.remove(oldest)
        self._snapshot()

    def _snapshot(self) -> None:
        if next(self.due):
            truth = np.concatenate([self.world.truth, *self.world.clones.values()])
            self.trace.snapshot(self.ekf.P, mean=self.ekf.x, error=truth - self.ekf.x)


def record(path: Path, seed: int, fault: str | None = None, snapshots: int = 1) -> Planted | None:
    """Simulate, filter and record into a new file. fault: one of FAULTS.

    snapshots: one is taken after every so many events.
    """
    chosen = None if fault is None else FAULTS[fault]
    with Recorder(path) as trace:
        run = Run(trace, seed, chosen, snapshots)
        for k in range(STEPS):
            trace.at(PERIOD_S * k)
            run.move()
            if k % GPS_EVERY == 0:
                run.fix()
            if k % IMAGE_EVERY == 0:
                run.image(f"clone {k // IMAGE_EVERY}")
    return where(path, chosen)


class World:
    """The truth: state (5,), clones by name, points (n, 2)."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Points lie in and around the circle that the vehicle drives, not on it."""
        self.rng, self.clones = rng, dict[str, Array]()
        self.truth = PRIOR_SIGMAS * rng.standard_normal(5)
        radius_m = SPEED_MPS / TURN_RATE_RADPS
        points = np.array([0.0, radius_m]) + rng.uniform(-20.0, 20.0, (400, 2))
        off_m = np.linalg.norm(points - [0.0, radius_m], axis=1) - radius_m
        self.points = points[np.abs(off_m) > 3.0][:80]

    def move(self) -> float:
        """Move; return what the gyroscope measures."""
        turn_rate_radps = TURN_RATE_RADPS + self.truth[3]
        self.truth = move(self.truth, turn_rate_radps)[0]
        self.truth = self.truth + NOISE_SIGMAS * self.rng.standard_normal(5)
        return float(turn_rate_radps)

    def image(self, name: str, bug: Bug) -> dict[int, float]:
        """Return bearings of the points in sight, by point."""
        self.clones[name] = self.truth[:3]
        away = self.points - self.truth[:2]
        bearings = wrapped(np.arctan2(away[:, 1], away[:, 0]) - self.truth[2])
        near = np.linalg.norm(away, axis=1) < FARTHEST_M
        noise = bug.noise("camera", SIGMA_BEARING_RAD, self.rng.standard_normal(len(away)))
        seen = np.flatnonzero(near & (np.abs(bearings) < WIDEST_RAD))
        return {int(point): float(bearings[point] + noise[point]) for point in seen}


def move(x: Array, turn_rate_radps: float) -> tuple[Array, Array]:
    """Return the moving state (5,) after a period, and its derivative (5, 5)."""
    speed, turn = SPEED_MPS * (1.0 + x[4]), PERIOD_S * (turn_rate_radps - x[3])
    heading = x[2] + 0.5 * turn
    ahead = np.array([np.cos(heading), np.sin(heading)])
    aside = np.array([-ahead[1], ahead[0]])
    f = np.eye(5)
    f[:2, 2] = PERIOD_S * speed * aside
    f[:2, 3] = -0.5 * PERIOD_S**2 * speed * aside
    f[:2, 4] = PERIOD_S * SPEED_MPS * ahead
    f[2, 3] = -PERIOD_S
    return np.concatenate([x[:2] + PERIOD_S * speed * ahead, [x[2] + turn], x[3:]]), f


def bearings_of(poses: Array, point: Array) -> tuple[Array, Array, Array]:
    """Return a point's bearings from poses (k, 3), by pose (k, 3) and by the point (k, 2)."""
    away = point - poses[:, :2]
    by_point = np.column_stack([-away[:, 1], away[:, 0]]) / (away**2).sum(axis=1)[:, None]
    by_pose = np.column_stack([-by_point, -np.ones(len(poses))])
    return np.arctan2(away[:, 1], away[:, 0]) - poses[:, 2], by_pose, by_point


def triangulated(poses: Array, bearings: Array) -> Array | None:
    """Return the point (2,) that bearings from poses (k, 3) meet in, by least squares.

    None where it is uncertain by more than a tenth of its distance, or lies too near or too far.
    """
    directions = bearings + poses[:, 2]
    across = np.column_stack([-np.sin(directions), np.cos(directions)])
    point = np.linalg.lstsq(across, (across * poses[:, :2]).sum(axis=1), rcond=None)[0]
    for _ in range(5):
        expected, _, by_point = bearings_of(poses, point)
        away_m = np.linalg.norm(point - poses[:, :2], axis=1)
        sharp = np.linalg.svd(by_point, compute_uv=False)[1] * away_m.min()
        if not 1.5 < away_m.min() < 2.0 * FARTHEST_M or sharp < 10.0 * SIGMA_BEARING_RAD:
            return None
        point = point + np.linalg.lstsq(by_point, wrapped(bearings - expected), rcond=None)[0]
    return np.asarray(point)


def wrapped(angle: Array) -> Array:
    """Return angles in [-pi, pi)."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
