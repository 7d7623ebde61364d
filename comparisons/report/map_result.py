"""From a dense map to the model of `map.json`, and to a short table for a terminal."""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from comparisons.checks.accuracy import assess
from comparisons.extensions.dense_maps.accuracy import OCCUPIED
from comparisons.extensions.dense_maps.result import add_surface_errors, surface_error_results
from comparisons.pipeline.dense_map import DenseMapping
from comparisons.report.map_models import (
    ClosingResult,
    DynamicResult,
    LayerResult,
    MapResult,
    ReturnsResult,
)
from comparisons.report.result import (
    accuracy_result,
    ekf_result,
    log_result,
    package_versions,
)
from comparisons.report.summary import add_accuracy, add_ekf, add_log
from ekf_reference.dense.dense_map import DenseMap
from ekf_reference.dense.dynamic import places


def build_map_result(mapping: DenseMapping, read_s: float) -> MapResult:
    """The findings, read_s being the seconds that reading the log took."""
    m = mapping
    before = m.dense.before
    labelled = m.choices.association == "known"
    return MapResult(
        log=log_result(m.log),
        ekf=ekf_result(m.ekf, m.choices),
        accuracy=accuracy_result(assess(m.ekf.estimate, m.log, labelled=labelled)),
        scan_landmarks=len(m.ekf.estimate.oriented),
        regions=len(m.placed.triangle),
        resolution_m=m.dense.options.resolution_m,
        returns=_returns(m.dense.dense),
        layers={
            name: LayerResult(
                samples=len(s.point), occupied=int(np.count_nonzero(s.occupancy > OCCUPIED))
            )
            for name, s in m.layers.items()
        },
        surface_errors=surface_error_results(m.errors),
        closing=None
        if before is None
        else ClosingResult(time_s=before.time_s, shift_m=before.shift_m),
        dynamic=_dynamic(m),
        remarks=_remarks(m),
        seconds={"read": read_s, **m.seconds, **{k: float(v) for k, v in m.dense.seconds.items()}},
        versions=package_versions(),
    )


def print_map(result: MapResult, console: Console) -> None:
    """Print what the map holds and how good it is."""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    add_log(table, result.log)
    add_ekf(table, result.ekf)
    add_accuracy(table, "accuracy", result.accuracy)
    if result.scan_landmarks:
        table.add_row("scan landmarks", f"{result.scan_landmarks:,}")
    returns = result.returns
    table.add_row(
        "returns",
        f"{returns.fused + returns.late:,} of {returns.returns:,} in {result.regions} regions "
        f"({returns.late:,} after a wait), {returns.outside:,} outside all; {returns.scans} scans",
    )
    for name, layer in result.layers.items():
        table.add_row(name, f"{layer.samples:,} held, {layer.occupied:,} occupied")
    add_surface_errors(table, result.surface_errors)
    if result.dynamic is not None:
        table.add_row(
            "dynamic",
            f"{result.dynamic.places} places, {result.dynamic.area_m2:.1f} m2, "
            f"{len(result.dynamic.landmarks)} landmarks in them",
        )
    table.add_row("seconds", ", ".join(f"{stage} {s:.2f}" for stage, s in result.seconds.items()))
    console.print(table)
    for remark in result.remarks:
        console.print(f"  note: {escape(remark)}", highlight=False)


def _returns(dense: DenseMap) -> ReturnsResult:
    waiting = lost = 0
    if dense.waiting is not None:
        waiting = len(dense.waiting.points.scan)
        lost = dense.waiting.counts.dropped + dense.waiting.counts.vanished
    return ReturnsResult(**vars(dense.tally), waiting=waiting, lost=lost)


def _dynamic(m: DenseMapping) -> DynamicResult | None:
    layer = m.dense.dense.dynamic
    if layer is None:
        return None
    number = places(layer.points(m.placed))
    under = m.dense.is_dynamic(m.ekf.estimate.landmark)
    return DynamicResult(
        places=int(number.max(initial=-1)) + 1,
        cells=len(number),
        area_m2=layer.area_m2(m.placed),
        **vars(layer.counters),
        landmarks=m.ekf.estimate.landmark_id[under].tolist(),
    )


def _remarks(m: DenseMapping) -> list[str]:
    remarks = []
    if m.ekf.breakdown:
        remarks.append(m.ekf.breakdown)
    if not len(m.placed.triangle):
        remarks.append("no three landmarks meet the conditions of a region, so the map is empty")
    if m.dense.before is not None:
        remarks.append(
            f"the update at {m.dense.before.time_s:.1f} s moved the regions by "
            f"{m.dense.before.shift_m:.2f} m (rms), and the map with them"
        )
    return remarks
