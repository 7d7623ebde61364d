"""The compressed filter equals the full one (Guivant 2002, section 4).

python examples/02_compressed_equals_full.py
"""

import math

import numpy as np

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import Ekf
from ekf_reference.filters.compressed import CompressedEkf, LocalAreas
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.range_bearing import RangeBearing

STEP_S, STEPS, RANGE_M = 0.2, 900, 15.0
SIGMA = np.array((0.1, math.radians(1.0)))
NOISE_CONTROL = np.diag((0.05, math.radians(1.0))) ** 2
PRIOR = np.zeros(3), np.diag((0.01, 0.01, 1e-4))


def main() -> float:
    """Return the largest difference of mean and covariance, relative to the states' sigmas."""
    rng = np.random.default_rng(3)
    landmarks = rng.uniform((-20, -20), (180, 60), (250, 2))
    motion, sensor = UnicycleModel(), RangeBearing()
    full = Ekf(motion, KnownAssociation(), *PRIOR)
    areas = LocalAreas(half_m=10.0, reach_m=20.0)
    compressed = CompressedEkf(motion, KnownAssociation(), *PRIOR, areas=areas)
    pose = np.zeros(3)
    for k in range(STEPS):  # there and back along a winding road
        control = np.array((2.0, 0.35 if k == STEPS // 2 else 0.15 * math.sin(0.05 * k)))
        duration = math.pi / 0.35 if k == STEPS // 2 else STEP_S
        pose = motion.step(pose, control, duration).pose
        exact = sensor.predict(pose, landmarks).z
        label = np.flatnonzero(exact[:, 0] < RANGE_M)
        z = exact[label] + SIGMA * rng.standard_normal((len(label), 2))
        measured = control + np.sqrt(NOISE_CONTROL.diagonal()) * rng.standard_normal(2)
        for ekf in (full, compressed):
            ekf.predict(measured, NOISE_CONTROL, duration)
            ekf.observe(z, np.tile(SIGMA, (len(z), 1)), label)

    sigma = np.sqrt(full.state.covariance.diagonal())
    updates = len(compressed.state.updates)
    apart = np.abs(full.state.covariance - compressed.state.covariance)
    of_mean = float((np.abs(full.state.mean - compressed.state.mean) / sigma).max())
    of_covariance = float((apart / np.outer(sigma, sigma)).max())
    print(f"{full.state.landmark_count} landmarks, {STEPS} steps, {updates} global updates")
    print(
        f"largest difference of the mean {of_mean:.1e}, of a covariance {of_covariance:.1e} sigmas"
    )
    return max(of_mean, of_covariance)


if __name__ == "__main__":
    main()
