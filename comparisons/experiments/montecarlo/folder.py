"""What a Monte Carlo study leaves beside its chunks: settings, figures, curves, what is printed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from pydantic import TypeAdapter

from comparisons.atomic import OWN, write_whole
from comparisons.experiments.montecarlo.chunk_files import CONFIG, LOGS
from comparisons.experiments.montecarlo.external import ExternalProgram
from comparisons.experiments.montecarlo.page import again_with, study_page
from comparisons.experiments.montecarlo.plots import curves_figure
from comparisons.experiments.montecarlo.statistics import (
    DOF,
    ERRORS,
    FilterFigures,
    per_run,
)
from comparisons.experiments.montecarlo.study import StudyOutcome
from comparisons.experiments.montecarlo.verdict import study_verdict
from comparisons.report.picture import save
from comparisons.report.terminal import Summary
from comparisons.statistics import LEVEL
from comparisons.words import Row

RESULT = "montecarlo.json"
_MOST_FAILURES = 5
_MOST_FILTERS = 8
"""Filters that have a line on the terminal unless more is asked for."""


def write_montecarlo(
    outcome: StudyOutcome, folder: Path, commands: Mapping[str, ExternalProgram] | None = None
) -> None:
    """Write the settings, the figures, those of each run, page and picture, each whole.

    commands: the user's filters; what repeats the study stands on the page alone, for a file that
    is read runs no command.
    """
    again = again_with(folder, commands) if commands else None
    result = TypeAdapter(StudyOutcome).dump_json(outcome, indent=2)
    texts = {
        CONFIG: outcome.study.config.toml(),
        RESULT: result.decode() + "\n",
        "report.html": study_page(outcome, remarks(outcome), again),
        "runs.csv": _run_rows(outcome),
    }
    for name, text in texts.items():
        write_whole(folder / name, partial(Path.write_text, data=text, encoding="utf-8"), OWN)
    write_whole(folder / "curves.png", lambda part: save(curves_figure(outcome), part), OWN)


def _run_rows(outcome: StudyOutcome) -> str:
    """A line per run and filter; empty where there is no such figure."""
    lines = ["seed,filter,ate_m,heading_rmse_rad,landmark_rmse_m,pose_nees,last_pose_nees"]
    for name, figures in outcome.filters.items():
        kept = figures.kept
        run = per_run(kept)
        columns = [run[f"{what}_rmse"] for what in ERRORS]
        columns += [run["pose_nees"], kept.last.pose_nees]
        for seed, row in enumerate(zip(*(column.tolist() for column in columns), strict=True)):
            lines.append(",".join([str(seed), name, *(_cell(value) for value in row)]))
    return "\n".join(lines) + "\n"


def _cell(value: float) -> str:
    return "" if math.isnan(value) else repr(value)


def montecarlo_summary(outcome: StudyOutcome) -> Summary:
    """Return what the command prints: consistent filters, then NEES and errors of each filter."""
    repeated = []
    if outcome.reused:
        repeated.append(f"results of commands that were used again: {outcome.reused}")
    if outcome.damaged:
        repeated.append(f"damaged chunk files, computed again: {outcome.damaged}")
    headline, look = study_verdict(outcome)
    shown = list(outcome.filters.items())[:_MOST_FILTERS]
    lines = [(name, _filter_line(figures)) for name, figures in shown]
    if more := len(outcome.filters) - len(shown):
        lines.append(("more", f"{more} filters in the report"))
    return Summary(
        headline=headline,
        look=look,
        remarks=[*remarks(outcome), *repeated],
        lines=[
            (
                "study",
                f"{outcome.runs:,} runs of {outcome.steps:,} steps, "
                f"{outcome.landmarks} landmarks ({outcome.scenario})",
            ),
            *lines,
        ],
        rows=_rows(outcome),
    )


def _filter_line(figures: FilterFigures) -> str:
    pose, rmse = figures.consistency["pose"], figures.rmse
    nees = "no NEES"
    if pose.place != "not given":
        low, high = pose.band
        nees = f"NEES {pose.mean:.2f} (band {low:.2f} to {high:.2f})"
    return f"{nees}; RMSE {rmse['position']:.3g} m, landmarks {rmse['landmarks']:.3g} m"


def _rows(outcome: StudyOutcome) -> list[Row]:
    rows = []
    for name, figures in outcome.filters.items():
        group = f"Filter {name} ({100 * LEVEL:.0f} % bands)"
        for block, nees in figures.consistency.items():
            known = nees.place != "not given"
            rows.append(
                Row(
                    group,
                    f"mean NEES of {block} (expected {DOF[block]})",
                    f"{nees.mean:.2f}" if known else "no covariances",
                    _interval(nees.band) if known else "",
                    nees.place == "inside" if known else None,
                )
            )
        for what, value in figures.rmse.items():
            rows.append(Row(group, f"error of {what} (RMSE)", f"{value:.4f} {ERRORS[what]}"))
    return rows


def remarks(outcome: StudyOutcome) -> list[str]:
    """What stands beside the figures: runs that are left out, and what was not handed in."""
    lines = []
    for name, figures in outcome.filters.items():
        failed = outcome.failures.get(name, ())
        if failed:
            lines.append(f"{name}: {len(failed)} of {outcome.runs} runs failed")
        elif figures.lost:
            lines.append(f"{name}: {figures.lost} runs broke down and are left out")
        for failure in failed[:_MOST_FAILURES]:
            kept = "" if failure.log is None else f"; its log is {LOGS}/{failure.log.name}"
            lines.append(f"  seed {failure.seed}: {failure.reason}{kept}")
        if len(failed) > _MOST_FAILURES:
            lines.append(f"  and {len(failed) - _MOST_FAILURES} more, in montecarlo.json")
        absent = [block for block, c in figures.consistency.items() if c.place == "not given"]
        if absent:
            lines.append(f"{name}: no covariances, so no NEES, of {', '.join(absent)}")
    if outcome.final_map:
        lines.append("landmarks: of the final map")
    return lines


def _interval(band: tuple[float, float]) -> str:
    return f"{band[0]:.2f} to {band[1]:.2f}"
