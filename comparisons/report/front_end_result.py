"""From a front end to the model of `odometry.json`, and to a short table for a terminal."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from comparisons.checks.accuracy import Accuracy
from comparisons.front_end import FrontEnd
from comparisons.report.models import (
    AccuracyResult,
    FrontEndResult,
    IncrementResult,
    LoopResult,
    ScanOdometryResult,
)
from comparisons.report.result import log_result, package_versions, smoother_result
from comparisons.report.summary import add_accuracy, add_log, add_smoother
from comparisons.runs.scan_log import sightings_kept


def build_front_end_result(front_end: FrontEnd, read_s: float) -> FrontEndResult:
    """The findings, read_s being the seconds that reading the log took."""
    f = front_end
    return FrontEndResult(
        log=log_result(f.log),
        odometry=scan_odometry_result(f),
        loops=LoopResult(
            tried=len(f.closed.attempts),
            closed=len(f.closed.closures.first),
            reasons=_by_reason(a.outcome for a in f.closed.attempts if a.outcome != "accepted"),
        ),
        graph=smoother_result(f.graph),
        landmarks=len(f.estimate.landmark),
        gps=f.choices.gps,
        increments=None if f.increments is None else IncrementResult(**vars(f.increments)),
        wheels=_accuracy(f.accuracy_wheels),
        scan_odometry=_accuracy(f.accuracy_odometry),
        scan_graph=_accuracy(f.accuracy_graph),
        verdict="proven" if f.graph.proof.proven else "unproven",
        remarks=_remarks(f),
        seconds={"read": read_s, **f.seconds},
        versions=package_versions(),
    )


def scan_odometry_result(front_end: FrontEnd) -> ScanOdometryResult:
    """What became of the scans."""
    motion = front_end.motion
    matches = [m for m in motion.matches if m is not None]
    wheeled = motion.wheels is not None and front_end.choices.guess
    return ScanOdometryResult(
        guess="wheels" if wheeled else "none",
        scans=len(motion.source.row),
        used=len(motion.row),
        failures=_by_reason(f.reason for f in motion.failures),
        breaks=motion.breaks,
        weak=sum(m.open_directions > 0 for m in matches),
        overlap=float(np.median([m.overlap for m in matches])) if matches else None,
        residual_m=float(np.median([m.residual_m for m in matches])) if matches else None,
        scans_per_second=len(motion.source.row) / front_end.seconds["odometry"],
    )


def print_front_end(result: FrontEndResult, console: Console) -> None:
    """Print log, evidence, accuracy and verdict."""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    add_log(table, result.log)
    o = result.odometry
    table.add_row(
        "scan odometry",
        f"{o.used:,} of {o.scans:,} scans used, {o.breaks} new beginnings, {o.weak} with a "
        f"direction open; guess: {o.guess}; {o.scans_per_second:.0f} scans/s",
    )
    for reason, count in o.failures.items():
        table.add_row("", escape(f"{count} failed: {reason}"))
    if o.overlap is not None and o.residual_m is not None:
        table.add_row(
            "matches", f"overlap {o.overlap:.2f}, residual {o.residual_m:.3f} m (medians)"
        )
    table.add_row("loops", f"{result.loops.closed} closed of {result.loops.tried} tried")
    i = result.increments
    if i is not None:
        table.add_row("increments", _increments(i))
    add_smoother(table, result.graph)
    add_accuracy(table, "wheels", result.wheels)
    add_accuracy(table, "scan odometry", result.scan_odometry)
    add_accuracy(table, "scan graph", result.scan_graph)
    table.add_row("seconds", ", ".join(f"{stage} {s:.2f}" for stage, s in result.seconds.items()))
    console.print(table)
    colour = "green" if result.verdict == "proven" else "yellow"
    console.print(f"verdict: [bold {colour}]{result.verdict}[/]", highlight=False)
    for remark in result.remarks:
        console.print(f"  note: {escape(remark)}", highlight=False)


def _increments(i: IncrementResult) -> str:
    if i.reference_factor is not None:
        return (
            f"by positions over windows: sigmas {i.factor:.2f} times as large would be most "
            f"likely (with the positions' {i.reference_factor:.2f} times)"
        )
    return (
        f"by truth: NEES {3.0 * i.nees:.2f} of 3 (band {3.0 * i.band[0]:.2f} to "
        f"{3.0 * i.band[1]:.2f}); sigmas {i.factor:.2f} times as large would fit"
    )


def _remarks(f: FrontEnd) -> list[str]:
    remarks = []
    stream = f.log.clouds if f.log.scans is None else f.log.scans
    beyond = 0 if stream is None else len(stream.time_s) - len(f.motion.source.row)
    if beyond:
        remarks.append(f"{beyond} scans lie outside the time of the odometry and were left out")
    seen = f.log.sightings
    beyond = int(np.count_nonzero(~sightings_kept(f.log, f.motion))) if seen.labelled else 0
    if beyond:
        remarks.append(f"{beyond} sightings lie outside the time of the scans and were left out")
    remarks += f.motion.remarks
    if f.increments is not None and f.increments.factor > _SURE:
        remarks.append(
            f"the increments are surer than they may be: by {f.increments.against} their sigmas "
            f"should be {f.increments.factor:.1f} times as large"
        )
    return remarks


_SURE = 2.0
"""Sigmas too small by more than this factor are remarked upon."""


def _by_reason(reasons: Iterable[str]) -> dict[str, int]:
    """Counts of reasons, their numbers left out."""
    return dict(Counter(re.sub(r"[-\d.]+(?:e[-+]?\d+)?", "…", r) for r in reasons).most_common())


def _accuracy(accuracy: Accuracy | None) -> AccuracyResult | None:
    return None if accuracy is None else AccuracyResult(**vars(accuracy))
