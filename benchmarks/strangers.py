"""Logs and EKF-SLAM filters of a stranger: numpy, docs/formats.md and slamcheck.Recorder, no more.

A drive is simulated and written as a log folder. A filter reads the folder and writes an estimate
folder. `Ekf` is the textbook's filter: one update by all known landmarks of a scan, linearised at
the predicted state, then the new ones are initialised, then positions are fused. Every other filter
replaces a method of it.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from slamcheck import Recorder

Array = NDArray[Any]
WHEELBASE_M = 2.0
NANOSECOND = 1e-9


def wrapped(angle: Any) -> Any:
    """Return angles in (-pi, pi]."""
    return np.pi - (np.pi - angle) % (2.0 * np.pi)


def rotation(angle: float) -> Array:
    """Return the matrix that turns by an angle."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


@dataclass(frozen=True)
class Course:
    """A drive. stamps: `grid`, `nanosecond`, `jitter`, `apart`, `epoch`; scan_every: in samples."""

    name: str
    rate_hz: float = 10.0
    scan_every: int = 5
    duration_s: float = 40.0
    hard: bool = False
    stamps: str = "grid"
    steering: bool = False


def stamps_ns(course: Course, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the stamps of odometry and scans, and which sample holds at each scan is theirs."""
    count = int(course.duration_s * course.rate_hz)
    period = 1e9 / course.rate_hz
    odometry = np.round(np.arange(count) * period).astype(np.int64)
    if course.stamps == "grid":
        odometry = np.round(odometry / 1e5).astype(np.int64) * 100_000
    if course.stamps in ("jitter", "apart", "epoch"):
        odometry[1:] += np.round(rng.uniform(-0.1, 0.1, count - 1) * period).astype(np.int64)
    scans = odometry[course.scan_every :: course.scan_every].copy()
    if course.stamps in ("apart", "epoch"):
        scans += np.round(rng.uniform(0.15, 0.75, len(scans)) * period).astype(np.int64)
        scans = scans[scans < odometry[-1]]
    start = 1_700_000_000_123_456_789 if course.stamps == "epoch" else 0
    return odometry + start, scans + start


def arc(pose: Array, u: Array, dt: float) -> Array:
    """Return the pose after an exact arc at speed and yaw rate u."""
    half: float = 0.5 * u[1] * dt
    chord = u[0] * dt * np.sinc(half / np.pi)
    ahead = pose[2] + half
    moved: Array = np.array([chord * np.cos(ahead), chord * np.sin(ahead), u[1] * dt])
    return moved + pose


def simulate(course: Course, seed: int, folder: Path) -> tuple[Array, Array]:
    """Write a log folder. Returns true poses at the odometry's stamps, and the true landmarks."""
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
    path, controls, seen = [], [], []
    ends = np.append(odometry_ns[1:], odometry_ns[-1])
    for begin, end in zip(odometry_ns, ends, strict=True):
        path.append(pose)
        if np.hypot(*(goals[goal] - pose[:2])) < 3.0:
            goal = (goal + 1) % 4
        turn = wrapped(np.arctan2(*(goals[goal] - pose[:2])[::-1]) - pose[2])
        limit = 1.0 if course.hard else 0.4
        u = np.array([1.5 + 0.5 * np.sin(0.1 * len(path)), np.clip(turn, -limit, limit)])
        raw = u.copy()
        if course.steering:
            raw[1] = np.arctan(u[1] * WHEELBASE_M / u[0])
        controls.append(raw + rng.normal(size=2) * sigma)
        for scan in scans_ns[(scans_ns >= begin) & (scans_ns < max(end, begin + 1))]:
            at = arc(pose, u, (scan - begin) * NANOSECOND)
            for label, point in enumerate(landmarks):
                z = measured(at, point) + rng.normal(size=2) * noise
                if 0.5 < z[0] < 15.0:
                    seen.append((scan, z[0], wrapped(z[1]), label + 1))
        dt = (end - begin) * NANOSECOND
        pose = arc(pose, u, dt) + rng.normal(size=3) * np.sqrt(dt * rates)
    folder.mkdir(parents=True)
    kind, turn_name = ("steering", "steering_rad") if course.steering else ("velocity", "")
    rows = [
        f"{stamp(t)},{v!r},{w!r}"
        for t, (v, w) in zip(odometry_ns, map(np.ndarray.tolist, controls), strict=True)
    ]
    head = f"time_s,speed_mps,{turn_name or 'yaw_rate_radps'}"
    (folder / "odometry.csv").write_text("\n".join([head, *rows]) + "\n")
    head = "time_s,range_m,bearing_rad,sigma_range_m,sigma_bearing_rad,landmark,diameter_m"
    rows = [f"{stamp(t)},{r!s},{b!s},{noise[0]},{noise[1]},{n},nan" for t, r, b, n in seen]
    (folder / "measurements.csv").write_text("\n".join([head, *rows]) + "\n")
    vehicle = f"[odometry.vehicle]\nwheelbase_m = {WHEELBASE_M}\nencoder_offset_m = 0.0\n"
    vehicle += "sensor_forward_m = 0.0\nsensor_left_m = 0.0\n"
    (folder / "log.toml").write_text(
        f'version = 1\nname = "{course.name}"\n[prior]\ntime_s = {stamp(odometry_ns[0])}\n'
        f"pose = {start.tolist()}\ncovariance = {prior.tolist()}\n"
        f'[odometry]\nkind = "{kind}"\n[odometry.noise]\nsigma_speed_mps = {sigma[0]}\n'
        f"sigma_turn = {sigma[1]}\nvariance_rate_position = {rates[0]}\n"
        f"variance_rate_heading = {rates[2]}\n" + vehicle * course.steering
    )
    return np.array(path), landmarks


def stamp(time_ns: int) -> str:
    """Return a stamp as text, exact to the nanosecond."""
    return f"{time_ns // 1_000_000_000}.{time_ns % 1_000_000_000:09d}"


def measured(pose: Array, point: Array) -> Array:
    """Return range and bearing of a point."""
    dx, dy = point - pose[:2]
    return np.array([np.hypot(dx, dy), wrapped(np.arctan2(dy, dx) - pose[2])])


@dataclass(frozen=True)
class Log:
    """A log folder's content. z: range, bearing; sigma: theirs; meta: log.toml; row: in the file.

    used_s: when each measurement is used, which is when it was made. fixed_s: times of positions;
    fix, fix_noise: these and their R.
    """

    meta: dict[str, Any]
    odometry_s: Array
    u: Array
    used_s: Array
    z: Array
    sigma: Array
    label: Array
    row: Array
    fixed_s: Array
    fix: Array
    fix_noise: Array


def read_log(folder: Path) -> Log:
    """Read a folder with speeds and yaw rates, or speeds and steering angles of a plain bicycle."""

    def table(name: str) -> dict[str, Array]:
        with (folder / name).open() as file:
            head, *rows = csv.reader(file)
        return dict(zip(head, np.array(rows, dtype=float).T, strict=True))

    odometry, seen = table("odometry.csv"), table("measurements.csv")
    names = ("time_s", "x_m", "y_m", "var_x_m2", "cov_xy_m2", "var_y_m2")
    fixes = {name: np.zeros(0) for name in names}
    if (folder / "positions.csv").exists():
        fixes = table("positions.csv")
    noise = np.array([fixes[name] for name in (names[3], names[4], names[4], names[5])])
    meta = tomllib.loads((folder / "log.toml").read_text())
    turn = "steering_rad" if meta["odometry"]["kind"] == "steering" else "yaw_rate_radps"
    return Log(
        meta=meta,
        odometry_s=odometry["time_s"],
        u=np.column_stack((odometry["speed_mps"], odometry[turn])),
        used_s=seen["time_s"],
        z=np.column_stack((seen["range_m"], seen["bearing_rad"])),
        sigma=np.column_stack((seen["sigma_range_m"], seen["sigma_bearing_rad"])),
        label=seen["landmark"].astype(int),
        row=np.arange(len(seen["time_s"])),
        fixed_s=fixes["time_s"],
        fix=np.column_stack((fixes["x_m"], fixes["y_m"])),
        fix_noise=noise.T.reshape(-1, 2, 2),
    )


class Ekf:
    """The textbook's filter. x: pose and landmarks, p: covariance, rows of both by v and index.

    departed, arrived, lasted_s: of the last step. now: the measurement at hand. began: where each
    landmark did, by its label.
    """

    traced: ClassVar[bool] = True
    kind: ClassVar[str] = "ekf"
    dtype: ClassVar[type] = np.float64

    def __init__(self, log: Log) -> None:
        """Start at the log's prior."""
        self.log = log = self.fed(log)
        prior, noise = log.meta["prior"], log.meta["odometry"]["noise"]
        self.x: Array = np.array(prior["pose"], self.dtype)
        self.p: Array = self.prior(np.array(prior["covariance"])).astype(self.dtype)
        turned = np.diag([noise["sigma_speed_mps"], noise["sigma_turn"]]) ** 2
        self.control_noise = self.of_control(turned)
        self.rates = np.diag(
            [noise["variance_rate_position"]] * 2 + [noise["variance_rate_heading"]]
        )
        self.v, self.index = np.arange(3), dict[int, Array]()
        self.departed = self.arrived = self.x[:3].copy()
        self.lasted_s, self.now, self.began = 1.0, 0, dict[int, Array]()
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []
        self.path: list[tuple[float, Array, Array]] = []
        self.note("prior", {"pose": 3}, self.p.copy(), point=self.x.copy())

    def fed(self, log: Log) -> Log:
        """Return the log that the filter works on."""
        return log

    def prior(self, covariance: Array) -> Array:
        """Return the covariance at the start."""
        return covariance

    def of_control(self, covariance: Array) -> Array:
        """Return the covariance of speed and turn."""
        return covariance

    def cast(self, *matrices: Array) -> Iterator[Array]:
        """Yield matrices as the filter keeps numbers."""
        return (one.astype(self.dtype) for one in matrices)

    def note(self, call: str, *matrices: Any, **more: Any) -> None:
        """Keep what a recorder will be told: what was linearised where."""
        self.calls.append((call, matrices, more))

    # Prediction

    def motion(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array, Array]:
        """Return the pose after dt by the heading at the step's middle, with F and B."""
        c, s = np.cos(pose[2] + 0.5 * dt * u[1]), np.sin(pose[2] + 0.5 * dt * u[1])
        f, d = np.eye(3), dt * u[0]
        f[:2, 2] = -d * s, d * c
        b = dt * np.array([[c, -0.5 * d * s], [s, 0.5 * d * c], [0.0, 1.0]])
        return pose + [d * c, d * s, dt * u[1]], f, b

    def driven(self, number: int) -> Array:
        """Return speed and turn of a sample."""
        u: Array = self.log.u[number]
        return u

    def control(self, number: int) -> tuple[Array, Array]:
        """Return speed and yaw rate of a sample, with their covariance."""
        u, noise = self.driven(number), self.control_noise
        if self.log.meta["odometry"]["kind"] == "steering":
            base = self.log.meta["odometry"]["vehicle"]["wheelbase_m"]
            j = np.array([[1.0, 0.0], [np.tan(u[1]), u[0] / np.cos(u[1]) ** 2]])
            j[1] /= base
            return np.array([u[0], u[0] * np.tan(u[1]) / base]), j @ noise @ j.T
        return u, noise

    def process(self, b: Array, noise: Array, dt: float) -> Array:
        """Return Q of a step."""
        return b @ noise @ b.T + dt * self.rates

    def carry(self, f: Array, q: Array) -> None:
        """Move the covariance."""
        self.p[self.v] = f @ self.p[self.v]
        self.p[:, self.v] = self.p[:, self.v] @ f.T
        self.p[np.ix_(self.v, self.v)] += q

    def predict(self, number: int, dt: float, end_s: float) -> None:
        """Drive by a sample of the odometry for dt."""
        before = self.x[self.v]
        u, noise = self.control(number)
        arrived, f, b = self.motion(before, u, dt)
        self.departed, self.arrived, self.lasted_s = before, arrived, dt
        f, q = self.cast(f, self.process(b, noise, dt))
        self.x[self.v] = arrived
        self.carry(f, q)
        self.note("at", end_s)
        self.note("predict", f, q, ["pose"], point=before, after=self.x[self.v])

    # Measurements

    def expected(self, pose: Array, point: Array) -> tuple[Array, Array, Array]:
        """Return range and bearing, with H of the pose and H of the landmark."""
        (dx, dy), d = point - pose[:2], np.hypot(*(point - pose[:2]))
        hl = np.array([[dx / d, dy / d], [-dy / d**2, dx / d**2]])
        return measured(pose, point), np.column_stack((-hl, [0.0, -1.0])), hl

    def residual(self, z: Array, expected: Array) -> Array:
        """Return the innovation, its bearing wrapped."""
        nu = z - expected
        return np.array([nu[0], wrapped(nu[1])])

    def seen(self, k: int) -> Array:
        """Return range and bearing of a measurement."""
        z: Array = self.log.z[k]
        return z

    def first_seen(self, k: int) -> Array:
        """Return range and bearing of a measurement that initialises a landmark."""
        return self.seen(k)

    def noise(self, k: int) -> Array:
        """Return R of a measurement."""
        return np.diag(self.log.sigma[k] ** 2)

    def first_noise(self, k: int) -> Array:
        """Return R of a measurement that initialises a landmark."""
        return self.noise(k)

    def linearised(self, ks: Array, x: Array) -> tuple[Array, Array, Array]:
        """Return H, innovation and R of measurements at a state."""
        h, nu = np.zeros((2 * len(ks), len(x))), np.zeros(2 * len(ks))
        r = np.zeros((2 * len(ks),) * 2)
        for at, k in enumerate(ks):
            rows, index = slice(2 * at, 2 * at + 2), self.index[self.log.label[k]]
            self.now = k
            expected, hv, hl = self.expected(x[self.v], x[index])
            h[rows, self.v], h[rows, index] = hv, hl
            nu[rows], r[rows, rows] = self.residual(self.seen(k), expected), self.noise(k)
        return h, nu, r

    def note_update(self, ks: Array, x: Array, h: Array, nu: Array, r: Array) -> None:
        """Keep what was linearised at a state."""
        labels = dict.fromkeys(self.log.label[ks].tolist())
        rows = np.concatenate((self.v, *(self.index[label] for label in labels)))
        blocks = ["pose", *(f"landmark {label}" for label in labels)]
        beside = {"point": x[rows], "numbers": self.log.row[ks]}
        self.note("update", "landmarks", nu, h[:, rows], r, blocks, **beside)

    def update(self, ks: Array) -> None:
        """Update by measurements of known landmarks, at once."""
        h, nu, r = self.cast(*self.linearised(ks, self.x))
        self.note_update(ks, self.x, h, nu, r)
        self.correct(h, nu, r)

    def gain(self, h: Array, r: Array) -> Array:
        """Return K."""
        return np.linalg.solve(h @ self.p @ h.T + r, h @ self.p).T

    def correct(self, h: Array, nu: Array, r: Array) -> None:
        """Use x + K nu and P - K H P, symmetrised."""
        gain = self.gain(h, r)
        self.x = self.x + gain @ nu
        self.p = self.reduced(gain, h, r)
        self.p = 0.5 * (self.p + self.p.T)

    def reduced(self, gain: Array, h: Array, r: Array) -> Array:
        """Return the covariance after an update."""
        reduced: Array = self.p - gain @ h @ self.p
        return reduced

    def place(self, pose: Array, z: Array) -> tuple[Array, Array, Array]:
        """Return where a new landmark lies, with G_x and G_z."""
        c, s = np.cos(pose[2] + z[1]), np.sin(pose[2] + z[1])
        gx = np.array([[1.0, 0.0, -z[0] * s], [0.0, 1.0, z[0] * c]])
        return pose[:2] + z[0] * np.array([c, s]), gx, np.array([[c, -z[0] * s], [s, z[0] * c]])

    def initialise(self, k: int) -> None:
        """Append a landmark."""
        n, pose = len(self.x), self.x[self.v]
        parts = *self.place(pose, self.first_seen(k)), self.first_noise(k)
        point, gx, gz, r = self.cast(*parts)
        g: Array = np.vstack((np.eye(n), np.zeros((2, n)))).astype(self.dtype)
        g[n:, self.v] = gx
        label = int(self.log.label[k])
        self.began[label] = point
        beside = {"point": pose, "after": point, "numbers": self.log.row[k]}
        self.note("augment", f"landmark {label}", gx, gz, r, ["pose"], **beside)
        self.x, self.p = np.append(self.x, point).astype(self.dtype), g @ self.p @ g.T
        self.p[n:, n:] += gz @ r @ gz.T
        self.index[label] = np.array([n, n + 1])

    def fuse(self, ks: Array) -> None:
        """Use a scan: landmarks that are known first, then the new ones."""
        known = np.array([self.log.label[k] in self.index for k in ks])
        if known.any():
            self.update(ks[known])
        for k in ks[~known]:
            self.initialise(k)

    def chosen(self, ks: Array) -> Array:
        """Return the measurements of a scan, as they are used."""
        return ks

    # Positions

    def position(self, g: int) -> tuple[Array, Array]:
        """Return a position and its R."""
        return self.log.fix[g], self.log.fix_noise[g]

    def arm(self, pose: Array) -> Array:
        """Return the way from the vehicle to the antenna."""
        lever: Array = rotation(pose[2]) @ self.log.meta["positions"]["antenna_m"]
        return lever

    def fix(self, g: int) -> None:
        """Update by a position."""
        pose, (place, r) = self.x[self.v], self.position(g)
        arm, h = self.arm(pose), np.zeros((2, len(self.x)))
        h[:, self.v] = np.array([[1.0, 0.0, -arm[1]], [0.0, 1.0, arm[0]]])
        h, nu, r = self.cast(h, place - pose[:2] - arm, r)
        beside = {"point": pose, "numbers": g}
        self.note("update", "positions", nu, h[:, self.v], r, ["pose"], **beside)
        self.correct(h, nu, r)

    # Run and output

    def pose(self) -> tuple[Array, Array]:
        """Return pose and covariance of the additive error in the log's frame."""
        return self.x[self.v], self.p[np.ix_(self.v, self.v)]

    def joint(self) -> tuple[Array, Array]:
        """Return pose and landmarks in the order of `index`, and their covariance."""
        order = np.concatenate((self.v, *self.index.values())).astype(int)
        return self.x[order], self.p[np.ix_(order, order)]

    def instants(self) -> Array:
        """Return the times to predict to."""
        return np.unique(np.concatenate((self.log.odometry_s, self.log.used_s, self.log.fixed_s)))

    def keeps(self, scan: bool) -> bool:
        """Return whether a pose is put out at an instant, with measurements or without."""
        return True

    def run(self) -> Ekf:
        """Filter the whole log."""
        log, now = self.log, self.log.meta["prior"]["time_s"]
        times = self.instants()
        for t in times:
            sample = np.searchsorted(log.odometry_s, now, side="right") - 1
            if t > now:
                self.predict(int(sample), t - now, t)
            now = t
            ks = self.chosen(np.flatnonzero(log.used_s == t))
            if len(ks):
                self.fuse(ks)
            for g in np.flatnonzero(log.fixed_s == t):
                self.fix(int(g))
            if t == times[-1] or self.keeps(len(ks) > 0):
                self.path.append((t, *map(np.array, self.pose())))
        return self

    def tum(self, pose: Array) -> list[float]:
        """Return a pose as a line of the trajectory."""
        return [*pose[:2], 0.0, 0.0, 0.0, np.sin(0.5 * pose[2]), np.cos(0.5 * pose[2])]

    def write(self, folder: Path, traced: bool) -> None:
        """Write an estimate folder."""
        folder.mkdir(parents=True)
        rows = [[t, *self.tum(pose)] for t, pose, _ in self.path]
        np.savetxt(folder / "trajectory.tum", rows, ["%.9f"] + ["%.17g"] * 7)
        x, p = self.joint()
        places = zip(self.index, x[3::2].tolist(), x[4::2].tolist(), strict=True)
        lines = [f"{label},{px!r},{py!r}" for label, px, py in places]
        (folder / "landmarks.csv").write_text("\n".join(["id,x_m,y_m", *lines]) + "\n")
        spread = np.array([p for _, _, p in self.path])
        np.savez(folder / "covariances.npz", pose=spread, last_pose_and_landmarks=p)
        text = f'version = 1\ninformation = "filtered"\nestimator = "{self.kind}"\n'
        (folder / "estimate.toml").write_text(text)
        if traced:
            with Recorder(folder / "filter.trace") as record:
                for call, matrices, more in self.calls:
                    getattr(record, call)(*matrices, **more)


# Sound filters


class Joseph(Ekf):
    """(I - K H) P (I - K H)^T + K R K^T."""

    def reduced(self, gain: Array, h: Array, r: Array) -> Array:
        """Return the covariance after an update."""
        keep = np.eye(len(self.x)) - gain @ h
        reduced: Array = keep @ self.p @ keep.T + gain @ r @ gain.T
        return reduced


class Information(Ekf):
    """The update adds information."""

    def correct(self, h: Array, nu: Array, r: Array) -> None:
        """P^-1 + H^T R^-1 H."""
        weighed = h.T @ np.linalg.inv(r)
        self.p = np.linalg.inv(np.linalg.inv(self.p) + weighed @ h)
        self.p = 0.5 * (self.p + self.p.T)
        self.x = self.x + self.p @ weighed @ nu


class SquareRoot(Ekf):
    """The update triangularises the roots of R and P."""

    def correct(self, h: Array, nu: Array, r: Array) -> None:
        """By QR of ((root R, H S), (0, S))."""
        m, root = len(nu), np.linalg.cholesky(self.p)
        below = np.zeros((len(root), m))
        whole = np.block([[np.linalg.cholesky(r), h @ root], [below, root]])
        lower = np.transpose(np.linalg.qr(whole.T, mode="r"))
        self.x = self.x + lower[m:, :m] @ np.linalg.solve(lower[:m, :m], nu)
        self.p = lower[m:, m:] @ lower[m:, m:].T


class Single(Ekf):
    """State, covariance and update are in single precision."""

    dtype = np.float32


class ByRow(Ekf):
    """Each measurement of a scan is linearised at the state after the one before."""

    def order(self, ks: Array) -> Array:
        """Return the measurements in the order of use."""
        return ks

    def fuse(self, ks: Array) -> None:
        """Use one after the other."""
        for k in self.order(ks):
            super().fuse(np.array([k]))


class ByLabel(ByRow):
    """In the order of labels, falling."""

    def order(self, ks: Array) -> Array:
        """By label."""
        return ks[np.argsort(-self.log.label[ks])]


class Backward(ByRow):
    """In the order of rows, the last first."""

    def order(self, ks: Array) -> Array:
        """The last first."""
        return ks[::-1]


class Shuffled(ByRow):
    """In a random order of the labels that is the same in all scans."""

    def order(self, ks: Array) -> Array:
        """By a fixed rank of labels."""
        rank = np.random.default_rng(1).permutation(10_000)
        return ks[np.argsort(rank[self.log.label[ks]])]


class Iterated(Ekf):
    """Gauss-Newton, four iterations."""

    iterations: ClassVar[int] = 4

    def update(self, ks: Array) -> None:
        """Linearise again at the estimate."""
        start, at = self.x, self.x
        for _ in range(self.iterations):
            point = at
            h, nu, r = self.linearised(ks, point)
            moved = nu + h @ (point - start)
            at = start + self.gain(h, r) @ moved
        self.note_update(ks, point, h, nu, r)
        self.correct(h, moved, r)


class Unscented(Ekf):
    """Sigma points of what a step or a scan depends on, in place of Jacobians."""

    traced = False
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
        u, noise = self.control(number)
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


class FirstEstimates(Ekf):
    """Jacobians at predicted poses and at the landmarks' first positions (Huang 2010)."""

    kind = "other"

    def __init__(self, log: Log) -> None:
        """Start with the prior as the first prediction."""
        super().__init__(log)
        self.before, self.first = self.x[:3].copy(), dict[int, Array]()

    def motion(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array, Array]:
        """F from prediction to prediction."""
        arrived, f, b = super().motion(pose, u, dt)
        d = arrived[:2] - self.before[:2]
        f[:2, 2] = -d[1], d[0]
        self.before = arrived.copy()
        return arrived, f, b

    def place(self, pose: Array, z: Array) -> tuple[Array, Array, Array]:
        """Keep the first position; G_x seen from the predicted pose."""
        point, gx, gz = super().place(pose, z)
        d = point - self.before[:2]
        gx[:, 2] = -d[1], d[0]
        self.first[len(self.x)] = point
        return point, gx, gz

    def linearised(self, ks: Array, x: Array) -> tuple[Array, Array, Array]:
        """H at first estimates, the innovation at the last."""
        h, nu, r = super().linearised(ks, x)
        for at, k in enumerate(ks):
            rows, index = slice(2 * at, 2 * at + 2), self.index[self.log.label[k]]
            _, hv, hl = self.expected(self.before, self.first[index[0]])
            h[rows, self.v], h[rows, index] = hv, hl
        return h, nu, r


class LandmarksFirst(Ekf):
    """The pose lies behind the landmarks."""

    def initialise(self, k: int) -> None:
        """Put the pose last again."""
        super().initialise(k)
        order = np.concatenate((*self.index.values(), self.v)).astype(int)
        self.x, self.p = self.x[order], self.p[np.ix_(order, order)]
        at = {int(old): new for new, old in enumerate(order)}
        self.v = np.array([at[int(row)] for row in self.v])
        self.index = {
            label: np.array([at[int(row)] for row in rows]) for label, rows in self.index.items()
        }


class Decimated(Ekf):
    """Poses at the instants of measurements only, and at the end."""

    def keeps(self, scan: bool) -> bool:
        """Return whether there are measurements."""
        return scan


class UntilLastScan(Decimated):
    """Stops with the last measurement."""

    def instants(self) -> Array:
        """Leave out what comes later."""
        times = super().instants()
        kept: Array = times[times <= self.log.used_s[-1]]
        return kept


class Car(Ekf):
    """Speed of a wheel, a sensor beside the axle, steps along the departing heading (Nieto 2.5)."""

    def control(self, number: int) -> tuple[Array, Array]:
        """Return speed and steering angle of a sample, with their covariance."""
        return self.driven(number), self.control_noise

    def velocity(self, u: Array, **other: float) -> Array:
        """Return the sensor's speed forward and left, and the turn. other: measures of the car."""
        car = self.log.meta["odometry"]["vehicle"] | other
        bend = np.tan(u[1]) / car["wheelbase_m"]
        speed = u[0] / (1.0 - bend * car["encoder_offset_m"])
        side = speed * bend * car["sensor_forward_m"]
        return np.array([speed * (1.0 - bend * car["sensor_left_m"]), side, speed * bend])

    def motion(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array, Array]:
        """Return the pose after dt, F and B; B by differences of exact steps in the complex."""
        face, f = np.eye(3), np.eye(3)
        face[:2, :2] = rotation(pose[2])
        moved = dt * face @ self.velocity(u)
        f[:2, 2] = -moved[1], moved[0]
        steps = 1e-200j * np.eye(2)
        slopes = [Car.velocity(self, u + step).imag / 1e-200 for step in steps]
        return pose + moved, f, dt * face @ np.column_stack(slopes)


class Arc(Ekf):
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


class Euler(Ekf):
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


class EulerStep(Ekf):
    """One step a sample, along the heading at its start."""

    def motion(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array, Array]:
        """Return the pose after it, F and B."""
        c, s = np.cos(pose[2]), np.sin(pose[2])
        f, b = np.eye(3), dt * np.array([[c, 0.0], [s, 0.0], [0.0, 1.0]])
        f[:2, 2] = -dt * u[0] * s, dt * u[0] * c
        return pose + b @ u, f, b


QUARTER = rotation(0.5 * np.pi)


class Invariant(Ekf):
    """Right-invariant errors (Barrau 2016): p is of a turn of the world and of displaced points."""

    traced = False
    kind = "other"

    def __init__(self, log: Log) -> None:
        """Start with the prior's covariance in these coordinates."""
        super().__init__(log)
        self.p = self.changed(self.p, -1.0)

    def basis(self, sign: float) -> Array:
        """Return T, by which additive errors are those of p (sign 1), or its inverse (-1)."""
        t = np.eye(len(self.x))
        for rows in (self.v[:2], *self.index.values()):
            t[rows, 2] = sign * QUARTER @ self.x[rows]
        return t

    def changed(self, p: Array, sign: float) -> Array:
        """Return the covariance of additive errors (1), or that of p (-1)."""
        t = self.basis(sign)
        return t @ p @ t.T

    def carry(self, f: Array, q: Array) -> None:
        """The error stays as it is; noise is added."""
        noise = np.zeros_like(self.p)
        noise[:3, :3] = q
        self.p = self.p + self.changed(noise, -1.0)

    def correct(self, h: Array, nu: Array, r: Array) -> None:
        """Move the state along the group."""
        h = h @ self.basis(1.0)
        gain = self.gain(h, r)
        xi = gain @ nu
        turn, move = rotation(xi[2]), xi[2] or 1e-300
        a, b = np.sin(move) / move, (1.0 - np.cos(move)) / move
        v = np.array([[a, -b], [b, a]])
        for rows in (self.v[:2], *self.index.values()):
            self.x[rows] = turn @ self.x[rows] + v @ xi[rows]
        self.x[2] += xi[2]
        self.p = self.reduced(gain, h, r)
        self.p = 0.5 * (self.p + self.p.T)

    def initialise(self, k: int) -> None:
        """In additive errors, and back."""
        self.p = self.changed(self.p, 1.0)
        super().initialise(k)
        self.p = self.changed(self.p, -1.0)

    def pose(self) -> tuple[Array, Array]:
        """Return the additive errors' covariance."""
        return self.x[:3], self.changed(self.p, 1.0)[:3, :3]

    def joint(self) -> tuple[Array, Array]:
        """Return the additive errors' covariance."""
        return self.x, self.changed(self.p, 1.0)


def inverse(pose: Array) -> Array:
    """Return the world's origin as seen from a pose, or the other way round."""
    return np.append(-rotation(-pose[2]) @ pose[:2], -pose[2])


def differences(f: Any, x: Array) -> Array:
    """Return the Jacobian of f by central differences."""
    steps = 1e-6 * np.eye(len(x))
    return np.column_stack([(f(x + e) - f(x - e)) / 2e-6 for e in steps])


class Robocentric(Ekf):
    """The state is the world's frame and the landmarks, as seen from the vehicle."""

    traced = False
    kind = "other"

    def __init__(self, log: Log) -> None:
        """Start with the world's frame as seen from the prior's pose."""
        super().__init__(log)
        j = differences(inverse, self.x)
        self.x, self.p = inverse(self.x), j @ self.p @ j.T

    def predict(self, number: int, dt: float, end_s: float) -> None:
        """Compose all with the inverse of the step."""
        u, noise = self.control(number)
        d, _, b = self.motion(np.zeros(3), u, dt)
        turn = rotation(-d[2])
        f, g = np.eye(len(self.x)), np.zeros((len(self.x), 3))
        for rows in (self.v[:2], *self.index.values()):
            self.x[rows] = turn @ (self.x[rows] - d[:2])
            f[np.ix_(rows, rows)], g[rows, :2] = turn, -turn
            g[rows, 2] = -QUARTER @ self.x[rows]
        self.x[2] -= d[2]
        g[2, 2] = -1.0
        self.p = f @ self.p @ f.T + g @ self.process(b, noise, dt) @ g.T

    def expected(self, pose: Array, point: Array) -> tuple[Array, Array, Array]:
        """Return what the vehicle's frame gives: the pose has no part in it."""
        z, _, hl = super().expected(np.zeros(3), point)
        return z, np.zeros((2, 3)), hl

    def place(self, pose: Array, z: Array) -> tuple[Array, Array, Array]:
        """Return a new landmark in the vehicle's frame."""
        point, _, gz = super().place(np.zeros(3), z)
        return point, np.zeros((2, 3)), gz

    def pose(self) -> tuple[Array, Array]:
        """Return the vehicle in the world's frame."""
        j = differences(inverse, self.x[:3])
        return inverse(self.x[:3]), j @ self.p[:3, :3] @ j.T

    def joint(self) -> tuple[Array, Array]:
        """Return vehicle and landmarks in the world's frame."""

        def seen(x: Array) -> Array:
            at = inverse(x[:3])
            points = x[3:].reshape(-1, 2) @ rotation(at[2]).T + at[:2]
            return np.concatenate((at, points.ravel()))

        j = differences(seen, self.x)
        return seen(self.x), j @ self.p @ j.T


SOUND: dict[str, type[Ekf]] = {
    "textbook EKF": Ekf,
    "Joseph form": Joseph,
    "information form": Information,
    "square root": SquareRoot,
    "landmarks first": LandmarksFirst,
    "decimated output": Decimated,
    "until the last scan": UntilLastScan,
    "single precision": Single,
    "one by one, by row": ByRow,
    "one by one, by label": ByLabel,
    "one by one, backward": Backward,
    "one by one, shuffled": Shuffled,
    "iterated": Iterated,
    "exact arc": Arc,
    "Euler, 100 Hz": Euler,
    "Euler, one step": EulerStep,
    "unscented": Unscented,
    "unscented, alpha 0.5": UnscentedHalf,
    "unscented, kappa 3 - n": UnscentedThird,
    "cubature": Cubature,
    "right-invariant": Invariant,
    "first estimates": FirstEstimates,
    "robocentric": Robocentric,
}
SAME = ("Joseph form", "information form", "square root", "landmarks first", "decimated output")
"""Those that must equal the textbook's to rounding."""
