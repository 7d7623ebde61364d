"""A newcomer's EKF-SLAM, from a textbook: speed and yaw rate along the exact arc, no trace.

It knows nothing of slamcheck but the files. A fault is another method, or `late` samples.
"""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class TextbookEkf:
    """State: x, y, heading, then landmarks as they come. late: samples that the odometry lags."""

    late = 0

    def __init__(self, mean: Array, covariance: Array, control: Array, drift: Array) -> None:
        self.mu, self.sigma, self.m, self.drift = mean, covariance, control, drift
        self.index: dict[int, int] = {}

    def q(self, v: Array, dt: float) -> Array:
        """Process noise; v: derivative by the control."""
        return v @ self.m @ v.T + dt * self.drift

    def r(self, sigma: Array) -> Array:
        """Measurement noise."""
        return np.diag(sigma**2)

    def innovation(self, z: Array, expected: Array) -> Array:
        """The bearing the short way round."""
        nu = z - expected
        nu[1] = np.arctan2(np.sin(nu[1]), np.cos(nu[1]))
        return nu

    def cross(self, g: Array) -> Array:
        """Covariance of a new landmark with the state."""
        return g @ self.sigma[:3]

    def predict(self, v: float, w: float, dt: float) -> None:
        """Drive along the arc."""
        th, end, n = self.mu[2], self.mu[2] + w * dt, len(self.mu)
        if abs(w) > 1e-9:
            a, b = np.sin(end) - np.sin(th), np.cos(th) - np.cos(end)
            move = np.array([v / w * a, v / w * b, w * dt])
            by_v = np.array([a / w, b / w, 0.0])
            by_w = np.array(
                [
                    v * dt / w * np.cos(end) - v / w**2 * a,
                    v * dt / w * np.sin(end) - v / w**2 * b,
                    dt,
                ]
            )
        else:
            move = np.array([v * dt * np.cos(th), v * dt * np.sin(th), w * dt])
            by_v = np.array([dt * np.cos(th), dt * np.sin(th), 0.0])
            by_w = np.array([-0.5 * v * dt**2 * np.sin(th), 0.5 * v * dt**2 * np.cos(th), dt])
        g = np.eye(n)
        g[0, 2], g[1, 2] = -move[1], move[0]
        self.mu[:3] += move
        self.sigma = g @ self.sigma @ g.T
        self.sigma[:3, :3] += self.q(np.column_stack((by_v, by_w)), dt)

    def observe(self, label: int, z: Array, r: Array) -> None:
        """Update with a landmark, or begin it."""
        n = len(self.mu)
        if label not in self.index:
            c, s = np.cos(self.mu[2] + z[1]), np.sin(self.mu[2] + z[1])
            gx = np.array([[1.0, 0.0, -z[0] * s], [0.0, 1.0, z[0] * c]])
            gz = np.array([[c, -z[0] * s], [s, z[0] * c]])
            grown = np.zeros((n + 2, n + 2))
            grown[:n, :n], grown[n:, :n] = self.sigma, self.cross(gx)
            grown[:n, n:] = grown[n:, :n].T
            grown[n:, n:] = gx @ self.sigma[:3, :3] @ gx.T + gz @ r @ gz.T
            self.index[label], self.sigma = n, grown
            self.mu = np.append(self.mu, self.mu[:2] + z[0] * np.array([c, s]))
            return
        j = self.index[label]
        dx, dy = self.mu[j : j + 2] - self.mu[:2]
        d2 = dx**2 + dy**2
        d = np.sqrt(d2)
        h = np.zeros((2, n))
        h[:, :3] = [[-dx / d, -dy / d, 0.0], [dy / d2, -dx / d2, -1.0]]
        h[:, j : j + 2] = [[dx / d, dy / d], [-dy / d2, dx / d2]]
        k = self.sigma @ h.T @ np.linalg.inv(h @ self.sigma @ h.T + r)
        self.mu = self.mu + k @ self.innovation(z, np.array([d, np.arctan2(dy, dx) - self.mu[2]]))
        self.sigma = (np.eye(n) - k @ h) @ self.sigma


def table(path: Path) -> dict[str, Array]:
    """Columns of a CSV file."""
    with path.open() as file:
        head, *rows = csv.reader(file)
    return dict(zip(head, np.array(rows, dtype=float).T, strict=True))


def run(kind: type[TextbookEkf], log: Path, out: Path) -> None:
    """Filter a log folder, write an estimate folder: stamps with nine decimals."""
    meta = tomllib.loads((log / "log.toml").read_text())
    drive, seen = table(log / "odometry.csv"), table(log / "measurements.csv")
    noise, now = meta["odometry"]["noise"], meta["prior"]["time_s"]
    control = np.diag([noise["sigma_speed_mps"] ** 2, noise["sigma_turn"] ** 2])
    rates = [noise["variance_rate_position"]] * 2 + [noise["variance_rate_heading"]]
    prior = meta["prior"]
    ekf = kind(np.array(prior["pose"]), np.array(prior["covariance"]), control, np.diag(rates))
    lines, spread = [], []
    for t in np.unique(np.concatenate((drive["time_s"], seen["time_s"]))):
        i = np.searchsorted(drive["time_s"], now, side="right") - 1
        if t > now:
            i = max(i - ekf.late, 0)
            ekf.predict(drive["speed_mps"][i], drive["yaw_rate_radps"][i], t - now)
        now = t
        for k in np.flatnonzero(seen["time_s"] == t):
            sigma = np.array([seen["sigma_range_m"][k], seen["sigma_bearing_rad"][k]])
            z = np.array([seen["range_m"][k], seen["bearing_rad"][k]])
            ekf.observe(int(seen["landmark"][k]), z, ekf.r(sigma))
        x, y, th = ekf.mu[:3]
        lines.append(f"{t:.9f} {x} {y} 0 0 0 {np.sin(th / 2)} {np.cos(th / 2)}\n")
        spread.append(ekf.sigma[:3, :3].copy())
    out.mkdir(parents=True)
    (out / "trajectory.tum").write_text("".join(lines))
    rows = (f"{name},{ekf.mu[j]},{ekf.mu[j + 1]}\n" for name, j in ekf.index.items())
    (out / "landmarks.csv").write_text("id,x_m,y_m\n" + "".join(rows))
    np.savez(out / "covariances.npz", pose=np.array(spread), last_pose_and_landmarks=ekf.sigma)
    (out / "estimate.toml").write_text('version = 1\ninformation = "filtered"\nestimator = "ekf"\n')
