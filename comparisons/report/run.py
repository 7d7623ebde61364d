"""The folder that a run leaves: result.json, pictures, the page, and all estimates."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from comparisons.pipeline.compare import Comparison
from comparisons.report.consistency_figure import consistency_figure
from comparisons.report.figures.run import correlation_figure, map_figure
from comparisons.report.folder import JobFolder
from comparisons.report.html.page import page
from comparisons.report.models import Result
from comparisons.report.panels import consistency_panels


def run_folder(comparison: Comparison, result: Result) -> JobFolder:
    """Return what is to be written."""
    c, config, panels = comparison, comparison.prepared.config, consistency_panels(comparison)
    found = c.findings.values()
    own = {name: figure for one in found for name, figure in one.figures().items()}

    def write_page(path: Path) -> None:
        pictures = [path.with_name(f"{name}.png") for name in ("correlation", *own)]
        path.write_text(page(comparison, panels, result, pictures), encoding="utf-8")

    files: dict[str, Callable[[Path], object]] = {"report.html": write_page}
    if config.report.trace:
        from comparisons.estimates.trace_file import TRACE, write_trace

        files[f"ekf/{TRACE}"] = lambda path: write_trace(comparison.ekf, path)
    return JobFolder(
        name="result",
        result=result,
        config=config,
        estimates={
            "ekf": c.ekf.estimate,
            "smoother": c.smoothed,
            **{name: estimate for one in found for name, estimate in one.estimates.items()},
        },
        figures={
            "map": map_figure(comparison),
            "correlation": correlation_figure(comparison),
            "consistency": consistency_figure(comparison, panels),
            **own,
        },
        files=files,
    )
