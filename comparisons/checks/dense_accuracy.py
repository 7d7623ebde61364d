"""How far what a dense map holds lies from the true surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.runs.estimate import Array
from ekf_reference.dense.layers.layer import Samples

OCCUPIED = 0.8
"""The thesis draws cells above this (Nieto 2005, Fig. 4.3)."""
_AT_ONCE = 4_000_000


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
    """(N,) from points (N, 2) to the nearest of segments (S, 4) [m]."""
    start, way = segment[:, :2], segment[:, 2:] - segment[:, :2]
    length = np.maximum(np.square(way).sum(axis=1), 1e-18)
    nearest = []
    for part in np.array_split(point, max(1, len(point) * len(segment) // _AT_ONCE)):
        apart = part[:, None] - start
        along = np.clip((apart * way).sum(axis=2) / length, 0.0, 1.0)
        off = apart - along[..., None] * way
        nearest.append(np.sqrt(np.square(off).sum(axis=2).min(axis=1)))
    result: Array = np.concatenate(nearest)
    return result
