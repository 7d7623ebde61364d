"""What several experiments measure alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.accuracy import OCCUPIED
from comparisons.logs.log import Log
from comparisons.statistics import squared_distance
from ekf_reference.dense.layers.layer import LayerSamples

SHARE_WITHIN_3_SIGMA, THREE_SIGMA_SQUARED = 0.989, 9.0
"""Of a Gaussian in the plane: the share within 3 sigma, and the squared distance there."""


def rms(*values: Array) -> float:
    """Root mean square of all numbers of several arrays."""
    every = np.concatenate([np.ravel(value) for value in values])
    return float(np.sqrt(np.mean(np.square(every))))


def mean(values: NDArray[Any] | Sequence[float]) -> float:
    """NaN of none."""
    return float(np.mean(values)) if len(values) else float("nan")


def median(values: NDArray[Any] | Sequence[float]) -> float:
    """NaN of none."""
    return float(np.median(values)) if len(values) else float("nan")


def within_3_sigma(error: Array, covariance: Array) -> NDArray[np.bool_]:
    """(N,) which errors (N, 2) their covariances (N, 2, 2) explain."""
    inside: NDArray[np.bool_] = squared_distance(error, covariance) <= THREE_SIGMA_SQUARED
    return inside


def at_gps(log: Log, time_s: Array, pose: Array) -> tuple[Array, Array]:
    """(G, 2) places of a path at the times of GPS, and GPS. Raises InputError for a log without."""
    fixes = log.positions
    if fixes is None:
        raise InputError(f"{log.name}: holds no positions")
    inside = (fixes.time_s >= time_s[0]) & (fixes.time_s <= time_s[-1])
    at = [np.interp(fixes.time_s[inside], time_s, pose[:, k]) for k in (0, 1)]
    return np.column_stack(at), fixes.position_m[inside]


def off_gps(log: Log, time_s: Array, pose: Array) -> Array:
    """(G,) distances of a path to GPS at its times. Raises InputError for a log without."""
    at, fixes = at_gps(log, time_s, pose)
    away: Array = np.linalg.norm(at - fixes, axis=1)
    return away


def occupied(samples: LayerSamples) -> Array:
    """(N, 2) what a layer holds with a probability above 0.8."""
    point: Array = samples.point[samples.occupancy > OCCUPIED]
    return point


def near_share(point: Array, other: Array, reach_m: float) -> float:
    """Share of points (N, 2) with one of others (M, 2) within reach; NaN of none."""
    if not len(point):
        return float("nan")
    if not len(other):
        return 0.0
    return float(np.mean(cKDTree(other).query(point)[0] <= reach_m))
