"""Dense maps of both estimators as a part of `result.json`, and as rows for a terminal."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from comparisons.extensions.dense_maps.accuracy import SurfaceError
from comparisons.extensions.dense_maps.check import DenseAgreement
from comparisons.extensions.dense_maps.source import DenseRun
from comparisons.figures import Model, finite
from comparisons.words import Row

_LISTED = 20


def dense_result(check: DenseAgreement, dense: DenseRun) -> DenseResult:
    """Return the check's figures, and by which rule the filter's map got its regions."""
    return DenseResult(
        agrees=check.agrees,
        first_condition=first_condition_result(dense),
        layers={
            name: DenseLayerResult(
                samples=len(layer.point),
                median_m=layer.median_m,
                p95_m=layer.p95_m,
                missed_m=layer.missed_m,
            )
            for name, layer in check.layers.items()
        },
        occupancy_share=check.occupancy_share,
        regions=[DenseRegionResult(**vars(row)) for row in check.regions[:_LISTED]],
        surface_errors=surface_error_results(check.errors),
    )


def first_condition_result(dense: DenseRun) -> FirstConditionResult:
    """Return the first condition of regions, and how many met it in which way."""
    regions = dense.dense.regions
    return FirstConditionResult(
        rule=dense.options.first_condition,
        regions=len(regions.base),
        by_correlation=int(np.count_nonzero(regions.by_correlation)),
        by_relative_sigma=int(np.count_nonzero(~regions.by_correlation)),
    )


def first_condition_rows(found: FirstConditionResult) -> list[Row]:
    """Return the regions, and how many met the first condition in which way."""
    return [
        Row("Regions of the dense map", "first condition", found.rule),
        Row("Regions of the dense map", "regions", f"{found.regions:,}"),
        Row(
            "Regions of the dense map",
            "regions that met the first condition by correlation",
            f"{found.by_correlation:,}",
        ),
        Row(
            "Regions of the dense map",
            "regions that met the first condition by relative sigma alone",
            f"{found.by_relative_sigma:,}",
        ),
    ]


def surface_error_results(errors: Mapping[str, SurfaceError]) -> dict[str, SurfaceErrorResult]:
    """Errors by name."""
    return {
        name: SurfaceErrorResult(
            median_m=finite(e.median_m), p95_m=finite(e.p95_m), occupied=e.occupied
        )
        for name, e in errors.items()
    }


def dense_rows(dense: DenseResult) -> list[Row]:
    """Return how far the filter's map is from the returns as the smoother places them."""
    rows, group = first_condition_rows(dense.first_condition), "Dense map, EKF and smoother"
    for name, layer in dense.layers.items():
        rows += [
            Row(group, f"{name}: occupied samples", f"{layer.samples:,}"),
            Row(group, f"{name}: map to returns, median", f"{layer.median_m:.3f} m"),
            Row(group, f"{name}: map to returns, 95 %", f"{layer.p95_m:.3f} m"),
            Row(group, f"{name}: returns to map, median", f"{layer.missed_m:.3f} m"),
        ]
    if dense.occupancy_share is not None:
        alike = "occupancy: cells decided in both maps that are alike"
        rows.append(Row(group, alike, f"{100.0 * dense.occupancy_share:.1f} %"))
    return rows + surface_error_rows(dense.surface_errors)


def surface_error_rows(errors: Mapping[str, SurfaceErrorResult]) -> list[Row]:
    """Return how far what is occupied is from true surfaces."""
    return [
        Row("Distance to true surfaces", f"{name}, {part}", f"{value:.3f} m")
        for name, error in errors.items()
        for part, value in (("median", error.median_m), ("95 %", error.p95_m))
        if value is not None
    ]


class SurfaceErrorResult(Model):
    """Distance of what is occupied from true surfaces; None where nothing is occupied.

    Attributes:
        median_m: median.
        p95_m: 95 % quantile.
        occupied: cells or points that were measured.
    """

    median_m: float | None
    p95_m: float | None
    occupied: int


class DenseLayerResult(Model):
    """A layer of the filter's dense map, compared with the returns at the smoother's poses.

    See comparisons.extensions.dense_maps.check.LayerAgreement.

    Attributes:
        samples: cells, points or Gaussians that were compared.
        median_m: median distance from the nearest return.
        p95_m: 95 % quantile of it.
        missed_m: median distance from the smoother's returns, inside regions, to the layer: what it
            misses.
    """

    samples: int
    median_m: float
    p95_m: float
    missed_m: float


class DenseRegionResult(Model):
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


class FirstConditionResult(Model):
    """The first condition of regions (Nieto 2005, section 3.5) as the run had it.

    Attributes:
        rule: the rule, in words.
        regions: regions that were made.
        by_correlation: of these, regions all of whose pairs met it by their correlation at birth,
            the vehicle's position among them where a corner is virtual.
        by_relative_sigma: the others, which the thesis' rule refuses.
    """

    rule: str
    regions: int
    by_correlation: int
    by_relative_sigma: int


class DenseResult(Model):
    """Entry `dense`: dense maps of filter and smoother.

    Attributes:
        agrees: whether the maps agree.
        first_condition: how the regions met the first condition.
        layers: each layer, by name.
        occupancy_share: of the cells that both maps decide, the share that they decide alike.
        regions: the worst regions first, at most twenty.
        surface_errors: distance from true surfaces, by layer.
    """

    agrees: bool
    first_condition: FirstConditionResult
    layers: dict[str, DenseLayerResult]
    occupancy_share: float | None
    regions: list[DenseRegionResult]
    surface_errors: dict[str, SurfaceErrorResult]
