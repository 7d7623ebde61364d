"""An EKF-SLAM that shares no code with ours, leaves a trace, and can be given a fault anywhere.

Every formula is a field, so that a fault is `replace(filter, range_bearing=...)`. It works in
double or in single precision, and writes an estimate folder with its trace.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array, Index
from comparisons.audit.run_trace import write_event
from comparisons.estimates.folder import tum_text
from comparisons.estimates.trace_file import TRACE
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import OdometryNoise, RelativePoses, SteeringOdometry
from comparisons.trace.events import Event
from comparisons.trace.reader import Trace
from comparisons.trace.recorder import Recorder


def control(f: Foreign, k: int) -> Array:
    """(2,) what acts in step k."""
    return f.cast(f.timeline.control[k])


def duration(f: Foreign, k: int) -> float:
    """How long it acts [s]."""
    return float(f.timeline.step_duration_s[k])


def velocity(f: Foreign, u: Array) -> tuple[complex, float]:
    """Of the sensor: forward + i left [m/s], and the turn [rad/s]."""
    if not isinstance(f.log.odometry, SteeringOdometry):
        return complex(u[0]), float(u[1])
    car = f.log.odometry.vehicle
    bend = np.tan(u[1]) / car.wheelbase_m
    speed = u[0] / (1.0 - bend * car.encoder_offset_m)
    return speed * (1.0 + bend * complex(-car.sensor_left_m, car.sensor_forward_m)), speed * bend


def along(f: Foreign, turned: float) -> float:
    """How far the heading that a step leads along is turned from the departing one."""
    return 0.0 if isinstance(f.log.odometry, SteeringOdometry) else 0.5 * turned


def motion(f: Foreign, pose: Array, u: Array, dt: float) -> Array:
    """(3,) the pose after a step."""
    forward, turn = f.velocity(f, u)
    way = dt * forward * np.exp(1j * (pose[2] + f.along(f, dt * turn)))
    return f.cast([pose[0] + way.real, pose[1] + way.imag, pose[2] + dt * turn])


def by_pose(f: Foreign, pose: Array, arrived: Array, u: Array, dt: float) -> Array:
    """F (3, 3)."""
    east, north = (motion(f, pose, u, dt) - pose)[:2]
    return f.cast([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 1.0]])


def by_control(f: Foreign, pose: Array, arrived: Array, u: Array, dt: float) -> Array:
    """B (3, 2), by hand from the chain rule of `motion`."""
    forward, turn = velocity(f, u)
    face = np.exp(1j * (pose[2] + f.along(f, dt * turn)))
    if not isinstance(f.log.odometry, SteeringOdometry):
        side = 0.5j * dt * forward
        columns = (dt * face, dt * face * side), (0.0, dt)
    else:
        car = f.log.odometry.vehicle
        bend = np.tan(u[1]) / car.wheelbase_m
        steep = (1.0 + np.tan(u[1]) ** 2) / car.wheelbase_m
        slip = 1.0 - bend * car.encoder_offset_m
        speed, faster = u[0] / slip, u[0] / slip**2 * car.encoder_offset_m * steep
        place = complex(-car.sensor_left_m, car.sensor_forward_m)
        both = faster * (1.0 + bend * place) + speed * steep * place
        columns = (
            (dt * face * (1.0 + bend * place) / slip, dt * face * both),
            (dt * bend / slip, dt * (speed * steep + faster * bend)),
        )
    ways, turns = np.array(columns[0], complex), np.array(columns[1])
    return f.cast(np.array([ways.real, ways.imag, turns]))


def step_noise(f: Foreign, pose: Array, arrived: Array, u: Array, dt: float) -> Array:
    """Q (3, 3)."""
    b = f.by_control(f, pose, arrived, u, dt)
    return f.cast(b @ control_noise(f) @ b.T + dt * stabilisation(f))


def wheel_noise(f: Foreign) -> OdometryNoise:
    """Of wheels."""
    if isinstance(f.log.odometry, RelativePoses):
        raise TypeError("no wheels")
    return f.log.odometry.noise


def control_noise(f: Foreign) -> Array:
    """(2, 2) of speed and turn."""
    noise = wheel_noise(f)
    return f.cast(np.diag([noise.sigma_speed_mps**2, noise.sigma_turn**2]))


def stabilisation(f: Foreign) -> Array:
    """(3, 3) a second's."""
    noise = wheel_noise(f)
    place, turn = noise.variance_rate_position, noise.variance_rate_heading
    return np.diag([place, place, turn])


