"""How far what a dense map holds lies from the true surfaces."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from comparisons.arrays import Array
from comparisons.figures import Figure, Less
from comparisons.words import Row
from ekf_reference.dense.layers.layer import LayerSamples

OCCUPIED = 0.8
"""The thesis draws cells above this (Nieto 2005, Fig. 4.3)."""
_STEP_M = 0.5


@dataclass(frozen=True)
class SurfaceError:
    """Distance of what is occupied from true surfaces; no number where nothing is occupied.

    Attributes:
        median_m: median.
        p95_m: 95 % quantile.
        occupied: cells or points that were measured.
    """

    median_m: Less[Figure]
    p95_m: Less[Figure]
    occupied: int


def surface_error_rows(errors: Mapping[str, SurfaceError]) -> list[Row]:
    """Return how far what is occupied is from true surfaces."""
    return [
        Row("Distance to true surfaces", f"{name}, {part}", f"{value:.3f} m")
        for name, error in errors.items()
        for part, value in (("median", error.median_m), ("95 %", error.p95_m))
        if math.isfinite(value)
    ]


def surface_error(samples: LayerSamples, segment: Array) -> SurfaceError:
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
    """(N,) from points (N, 2) to the nearest of segments (S, 4) [m], exactly.

    Marks along the segments, at most _STEP_M apart, tell which of them can be the nearest.
    """
    start, way = segment[:, :2], segment[:, 2:] - segment[:, :2]
    length = np.linalg.norm(way, axis=1)
    count = np.ceil(length / _STEP_M).astype(np.intp) + 1
    owner = np.repeat(np.arange(len(segment)), count)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    share = place / np.maximum(count - 1, 1)[owner]
    marks = cKDTree(start[owner] + share[:, None] * way[owner])
    reach = marks.query(point)[0] + 0.5 * _STEP_M
    near = marks.query_ball_point(point, reach)
    counts = np.array([len(marked) for marked in near], dtype=np.intp)
    which = owner[np.concatenate([*near, []]).astype(np.intp)]
    apart = np.repeat(point, counts, axis=0) - start[which]
    square = np.maximum(np.square(length[which]), 1e-18)
    along = np.clip((apart * way[which]).sum(axis=1) / square, 0.0, 1.0)
    off = np.linalg.norm(apart - along[:, None] * way[which], axis=1)
    return np.minimum.reduceat(off, np.cumsum(counts) - counts)
