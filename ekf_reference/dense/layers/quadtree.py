"""A grid as a quadtree: four squares become one where their occupancies are alike.

What a classic grid needs for a resolution that differs from place to place (Nieto 2005, section
4.1.3, "unless quadtree maps are implemented").
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array

_LEVELS = 12
"""Largest side: so many times doubled."""


class Quadtree(NamedTuple):
    """Leaves: west, south corners (M, 2) [m], sides (M,) [m] and mean occupancies (M,)."""

    corner: Array
    side_m: Array
    occupancy: Array


def quadtree(center: Array, occupancy: Array, cell_m: float, most: float) -> Quadtree:
    """Merge cells bottom up.

    Args:
        center: (N, 2) middles [m] of square cells, whose lattice has a corner at 0, 0.
        occupancy: (N,) of each.
        cell_m: side of a cell.
        most: largest difference of the occupancies within a leaf.
    """
    at = np.floor(center / cell_m).astype(np.int64)
    low = high = total = occupancy
    leaves = []
    for level in range(_LEVELS + 1):
        parent, child, count = np.unique(at >> 1, axis=0, return_inverse=True, return_counts=True)
        child = child.ravel()
        least, largest = np.full(len(parent), np.inf), np.full(len(parent), -np.inf)
        np.minimum.at(least, child, low)
        np.maximum.at(largest, child, high)
        whole = (count == 4) & (largest - least <= most) & (level < _LEVELS)
        kept = ~whole[child]
        side = cell_m * 2**level
        leaves.append((at[kept] * side, np.full(kept.sum(), side), total[kept] / 4**level))
        if not whole.any():
            break
        total = np.bincount(child, total, len(parent))[whole]
        at, low, high = parent[whole], least[whole], largest[whole]
    return Quadtree(*(np.concatenate(part) for part in zip(*leaves, strict=True)))
