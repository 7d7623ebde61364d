"""An own EKF-SLAM from a log folder to an estimate folder: plain numpy, and a recorder.

For logs with velocity odometry whose measurements name their landmarks. What is recorded is
filter.trace, in which `slamcheck check` and `slamcheck audit` find what is wrong; a filter without
it is checked, too.

python my_ekf.py LOG OUT
"""

import csv
import sys
import tomllib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slamcheck import Recorder

Array = NDArray[np.float64]


class MyEkf:
    """x: pose (x, y, heading), landmarks; p: covariance; landmark_index: first row by label."""

    def __init__(
        self, prior: dict[str, list[float]], noise: dict[str, float], record: Recorder
    ) -> None:
        """Start from the log's prior, with its odometry's noise."""
        self.x, self.p = np.array(prior["pose"]), np.array(prior["covariance"])
        self.control = np.diag([noise["sigma_speed_mps"] ** 2, noise["sigma_turn"] ** 2])
        self.rate = np.diag(
            [noise["variance_rate_position"]] * 2 + [noise["variance_rate_heading"]]
        )
        self.landmark_index: dict[int, int] = {}
        self.record = record
        record.prior({"pose": 3}, self.p, point=self.x)

    def predict(self, v: float, w: float, dt: float) -> None:
        """Drive at v and w for dt."""
        c, s = np.cos(self.x[2] + 0.5 * dt * w), np.sin(self.x[2] + 0.5 * dt * w)
        f, d, departed = np.eye(3), dt * v, self.x[:3].copy()
        f[:2, 2] = -d * s, d * c
        b = dt * np.array([[c, -0.5 * d * s], [s, 0.5 * d * c], [0.0, 1.0]])
        q = b @ self.control @ b.T + dt * self.rate
        self.x[:3] += d * c, d * s, dt * w
        self.p[:3] = f @ self.p[:3]
        self.p[:, :3] = self.p[:, :3] @ f.T
        self.p[:3, :3] += q
        self.record.predict(f, q, ["pose"], point=departed, after=self.x[:3])

    def observe(self, row: int, label: int, z: Array, r: Array) -> None:
        """Fuse one range and bearing, or initialise a landmark with it."""
        n, pose = len(self.x), self.x[:3].copy()
        name = f"landmark {label}"
        if label not in self.landmark_index:  # initialise a landmark
            c, s = np.cos(pose[2] + z[1]), np.sin(pose[2] + z[1])
            gx = np.array([[1.0, 0.0, -z[0] * s], [0.0, 1.0, z[0] * c]])
            gz = np.array([[c, -z[0] * s], [s, z[0] * c]])
            g = np.vstack((np.eye(n), np.hstack((gx, np.zeros((2, n - 3))))))
            point = pose[:2] + z[0] * np.array([c, s])
            self.landmark_index[label], self.x = n, np.append(self.x, point)
            self.p = g @ self.p @ g.T
            self.p[n:, n:] += gz @ r @ gz.T
            self.record.augment(name, gx, gz, r, ["pose"], point=pose, after=point, numbers=row)
            return
        at = slice(self.landmark_index[label], self.landmark_index[label] + 2)
        point = self.x[at].copy()
        dx, dy = point - pose[:2]
        d = np.hypot(dx, dy)
        hl = np.array([[dx / d, dy / d], [-dy / d**2, dx / d**2]])
        hv = np.column_stack((-hl, [0.0, -1.0]))
        nu = z - [d, np.arctan2(dy, dx) - pose[2]]
        nu[1] = (nu[1] + np.pi) % (2.0 * np.pi) - np.pi
        h = np.zeros((2, n))
        h[:, :3], h[:, at] = hv, hl
        gain = np.linalg.solve(h @ self.p @ h.T + r, h @ self.p).T
        self.x, self.p = self.x + gain @ nu, self.p - gain @ h @ self.p
        self.p = 0.5 * (self.p + self.p.T)
        at_state, by = np.append(pose, point), np.hstack((hv, hl))
        self.record.update("landmarks", nu, by, r, ["pose", name], point=at_state, numbers=row)


def read(path: Path) -> dict[str, Array]:
    """Columns of a CSV file by name."""
    with path.open() as file:
        head, *rows = csv.reader(file)
    return dict(zip(head, np.array(rows, dtype=float).T, strict=True))


def main(log: Path, out: Path) -> None:
    """Run the filter over a log folder; write an estimate folder."""
    meta = tomllib.loads((log / "log.toml").read_text())
    odometry, seen = read(log / "odometry.csv"), read(log / "measurements.csv")
    if "yaw_rate_radps" not in odometry or (seen["landmark"] < 0).any():
        sys.exit(f"{log}: expected speeds and yaw rates, and a landmark named in each measurement")
    out.mkdir(parents=True, exist_ok=True)
    (out / "filter.trace").unlink(missing_ok=True)
    record = Recorder(out / "filter.trace")
    ekf, now = MyEkf(meta["prior"], meta["odometry"]["noise"], record), meta["prior"]["time_s"]
    path, spread = [], []
    for t in np.unique(np.concatenate((odometry["time_s"], seen["time_s"]))):
        i = np.searchsorted(odometry["time_s"], now, side="right") - 1  # a sample holds on
        record.at(t)
        if t > now and i >= 0:
            ekf.predict(odometry["speed_mps"][i], odometry["yaw_rate_radps"][i], t - now)
        now = t
        for k in np.flatnonzero(seen["time_s"] == t):
            z = np.array([seen["range_m"][k], seen["bearing_rad"][k]])
            r = np.diag([seen["sigma_range_m"][k], seen["sigma_bearing_rad"][k]]) ** 2
            ekf.observe(int(k), int(seen["landmark"][k]), z, r)
        path.append([t, *ekf.x[:2], 0, 0, 0, np.sin(ekf.x[2] / 2), np.cos(ekf.x[2] / 2)])
        spread.append(ekf.p[:3, :3].copy())
    record.snapshot(ekf.p)
    record.close()
    np.savetxt(out / "trajectory.tum", path, "%.17g")
    places = "".join(
        f"{label},{ekf.x[i]},{ekf.x[i + 1]}\n" for label, i in ekf.landmark_index.items()
    )
    (out / "landmarks.csv").write_text("id,x_m,y_m\n" + places)
    np.savez(out / "covariances.npz", pose=np.array(spread), last_pose_and_landmarks=ekf.p)
    (out / "estimate.toml").write_text('version = 1\ninformation = "filtered"\nestimator = "ekf"\n')


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