def measured(f: Foreign, i: int) -> Array:
    """(2,) range and bearing of measurement i."""
    seen = f.log.measurements
    return f.cast([seen.range_m[i], seen.bearing_rad[i]])


def noise(f: Foreign, i: int) -> Array:
    """R (2, 2) of measurement i."""
    seen = f.log.measurements
    return f.cast(np.diag([seen.sigma_range_m[i] ** 2, seen.sigma_bearing_rad[i] ** 2]))


def expected(f: Foreign, pose: Array, point: Array) -> Array:
    """(2,) range and bearing of a point."""
    ray = complex(*(point - pose[:2])) * np.exp(-1j * float(pose[2]))
    return f.cast([abs(ray), np.angle(ray)])


def by_state(f: Foreign, pose: Array, point: Array) -> Array:
    """H (2, 5), by pose and by point."""
    ray = complex(*(point - pose[:2]))
    one = ray / abs(ray)
    row = [one.real, one.imag], [-one.imag / abs(ray), one.real / abs(ray)]
    return f.cast(np.array([[-r[0], -r[1], k, *r] for r, k in zip(row, (0.0, -1.0), strict=True)]))


def innovation(f: Foreign, z: Array, z_hat: Array) -> Array:
    """(2,) the difference, the bearing the short way round."""
    apart = z - z_hat
    return f.cast([apart[0], (apart[1] + np.pi) % (2.0 * np.pi) - np.pi])


def point(f: Foreign, pose: Array, z: Array) -> Array:
    """(2,) where a new landmark stands."""
    ray = z[0] * np.exp(1j * (pose[2] + z[1]))
    return f.cast([pose[0] + ray.real, pose[1] + ray.imag])


def by_new(f: Foreign, pose: Array, z: Array) -> Array:
    """G_x and G_z (2, 5)."""
    one = np.exp(1j * (pose[2] + z[1]))
    across = 1j * z[0] * one
    return f.cast(
        [[1.0, 0.0, across.real, one.real, across.real],
         [0.0, 1.0, across.imag, one.imag, across.imag]]
    )  # fmt: skip


def given(f: Foreign) -> Positions:
    """The positions, of which there are some."""
    if f.positions is None:
        raise ValueError("no positions")
    return f.positions


def place(f: Foreign, g: int) -> Array:
    """(2,) position g."""
    return f.cast(given(f).position_m[g])


def place_noise(f: Foreign, g: int) -> Array:
    """Its R (2, 2)."""
    return f.cast(given(f).covariance[g])


def lever(f: Foreign) -> Array:
    """(2,) from the vehicle to the antenna, ahead and left."""
    return f.cast(given(f).antenna_m)


def arm(f: Foreign, pose: Array) -> Array:
    """(2,) from the vehicle to the antenna, in the map."""
    turned = complex(*lever(f)) * np.exp(1j * float(pose[2]))
    return f.cast([turned.real, turned.imag])


