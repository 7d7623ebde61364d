"""Alignment by correlation with an occupancy grid (Nieto 2005, section 5.3, [19, 76, 71]).

The method that the thesis names beside ICP and sums of Gaussians, to compare them with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.dense.layers.classic_grid import ClassicGrid
from ekf_reference.dense.scan import Scan
from ekf_reference.scan_matching.search import Lattice, Picture

_OCCUPIED = 0.5
"""Cells less likely occupied than that, or unknown, count for nothing."""
_ROUNDS = 3


@dataclass(frozen=True)
class GridAlignment:
    """pose: (3,) of the points' frame in the grid's. score: mean occupancy that they fall on."""

    pose: Array
    score: float


def correlate(
    point: Array, scan: Scan, guess: Array, covariance: Array, resolution_m: float = 0.2
) -> GridAlignment:
    """The pose, among many about a guess, at which points (N, 2) fall on the most occupied cells.

    scan: becomes the grid, as one look at it does. The pose space is sampled a cell apart over
    2.5 sigmas of the guess's covariance (3, 3), wider where that would be too many, and about the
    best again, each round three times as finely; no finer than the grid it is drawn from
    warrants. Raises ValueError where one of the two is empty.
    """
    if not len(point) or not len(scan.range_m):
        raise ValueError("a scan has no returns")
    grid = ClassicGrid(resolution_m)
    grid.fuse(scan)
    seen = grid.samples()
    low, high = seen.point.min(axis=0), seen.point.max(axis=0)
    occupied = np.where(seen.occupancy > _OCCUPIED, seen.occupancy, 0.0)
    corner = low - 0.5 * resolution_m
    picture = Picture.of(seen.point, occupied, corner, high, resolution_m)
    weight = np.full(len(point), 1.0 / len(point))
    lever = float(np.sqrt(np.square(point - point.mean(axis=0)).sum(axis=1).mean()))
    best, spread, spacing = np.asarray(guess, dtype=float), covariance, resolution_m
    score = 0.0
    for _ in range(_ROUNDS):
        pose = Lattice.over(best, spread, spacing, lever).pose
        value = picture.scores(point, weight, pose)
        row = int(np.argmax(value))
        best, score = pose[row], float(value[row])
        unit = np.array((1.0, 1.0, 1.0 / max(lever, resolution_m)))
        spread = np.diag((0.6 * spacing * unit) ** 2)
        spacing /= 3.0
    return GridAlignment(best, score)
