"""The filter's dense map against the same scans placed by the smoother's trajectory.

The two maps share nothing but the log: one is anchored to the filter's landmarks, the other to the
smoother's poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from comparisons.adapters.motion import poses_at
from comparisons.arrays import Array
from comparisons.estimates.estimate import Estimate
from comparisons.extensions.dense_maps.accuracy import (
    OCCUPIED,
    SurfaceError,
    error_of_points,
    surface_error,
    surface_error_rows,
)
from comparisons.extensions.dense_maps.source import DenseRun, classic_grid
from comparisons.figures import METRES, Aside, Less, More, Named, percent, rows_of
from comparisons.logs.log import Log
from comparisons.words import Cause, Row
from ekf_reference.dense.layers.classic_grid import ClassicGrid
from ekf_reference.dense.layers.layer import LayerSamples
from ekf_reference.dense.regions_at_map import RegionsAtMap

AGREE_M = 0.3
"""Two maps agree when half of what the one holds is no farther than this from the other, in all
and in every region that holds enough."""
_ENOUGH = _LISTED = 20
_MET = "regions that met the first condition by"
_DECIDED = (0.35, 0.65)
"""A cell below is free, one above occupied."""


@dataclass(frozen=True, kw_only=True)
class LayerAgreement:
    """A layer of the filter's dense map, compared with the returns at the smoother's poses.

    Attributes:
        samples: cells, points or Gaussians that were compared.
        median_m: median distance from the nearest return.
        p95_m: 95 % quantile of it.
        missed_m: median distance from the smoother's returns, inside regions, to the layer: what it
            misses.
        point: (N, 2) the samples.
        distance_m: (N,) theirs.
    """

    samples: Annotated[int, Named("occupied samples")]
    median_m: Annotated[Less[float], Named("map to returns, median", METRES)]
    p95_m: Annotated[Less[float], Named("map to returns, 95 %", METRES)]
    missed_m: Annotated[Less[float], Named("returns to map, median", METRES)]
    point: Aside[Array]
    distance_m: Aside[Array]


@dataclass(frozen=True)
class RegionAgreement:
    """One region of one layer.

    Attributes:
        layer: name of the layer.
        region: number of the region.
        samples: samples that were compared.
        distance_m: median distance of the samples from the smoother's returns.
    """

    layer: str
    region: int
    samples: int
    distance_m: float


@dataclass(frozen=True)
class FirstCondition:
    """The first condition of regions (Nieto 2005, section 3.5) as the run had it.

    Attributes:
        rule: the rule, in words.
        regions: regions that were made.
        by_correlation: of these, regions all of whose pairs met it by their correlation at birth,
            the vehicle's position among them where a corner is virtual.
        by_relative_sigma: the others, which the thesis' rule refuses.
    """

    rule: Annotated[str, Named("first condition", "{}")]
    regions: Annotated[int, Named("regions")]
    by_correlation: Annotated[int, Named(f"{_MET} correlation")]
    by_relative_sigma: Annotated[int, Named(f"{_MET} relative sigma alone")]

    @classmethod
    def of(cls, dense: DenseRun) -> FirstCondition:
        """Return it, and how many met it in which way."""
        met = dense.dense.regions.by_correlation
        by, count = int(np.count_nonzero(met)), len(dense.dense.regions.base)
        return cls(dense.options.first_condition, count, by, int(np.count_nonzero(~met)))

    def rows(self) -> list[Row]:
        """Return the regions, and how many met the first condition in which way."""
        return rows_of("Regions of the dense map", self)


@dataclass(frozen=True, kw_only=True)
class DenseAgreement:
    """Entry `dense`: dense maps of filter and smoother.

    Attributes:
        agrees: whether the maps agree.
        first_condition: how the regions met the first condition.
        layers: each layer, by name.
        occupancy_share: of the cells that both maps decide, the share that they decide alike; None
            without an occupancy layer.
        regions: the worst regions first, at most twenty.
        surface_errors: distance from true surfaces, by layer, and of the `smoother`.
        median_m: of the worst layer.
        far: regions that differ by more than the limit.
        smoother_point: (M, 2) the smoother's returns inside regions.
    """

    agrees: bool
    first_condition: FirstCondition
    layers: dict[str, LayerAgreement]
    occupancy_share: Annotated[
        More[float | None], Named("occupancy: cells decided in both maps that are alike", percent)
    ]
    regions: tuple[RegionAgreement, ...]
    surface_errors: dict[str, SurfaceError]
    median_m: Aside[float]
    far: Aside[int]
    smoother_point: Aside[Array]

    def rows(self) -> list[Row]:
        """Return how far the filter's map is from the returns as the smoother places them."""
        rows, group = self.first_condition.rows(), "Dense map, EKF and smoother"
        for name, layer in self.layers.items():
            rows += rows_of(group, layer, before=f"{name}: ")
        return [*rows, *rows_of(group, self), *surface_error_rows(self.surface_errors)]


def compare_dense(log: Log, dense: DenseRun, smoothed: Estimate) -> DenseAgreement | None:
    """Compare all layers; None where no return fell into a region."""
    regions = dense.dense.regions
    by_filter = regions.placed(dense.landmark)
    by_smoother = regions.placed(dense.landmarks_of(smoothed))
    grid = classic_grid(dense.options)
    other = _returns(log, dense, smoothed, by_smoother, grid)
    layers, rows, errors = {}, [], {}
    surfaces = log.truth.surfaces
    for name, layer in dense.layers.items():
        samples = layer.samples(by_filter)
        if surfaces is not None:
            errors[name] = surface_error(samples, surfaces.segment)
        found = _against(samples, other)
        if found is not None:
            layers[name], each = found
            rows += [RegionAgreement(name, *row) for row in each]
    if not layers:
        return None
    if surfaces is not None:
        errors["smoother"] = error_of_points(other, surfaces.segment)
    share = None
    if "occupancy" in layers:
        layer_samples = grid.samples()
        mine = dense.dense.layers["occupancy"].occupancy(layer_samples.point, by_filter)
        share = _decided_alike(mine, layer_samples.occupancy)
    rows.sort(key=lambda row: -row.distance_m)
    median_m = max(layer.median_m for layer in layers.values())
    worst = rows[0].distance_m if rows else 0.0
    return DenseAgreement(
        agrees=bool(median_m <= AGREE_M and worst <= AGREE_M),
        first_condition=FirstCondition.of(dense),
        layers=layers,
        occupancy_share=share,
        regions=tuple(rows[:_LISTED]),
        surface_errors=errors,
        median_m=median_m,
        far=len({row.region for row in rows if row.distance_m > AGREE_M}),
        smoother_point=other,
    )


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
    samples: LayerSamples, other: Array
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
        samples=len(point),
        median_m=float(np.median(distance)),
        p95_m=float(np.percentile(distance, 95.0)),
        missed_m=float(np.median(missed)),
        point=point,
        distance_m=distance,
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
        evidence += (
            f"; {maps.far} regions differ by more than {AGREE_M:g} m, region {worst.region} most, "
            f"by {worst.distance_m:.2f} m ({worst.layer})"
        )
    return Cause(
        "dense",
        evidence,
        "check the landmarks at the corners of that region: they may have been uncertain relative "
        "to each other, or to the vehicle, when the scans were taken",
    )
