"""Corners of what stands in an occupancy grid (Nieto 2005, sections 6.1.1 and 6.1.3).

The thesis gives no formula. Here it is that of Harris and Stephens 1988, R = det M - k (trace M)^2
of the gradients' products, M, averaged over a window.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from ekf_reference.core.geometry import Array, Index

_GRADIENT_M = 0.3
"""Sigma at which derivatives are taken; in metres, so that it holds for every resolution."""
_WINDOW_M = 0.8
"""Sigma of the window over which their products are averaged."""
_APART_M = 2.0
"""Of two corners nearer than that, the stronger counts."""
_BLOCK = 12
"""Size in window sigmas of the block whose corner sets the scale."""


def harris(occupied: Array, cell_m: float, trace: float = 0.06, least: float = 0.01) -> Array:
    """Corners (C, 2) [m] of an occupancy grid, the strongest first.

    Each lies at the peak of the parabolas through the response at a cell and its neighbours.

    Args:
        occupied: (I, J) cells from 0, free or unknown, to 1. What touches the border goes on
            beyond it. Rows go along the first axis of the points, the first cell's centre is 0.
        cell_m: size of a cell.
        trace: k.
        least: response of the weakest corner over that of a solid block's right angle; walls as
            thin as scans draw them have 0.1 and more there, and 0.02 to 0.05 where they end.
    """
    height = _response(occupied, cell_m, trace) / _of_a_block(cell_m, trace)
    peak = (height == maximum_filter(height, 3, mode="nearest")) & (height >= least)
    peak[[0, -1]] = peak[:, [0, -1]] = False
    row = np.argwhere(peak)
    row = row[np.argsort(-height[peak], kind="stable")]
    point = cell_m * (row + _offset(height, row))
    corner: Array = point[_apart(point, _APART_M)]
    return corner


def _response(value: Array, cell_m: float, trace: float) -> Array:
    fine, window = _GRADIENT_M / cell_m, _WINDOW_M / cell_m
    first = gaussian_filter(value, fine, order=(1, 0), mode="nearest")
    second = gaussian_filter(value, fine, order=(0, 1), mode="nearest")
    xx, xy, yy = (
        gaussian_filter(product, window, mode="nearest")
        for product in (first * first, first * second, second * second)
    )
    response: Array = xx * yy - xy * xy - trace * np.square(xx + yy)
    return response


@lru_cache
def _of_a_block(cell_m: float, trace: float) -> float:
    """Response at the right angle of a solid block."""
    half = max(int(_BLOCK * max(_WINDOW_M, _GRADIENT_M) / cell_m), 4)
    block = np.zeros((2 * half, 2 * half))
    block[half:, half:] = 1.0
    return float(_response(block, cell_m, trace).max())


def _apart(point: Array, least_m: float) -> Index:
    """Of points (C, 2), the first first, those not near to one chosen before; (k,)."""
    chosen: list[int] = []
    for i, place in enumerate(point):
        if not chosen or np.square(point[chosen] - place).sum(axis=1).min() >= least_m**2:
            chosen.append(i)
    return np.array(chosen, dtype=np.intp)


def _offset(height: Array, row: Index) -> Array:
    """(C, 2) how far in cells the peaks lie from the middles of their cells."""
    here = height[tuple(row.T)]
    offset = np.zeros((len(row), 2))
    for axis in range(2):
        step = np.eye(2, dtype=np.intp)[axis]
        before, after = height[tuple((row - step).T)], height[tuple((row + step).T)]
        bend = before - 2.0 * here + after
        curved = bend < 0.0
        slope = 0.5 * (before - after)
        offset[curved, axis] = np.clip(slope[curved] / bend[curved], -0.5, 0.5)
    return offset
