"""EKF-SLAM on a page: simulate a drive, step the filter, compare it with the truth, plot.

python examples/01_ekf_slam.py [FIGURE.png]
"""

import math
import sys

import numpy as np

from ekf_reference.association.nearest_neighbour import NearestNeighbour
from ekf_reference.core.ekf import Control, Ekf
from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import POINT, diagonal_noise
from ekf_reference.core.measurements import Measurements
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.range_bearing import RangeBearing

STEP_S, LAPS, RANGE_M = 0.1, 2, 12.0
SIGMA_CONTROL = np.array((0.1, math.radians(2.0)))  # speed [m/s], yaw rate [rad/s]
SIGMA = np.array((0.1, math.radians(1.0)))  # range [m], bearing [rad]


def main(figure: str | None = None) -> float:
    """Return the normalised error squared of the last pose, chi-square of 3 if all is right."""
    rng = np.random.default_rng(7)
    landmarks = np.column_stack((rng.uniform(-14, 14, 30), rng.uniform(-4, 24, 30)))
    motion, sensor, control = UnicycleModel(), RangeBearing(), np.array((2.0, 0.2))
    noise_control = np.diag(SIGMA_CONTROL**2)

    pose, prior = np.zeros(3), np.diag((1e-4, 1e-4, 1e-6))
    ekf = Ekf(motion, NearestNeighbour(), rng.multivariate_normal(pose, prior), prior)
    truth, path = [pose], [ekf.state.pose]
    for _ in range(round(LAPS * 2.0 * math.pi / (control[1] * STEP_S))):
        pose = motion.step(pose, control, STEP_S).pose
        exact = sensor.predict(pose, landmarks).z
        z = exact[exact[:, 0] < RANGE_M]
        z = z + SIGMA * rng.standard_normal(z.shape)
        seen = Measurements(z, diagonal_noise(np.tile(SIGMA, (len(z), 1))), np.full(len(z), -1))
        measured = control + SIGMA_CONTROL * rng.standard_normal(2)
        ekf.step(Control(measured, noise_control, STEP_S), seen)
        truth.append(pose)
        path.append(ekf.state.pose)

    error = ekf.state.pose - pose
    nees = float(error @ np.linalg.solve(ekf.state.pose_covariance, error))
    print(f"{ekf.state.landmark_count} landmarks, the vehicle is {np.hypot(*error[:2]):.3f} m off")
    print(f"normalised estimation error squared {nees:.2f} (95 % of chi-square of 3: below 7.81)")
    if figure:
        plot(figure, landmarks, np.array(truth), np.array(path), ekf.state.places(POINT))
    return nees


def plot(figure: str, landmarks: Array, truth: Array, path: Array, found: Array) -> None:
    """Draw the true and the estimated path and map."""
    import matplotlib.pyplot as plt

    _, ax = plt.subplots(figsize=(6, 6))
    ax.plot(*landmarks.T, "k+", label="landmarks")
    ax.plot(*found.T, "o", mfc="none", color="tab:blue", label="estimated")
    ax.plot(*truth.T[:2], "k-", lw=0.8, label="path")
    ax.plot(*path.T[:2], "-", color="tab:blue", lw=0.8, label="estimated")
    ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    ax.legend(loc="upper right")
    plt.savefig(figure, dpi=120, bbox_inches="tight")
    plt.close()


if __name__ == "__main__":
    main(*sys.argv[1:2])
