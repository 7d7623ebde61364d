"""Poses and places in the plane, many at once."""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array
from ekf_reference.core.geometry import wrap_angle


def pose_difference(first: Array, second: Array) -> Array:
    """Return first - second (K, 3), headings wrapped."""
    difference: Array = first - second
    difference[:, 2] = wrap_angle(difference[:, 2])
    return difference


def turned(place: Array, by: Array | float) -> Array:
    """Return vectors (N, 2), or one (2,), turned by angles (N,), or by one [rad]."""
    cos, sin, (x, y) = np.cos(by), np.sin(by), np.moveaxis(place, -1, 0)
    return np.column_stack((cos * x - sin * y, sin * x + cos * y))


def in_own_axes(departed: Array, arrived: Array) -> Array:
    """Return moves (N, 3) ahead, left and turned, between poses (N, 3)."""
    apart = arrived - departed
    return np.column_stack((turned(apart[:, :2], -departed[:, 2]), apart[:, 2]))


def rms(error: Array) -> float:
    """Return the root mean square length of vectors (K, d)."""
    return float(np.sqrt(np.square(error).sum(axis=1).mean()))
