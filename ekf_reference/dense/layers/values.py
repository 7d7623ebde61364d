"""A layer of one number that is measured with returns, such as intensity (Nieto 2005, 6.4)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.layers.layer import Hits
from ekf_reference.dense.layers.points import PointLayer
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan


class PlaceValues(NamedTuple):
    """What a layer holds around some places, in the values' unit.

    mean: (L,) and variance: (L,) of single returns from there, NaN where none is known. returns:
    (L,) how many these are.
    """

    mean: Array
    variance: Array
    returns: Array


class Values(PointLayer):
    """Mean and scatter of returns' values, in samples that keep local coordinates.

    d_min_m: a return joins the nearest sample so near; farther away it begins one. Returns without
    a value are left out.
    """

    def __init__(self, d_min_m: float = 0.1) -> None:
        """Raises ValueError for a distance that is not above zero."""
        super().__init__(5, d_min_m)  # alpha, beta, count, mean, sum of squares about it

    def fuse(self, hits: Hits, placed: RegionsAtMap, scan: Scan | None, near: Index) -> None:
        """Average in the values of returns, late ones as well."""
        if hits.value is None:
            return
        reported = np.flatnonzero(np.isfinite(hits.value))
        value, region = hits.value[reported], hits.region[reported]
        old, where = self._placed(placed, np.union1d(near, region))
        row = np.full(len(reported), len(where), dtype=np.intp)
        if len(where) and len(reported):
            row = cKDTree(where).query(hits.point[reported], distance_upper_bound=self._reach_m)[1]
        met = row < len(where)
        if met.any():
            old.value[:, 2:] = _pooled(old.value[:, 2:], row[met], value[met])
            self._store.put(old)
        rest = np.flatnonzero(~met)
        none = np.zeros(len(rest))
        columns = hits.local[reported[rest]], none + 1.0, value[rest], none
        self._store.append(region[rest], np.column_stack(columns))

    def around(self, point: Array, placed: RegionsAtMap, reach_m: float) -> PlaceValues:
        """Of all returns from within reach of points (L, 2) [m], whatever region they are in."""
        asked = np.where(np.isfinite(point).all(axis=1, keepdims=True), point, np.nan)
        box = np.concatenate((asked - reach_m, asked + reach_m), axis=1)
        near = np.unique(placed.tree.meeting(box).item)
        (region, value), where = self._placed(placed, near)
        known = np.flatnonzero(np.isfinite(point).all(axis=1))
        count, mean, square_sum = (np.zeros(len(point)) for _ in range(3))
        if len(region) and len(known):
            tree = cKDTree(where)
            for k, rows in zip(known, tree.query_ball_point(point[known], reach_m), strict=True):
                n, middle, apart = value[rows, 2:].T
                count[k] = n.sum()
                mean[k] = n @ middle / max(count[k], 1.0)
                square_sum[k] = apart.sum() + n @ (middle - mean[k]) ** 2
        seen = count > 0.0
        share = np.where(seen, count, 1.0)
        return PlaceValues(
            np.where(seen, mean, np.nan), np.where(seen, square_sum / share, np.nan), count
        )


def _pooled(kept: Array, row: Index, value: Array) -> Array:
    """Count, mean and sum of squares (n, 3) with values (k,) added to rows (k,); Chan's formula."""
    n, mean, square = kept.T
    size = len(kept)
    more = np.bincount(row, minlength=size)
    fresh = np.bincount(row, value, minlength=size) / np.maximum(more, 1)
    apart = np.bincount(row, (value - fresh[row]) ** 2, minlength=size)
    shift = np.where(more > 0, fresh - mean, 0.0)
    total = n + more
    return np.column_stack(
        (total, mean + shift * more / total, square + apart + shift**2 * n * more / total)
    )
