"""Sides of closed polygons."""

from __future__ import annotations

import math

import numpy as np

from comparisons.arrays import Array


def sides(corner: Array) -> Array:
    """(K, 4) of a closed polygon (K, 2)."""
    return np.hstack((corner, np.roll(corner, -1, axis=0)))


def along_sides(corner: Array, spacing_m: float) -> Array:
    """Points (N, 2) evenly along the sides of a closed polygon (K, 2), at most a spacing apart."""
    pieces = []
    for start, end in sides(corner).reshape(-1, 2, 2):
        count = max(1, math.ceil(float(np.linalg.norm(end - start)) / spacing_m))
        pieces.append(start + np.arange(count)[:, None] / count * (end - start))
    return np.concatenate(pieces)
