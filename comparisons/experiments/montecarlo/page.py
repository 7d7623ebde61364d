"""`report.html` of a study: consistency and errors by filter, curves, and every two filters."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from comparisons.arrays import Array
from comparisons.experiments.montecarlo.chunk_files import CONFIG
from comparisons.experiments.montecarlo.external import TIMEOUT_S, ExternalProgram
from comparisons.experiments.montecarlo.plots import colour_of
from comparisons.experiments.montecarlo.statistics import DOF, ERRORS, FilterPair, per_run
from comparisons.experiments.montecarlo.verdict import study_verdict
from comparisons.report.html.curves import curve_data, data_block
from comparisons.report.html.shell import again, document, number, script, sortable, table
from comparisons.report.marks import TIME, Curve, FilledBand, Panel
from comparisons.report.notebook import framed
from comparisons.statistics import LEVEL

if TYPE_CHECKING:
    from comparisons.experiments.montecarlo.study import StudyOutcome

_SCRIPTS = ("common.js", "curves.js", "tables.js", "folder.js")
_LEVEL = f"{100 * LEVEL:.0f} %"
_WHAT = {
    "pose_nees": "NEES of the pose",
    "position_rmse": "ATE [m]",
    "heading_rmse": "heading RMSE [rad]",
    "landmarks_rmse": "landmark RMSE [m]",
}


def framed_page(outcome: StudyOutcome) -> str:
    """Return the page as a notebook shows it."""
    return framed(study_page(outcome, [], ""))


def again_with(folder: Path, commands: Mapping[str, ExternalProgram]) -> str:
    """Return the command that repeats a study of the user's filters, as a part of its page.

    folder: of the study, from the folder in which the commands were given.
    """
    options = list[str]()
    for name, command in commands.items():
        options += ["--command", f"{name}={command.text}"]
    for timeout_s in {command.timeout_s for command in commands.values()} - {TIMEOUT_S}:
        options += ["--timeout", f"{timeout_s:g}"]
    place = "in the folder in which it was started"
    return again("montecarlo", file=shlex.quote(str(folder / CONFIG)), options=options, place=place)


def study_page(outcome: StudyOutcome, remarks: list[str], repeated: str | None = None) -> str:
    """The whole page.

    remarks: what stands beside the figures. repeated: how the study is repeated, as HTML; by its
    config.toml beside the page where nothing is given.
    """
    headline, look = study_verdict(outcome)
    reported = "".join(f"<li>{escape(remark.strip())}</li>" for remark in remarks)
    rows = sum(pair.runs > 0 for pair in outcome.pairs)
    parts = [
        f"<header><h1>{escape(outcome.scenario)}</h1>"
        f'<p><span class="verdict {look}">{escape(headline)}</span> '
        f'<span class="about">{outcome.runs:,} runs of {outcome.steps:,} steps, '
        f"{outcome.landmarks} landmarks</span></p></header>",
        f'<ul class="note">{reported}</ul>' if reported else "",
        "<h2>Consistency: mean NEES</h2>",
        _consistency(outcome),
        f'<p class="note">In brackets the exact {_LEVEL} band of the mean over the runs at one '
        "step, by chi-square. A mean over steps, or over landmarks, has a narrower true band: "
        "outside is certain, inside is not. The count of last poses within their own band "
        "is exact, too, by the binomial.</p>",
        "<h2>Errors</h2>",
        _errors(outcome),
        '<p class="note">ATE: root mean square of the position error over the steps of a run, '
        "without alignment, for the start is known. Every run is in runs.csv.</p>",
        '<section id="when"><h2>Over time <span id="now"></span></h2>'
        '<noscript><p class="note">Curves need JavaScript; they are in curves.png, too.</p>'
        '</noscript><div id="curves"></div></section>',
        "<h2>Pairs of filters</h2>",
        _pairs(outcome.pairs),
        f'<p class="note">First minus second over the runs (seeds) that both have. Intervals are '
        f"Student's t for the mean; p is the two-sided sign test's. A finding is by either, "
        f"both tests of all {rows} rows corrected together (Bonferroni, {_LEVEL} for the whole "
        "table). A lower error is better; a NEES is best near its degrees of freedom, 3.</p>",
        f'<h2>Scenario</h2><p class="note">{escape(outcome.description)}</p>',
        again("montecarlo") if repeated is None else repeated,
        data_block({"start": 0.0, **curve_data(_panels(outcome), 0.0)}),
    ]
    return document(f"{outcome.scenario}: Monte Carlo", parts, script(_SCRIPTS))


def _consistency(outcome: StudyOutcome) -> str:
    rows: list[tuple[str, ...]] = []
    bad: list[int] = []
    for name, figures in outcome.filters.items():
        cells = [
            "none"
            if c.place == "not given"
            else f"{number(c.mean)} ({number(c.band[0])} to {number(c.band[1])})"
            for c in figures.consistency.values()
        ]
        last, band = figures.last_pose_inside, figures.last_pose_inside.band
        inside = f"{last.inside} of {last.of} ({band[0]} to {band[1]})" if last.of else "none"
        place = figures.consistency["pose"].place
        if place == "above":
            bad.append(len(rows))
        rows.append((name, *cells, inside, _PLACES[place]))
    head = ("filter", *(f"{block} ({dof} dof)" for block, dof in DOF.items()))
    return _wide(table((*head, "last poses inside", "pose NEES"), rows, bad))


_PLACES = {
    "above": "above: too certain",
    "inside": "inside",
    "below": "below: too cautious",
    "not given": "no covariances",
}


def _errors(outcome: StudyOutcome) -> str:
    rows = []
    for name, figures in outcome.filters.items():
        ate = per_run(figures.kept)["position_rmse"]
        runs = np.flatnonzero(np.isfinite(ate))
        middle, worst = np.nan, "none"
        if len(runs):
            seed = int(runs[ate[runs].argmax()])
            middle, worst = float(np.median(ate[runs])), f"{number(float(ate[seed]))} (seed {seed})"
        others = [number(figures.rmse[what]) for what in ("heading", "landmarks")]
        ours = (number(figures.rmse["position"]), number(middle), worst)
        rows.append((name, f"{len(runs)} of {len(ate)}", *ours, *others))
    head = ("ATE [m], all runs", "median run", "worst run", "heading [rad]", "landmarks [m]")
    return _wide(table(("filter", "runs", *head), rows))


def _pairs(pairs: list[FilterPair]) -> str:
    rows = []
    for pair in pairs:
        if not pair.runs:
            continue
        low, high = pair.family_interval
        found = "no difference shown"
        if high < 0 or low > 0 or pair.sign_p < 1.0 - LEVEL:
            found = "first lower" if pair.mean < 0 else "first higher"
        interval = f"{number(low)} to {number(high)}" if np.isfinite(low) else "none"
        counts = f"{pair.lower} / {pair.higher} of {pair.runs}"
        cells = (pair.first, pair.second, _WHAT[pair.what], number(pair.mean), interval)
        rows.append(("", (*cells, counts, number(pair.sign_p), found)))
    head = ("first", "second", "of each run", "mean difference", "interval")
    return _wide(sortable("pairs", (*head, "lower / higher", "sign test p", "finding"), rows))


def _wide(content: str) -> str:
    """A table to be moved sideways where the window is narrow."""
    return f'<div class="sideways">{content}</div>'


def _panels(outcome: StudyOutcome) -> list[Panel]:
    """NEES with its band, then RMSE."""
    figures, time_s = outcome.filters, outcome.time_s
    panels = []
    for block, dof in DOF.items():
        widest = max(
            (f.consistency[block].band for f in figures.values()), key=lambda b: b[1] - b[0]
        )
        low, high = np.broadcast_to(np.array(widest)[:, None], (2, len(time_s)))
        band = FilledBand(name=f"{_LEVEL} band", colour="#999999", x=time_s, low=low, high=high)
        panels.append(
            Panel(
                title=f"mean NEES of {block} ({dof} dof)",
                x_label=TIME,
                curves=_curves(time_s, {name: f.nees_curve[block] for name, f in figures.items()}),
                bands=(band,) if np.isfinite(widest).all() else (),
                logarithmic=True,
                level=float(dof),
            )
        )
    for what, unit in ERRORS.items():
        panels.append(
            Panel(
                title=f"RMSE of {what} [{unit}]",
                x_label=TIME,
                curves=_curves(time_s, {name: f.rmse_curve[what] for name, f in figures.items()}),
                bands=(),
            )
        )
    return [panel for panel in panels if panel.curves]


def _curves(time_s: Array, curves: dict[str, Array]) -> tuple[Curve, ...]:
    """Those that are known at more than one instant."""
    return tuple(
        Curve(name, colour_of(name, curves), time_s, curve)
        for name, curve in curves.items()
        if np.isfinite(curve).sum() > 1
    )
