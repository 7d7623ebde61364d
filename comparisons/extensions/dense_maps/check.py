"""The filter's dense map against the same scans placed by the smoother's trajectory.

The two maps share nothing but the log: one is anchored to the filter's landmarks, the other to the
smoother's poses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from comparisons.adapters.motion import poses_at
from comparisons.arrays import Array
from comparisons.checks.causes import Cause
from comparisons.estimates.estimate import Estimate
from comparisons.extensions.dense_maps.accuracy import (
    OCCUPIED,
    SurfaceError,
    error_of_points,
    surface_error,
)
from comparisons.extensions.dense_maps.source import DenseRun, grid_model
from comparisons.logs.log import Log
from ekf_reference.dense.layers.classic_grid import ClassicGrid
from ekf_reference.dense.layers.layer import Samples
from ekf_reference.dense.regions_at_map import RegionsAtMap

AGREE_M = 0.3
"""Two maps agree when half of what the one holds is no farther than this from the other, in all
and in every region that holds enough."""
_ENOUGH = 20
_DECIDED = (0.35, 0.65)
"""A cell below is free, one above occupied."""


@dataclass(frozen=True)
class LayerAgreement:
    """What a layer holds occupied, against the smoother's returns, as clouds.

    median_m, p95_m: distances of the layer's samples to the smoother's returns.
    missed_m: median distance of the smoother's returns, inside regions, to the layer's samples.
    point: (N, 2) the samples, distance_m: (N,).
    """

    median_m: float
    p95_m: float
    missed_m: float
    point: Array
    distance_m: Array


@dataclass(frozen=True)
class RegionAgreement:
    """One region of one layer: how many samples, and their median distance."""

    layer: str
    region: int
    samples: int
    distance_m: float


@dataclass(frozen=True)
class DenseAgreement:
    """Filter's dense map against the smoother's.

    layers: by name. regions: those with enough samples, the worst first. occupancy_share: of the
    cells that are decided in both maps, those decided alike; None without an occupancy layer.
    smoother_point: (M, 2) the smoother's returns inside regions. errors: of both against true
    surfaces, where the log has them: layers by name, and `smoother`.
    """

    layers: Mapping[str, LayerAgreement]
    regions: tuple[RegionAgreement, ...]
    occupancy_share: float | None
    smoother_point: Array
    errors: Mapping[str, SurfaceError]

    @property
    def median_m(self) -> float:
        """Of the worst layer."""
        return max((a.median_m for a in self.layers.values()), default=0.0)

    @property
    def agrees(self) -> bool:
        """Whether the maps agree."""
        worst = self.regions[0].distance_m if self.regions else 0.0
        return bool(self.median_m <= AGREE_M and worst <= AGREE_M)


def compare_dense(log: Log, dense: DenseRun, smoothed: Estimate) -> DenseAgreement | None:
    """Compare all layers; None where no return fell into a region."""
    regions = dense.dense.regions
    by_filter = regions.placed(dense.landmark)
    by_smoother = regions.placed(dense.landmarks_of(smoothed))
    grid = ClassicGrid(dense.options.resolution_m, grid_model(dense.options))
    other = _returns(log, dense, smoothed, by_smoother, grid)
    layers, rows, errors = {}, [], {}
    surfaces = log.truth.surfaces
    for name, layer in dense.layers.items():
        samples = layer.samples(by_filter)
        if surfaces is not None:
            errors[name] = surface_error(samples, surfaces.segment)
        found = _against(samples, other)
        if found is not None:
            layers[name], worst = found
            rows += [RegionAgreement(name, *row) for row in worst]
    if not layers:
        return None
    if surfaces is not None:
        errors["smoother"] = error_of_points(other, surfaces.segment)
    share = None
    if "occupancy" in layers:
        seen = grid.samples()
        mine = dense.dense.layers["occupancy"].occupancy(seen.point, by_filter)
        share = _decided_alike(mine, seen.occupancy)
    worst_first = tuple(sorted(rows, key=lambda row: -row.distance_m))
    return DenseAgreement(layers, worst_first, share, other, errors)


def _returns(
    log: Log, dense: DenseRun, smoothed: Estimate, placed: RegionsAtMap, grid: ClassicGrid
) -> Array:
    """(M, 2) all returns in regions, from the smoother's poses; the scans go into a grid, too."""
    seen = [np.empty((0, 2))]
    for number, vehicle in enumerate(poses_at(log, smoothed, dense.scan_time_s)):
        scan = dense.scans.scan(number, vehicle)
        grid.fuse(scan)
        seen.append(scan.point[placed.locate(scan.point).region >= 0])
    return np.concatenate(seen)


def _against(
    samples: Samples, other: Array
) -> tuple[LayerAgreement, list[tuple[int, int, float]]] | None:
    """A layer's samples against returns (M, 2), in all and by region."""
    occupied = np.flatnonzero(samples.occupancy > OCCUPIED)
    if not len(occupied) or not len(other):
        return None
    point, region = samples.point[occupied], samples.region[occupied]
    distance = cKDTree(other).query(point)[0]
    missed = cKDTree(point).query(other)[0]
    rows = []
    for number, count in zip(*np.unique(region, return_counts=True), strict=True):
        if count >= _ENOUGH:
            median = float(np.median(distance[region == number]))
            rows.append((int(number), int(count), median))
    agreement = LayerAgreement(
        float(np.median(distance)),
        float(np.percentile(distance, 95.0)),
        float(np.median(missed)),
        point,
        distance,
    )
    return agreement, rows


def _decided_alike(first: Array, second: Array) -> float | None:
    """Share of the cells, decided in both, that are free in both or occupied in both."""
    free, occupied = _DECIDED
    decided = [
        (np.nan_to_num(m, nan=0.5) < free, np.nan_to_num(m) > occupied) for m in (first, second)
    ]
    both = (decided[0][0] | decided[0][1]) & (decided[1][0] | decided[1][1])
    alike = (decided[0][0] & decided[1][0]) | (decided[0][1] & decided[1][1])
    return float(alike[both].mean()) if both.any() else None


def dense_cause(maps: DenseAgreement) -> Cause:
    """The dense maps of both."""
    evidence = f"the dense maps differ by {maps.median_m:.2f} m (median of the worst layer)"
    if maps.regions:
        worst = maps.regions[0]
        far = len({row.region for row in maps.regions if row.distance_m > AGREE_M})
        evidence += (
            f"; {far} regions differ by more than {AGREE_M:g} m, region {worst.region} most, by "
            f"{worst.distance_m:.2f} m ({worst.layer})"
        )
    return Cause(
        "dense",
        evidence,
        "check the landmarks at the corners of that region: they may have been uncertain relative "
        "to each other, or to the vehicle, when the scans were taken",
    )
