"""Corners of what stands in an occupancy grid (Nieto 2005, sections 6.1.1 and 6.1.3).

The thesis runs "a Harris corner detector", without its formula or its settings. Here it is that of
Harris and Stephens 1988: R = det M - k (trace M)^2 of the gradients' products, M, averaged over a
window. The trace takes away what has one direction only, so that a wall is no corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from ekf_reference.core.geometry import Array, Index

_BLOCK = 12
"""Size in window sigmas of the block whose corner sets the scale."""


@dataclass(frozen=True)
class HarrisOptions:
    """Scales in metres, so that they hold for every resolution.

    gradient_m: sigma at which derivatives are taken. window_m: sigma of the window over which
    their products are averaged. trace: k. least: response of the weakest corner over that of a
    solid block's right angle; walls as thin as scans draw them have 0.1 and more there, and 0.02
    to 0.05 where they end. apart_m: of two corners nearer than that, the stronger counts.
    """

    gradient_m: float = 0.3
    window_m: float = 0.8
    trace: float = 0.06
    least: float = 0.01
    apart_m: float = 2.0

    def __post_init__(self) -> None:
        """Check the numbers."""
        scales = self.gradient_m, self.window_m, self.least, self.apart_m
        if not (all(s > 0.0 for s in scales) and 0.0 <= self.trace < 0.25):
            raise ValueError(f"scales {scales} must be above zero and k {self.trace} below 0.25")


class Corners(NamedTuple):
    """The strongest first. point: (C, 2) [m] in the grid's axes, the first cell's centre being 0.

    response: (C,) over that of a solid block's right angle.
    """

    point: Array
    response: Array


def harris(occupied: Array, cell_m: float, options: HarrisOptions | None = None) -> Corners:
    """Corners of a grid (I, J) of cells from 0, free or unknown, to 1, occupied.

    Rows go along the first axis of the points. What touches the grid's border goes on beyond it.
    A place is that of the peak of the parabolas through the response at a cell and its neighbours.
    """
    o = options or HarrisOptions()
    height = _response(occupied, cell_m, o) / _of_a_block(cell_m, o)
    peak = (height == maximum_filter(height, 3, mode="nearest")) & (height >= o.least)
    peak[[0, -1]] = peak[:, [0, -1]] = False
    row = np.argwhere(peak)
    row = row[np.argsort(-height[peak], kind="stable")]
    point = cell_m * (row + _offset(height, row))
    kept = _apart(point, o.apart_m)
    return Corners(point[kept], height[tuple(row[kept].T)])


def _response(value: Array, cell_m: float, o: HarrisOptions) -> Array:
    fine, window = o.gradient_m / cell_m, o.window_m / cell_m
    first = gaussian_filter(value, fine, order=(1, 0), mode="nearest")
    second = gaussian_filter(value, fine, order=(0, 1), mode="nearest")
    xx, xy, yy = (
        gaussian_filter(product, window, mode="nearest")
        for product in (first * first, first * second, second * second)
    )
    response: Array = xx * yy - xy * xy - o.trace * np.square(xx + yy)
    return response


@lru_cache
def _of_a_block(cell_m: float, o: HarrisOptions) -> float:
    """Response at the right angle of a solid block."""
    half = max(int(_BLOCK * max(o.window_m, o.gradient_m) / cell_m), 4)
    block = np.zeros((2 * half, 2 * half))
    block[half:, half:] = 1.0
    return float(_response(block, cell_m, o).max())


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
