"""Dense maps of both estimators as a part of `result.json`, and as rows for a terminal."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from rich.table import Table

from comparisons.extensions.dense_maps.accuracy import SurfaceError
from comparisons.extensions.dense_maps.check import DenseAgreement
from comparisons.extensions.dense_maps.models import (
    DenseLayerResult,
    DenseRegionResult,
    DenseResult,
    HighLevelResult,
    SurfaceErrorResult,
)
from comparisons.extensions.high_level.source import HighLevelRun
from comparisons.report.finite import finite

_LISTED = 20


def dense_result(check: DenseAgreement | None) -> DenseResult | None:
    """The check's figures."""
    if check is None:
        return None
    return DenseResult(
        agrees=check.agrees,
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


def surface_error_results(errors: Mapping[str, SurfaceError]) -> dict[str, SurfaceErrorResult]:
    """Errors by name."""
    return {
        name: SurfaceErrorResult(
            median_m=finite(e.median_m), p95_m=finite(e.p95_m), occupied=e.occupied
        )
        for name, e in errors.items()
    }


def high_level_result(run: HighLevelRun | None) -> HighLevelResult | None:
    """What became of them."""
    if run is None:
        return None
    return HighLevelResult(
        searches=run.searches,
        corners=run.corners,
        pairs=run.pairs,
        candidates=run.candidates,
        poor=run.poor,
        found=len(run.slot),
        kept=int(np.count_nonzero(run.slot >= 0)),
        looks=dict(sorted(run.looks.items())),
    )


def high_level_text(made: HighLevelResult) -> str:
    """Found, kept, seen, in a line."""
    rest = ", ".join(f"{n} {name}" for name, n in made.looks.items() if name != "seen")
    return (
        f"{made.found} landmarks found in {made.searches} searches ({made.corners} corners, "
        f"{made.pairs} pairs, {made.poor} with too few Gaussians), {made.kept} kept; "
        f"{made.looks.get('seen', 0)} sightings" + (f" ({rest})" if rest else "")
    )


def add_dense(table: Table, dense: DenseResult) -> None:
    """How far the maps are apart."""
    for name, layer in dense.layers.items():
        table.add_row(
            f"dense {name}",
            f"{layer.samples:,} occupied, {layer.median_m:.3f} m from the smoother's returns "
            f"(median; 95 % {layer.p95_m:.3f}, back {layer.missed_m:.3f})",
        )
    if dense.occupancy_share is not None:
        table.add_row(
            "dense cells", f"{100.0 * dense.occupancy_share:.1f} % of the decided cells are alike"
        )
    add_surface_errors(table, dense.surface_errors)


def add_surface_errors(table: Table, errors: Mapping[str, SurfaceErrorResult]) -> None:
    """How far what is occupied is from true surfaces."""
    for name, error in errors.items():
        if error.median_m is not None and error.p95_m is not None:
            table.add_row(
                f"{name} error",
                f"median {error.median_m:.3f} m, 95 % {error.p95_m:.3f} m from true surfaces",
            )
