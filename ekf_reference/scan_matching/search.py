"""Starts of an alignment: poses all over a prior, scored on a coarse picture of the second sum.

As correlation with occupancy grids (Nieto 2005, section 5.3): the second sum, blurred, is drawn
once on a grid, and read at the first sum's means from many poses.
"""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.ndimage import gaussian_filter

from ekf_reference.core.geometry import Array
from ekf_reference.scan_matching.sog import SumOfGaussians

_SIGMAS = 2.5
"""How far the lattice of starts goes."""
_CELL = 0.6
"""Size of a cell over the blur."""
_BLURRED = 3.3
"""How far the picture goes beyond what is drawn in it, over the blur: no whole number of cells, so
that the outermost means do not lie on a border of cells, where the last digit would tell which."""
_CELLS = 2**20
_POSES = 2**13
_AT_ONCE = 2**18
"""Greatest number of readings of the picture at a time: its arrays stay in the cache."""
_WORTH = 0.6
"""Starts that promise less than so much of the best one's score are not followed."""
_EQUAL = 1e-6
"""Sizes of a prior's axes, over the greatest, that are equal. Of a round prior all axes are right,
and the last digit would choose: there the directions of x, y and heading do."""
_ORDER = np.array((1.0, 2.0, 4.0))
"""Of these directions, where axes or their signs are free."""
_APART = 1.8
"""Starts closer than so many steps of the lattice are one."""


@dataclass(frozen=True)
class Lattice:
    """Poses (n, 3) all over a prior, the same in steps, and how far the prior reaches."""

    pose: Array
    step: Array
    reach_m: float

    @classmethod
    def over(cls, guess: Array, covariance: Array, spacing_m: float, lever_m: float) -> Self:
        """Within 2.5 sigmas of a guess, no farther apart than a spacing at the lever's end.

        Where that would be too many the spacing is wider. The guess itself is one of them.
        """
        unit = np.array((1.0, 1.0, 1.0 / max(lever_m, spacing_m)))
        scaled = covariance / np.outer(unit, unit)
        size, axes = np.linalg.eigh(scaled)
        if np.diff(size).min() < _EQUAL * size[-1]:
            axes = np.linalg.eigh(scaled + _EQUAL * size[-1] * np.diag(_ORDER))[1]
        axes = axes * np.where(_ORDER @ axes < 0.0, -1.0, 1.0)
        reach = _SIGMAS * np.sqrt(np.maximum(size, 0.0))
        while True:
            count = np.floor(reach / spacing_m).astype(int)
            if np.prod(2.0 * count + 1.0) <= _POSES:
                break
            spacing_m *= 1.2
        ranges = [np.arange(-n, n + 1) for n in count.tolist()]
        step = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 3).astype(float)
        far = np.square(step * spacing_m / np.maximum(reach, spacing_m)).sum(axis=1)
        step = step[far <= 1.0]
        return cls(guess + spacing_m * step @ axes.T * unit, step, float(reach.max()))


def starts(
    first: SumOfGaussians, second: SumOfGaussians, lattice: Lattice, blur_m: float, most: int
) -> Array:
    """(k, 3) up to `most` poses of the lattice, best first, none in the basin of a better one."""
    if len(lattice.pose) == 1:
        return lattice.pose
    score = _scores(first, second, lattice.pose, blur_m)
    chosen: list[int] = []
    for row in np.argsort(-score, kind="stable").tolist():
        if score[row] <= _WORTH * score.max() or len(chosen) == most:
            break
        apart = np.square(lattice.step[chosen] - lattice.step[row]).sum(axis=1)
        if not chosen or apart.min() > _APART**2:
            chosen.append(row)
    return lattice.pose[chosen] if chosen else lattice.pose[len(lattice.pose) // 2][None]


def _scores(first: SumOfGaussians, second: SumOfGaussians, pose: Array, blur_m: float) -> Array:
    """(n,) the first sum's means, weighed, in the picture of the second."""
    reach = float(np.hypot(*first.mean.T).max())
    low = np.maximum(pose[:, :2].min(axis=0) - reach, second.mean.min(axis=0)) - _BLURRED * blur_m
    high = np.minimum(pose[:, :2].max(axis=0) + reach, second.mean.max(axis=0)) + _BLURRED * blur_m
    if (high <= low).any():
        return np.zeros(len(pose))
    cell = max(_CELL * blur_m, math.sqrt(float(np.prod(high - low)) / _CELLS))
    drawn = RasterImage.of(second.mean, second.weight, low, high, cell)
    blurred = gaussian_filter(drawn.value, blur_m / cell, mode="constant", truncate=2.5)
    return replace(drawn, value=blurred).scores(first.mean, first.weight, pose)


@dataclass(frozen=True)
class RasterImage:
    """value: (I, J) of square cells, the first with its corner at low (2,) [m]; 0 around them."""

    value: Array
    low: Array
    cell_m: float

    @classmethod
    def of(cls, point: Array, value: Array, low: Array, high: Array, cell_m: float) -> Self:
        """What points (N, 2) between two corners (2,) add to their cells."""
        shape = np.ceil((high - low) / cell_m).astype(int) + 1
        at = np.floor((point - low) / cell_m).astype(np.intp)
        inside = ((at >= 0) & (at < shape)).all(axis=1)
        flat = at[inside, 0] * shape[1] + at[inside, 1]
        added = np.bincount(flat, value[inside], minlength=int(np.prod(shape)))
        return cls(added.reshape(shape).astype(float), low, cell_m)

    def scores(self, point: Array, weight: Array, pose: Array) -> Array:
        """(n,) sums of weight (N,) times the value where points (N, 2) lie from poses (n, 3)."""
        shape = self.value.shape
        framed = np.zeros((shape[0] + 2, shape[1] + 2))
        framed[1:-1, 1:-1] = self.value
        result, scale = np.empty(len(pose)), 1.0 / self.cell_m
        rows = max(_AT_ONCE // len(point), 1)
        for begin in range(0, len(pose), rows):
            some = pose[begin : begin + rows]
            cos, sin = np.cos(some[:, 2:]), np.sin(some[:, 2:])
            x = cos * point[:, 0] - sin * point[:, 1] + (some[:, :1] - self.low[0])
            y = sin * point[:, 0] + cos * point[:, 1] + (some[:, 1:2] - self.low[1])
            i = np.clip(x * scale + 1.0, 0.0, shape[0] + 1.0).astype(np.intp)
            j = np.clip(y * scale + 1.0, 0.0, shape[1] + 1.0).astype(np.intp)
            i *= shape[1] + 2
            i += j
            result[begin : begin + rows] = framed.ravel().take(i) @ weight
        return result
