"""A Gaussian low-pass over the cells of a region (Nieto 2005, section 6.3.3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.geometry import Array
from ekf_reference.dense.layers.occupancy import RegionGrid

_SIGMAS = 3.0
_LEAST_INSIDE = 0.5


@dataclass(frozen=True)
class LowPass:
    """A Gaussian over a region's skewed cells.

    spectrum: of the kernel, over `size` cells so that nothing comes round from the other side.
    inside: the kernel's weight within the region at every cell, by which results are divided, so
    that along an edge the average is over the inside alone; at least half of the whole: in a
    corner few cells are left, and their noise would pass. cell_m2: area of a cell.
    """

    spectrum: NDArray[np.complex128]
    size: tuple[int, int]
    inside: Array
    cell_m2: float

    @classmethod
    def over(cls, grid: RegionGrid, triangle: Array, sigma_m: float) -> LowPass:
        """For a region's grid and triangle (3, 2) [m]."""
        axes = (triangle[1:] - triangle[0]) / np.array(grid.cells)[:, None]
        # |w_1 a_1 + w_2 a_2| <= r needs |w_i| <= r times the length of the dual axis
        reach = np.linalg.norm(np.linalg.inv(axes), axis=0) * _SIGMAS * sigma_m
        half = np.minimum(np.ceil(reach).astype(int), grid.cells)
        size = (grid.cells[0] + int(half[0]), grid.cells[1] + int(half[1]))
        steps = [np.arange(-h, h + 1) for h in half.tolist()]
        i, j = np.meshgrid(*steps, indexing="ij")
        offset = i[..., None] * axes[0] + j[..., None] * axes[1]
        weight = np.exp(-0.5 * np.square(offset).sum(axis=-1) / sigma_m**2)
        kernel = np.zeros(size)
        np.add.at(kernel, (i % size[0], j % size[1]), weight / weight.sum())
        spectrum, area_m2 = np.fft.rfft2(kernel), abs(float(np.linalg.det(axes)))
        whole = cls(spectrum, size, np.ones(grid.place.shape), area_m2)
        inside = whole((grid.place >= 0).astype(float))
        return replace(whole, inside=np.maximum(inside, _LEAST_INSIDE))

    def __call__(self, value: Array) -> Array:
        """The average around every cell, of values over the region's cells (along a, along b)."""
        rows, columns = value.shape
        smooth = np.fft.irfft2(np.fft.rfft2(value, self.size) * self.spectrum, self.size)
        average: Array = smooth[:rows, :columns] / self.inside
        return average
