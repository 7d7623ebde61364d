"""The folder a run leaves: result.json, pictures, and both estimates."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from comparisons.atomic import fresh_folder
from comparisons.estimates.folder import FILES as ESTIMATE_FILES
from comparisons.estimates.folder import write_estimate
from comparisons.estimates.trace_file import TRACE, write_trace
from comparisons.extensions.dense_maps.figure import dense_check_figure
from comparisons.pipeline.compare import Comparison
from comparisons.report.consistency_figure import consistency_figure
from comparisons.report.html.page import page
from comparisons.report.models import Result
from comparisons.report.panels import consistency_panels
from comparisons.report.picture import FORMATS, save
from comparisons.report.plots import correlation_figure, map_figure

ESTIMATORS = ("ekf", "smoother", "scans", "own-matcher")
_PICTURES = ("map", "correlation", "consistency", "dense")
CONTENTS = frozenset(
    {"result.json", "report.html", f"ekf/{TRACE}"}
    | {f"{picture}.{suffix}" for picture in _PICTURES for suffix in FORMATS}
    | {f"{estimator}/{name}" for estimator in ESTIMATORS for name in ESTIMATE_FILES}
)
"""What a run folder holds; a folder with nothing else may be replaced by the next run."""


def write_run_folder(
    comparison: Comparison,
    result: Result,
    folder: Path,
    formats: Collection[str] = (),
    *,
    trace: bool = False,
) -> None:
    """Write everything; the folder appears whole or not at all. Raises InputError.

    formats: of the pictures; see picture.save. trace: the filter's, too.
    """
    with fresh_folder(folder, CONTENTS) as work:
        three, own = comparison.three_way, comparison.own_matching
        estimates = (
            comparison.ekf.estimate,
            comparison.smoothed,
            None if three is None else three.estimate,
            None if own is None else own.estimate,
        )
        for name, estimate in zip(ESTIMATORS, estimates, strict=True):
            if estimate is not None:
                (work / name).mkdir()
                write_estimate(estimate, work / name)
        if trace:
            write_trace(comparison.ekf, work / "ekf" / TRACE)
        save(map_figure(comparison), work / "map.png", formats)
        save(correlation_figure(comparison), work / "correlation.png", formats)
        panels = consistency_panels(comparison)
        save(consistency_figure(comparison, panels), work / "consistency.png", formats)
        if comparison.dense is not None and comparison.dense_check is not None:
            figure = dense_check_figure(comparison.dense, comparison.dense_check, comparison.log)
            save(figure, work / "dense.png", formats)
        (work / "report.html").write_text(page(comparison, panels, result, work), encoding="utf-8")
        (work / "result.json").write_text(result.model_dump_json(indent=2) + "\n", encoding="utf-8")
