"""A strong position fix, fused at once and as a sequence of weak ones (Guivant 2002, section 4.2).

The antenna is 3 m ahead of the axle, so that a fix tells the heading, too; but how much depends on
the heading. A single update uses the Jacobian at the predicted heading, which is 30 degrees off;
the sequence linearises again as the heading gets better.

python examples/03_sequential_gps.py
"""

import math

import numpy as np

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.measurement_update import UpdateSplitter
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.position import POSITION_SPLITTER, PositionFixes, PositionModel

TRIALS, LEVER_M, SIGMA_POSITION_M = 300, 3.0, 0.05
PRIOR = np.diag((0.05, 0.05, math.radians(30.0))) ** 2


def main() -> dict[str, float]:
    """Return the mean normalised error squared of the pose after the fix: 3 if all is right."""
    model = PositionModel((LEVER_M, 0.0))
    ways = {"at once": UpdateSplitter(), "in parts": POSITION_SPLITTER}
    nees, squares = dict.fromkeys(ways, 0.0), dict.fromkeys(ways, 0.0)
    rng = np.random.default_rng(11)
    for _ in range(TRIALS):
        pose = rng.multivariate_normal(np.zeros(3), PRIOR)
        z = model.predict(pose)[0] + SIGMA_POSITION_M * rng.standard_normal(2)
        for name, splitter in ways.items():
            ekf = Ekf(UnicycleModel(), KnownAssociation(), np.zeros(3), PRIOR)
            ekf.fixes = PositionFixes(model, gate=math.inf, splitter=splitter)
            ekf.fix_position(z, SIGMA_POSITION_M**2 * np.eye(2))
            error = ekf.state.pose - pose
            own = error @ np.linalg.solve(ekf.state.pose_covariance, error)
            nees[name] += float(own) / TRIALS
            squares[name] += float(error[2]) ** 2 / TRIALS
    for name in ways:
        degrees = math.degrees(math.sqrt(squares[name]))
        print(f"fused {name}: heading {degrees:.2f} degrees off (rms), mean NEES {nees[name]:.1f}")
    return nees


if __name__ == "__main__":
    main()
