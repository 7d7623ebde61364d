"""Numerical derivatives and comparisons of arrays."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.geometry import Array, Index


def central_difference(f: Callable[[Array], Array], x: Array, step: float = 1e-6) -> Array:
    """Return the Jacobian (len(f), len(x)) of a function of vectors at x."""
    columns = []
    for i in range(len(x)):
        d = np.zeros(len(x))
        d[i] = step
        columns.append((f(x + d) - f(x - d)) / (2.0 * step))
    return np.column_stack(columns)


def relative_error(actual: NDArray[np.floating], expected: NDArray[np.floating]) -> float:
    """Return the largest difference over the largest expected entry."""
    return float(np.max(np.abs(actual - expected)) / np.max(np.abs(expected)))


def random_covariance(rng: np.random.Generator, n: int) -> Array:
    """Return a well-conditioned random covariance (n, n)."""
    a = rng.standard_normal((n, n))
    return a @ a.T + n * np.eye(n)


def point_columns(landmark_index: Index, pose_size: int = 3) -> Index:
    """Return the entries (p + 2 m,) of the pose and some points (m,) of a map of points alone."""
    columns = np.empty(pose_size + 2 * len(landmark_index), dtype=np.intp)
    columns[:pose_size] = np.arange(pose_size)
    columns[pose_size::2] = pose_size + 2 * landmark_index
    columns[pose_size + 1 :: 2] = pose_size + 1 + 2 * landmark_index
    return columns
