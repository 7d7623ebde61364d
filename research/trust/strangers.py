"""EKF-SLAM filters of a stranger: numpy, docs/formats.md and slamcheck.Recorder, no more.

A filter reads a log folder and writes an estimate folder. `TextbookEkf` is the textbook's: one
update by all known landmarks of a scan, linearised at the predicted state, then the new ones are
initialised, then positions are fused. Every other filter replaces a method of it.
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


def wrapped(angle: Any) -> Any:
    """Return angles in (-pi, pi]."""
    return np.pi - (np.pi - angle) % (2.0 * np.pi)


def rotation(angle: float) -> Array:
    """Return the matrix that turns by an angle."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def measured(pose: Array, point: Array) -> Array:
    """Return range and bearing of a point."""
    dx, dy = point - pose[:2]
    return np.array([np.hypot(dx, dy), wrapped(np.arctan2(dy, dx) - pose[2])])


@dataclass(frozen=True)
class StrangerLog:
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


def read_log(folder: Path) -> StrangerLog:
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
    return StrangerLog(
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


class TextbookEkf:
    """The textbook's filter. x: pose and landmarks, p: covariance, rows of both by v and index.

    departed, arrived, lasted_s: of the last step. now: the measurement at hand. began: where each
    landmark did, by its label.
    """

    kind: ClassVar[str] = "ekf"
    dtype: ClassVar[type] = np.float64

    def __init__(self, log: StrangerLog) -> None:
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

    def fed(self, log: StrangerLog) -> StrangerLog:
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
        arrived, f, b = self.motion(before, self.driven(number), dt)
        self.departed, self.arrived, self.lasted_s = before, arrived, dt
        f, q = self.cast(f, self.process(b, self.control_noise, dt))
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

    def linearised(self, ks: Array) -> tuple[Array, Array, Array]:
        """Return H, innovation and R of measurements at the state."""
        h, nu, x = np.zeros((2 * len(ks), len(self.x))), np.zeros(2 * len(ks)), self.x
        r = np.zeros((2 * len(ks),) * 2)
        for at, k in enumerate(ks):
            rows, index = slice(2 * at, 2 * at + 2), self.index[self.log.label[k]]
            self.now = k
            expected, hv, hl = self.expected(x[self.v], x[index])
            h[rows, self.v], h[rows, index] = hv, hl
            nu[rows], r[rows, rows] = self.residual(self.seen(k), expected), self.noise(k)
        return h, nu, r

    def update(self, ks: Array) -> None:
        """Update by measurements of known landmarks, at once."""
        h, nu, r = self.cast(*self.linearised(ks))
        labels = dict.fromkeys(self.log.label[ks].tolist())
        rows = np.concatenate((self.v, *(self.index[label] for label in labels)))
        blocks = ["pose", *(f"landmark {label}" for label in labels)]
        beside = {"point": self.x[rows], "numbers": self.log.row[ks]}
        self.note("update", "landmarks", nu, h[:, rows], r, blocks, **beside)
        self.correct(h, nu, r)

    def correct(self, h: Array, nu: Array, r: Array) -> None:
        """Use x + K nu and P - K H P, symmetrised."""
        gain = np.linalg.solve(h @ self.p @ h.T + r, h @ self.p).T
        self.x = self.x + gain @ nu
        self.p = self.p - gain @ h @ self.p
        self.p = 0.5 * (self.p + self.p.T)

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

    def run(self) -> TextbookEkf:
        """Filter the whole log."""
        log, now = self.log, self.log.meta["prior"]["time_s"]
        for t in np.unique(np.concatenate((log.odometry_s, log.used_s, log.fixed_s))):
            sample = np.searchsorted(log.odometry_s, now, side="right") - 1
            if t > now:
                self.predict(int(sample), t - now, t)
            now = t
            ks = np.flatnonzero(log.used_s == t)
            if len(ks):
                self.fuse(ks)
            for g in np.flatnonzero(log.fixed_s == t):
                self.fix(int(g))
            self.path.append((t, self.x[:3].copy(), self.p[:3, :3].copy()))
        return self

    def write(self, folder: Path, traced: bool) -> None:
        """Write an estimate folder."""
        folder.mkdir(parents=True)
        rows = [
            (t, *pose[:2], 0.0, 0.0, 0.0, np.sin(0.5 * pose[2]), np.cos(0.5 * pose[2]))
            for t, pose, _ in self.path
        ]
        np.savetxt(folder / "trajectory.tum", rows, ["%.9f"] + ["%.17g"] * 7)
        places = zip(self.index, self.x[3::2].tolist(), self.x[4::2].tolist(), strict=True)
        lines = [f"{label},{px!r},{py!r}" for label, px, py in places]
        (folder / "landmarks.csv").write_text("\n".join(["id,x_m,y_m", *lines]) + "\n")
        spread = np.array([p for _, _, p in self.path])
        np.savez(folder / "covariances.npz", pose=spread, last_pose_and_landmarks=self.p)
        text = f'version = 1\ninformation = "filtered"\nestimator = "{self.kind}"\n'
        (folder / "estimate.toml").write_text(text)
        if traced:
            with Recorder(folder / "filter.trace") as record:
                for call, matrices, more in self.calls:
                    getattr(record, call)(*matrices, **more)


# Sound filters


class Single(TextbookEkf):
    """State, covariance and update are in single precision."""

    dtype = np.float32


class Car(TextbookEkf):
    """Speed of a wheel, a sensor beside the axle, steps along the departing heading (Nieto 2.5)."""

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
