"""How far what a dense map holds lies from the true surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.runs.estimate import Array
from ekf_reference.dense.layers.layer import Samples

OCCUPIED = 0.8
"""The thesis draws cells above this (Nieto 2005, Fig. 4.3)."""
_AT_ONCE = 30_000
"""So many pairs of point and segment are tried at once: their arrays stay in the cache."""
_CELL_M = 4.0


@dataclass(frozen=True)
class SurfaceError:
    """Distances to the nearest true surface [m]; NaN where nothing is occupied.

    occupied: how many samples are above OCCUPIED.
    """

    median_m: float
    p95_m: float
    occupied: int


def surface_error(samples: Samples, segment: Array) -> SurfaceError:
    """Of the samples of a layer that are occupied. segment: (S, 4) as of Surfaces [m]."""
    return error_of_points(samples.point[samples.occupancy > OCCUPIED], segment)


def error_of_points(point: Array, segment: Array) -> SurfaceError:
    """Of points (N, 2) [m]."""
    if not len(point):
        return SurfaceError(np.nan, np.nan, 0)
    distance = distance_to_segments(point, segment)
    return SurfaceError(
        float(np.median(distance)), float(np.percentile(distance, 95.0)), len(point)
    )


def distance_to_segments(point: Array, segment: Array) -> Array:
    """(N,) from points (N, 2) to the nearest of segments (S, 4) [m]; NaN of what is not finite.

    Points are taken by cells. From anywhere in a cell, the nearest segment is at most a diagonal
    farther from the cell's centre than the one nearest to that, so few segments need be tried.
    """
    result = np.full(len(point), np.nan)
    finite = np.flatnonzero(np.isfinite(point).all(axis=1))
    cell, group = np.unique(
        np.floor(point[finite] / _CELL_M).astype(np.int64), axis=0, return_inverse=True
    )
    rows = np.split(finite[np.argsort(group.ravel(), kind="stable")], _ends(group.ravel()))
    center, diagonal = (cell + 0.5) * _CELL_M, 1.001 * np.sqrt(2.0) * _CELL_M
    for row, middle in zip(rows, center, strict=False):
        apart = _distances(middle[None], segment)[0]
        near = segment[apart <= apart.min() + diagonal]
        for part in np.array_split(row, len(row) * len(near) // _AT_ONCE + 1):
            result[part] = _distances(point[part], near).min(axis=1)
    return result


def _distances(point: Array, segment: Array) -> Array:
    """(N, S) of all points (N, 2) to all segments (S, 4)."""
    start, way = segment[:, :2], segment[:, 2:] - segment[:, :2]
    length = np.maximum(np.square(way).sum(axis=1), 1e-18)
    apart = point[:, None] - start
    along = np.clip((apart * way).sum(axis=2) / length, 0.0, 1.0)
    off = apart - along[..., None] * way
    distance: Array = np.sqrt(np.square(off).sum(axis=2))
    return distance


def _ends(group: NDArray[np.intp]) -> NDArray[np.intp]:
    """Where each group but the last ends, once they are in order."""
    return np.cumsum(np.bincount(group))[:-1]
