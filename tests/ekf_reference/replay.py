"""The exact solution of the linear equations that a filter recorded, by another algebra."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, eigh, solve_triangular

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.trace import MeasurementRecords, TraceArrays


class Gaussian(NamedTuple):
    """mean: (n,) the pose, then point landmarks by their index. covariance: (n, n)."""

    mean: Array
    covariance: Array


def replay(trace: TraceArrays) -> Gaussian:
    """Estimate the last pose and all point landmarks by a square-root information filter.

    Every record is a row |J x - b| of a least-squares problem, with the factor R of its QR
    decomposition as the only memory (Bierman 1977); poses are eliminated as new ones come. No
    covariance is formed before the end. Landmarks must not have been removed.
    """
    p, steps = len(trace.prior_pose), len(trace.departed)
    size = p + POINT.width * len(np.unique(trace.initialisations[POINT].landmark_index))
    root = _Root(size)
    root.add(np.eye(p, size), trace.prior_pose, trace.prior_covariance)
    for k in range(steps + 1):
        if k:
            root.move(
                trace.f[k - 1],
                trace.arrived[k - 1] - trace.f[k - 1] @ trace.departed[k - 1],
                trace.q[k - 1],
            )
        for records, begins in (
            (trace.initialisations[POINT], True),
            (trace.measurements[POINT], False),
        ):
            for row in np.flatnonzero(records.step == k):
                root.add(*_measurement(records, int(row), size, begins=begins))
        fixes = trace.positions
        for row in np.flatnonzero(fixes.step == k):
            jacobian = np.zeros((POINT.width, size))
            jacobian[:, :p] = fixes.jacobian_pose[row]
            value = fixes.innovation[row] + jacobian[:, :p] @ fixes.pose[row]
            root.add(jacobian, value, fixes.noise[row])
    return root.solved()


def gap(estimate: Gaussian, exact: Gaussian) -> float:
    """Return how far an estimate is from the exact one.

    The larger of the largest difference of means in standard deviations, and the largest
    |lambda - 1| over the generalised eigenvalues of the covariances.
    """
    sigma = np.sqrt(np.diag(exact.covariance))
    low, high = eigenvalue_range(estimate.covariance, exact.covariance)
    return max(float(np.max(np.abs(estimate.mean - exact.mean) / sigma)), 1.0 - low, high - 1.0)


def eigenvalue_range(first: Array, second: Array) -> tuple[float, float]:
    """Return the least and the largest generalised eigenvalue of a pair of covariances.

    Both at least 1 say that the first is conservative. (-inf, inf) where the second is not
    positive definite: no comparison of such a pair may pass.
    """
    try:
        values = eigh(first, second, eigvals_only=True)
    except LinAlgError:
        return float("-inf"), float("inf")
    return float(values[0]), float(values[-1])


def _measurement(
    records: MeasurementRecords, row: int, size: int, *, begins: bool
) -> tuple[Array, Array, Array]:
    """Jacobian (2, n), value (2,) and covariance (2, 2) of a record."""
    pose, landmark = records.pose[row], records.landmark[row]
    by_pose, other = records.jacobian_pose[row], records.jacobian_other[row]
    noise, value = records.noise[row], records.innovation[row]
    by_landmark = other
    if begins:  # l - G_x x = landmark - G_x pose + G_z v
        by_pose, by_landmark, noise = -by_pose, np.eye(POINT.width), other @ noise @ other.T
    columns: Index = len(pose) + POINT.width * records.landmark_index[row] + np.arange(POINT.width)
    jacobian = np.zeros((POINT.width, size))
    jacobian[:, : len(pose)], jacobian[:, columns] = by_pose, by_landmark
    return jacobian, value + by_pose @ pose + by_landmark @ landmark, noise


def _triangular(rows: Array) -> Array:
    """R of the rows' QR decomposition."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


class _Root:
    """Rows (R, b) of |R x - b|, R upper triangular, and rows that wait to be decomposed."""

    def __init__(self, size: int) -> None:
        self._rows, self._waiting = np.zeros((0, size + 1)), list[Array]()

    def add(self, jacobian: Array, value: Array, covariance: Array) -> None:
        """Add rows J x = value with a covariance."""
        lower = np.linalg.cholesky(covariance)
        rows = np.column_stack((jacobian, value))
        self._waiting.append(solve_triangular(lower, rows, lower=True))

    def move(self, f: Array, shift: Array, q: Array) -> None:
        """Replace the pose by x' = f x + shift + w, w of covariance q."""
        self._decompose()
        p, width = len(f), self._rows.shape[1]
        top = np.zeros((2 * p, p + width))
        top[:p, :p], top[:p, 2 * p :] = self._rows[:p, :p], self._rows[:p, p:]
        top[p:, :p], top[p:, p : 2 * p], top[p:, -1] = -f, np.eye(p), shift
        lower = np.linalg.cholesky(q)
        top[p:] = solve_triangular(lower, top[p:], lower=True)
        self._rows[:p] = _triangular(top)[p : 2 * p, p:]

    def solved(self) -> Gaussian:
        """The estimate."""
        self._decompose()
        size = self._rows.shape[1] - 1
        inverse = solve_triangular(self._rows[:size, :size], np.eye(size))
        return Gaussian(inverse @ self._rows[:size, size], inverse @ inverse.T)

    def _decompose(self) -> None:
        if self._waiting:
            self._rows = _triangular(np.vstack((self._rows, *self._waiting)))
            self._waiting = []
