"""Numerical oracles: derivatives, relative errors, random covariances, the exponential of SE(2)."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


def central_difference(f: Callable[[Array], Array], x: Array, step: float = 1e-6) -> Array:
    """Jacobian of f at x, (len(f), len(x))."""
    columns = []
    for i in range(len(x)):
        d = np.zeros(len(x))
        d[i] = step
        columns.append((f(x + d) - f(x - d)) / (2.0 * step))
    return np.column_stack(columns)


def relative_error(actual: NDArray[np.floating], expected: NDArray[np.floating]) -> float:
    """Largest difference over the largest expected entry."""
    return float(np.max(np.abs(actual - expected)) / np.max(np.abs(expected)))


def random_covariance(rng: np.random.Generator, n: int) -> Array:
    """A well-conditioned random covariance (n, n)."""
    a = rng.standard_normal((n, n))
    return a @ a.T + n * np.eye(n)


def exponential(xi: Array) -> Array:
    """Motion (x, y, heading) of a constant twist (3,), which a right perturbation is."""
    turn = 1j * xi[2]
    way = (xi[0] + 1j * xi[1]) * ((np.exp(turn) - 1.0) / turn if xi[2] else 1.0)
    return np.array((way.real, way.imag, xi[2]))


def product(first: Array, second: Array) -> Array:
    """Pose (3,) of `second` in the frame of `first`, seen from outside; headings add unwrapped."""
    way = (second[0] + 1j * second[1]) * np.exp(1j * first[2])
    return np.array((first[0] + way.real, first[1] + way.imag, first[2] + second[2]))


def quotient(first: Array, second: Array) -> Array:
    """Pose (3,) of `second` in the frame of `first`, so that product(first, it) is `second`."""
    way = (second[0] - first[0] + 1j * (second[1] - first[1])) * np.exp(-1j * first[2])
    return np.array((way.real, way.imag, second[2] - first[2]))


def angle(difference: NDArray[np.floating]) -> Array:
    """Angles wrapped to (-pi, pi]."""
    wrapped: Array = np.angle(np.exp(1j * difference))
    return wrapped
