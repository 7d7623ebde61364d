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


def first_condition_row(found: FirstConditionResult) -> Row:
    """Return the rule and both shares."""
    return Row(
        "regions",
        f"{found.rule}; of {found.regions} regions {found.by_correlation} met it by correlation "
        f"when made, {found.by_relative_sigma} only by relative sigma",
    )


def surface_error_results(errors: Mapping[str, SurfaceError]) -> dict[str, SurfaceErrorResult]:
    """Errors by name."""
    return {
        name: SurfaceErrorResult(
            median_m=finite(e.median_m), p95_m=finite(e.p95_m), occupied=e.occupied
        )
        for name, e in errors.items()
    }


def dense_rows(dense: DenseResult) -> list[Row]:
    """Return how far the maps are apart."""
    rows = [first_condition_row(dense.first_condition)]
    rows += [
        Row(
            f"dense {name}",
            f"{layer.samples:,} occupied, {layer.median_m:.3f} m from the smoother's returns "
            f"(median; 95 % {layer.p95_m:.3f}, back {layer.missed_m:.3f})",
        )
        for name, layer in dense.layers.items()
    ]
    if dense.occupancy_share is not None:
        share = f"{100.0 * dense.occupancy_share:.1f} % of the decided cells are alike"
        rows.append(Row("dense cells", share))
    return rows + surface_error_rows(dense.surface_errors)


def surface_error_rows(errors: Mapping[str, SurfaceErrorResult]) -> list[Row]:
    """Return how far what is occupied is from true surfaces."""
    return [
        Row(
            f"{name} error",
            f"median {error.median_m:.3f} m, 95 % {error.p95_m:.3f} m from true surfaces",
        )
        for name, error in errors.items()
        if error.median_m is not None and error.p95_m is not None
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
