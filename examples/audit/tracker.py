"""A Kalman filter of position, velocity and the bias of a radar, recorded for `slamcheck audit`.

Five lines, marked with #, are all that recording takes.

python tracker.py TRACE [--bug]
"""

import sys

import numpy as np

from slamcheck import Recorder

DT = 0.1
STATE = {"position": 2, "velocity": 2, "bias": 1}
F = np.eye(5)
F[0, 2] = F[1, 3] = DT
Q = np.diag([0.0, 0.0, 0.02, 0.02, 1e-6])
H = {
    "gps": np.array([[1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0, 0.0]]),
    "radar": np.array([[0.0, 0.0, 1.0, 0.0, 1.0]]),
}
R = {"gps": np.diag([4.0, 4.0]), "radar": np.diag([0.01])}


def track(path: str, *, bug: bool) -> None:
    """Simulate a drive, filter it, and record what the filter does."""
    rng = np.random.default_rng(0)
    p = np.diag([4.0, 4.0, 1.0, 1.0, 0.04])
    truth = np.sqrt(np.diag(p)) * rng.standard_normal(5)
    x = np.zeros(5)
    with Recorder(path) as record:  #
        record.prior(STATE, p)  #
        for step in range(1, 601):
            truth = F @ truth + np.sqrt(np.diag(Q)) * rng.standard_normal(5)
            x, p = F @ x, F @ p @ F.T + Q
            record.at(step * DT)
            record.predict(F, Q)  #
            for sensor in ("radar", "gps") if step % 10 == 0 else ("radar",):
                h, r = H[sensor], R[sensor]
                z = h @ truth + np.sqrt(np.diag(r)) * rng.standard_normal(len(r))
                residual = z - h @ x
                gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
                x, before = x + gain @ residual, p
                p = p - gain @ h @ p
                if bug and sensor == "gps" and step > 300:
                    p[:2, 4], p[4, :2] = before[:2, 4], before[4, :2]
                record.update(sensor, residual, h, r, correction=gain @ residual)  #
            if step % 5 == 0:
                record.snapshot(p, error=truth - x)  #


if __name__ == "__main__":
    track(sys.argv[1], bug="--bug" in sys.argv)
