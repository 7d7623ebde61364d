"""What every layer of a dense map can do (Nieto 2005, chapter 4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan


class LateScan(NamedTuple):
    """Those returns of a scan that waited. near: (r,) regions in which it has not spoken yet."""

    scan: Scan
    near: Index


@dataclass(frozen=True, kw_only=True)
class Hits:
    """Returns in regions, from one scan or from several that waited for a region.

    region: (N,) never -1. local: (N, 2) alpha, beta. point: (N, 2) in the world [m] as the
    landmarks lie now. covariance: (N, 2, 2) of it within the region [m^2]. late: of returns that
    waited, the scans that they are of.
    """

    region: Index
    local: Array
    point: Array
    covariance: Array
    late: tuple[LateScan, ...] = ()


class LayerSamples(NamedTuple):
    """What a layer holds, in the world.

    point: (N, 2) [m]. occupancy: (N,) from 0, free, to 1. region: (N,).
    """

    point: Array
    occupancy: Array
    region: Index

    def chosen(self, rows: Index | NDArray[np.bool_]) -> LayerSamples:
        """Some of them. rows: numbers, or a mask (N,)."""
        return LayerSamples(self.point[rows], self.occupancy[rows], self.region[rows])


class Layer(Protocol):
    """One way to represent what was seen inside regions.

    A layer keeps local coordinates only; where its data is follows from the placed regions that
    it is given, so that it moves with the landmarks at no cost (Nieto 2005, section 3.7).
    """

    def fuse(self, hits: Hits, placed: RegionsAtMap, scan: Scan | None, near: Index) -> None:
        """Take in returns.

        scan: whose they are, for what it says about free space; None for late returns, whose scans
        hits.late has. near: (r,) regions that the scan may speak about.
        """

    def samples(self, placed: RegionsAtMap, regions: Index | None = None) -> LayerSamples:
        """All that the layer holds, or what it holds in distinct regions (r,)."""

    def occupancy(self, point: Array, placed: RegionsAtMap) -> Array:
        """(N,) how likely points (N, 2) [m] are occupied; NaN where the layer knows nothing."""


def in_world(placed: RegionsAtMap, region: Index, local: Array) -> Array:
    """Points (N, 2) [m] of local coordinates (N, 2) in regions (N,) (Nieto 2005, eq. 3.7)."""
    origin, a, b = placed.frames
    first, along_a, along_b = (f.take(region, axis=0) for f in (origin, a, b))  # faster than [ ]
    return first + local[:, :1] * along_a + local[:, 1:] * along_b
