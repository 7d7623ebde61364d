"""A scan or a template as a sum of Gaussians (Nieto 2005, sections 4.3.1 and 5.2.1)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ekf_reference.core.geometry import Array, Index, Mask, rotation

Complex = NDArray[np.complex128]

_OFF_ROUND = 0.381966
"""Of a cell, from the origin to the next border: no round coordinate lies on a border, where the
last digit would tell the cell."""


@dataclass(frozen=True)
class SumOfGaussians:
    """Weighted Gaussians of one frame: a shape, not a distribution (Nieto 2005, 4.3, eq. 4.14).

    mean: (N, 2) [m]. covariance: (N, 2, 2) [m^2]. weight: (N,) alpha, positive, of sum one.
    boundary: (N,) at an end of the view, where the surface goes on unseen.
    """

    mean: Array
    covariance: Array
    weight: Array
    boundary: Mask

    @classmethod
    def of_equal_height(
        cls, mean: Array, covariance: Array, boundary: Mask | None = None
    ) -> SumOfGaussians:
        """Alpha_i in proportion to sqrt((2 pi)^2 |P_i|), as in Nieto 2005, Fig. 4.11.

        Raises ValueError for numbers that are not finite, shapes that do not fit, or covariances
        that are not positive definite. boundary: none by default.
        """
        mean, covariance = np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float)
        if mean.ndim != 2 or mean.shape[1] != 2 or covariance.shape != (len(mean), 2, 2):
            raise ValueError(
                f"means {mean.shape} and covariances {covariance.shape}, "
                "expected (N, 2) and (N, 2, 2)"
            )
        area = np.linalg.det(covariance)
        positive = (area > 0.0) & (covariance[:, 0, 0] > 0.0)
        if not (np.isfinite(mean).all() and positive.all()):
            raise ValueError("a mean is not finite or a covariance not positive definite")
        height = np.sqrt(area)
        weight = height / (height.sum() if len(height) else 1.0)
        return cls(
            mean, covariance, weight, np.zeros(len(mean), bool) if boundary is None else boundary
        )

    def __len__(self) -> int:
        """Number of Gaussians."""
        return len(self.mean)

    @cached_property
    def tree(self) -> cKDTree:
        """The means, to look for neighbours."""
        return cKDTree(self.mean)

    @cached_property
    def point(self) -> Complex:
        """(N,) the means as x + i y [m]."""
        return np.asarray(self.mean[:, 0] + 1j * self.mean[:, 1])

    @cached_property
    def half_trace(self) -> Array:
        """(N,) (xx + yy) / 2 of the covariances [m^2]."""
        return np.asarray(0.5 * (self.covariance[:, 0, 0] + self.covariance[:, 1, 1]))

    @cached_property
    def deviator(self) -> Complex:
        """(N,) (xx - yy) / 2 + i xy of the covariances [m^2]: what makes them ellipses."""
        half = 0.5 * (self.covariance[:, 0, 0] - self.covariance[:, 1, 1])
        return np.asarray(half + 1j * self.covariance[:, 0, 1])

    @cached_property
    def larger(self) -> Array:
        """(N,) variances along the longer axes [m^2]."""
        return np.asarray(self.half_trace + np.abs(self.deviator))

    @cached_property
    def _thinned(self) -> dict[float, SumOfGaussians]:
        return {}

    @cached_property
    def centroid(self) -> Array:
        """(2,) mean of the points, the local axis of section 5.2.3 [m]; zeros where none."""
        return self.mean.mean(axis=0) if len(self) else np.zeros(2)

    @cached_property
    def lever_m(self) -> float:
        """Root mean square distance of the means from the centroid, per heading [m/rad]."""
        if not len(self):
            return 0.0
        return float(np.sqrt(np.square(self.mean - self.centroid).sum(axis=1).mean()))

    @cached_property
    def typical_variance(self) -> float:
        """The larger one that nine Gaussians in ten stay below [m^2]."""
        larger = np.sort(2.0 * self.half_trace)
        return float(larger[int(0.9 * (len(self) - 1))]) if len(self) else 0.0

    def transformed(self, pose: Array) -> SumOfGaussians:
        """The same in the frame in which this one's lies at pose (3,): x, y [m], heading [rad]."""
        turn = rotation(float(pose[2]))
        mean = self.mean @ turn.T + pose[:2]
        return SumOfGaussians(mean, turn @ self.covariance @ turn.T, self.weight, self.boundary)

    def take(self, rows: Index | Mask) -> SumOfGaussians:
        """Some of them, their weights adding up to one again."""
        weight = self.weight[rows]
        total = weight.sum() if len(weight) else 1.0
        return SumOfGaussians(
            self.mean[rows], self.covariance[rows], weight / total, self.boundary[rows]
        )

    def value(self, point: Array) -> Array:
        """G (M,) of Nieto 2005, eqs. 4.13 and 4.14, at points (M, 2) [1/m^2]."""
        apart = point[:, None, :] - self.mean
        inverse = np.linalg.inv(self.covariance)
        square = np.einsum("mni,nij,mnj->mn", apart, inverse, apart)
        peak = self.weight / (2.0 * np.pi * np.sqrt(np.linalg.det(self.covariance)))
        height: Array = np.exp(-0.5 * square) @ peak
        return height

    def thinned(self, cell_m: float) -> SumOfGaussians:
        """One Gaussian for those in each cell of a grid, with their mean, covariance and weight.

        Worked out once for each size of cells. Boundaries are lost.
        """
        if cell_m not in self._thinned:
            self._thinned[cell_m] = self._in_cells(cell_m) if len(self) else self
        return self._thinned[cell_m]

    def _in_cells(self, cell_m: float) -> SumOfGaussians:
        cell = np.floor(self.mean / cell_m + _OFF_ROUND).astype(np.int64)
        cell -= cell.min(axis=0)
        _, row = np.unique(cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1], return_inverse=True)
        total = np.bincount(row, weights=self.weight).astype(float)

        def average(value: Array) -> Array:
            return np.asarray(np.bincount(row, weights=self.weight * value) / total)

        mean = np.stack([average(column) for column in self.mean.T], axis=1)
        apart = self.mean - mean[row]
        spread = self.covariance + apart[:, :, None] * apart[:, None, :]
        xx, xy, yy = (average(spread[:, i, j]) for i, j in ((0, 0), (0, 1), (1, 1)))
        flat = np.stack((xx, xy, xy, yy), axis=1)
        none = np.zeros(len(total), dtype=bool)
        return SumOfGaussians(mean, flat.reshape(-1, 2, 2), total, none)