@dataclass(kw_only=True)
class Foreign:
    """The filter. landmark_index: (M,) of each measurement, negative to leave it out.

    before, arrived: where the last step led from and to. now: the measurement at hand, and its
    landmark. scan: the pose of the scan before. first: where each landmark began.
    """

    log: Log
    timeline: Timeline
    landmark_index: Index
    positions: Positions | None = None
    dtype: type = np.float64
    prior_pose: Array = field(default_factory=lambda: np.zeros(0))
    prior_covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    control: Callable[[Foreign, int], Array] = control
    duration: Callable[[Foreign, int], float] = duration
    velocity: Callable[[Foreign, Array], tuple[complex, float]] = velocity
    along: Callable[[Foreign, float], float] = along
    motion: Callable[[Foreign, Array, Array, float], Array] = motion
    by_pose: Callable[[Foreign, Array, Array, Array, float], Array] = by_pose
    by_control: Callable[[Foreign, Array, Array, Array, float], Array] = by_control
    step_noise: Callable[[Foreign, Array, Array, Array, float], Array] = step_noise
    measured: Callable[[Foreign, int], Array] = measured
    measured_new: Callable[[Foreign, int], Array] | None = None
    noise: Callable[[Foreign, int], Array] = noise
    noise_new: Callable[[Foreign, int], Array] | None = None
    expected: Callable[[Foreign, Array, Array], Array] = expected
    by_state: Callable[[Foreign, Array, Array], Array] = by_state
    innovation: Callable[[Foreign, Array, Array], Array] = innovation
    point: Callable[[Foreign, Array, Array], Array] = point
    by_new: Callable[[Foreign, Array, Array], Array] = by_new
    place: Callable[[Foreign, int], Array] = place
    place_noise: Callable[[Foreign, int], Array] = place_noise
    arm: Callable[[Foreign, Array], Array] = arm
    keep: Callable[[Foreign, Array, int], Array] = lambda f, p, n: p

    def __post_init__(self) -> None:
        """Start from the log's prior where none was given."""
        prior = self.log.prior
        if not len(self.prior_pose):
            self.prior_pose = prior.pose
        if not len(self.prior_covariance):
            self.prior_covariance = prior.covariance
        self.begin()

    def begin(self) -> None:
        """Forget everything."""
        self.x, self.p = self.cast(self.prior_pose), self.cast(self.prior_covariance)
        self.at: dict[int, int] = {}
        self.first: dict[int, Array] = {}
        self.time_s = float(self.timeline.epoch_time_s[0])
        self.before, self.arrived, self.scan = self.x.copy(), self.x.copy(), self.x.copy()
        self.step, self.now = 0, (0, 0)

    def cast(self, values: object) -> Array:
        """As this filter keeps numbers."""
        return np.array(values, self.dtype)

    def run(self, folder: Path) -> None:
        """Drive through the log, and write the estimate with its trace."""
        self.begin()
        with Recorder(folder / TRACE) as self.record:
            self.record.prior({"pose": 3}, self.p, point=self.x)
            poses, spreads = self._drive()
        self._write(folder, poses, spreads)

    def _drive(self) -> tuple[Array, Array]:
        """Go through the log; return poses and their covariances at the epochs."""
        t, poses, spreads = self.timeline, [], []
        until, seen = t.steps_until(), t.measurements_until()
        fixed = t.positions_until()
        for k in range(len(t.epoch_time_s)):
            while self.step < until[k]:
                self._predict()
            rows = np.arange(seen[k], seen[k + 1])
            rows = rows[self.landmark_index[rows] >= 0]
            known = np.array([self.landmark_index[i] in self.at for i in rows], bool)
            if known.any():
                self._update(rows[known])
            for i in rows[~known].tolist():
                self._augment(i)
            if len(rows):
                self.scan = self.x[:3].copy()
            for g in range(fixed[k], fixed[k + 1]):
                self._fix(g)
            poses.append(self.x[:3].copy())
            spreads.append(self.p[:3, :3].copy())
        return np.array(poses), np.array(spreads)

    def _predict(self) -> None:
        k, pose = self.step, self.x[:3].copy()
        u, dt = self.cast(self.control(self, k)), self.dtype(self.duration(self, k))
        arrived = self.motion(self, pose, u, dt)
        f, q = (part(self, pose, arrived, u, dt) for part in (self.by_pose, self.step_noise))
        self.time_s += float(self.timeline.step_duration_s[k])
        self.record.at(self.time_s)
        self.record.predict(f, q, ["pose"], point=pose, after=arrived)
        self.before, self.arrived, self.step = pose, arrived, k + 1
        self.x[:3] = arrived
        self.p[:3, 3:] = f @ self.p[:3, 3:]
        self.p[3:, :3] = self.p[:3, 3:].T
        self.p[:3, :3] = f @ self.p[:3, :3] @ f.T + q
        self.p = self.keep(self, self.p, 3)

    def _correct(self, h: Array, nu: Array, r: Array) -> None:
        ph = self.p @ h.T
        w = np.linalg.solve(h @ ph + r, ph.T).T
        self.x = self.x + w @ nu
        self.p = self.p - w @ ph.T
        if self.dtype is np.float64:
            self.p = 0.5 * (self.p + self.p.T)

    def _update(self, rows: Index) -> None:
        n, m = len(self.x), len(rows)
        h, nu, r = (self.cast(np.zeros(s)) for s in ((2 * m, n), 2 * m, (2 * m, 2 * m)))
        pose = self.x[:3].copy()
        begins = {f"landmark {k}": self.at[k] for k in self.landmark_index[rows].tolist()}
        for j, i in enumerate(rows.tolist()):
            landmark_index = int(self.landmark_index[i])
            at, part = self.at[landmark_index], slice(2 * j, 2 * j + 2)
            self.now = i, landmark_index
            landmark = self.x[at : at + 2].copy()
            row = self.by_state(self, pose, landmark)
            nu[part] = self.innovation(
                self, self.measured(self, i), self.expected(self, pose, landmark)
            )
            r[part, part] = self.noise(self, i)
            h[part, :3], h[part, at : at + 2] = row[:, :3], row[:, 3:]
        columns = [0, 1, 2, *(at + k for at in begins.values() for k in (0, 1))]
        blocks, point = ["pose", *begins], self.x[columns]
        self.record.update("landmarks", nu, h[:, columns], r, blocks, point=point, numbers=rows)
        self._correct(h, nu, r)

    def _augment(self, i: int) -> None:
        landmark_index, n, pose = int(self.landmark_index[i]), len(self.x), self.x[:3].copy()
        self.now = i, landmark_index
        z = (self.measured_new or self.measured)(self, i)
        r = (self.noise_new or self.noise)(self, i)
        landmark, g = self.point(self, pose, z), self.by_new(self, pose, z)
        self.at[landmark_index], self.first[landmark_index] = n, landmark
        p = self.cast(np.zeros((n + 2, n + 2)))
        p[:n, :n] = self.p
        p[n:, :n] = g[:, :3] @ self.p[:3]
        p[:n, n:] = p[n:, :n].T
        p[n:, n:] = g[:, :3] @ self.p[:3, :3] @ g[:, :3].T + g[:, 3:] @ r @ g[:, 3:].T
        self.x, self.p = np.concatenate((self.x, landmark)), self.keep(self, p, n)
        name, by_pose, by_z = f"landmark {landmark_index}", g[:, :3], g[:, 3:]
        self.record.augment(name, by_pose, by_z, r, ["pose"], numbers=i, point=pose, after=landmark)

    def _fix(self, g: int) -> None:
        pose, n = self.x[:3].copy(), len(self.x)
        arm, r = self.arm(self, pose), self.place_noise(self, g)
        nu = self.place(self, g) - pose[:2] - arm
        h = self.cast(np.zeros((2, n)))
        h[:, :3] = [[1.0, 0.0, -arm[1]], [0.0, 1.0, arm[0]]]
        self.record.update("positions", nu, h[:, :3], r, ["pose"], point=pose, numbers=g)
        self._correct(h, nu, r)

    def _write(self, folder: Path, poses: Array, spreads: Array) -> None:
        order = [at - 3 for at in self.at.values()]
        if order != sorted(order):
            raise RuntimeError("landmarks out of order")
        np.savez(folder / "covariances.npz", pose=spreads, last_pose_and_landmarks=self.p)
        (folder / "trajectory.tum").write_text(
            tum_text(self.timeline.epoch_time_s, poses.astype(np.float64)), encoding="utf-8"
        )
        lines = ["id,x_m,y_m"]
        for landmark_index, at in self.at.items():
            x, y = self.x[at : at + 2].tolist()
            lines.append(f"{landmark_index},{x!r},{y!r}")
        (folder / "landmarks.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _rounded(event: Event) -> dict[str, Array]:
    """Return an event's numbers in single precision; numbers of measurements stay whole."""
    return {
        name: value.astype(np.float32)
        for name, value in event._asdict().items()
        if isinstance(value, np.ndarray) and name != "numbers"
    }


def in_single(folder: Path) -> None:
    """Store in single precision what a folder holds in double."""
    with np.load(folder / "covariances.npz") as archive:
        arrays = {key: a.astype(np.float32) for key, a in archive.items()}
    np.savez(folder / "covariances.npz", **arrays)
    events = list(Trace(folder / TRACE))
    (folder / TRACE).unlink()
    with Recorder(folder / TRACE) as record:
        for event in events:
            if event.time_s is not None:
                record.at(event.time_s)
            write_event(event._replace(**_rounded(event)), record)  # type: ignore[arg-type]
    for name, separator in (("trajectory.tum", " "), ("landmarks.csv", ",")):
        lines = []
        for line in (folder / name).read_text(encoding="utf-8").splitlines():
            first, *rest = line.split(separator)
            if not first[0].isalpha():
                rest = [repr(float(np.float32(value))) for value in rest]
            lines.append(separator.join((first, *rest)))
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
