"""Dense maps of both estimators as a part of `result.json`, and as rows for a terminal."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from comparisons.extensions.dense_maps.accuracy import SurfaceError
from comparisons.extensions.dense_maps.check import DenseAgreement
from comparisons.extensions.dense_maps.source import DenseRun
from comparisons.extensions.interface import Row
from comparisons.report.model import Model, finite

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
    """What is occupied against true surfaces; None where nothing is. occupied: how much."""

    median_m: float | None
    p95_m: float | None
    occupied: int


class DenseLayerResult(Model):
    """A layer of the filter's dense map against the smoother's returns.

    See comparisons.extensions.dense_maps.check.LayerAgreement.
    """

    samples: int
    median_m: float
    p95_m: float
    missed_m: float


class DenseRegionResult(Model):
    """One region of one layer."""

    layer: str
    region: int
    samples: int
    distance_m: float


class FirstConditionResult(Model):
    """The first condition of regions (Nieto 2005, section 3.5) as the run had it.

    regions: how many were made. by_correlation: of these, at birth all pairs met it by their
    correlation, the vehicle's position among them where a corner is virtual; by_relative_sigma:
    the others, which the thesis' rule refuses.
    """

    rule: str
    regions: int
    by_correlation: int
    by_relative_sigma: int


class DenseResult(Model):
    """Dense maps of filter and smoother. regions: the worst first, at most twenty.

    occupancy_share: of the cells decided in both maps, those decided alike.
    """

    agrees: bool
    first_condition: FirstConditionResult
    layers: dict[str, DenseLayerResult]
    occupancy_share: float | None
    regions: list[DenseRegionResult]
    surface_errors: dict[str, SurfaceErrorResult]
