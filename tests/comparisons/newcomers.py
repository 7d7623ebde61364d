"""Logs of a newcomer, and sound filters of other kinds than `research/trust/strangers.py` has."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from research.trust.strangers import Array, TextbookEkf, measured, wrapped

NANOSECOND = 1e-9


@dataclass(frozen=True)
class Course:
    """A drive. scan_every: in samples. apart: stamps jitter, scans lie between the samples.

    start_ns: its first stamp.
    """

    name: str
    rate_hz: float = 10.0
    scan_every: int = 5
    duration_s: float = 40.0
    hard: bool = False
    apart: bool = False
    start_ns: int = 0


def stamps_ns(course: Course, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the stamps of odometry and scans."""
    count = int(course.duration_s * course.rate_hz)
    period = 1e9 / course.rate_hz
    odometry = np.round(np.arange(count) * period).astype(np.int64)
    if course.apart:
        odometry[1:] += np.round(rng.uniform(-0.1, 0.1, count - 1) * period).astype(np.int64)
    scans = odometry[course.scan_every :: course.scan_every].copy()
    if course.apart:
        scans += np.round(rng.uniform(0.15, 0.75, len(scans)) * period).astype(np.int64)
        scans = scans[scans < odometry[-1]]
    return odometry + course.start_ns, scans + course.start_ns


def arc(pose: Array, u: Array, dt: float) -> Array:
    """Return the pose after an exact arc at speed and yaw rate u."""
    half: float = 0.5 * u[1] * dt
    chord = u[0] * dt * np.sinc(half / np.pi)
    ahead = pose[2] + half
    moved: Array = np.array([chord * np.cos(ahead), chord * np.sin(ahead), u[1] * dt])
    return moved + pose


def simulate(course: Course, seed: int, folder: Path) -> None:
    """Write a log folder."""
    rng = np.random.default_rng((seed, sum(map(ord, course.name))))
    odometry_ns, scans_ns = stamps_ns(course, rng)
    sigma = np.array([0.2, 0.08]) if course.hard else np.array([0.1, 0.02])
    noise = np.array([0.3, 0.15]) if course.hard else np.array([0.1, 0.02])
    landmarks = rng.uniform(-14.0, 14.0, (6 if course.hard else 16, 2))
    prior = np.diag([0.05, 0.05, 0.02]) ** 2
    rates = np.array([1e-6, 1e-6, 1e-8])
    pose = np.array([-8.0, -8.0, 0.3])
    start, goal = pose.copy(), 0
    pose = pose + rng.normal(size=3) * np.sqrt(np.diag(prior))
    goals = np.array([[8.0, -8.0], [8.0, 8.0], [-8.0, 8.0], [-8.0, -8.0]])
    controls, seen = list[Array](), []
    ends = np.append(odometry_ns[1:], odometry_ns[-1])
    for begin, end in zip(odometry_ns, ends, strict=True):
        if np.hypot(*(goals[goal] - pose[:2])) < 3.0:
            goal = (goal + 1) % 4
        turn = wrapped(np.arctan2(*(goals[goal] - pose[:2])[::-1]) - pose[2])
        limit = 1.0 if course.hard else 0.4
        u = np.array([1.5 + 0.5 * np.sin(0.1 * (len(controls) + 1)), np.clip(turn, -limit, limit)])
        controls.append(u + rng.normal(size=2) * sigma)
        for scan in scans_ns[(scans_ns >= begin) & (scans_ns < max(end, begin + 1))]:
            at = arc(pose, u, (scan - begin) * NANOSECOND)
            for label, point in enumerate(landmarks):
                z = measured(at, point) + rng.normal(size=2) * noise
                if 0.5 < z[0] < 15.0:
                    seen.append((scan, z[0], wrapped(z[1]), label + 1))
        dt = (end - begin) * NANOSECOND
        pose = arc(pose, u, dt) + rng.normal(size=3) * np.sqrt(dt * rates)
    folder.mkdir(parents=True)
    rows = [
        f"{stamp(t)},{v!r},{w!r}"
        for t, (v, w) in zip(odometry_ns, map(np.ndarray.tolist, controls), strict=True)
    ]
    head = "time_s,speed_mps,yaw_rate_radps"
    (folder / "odometry.csv").write_text("\n".join([head, *rows]) + "\n")
    head = "time_s,range_m,bearing_rad,sigma_range_m,sigma_bearing_rad,landmark,diameter_m"
    rows = [f"{stamp(t)},{r!s},{b!s},{noise[0]},{noise[1]},{n},nan" for t, r, b, n in seen]
    (folder / "measurements.csv").write_text("\n".join([head, *rows]) + "\n")
    (folder / "log.toml").write_text(
        f'version = 1\nname = "{course.name}"\n[prior]\ntime_s = {stamp(odometry_ns[0])}\n'
        f"pose = {start.tolist()}\ncovariance = {prior.tolist()}\n"
        f'[odometry]\nkind = "velocity"\n[odometry.noise]\nsigma_speed_mps = {sigma[0]}\n'
        f"sigma_turn = {sigma[1]}\nvariance_rate_position = {rates[0]}\n"
        f"variance_rate_heading = {rates[2]}\n"
    )


def stamp(time_ns: int) -> str:
    """Return a stamp as text, exact to the nanosecond."""
    return f"{time_ns // 1_000_000_000}.{time_ns % 1_000_000_000:09d}"


class ByRow(TextbookEkf):
    """Each measurement of a scan is linearised at the state after the one before."""

    def fuse(self, ks: Array) -> None:
        """Use one after the other."""
        for k in ks:
            super().fuse(np.array([k]))


