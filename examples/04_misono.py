"""Misono's filter of direction cosines as published, and with what it leaves out.

The published filter keeps cosine and sine of the heading as two free numbers and takes their
columns of the measurement Jacobian for zero (Misono 2007, eq. 9). Renormalised, with the full
Jacobian, it is a filter of x, y, heading that measures landmarks in the vehicle's axes.

python examples/04_misono.py
"""

import math

import numpy as np

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import Ekf
from ekf_reference.filters.misono import DirectionCosineEkf, DirectionCosineOptions
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.range_bearing import RangeBearing

STEP_S, STEPS = 0.25, 400
SIGMA = np.array((0.05, math.radians(0.5)))
CONTROL, NOISE_CONTROL = np.array((1.0, 0.1)), np.diag((0.02, math.radians(1.0))) ** 2
PRIOR = np.zeros(3), np.diag((1e-4, 1e-4, 1e-6))


def main() -> dict[str, float]:
    """Return the last pose's error [m] of each filter."""
    rng = np.random.default_rng(5)
    landmarks = np.column_stack((rng.uniform(-14, 14, 15), rng.uniform(-4, 24, 15)))
    motion, sensor = UnicycleModel(), RangeBearing()
    whole = DirectionCosineOptions(full_jacobian=True, renormalise=True, stacked=True)
    filters = {
        "x, y, heading": Ekf(motion, KnownAssociation(), *PRIOR),
        "direction cosines, as published": DirectionCosineEkf(motion, KnownAssociation(), *PRIOR),
        "direction cosines, renormalised, full Jacobian": DirectionCosineEkf(
            motion, KnownAssociation(), *PRIOR, options=whole
        ),
    }
    pose = np.zeros(3)
    for _ in range(STEPS):
        pose = motion.step(pose, CONTROL, STEP_S).pose
        z = sensor.predict(pose, landmarks).z
        z += SIGMA * rng.standard_normal(z.shape)
        measured = CONTROL + np.sqrt(NOISE_CONTROL.diagonal()) * rng.standard_normal(2)
        for ekf in filters.values():
            ekf.predict(measured, NOISE_CONTROL, STEP_S)
            ekf.observe(z, np.tile(SIGMA, (len(z), 1)), np.arange(len(z)))
    errors = {
        name: float(np.hypot(*(ekf.read_pose().pose - pose)[:2])) for name, ekf in filters.items()
    }
    for name, error in errors.items():
        print(f"{name}: {error:.3f} m off")
    own = filters["direction cosines, as published"].state.pose
    print(f"length of the published pair {np.hypot(*own[2:]):.4f}, where 1 is a direction")
    return errors


if __name__ == "__main__":
    main()
