"""A scan or a template as a sum of Gaussians (Nieto 2005, sections 4.3.1 and 5.2.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ekf_reference.dense.scan import Scan, Sensor

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Flags = NDArray[np.bool_]

_NEXT = 1.5
"""Two returns are neighbours when so many beams or fewer apart."""
_NOISY = 3.0
"""Standard deviations by which ranges on one surface may differ beside its slope."""
_MEET = 0.5
"""Sigma of a piece of surface over its length, at which a row of pieces has an even height."""


@dataclass(frozen=True)
class SumOfGaussians:
    """Gaussians of one frame, weighted (Nieto 2005, eq. 4.14).

    mean: (N, 2) [m]. covariance: (N, 2, 2) [m^2]. weight: (N,) alpha, positive, of sum one where
    there are any. It is a shape, not a distribution of anything (section 4.3).
    """

    mean: Array
    covariance: Array
    weight: Array

    @classmethod
    def of_equal_height(cls, mean: Array, covariance: Array) -> SumOfGaussians:
        """Alpha_i in proportion to sqrt((2 pi)^2 |P_i|), as in Nieto 2005, Fig. 4.11.

        On pieces of surface that is in proportion to their lengths. Raises ValueError for
        numbers that are not finite, shapes that do not fit, or covariances that are not
        positive definite.
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
        return cls(mean, covariance, height / (height.sum() if len(height) else 1.0))

    def __len__(self) -> int:
        """Number of Gaussians."""
        return len(self.mean)

    @cached_property
    def tree(self) -> cKDTree:
        """The means, to look for neighbours."""
        return cKDTree(self.mean)

    @cached_property
    def centroid(self) -> Array:
        """(2,) mean of the points, the local axis of section 5.2.3 [m]; zeros where none."""
        return self.mean.mean(axis=0) if len(self) else np.zeros(2)

    @cached_property
    def lever_m(self) -> float:
        """Root mean square distance of the means from the centroid: a heading's worth [m/rad]."""
        if not len(self):
            return 0.0
        return float(np.sqrt(np.square(self.mean - self.centroid).sum(axis=1).mean()))

    def transformed(self, pose: Array) -> SumOfGaussians:
        """The same in the frame in which this one's lies at pose (3,): x, y [m], heading [rad]."""
        turn = rotation(float(pose[2]))
        return SumOfGaussians(
            self.mean @ turn.T + pose[:2], turn @ self.covariance @ turn.T, self.weight
        )

    def take(self, rows: Index | Flags) -> SumOfGaussians:
        """Some of them, their weights adding up to one again."""
        weight = self.weight[rows]
        total = weight.sum() if len(weight) else 1.0
        return SumOfGaussians(self.mean[rows], self.covariance[rows], weight / total)

    def value(self, point: Array) -> Array:
        """G (M,) of Nieto 2005, eqs. 4.13 and 4.14, at points (M, 2) [1/m^2]."""
        apart = point[:, None, :] - self.mean
        inverse = np.linalg.inv(self.covariance)
        square = np.einsum("mni,nij,mnj->mn", apart, inverse, apart)
        peak = self.weight / (2.0 * np.pi * np.sqrt(np.linalg.det(self.covariance)))
        height: Array = np.exp(-0.5 * square) @ peak
        return height

    def thinned(self, cell_m: float) -> SumOfGaussians:
        """One Gaussian for those in each cell of a grid, with their mean, covariance and weight."""
        if not len(self):
            return self
        cell = np.floor(self.mean / cell_m).astype(np.int64)
        _, row = np.unique(cell, axis=0, return_inverse=True)
        row = row.ravel()
        total = np.bincount(row, weights=self.weight)

        def average(value: Array) -> Array:
            return np.bincount(row, weights=self.weight * value) / total

        mean = np.stack([average(column) for column in self.mean.T], axis=1)
        apart = self.mean - mean[row]
        spread = self.covariance + apart[:, :, None] * apart[:, None, :]
        flat = np.stack([average(column) for column in spread.reshape(-1, 4).T], axis=1)
        return SumOfGaussians(mean, flat.reshape(-1, 2, 2), total)


def rotation(heading_rad: float) -> Array:
    """(2, 2) from the axes of a frame with that heading to those it is seen in."""
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    return np.array(((cos, -sin), (sin, cos)))


def of_scan(
    bearing_rad: Array, range_m: Array, sensor: Sensor, *, surface: bool = True
) -> SumOfGaussians:
    """The returns of a scan in the scanner's frame; beams (B,), those without return left out.

    Means and covariances are Nieto 2005, eqs. 4.15 and 4.16. surface: each return also stands
    for the surface between it and its neighbours on the same surface, and its Gaussian is so much
    longer. Without that two scans of one wall match where their returns fall on each other,
    which says where the beams went and nothing about the wall. A sensor with grazing_rad 0 has
    no neighbours.
    """
    scan = Scan.of_ranges(np.zeros(3), bearing_rad, range_m, sensor)
    covariance = scan.covariance
    if surface and len(scan.range_m) > 1:
        piece = _pieces(scan)
        covariance = covariance + _MEET**2 * piece[:, :, None] * piece[:, None, :]
    return SumOfGaussians.of_equal_height(scan.point, covariance)


def joined(bearing_rad: Array, range_m: Array, sensor: Sensor) -> Flags:
    """(B - 1,) whether a return (B,), in order of bearing, and the next lie on one surface.

    They do when they are next to each other and the surface between them is met at no less than
    the sensor's grazing angle, give or take the noise.
    """
    if not sensor.grazing_rad > 0.0:
        return np.zeros(max(len(range_m) - 1, 0), dtype=bool)
    turn = np.diff(bearing_rad)
    nearer = np.minimum(range_m[1:], range_m[:-1])
    steepest = nearer * turn / math.tan(sensor.grazing_rad)
    noise = _NOISY * math.sqrt(2.0) * sensor.sigma_range_m
    one: Flags = (turn <= _NEXT * sensor.beam_rad) & (np.abs(np.diff(range_m)) <= steepest + noise)
    return one


def _pieces(scan: Scan) -> Array:
    """(B, 2) the piece of surface that a return stands for: half the way to each neighbour."""
    one = joined(scan.bearing_rad, scan.range_m, scan.sensor)
    half = 0.5 * np.where(one[:, None], np.diff(scan.point, axis=0), 0.0)
    none = np.zeros((1, 2))
    piece: Array = np.vstack((half, none)) + np.vstack((none, half))
    return piece
