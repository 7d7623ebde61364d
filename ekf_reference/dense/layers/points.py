"""The returns themselves, at their local coordinates (Nieto 2005, section 3.9)."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.layers.layer import Hits, Layer, Samples, in_world
from ekf_reference.dense.placed_regions import PlacedRegions
from ekf_reference.dense.region_store import RegionStore
from ekf_reference.dense.scan import Scan


class Points:
    """Keeps every return. resolution_m: how near a point is to one that counts as occupied."""

    def __init__(self, resolution_m: float = 0.2) -> None:
        """resolution_m: above zero."""
        self.resolution_m = resolution_m
        self._store = RegionStore(2)

    def fuse(self, hits: Hits, placed: PlacedRegions, scan: Scan | None, near: Index) -> None:
        """Append the returns."""
        self._store.append(hits.region, hits.local)

    def samples(self, placed: PlacedRegions, regions: Index | None = None) -> Samples:
        """Every return, occupied for certain."""
        region, local = self._store.gather(self._store.regions if regions is None else regions)
        return Samples(in_world(placed, region, local), np.ones(len(region)), region)

    def occupancy(self, point: Array, placed: PlacedRegions) -> Array:
        """1 within resolution_m of a return, NaN elsewhere: returns say nothing about free space.

        Only returns in the point's own region count.
        """
        return from_nearest(self, point, placed, self.resolution_m)


def from_nearest(layer: Layer, point: Array, placed: PlacedRegions, reach_m: float) -> Array:
    """(N,) occupancy of the nearest sample within reach, in any region the points are in."""
    found = placed.locate(point).region
    inside = np.flatnonzero(found >= 0)
    known = layer.samples(placed, np.unique(found[inside]))
    result = np.full(len(point), np.nan)
    if len(known.point) and len(inside):
        distance, nearest = cKDTree(known.point).query(point[inside], distance_upper_bound=reach_m)
        met = np.isfinite(distance)
        result[inside[met]] = known.occupancy[nearest[met]]
    return result
