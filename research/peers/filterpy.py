"""filterpy's linear Kalman filter, and the state of our EKF, on the same linear problem.

Three entries, positions of the first two measured in every step. Both are given the same matrices.
"""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array
from ekf_reference.core.state import KalmanState
from research.timing import MissingError, TimedPair, here

STEPS, QUICK_STEPS = 20_000, 200
EQUAL = 1e-9


def rows(*, quick: bool) -> list[TimedPair]:
    """Return the pair. Raises MissingError without filterpy."""
    try:
        from filterpy.kalman import KalmanFilter
    except ModuleNotFoundError:
        raise MissingError("filterpy not installed: make peers") from None
    steps = QUICK_STEPS if quick else STEPS
    f = np.array([[1.0, 0.0, -0.02], [0.0, 1.0, 0.03], [0.0, 0.0, 1.0]])
    h, q, r = np.eye(2, 3), np.diag((1e-4, 1e-4, 1e-6)), 0.25 * np.eye(2)
    prior, covariance, columns = np.zeros(3), np.diag((0.1, 0.1, 0.01)), np.arange(3)
    z = np.random.default_rng(0).standard_normal((steps, 2))
    found: dict[str, tuple[Array, Array]] = {}

    def ours() -> None:
        state = KalmanState(prior, covariance)
        for measured in z:
            state.predict(f @ state.pose, f, q)
            state.update(columns, h, measured - h @ state.pose, r)
        found["ours"] = np.array(state.mean), np.array(state.covariance)

    def theirs() -> None:
        kalman = KalmanFilter(dim_x=3, dim_z=2)
        kalman.x, kalman.P = prior[:, None].copy(), covariance.copy()
        kalman.F, kalman.H, kalman.Q, kalman.R = f, h, q, r
        for measured in z:
            kalman.predict()
            kalman.update(measured)
        found["theirs"] = kalman.x[:, 0], kalman.P

    def apart() -> list[str]:
        both = zip(found["ours"], found["theirs"], strict=True)
        largest = max(float(np.abs(one - other).max()) for one, other in both)
        if not largest <= EQUAL:
            raise RuntimeError(f"filterpy and our state differ by {largest:g}, expected {EQUAL:g}")
        return [f"means and covariances differ by {largest:.1g} at most"]

    return [
        TimedPair(
            name="filterpy: our state",
            work=f"{steps} steps of a linear filter of 3 entries, 2 measured",
            ours=here(ours),
            theirs=here(theirs),
            goal=None,
            parts=(steps, "step"),
            notes=apart,
        )
    ]