class Unscented(TextbookEkf):
    """Sigma points of what a step or a scan depends on, in place of Jacobians."""

    kind = "other"

    alpha: ClassVar[float] = 1.0
    beta: ClassVar[float] = 0.0

    @classmethod
    def kappa(cls, n: int) -> float:
        """Return kappa for n entries."""
        return max(3.0 - n, 0.0)

    @classmethod
    def root(cls, cov: Array) -> Array:
        """Return a square root of a covariance."""
        lower: Array = np.linalg.cholesky(cov)
        return lower

    @classmethod
    def regression(cls, f: Any, mean: Array, cov: Array) -> tuple[Array, Array, Array]:
        """Return the mean of f, the matrix that fits it best, and what remains."""
        n = len(mean)
        scale = cls.alpha**2 * (n + cls.kappa(n))
        spread = np.sqrt(scale) * cls.root(cov).T
        points = np.vstack((mean, mean + spread, mean - spread))
        w = np.array([scale - n] + [0.5] * (2 * n)) / scale
        wc = w + np.eye(1, 2 * n + 1)[0] * (1.0 - cls.alpha**2 + cls.beta)
        first = f(mean)
        y = np.array([f(point) - first for point in points])
        y[:, 1::2] = y[:, 1::2] if len(first) == 3 else wrapped(y[:, 1::2])
        centre = w @ y
        cross = (wc[:, None] * (points - mean)).T @ (y - centre)
        a = np.linalg.solve(cov, cross).T
        rest = (wc[:, None] * (y - centre)).T @ (y - centre) - a @ cov @ a.T
        return first + centre, a, rest

    def predict(self, number: int, dt: float, end_s: float) -> None:
        """Sigma points of pose and control."""
        u, noise = self.driven(number), self.control_noise
        cov = np.zeros((5, 5))
        cov[:3, :3], cov[3:, 3:] = self.p[:3, :3], noise
        mean = np.append(self.x[:3], u)
        arrived, a, rest = self.regression(lambda s: self.motion(s[:3], s[3:], dt)[0], mean, cov)
        self.x[:3] = arrived
        self.carry(a[:, :3], self.process(a[:, 3:], noise, dt) + rest)

    def update(self, ks: Array) -> None:
        """Sigma points of the pose and the scan's landmarks."""
        rows = np.concatenate((self.v, *(self.index[self.log.label[k]] for k in ks)))

        def scan(s: Array) -> Array:
            points = s[3:].reshape(-1, 2)
            return np.concatenate([measured(s[:3], point) for point in points])

        z, a, rest = self.regression(scan, self.x[rows], self.p[np.ix_(rows, rows)])
        h = np.zeros((len(z), len(self.x)))
        h[:, rows] = a
        nu = self.log.z[ks].ravel() - z
        nu[1::2] = wrapped(nu[1::2])
        r = np.diag(self.log.sigma[ks].ravel() ** 2)
        self.correct(h, nu, r + rest)


class UnscentedHalf(Unscented):
    """Scaled sigma points: alpha 0.5, beta 2, kappa 0."""

    alpha, beta = 0.5, 2.0

    @classmethod
    def kappa(cls, n: int) -> float:
        """Return 0."""
        return 0.0


class UnscentedThird(Unscented):
    """Sigma points that are sqrt(3) sigma away, whatever n is (Julier 2000)."""

    @classmethod
    def kappa(cls, n: int) -> float:
        """Return 3 - n."""
        return 3.0 - n


class Cubature(UnscentedHalf):
    """Cubature points along the symmetric root (Arasaratnam and Haykin 2009)."""

    alpha, beta = 1.0, 0.0

    @classmethod
    def root(cls, cov: Array) -> Array:
        """Return the symmetric root."""
        values, axes = np.linalg.eigh(cov)
        symmetric: Array = (axes * np.sqrt(values)) @ axes.T
        return symmetric


class Arc(TextbookEkf):
    """An exact arc, with its derivatives."""

    def motion(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array, Array]:
        """Return the arc's end, F and B."""
        arrived, f, b = arc(pose, u, dt), np.eye(3), np.zeros((3, 2))
        d = arrived[:2] - pose[:2]
        f[:2, 2] = -d[1], d[0]
        half = 0.5 * u[1] * dt
        c, s = np.cos(pose[2] + half), np.sin(pose[2] + half)
        k = np.sinc(half / np.pi)
        slope = -half / 3.0 if abs(half) < 1e-4 else (np.cos(half) - k) / half
        b[:, 0] = dt * k * c, dt * k * s, 0.0
        across, along = 0.5 * dt * k, 0.5 * dt * slope
        b[:, 1] = u[0] * dt * (along * c - across * s), u[0] * dt * (along * s + across * c), dt
        return arrived, f, b


class Euler(TextbookEkf):
    """Steps of at most 10 ms along the heading at their start."""

    def motion(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array, Array]:
        """Chain the steps; the noise is the same in all of them."""
        count = int(np.ceil(dt / 0.01 - 1e-9))
        h, at, f, b = dt / count, pose, np.eye(3), np.zeros((3, 2))
        for _ in range(count):
            c, s = np.cos(at[2]), np.sin(at[2])
            step = np.eye(3)
            step[:2, 2] = -h * u[0] * s, h * u[0] * c
            f, b = step @ f, step @ b + h * np.array([[c, 0.0], [s, 0.0], [0.0, 1.0]])
            at = at + [h * u[0] * c, h * u[0] * s, h * u[1]]
        return at, f, b
