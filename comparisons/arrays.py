"""Array types and small matrices that the whole harness shares."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

_FROM_UPPER = {3: (0, 1, 1, 2), 6: (0, 1, 2, 1, 3, 4, 2, 4, 5)}


def symmetric(upper: Array) -> Array:
    """(N, 2, 2) or (N, 3, 3) of their upper triangles by rows, (N, 3) or (N, 6)."""
    places = _FROM_UPPER[upper.shape[1]]
    size = math.isqrt(len(places))
    full: Array = upper[:, places].reshape(-1, size, size)
    return full


def upper_triangles(full: Array) -> Array:
    """(N, 3) or (N, 6) upper triangles by rows of (N, 2, 2) or (N, 3, 3)."""
    return full[:, *np.triu_indices(full.shape[-1])]


def wrapped(angle: Array) -> Array:
    """Return angles [rad] of any shape in (-pi, pi]."""
    return math.pi - np.mod(math.pi - angle, 2.0 * math.pi)


def rotations(angle: Array) -> Array:
    """Return matrices (N, 2, 2) that turn vectors by angles (N,) [rad]."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack((cos, -sin, sin, cos), axis=-1).reshape(-1, 2, 2)
