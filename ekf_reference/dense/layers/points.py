"""Layers of points at local coordinates; the plainest keeps the returns (Nieto 2005, 3.9)."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.layers.layer import Hits, LayerSamples, in_world
from ekf_reference.dense.region_store import RegionRows, RegionStore
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan
from ekf_reference.dense.triangles import is_degenerate


class PointLayer:
    """Points in regions, each a row of numbers of which alpha and beta come first."""

    def __init__(self, width: int, reach_m: float) -> None:
        """width: numbers in a row. reach_m: how far around a point its occupancy holds.

        Raises ValueError for a reach that is not above zero.
        """
        if not reach_m > 0.0:
            raise ValueError(f"the distance is {reach_m} m, it must be above zero")
        self._store, self._reach_m = RegionStore(width), reach_m

    def __len__(self) -> int:
        """Number of points."""
        return len(self._store)

    def samples(self, placed: RegionsAtMap, regions: Index | None = None) -> LayerSamples:
        """All points, or those in distinct regions (r,)."""
        region, value = self._store.gather(regions)
        return LayerSamples(in_world(placed, region, value[:, :2]), self._occupied(value), region)

    def occupancy(self, point: Array, placed: RegionsAtMap) -> Array:
        """(N,) occupancy of the nearest sample within reach, NaN where there is none.

        Samples of all regions count in which any of the points (N, 2) [m] are.
        """
        found = placed.locate(point).region
        inside = np.flatnonzero(found >= 0)
        known = self.samples(placed, np.unique(found[inside]))
        result = np.full(len(point), np.nan)
        if len(known.point) and len(inside):
            tree = cKDTree(known.point)
            distance, nearest = tree.query(point[inside], distance_upper_bound=self._reach_m)
            met = np.isfinite(distance)
            result[inside[met]] = known.occupancy[nearest[met]]
        return result

    def _occupied(self, value: Array) -> Array:
        """(N,) occupancy of rows (N, w): returns are occupied for certain."""
        return np.ones(len(value))

    def _placed(self, placed: RegionsAtMap, regions: Index) -> tuple[RegionRows, Array]:
        """The rows of those of some regions (r,) that have an area now, and their points (n, 2)."""
        rows = self._store.gather(regions[~is_degenerate(placed.triangle[regions])])
        return rows, in_world(placed, rows.region, rows.value[:, :2])


class AllReturns(PointLayer):
    """Keeps every return; a return says nothing about free space."""

    def __init__(self, resolution_m: float = 0.2) -> None:
        """resolution_m: how near a point is to a return that counts as occupied."""
        super().__init__(2, resolution_m)

    def fuse(self, hits: Hits, placed: RegionsAtMap, scan: Scan | None, near: Index) -> None:
        """Append the returns."""
        self._store.append(hits.region, hits.local)
