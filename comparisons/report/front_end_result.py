"""From a front end to the model of `odometry.json`, and to a short table for a terminal."""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from comparisons.extensions.scan_motion.result import (
    add_scan_odometry,
    by_reason,
    increment_remarks,
    increment_result,
    scan_odometry_result,
)
from comparisons.logs.transforms.scan_motion import sightings_kept
from comparisons.pipeline.odometry import FrontEnd
from comparisons.report.models import (
    FrontEndResult,
    LoopResult,
)
from comparisons.report.result import accuracy_result, log_result, package_versions, smoother_result
from comparisons.report.summary import add_accuracy, add_log, add_smoother


def build_front_end_result(front_end: FrontEnd, read_s: float) -> FrontEndResult:
    """The findings, read_s being the seconds that reading the log took."""
    f = front_end
    return FrontEndResult(
        log=log_result(f.log),
        odometry=scan_odometry_result(
            f.motion, guess=f.choices.guess, seconds=f.seconds["odometry"]
        ),
        loops=LoopResult(
            tried=len(f.closed.attempts),
            closed=len(f.closed.closures.first),
            reasons=by_reason(a.outcome for a in f.closed.attempts if a.outcome != "accepted"),
        ),
        graph=smoother_result(f.graph),
        landmarks=len(f.estimate.landmark),
        gps=f.choices.gps,
        increments=increment_result(f.increments),
        wheels=accuracy_result(f.accuracy_wheels),
        scan_odometry=accuracy_result(f.accuracy_odometry),
        scan_graph=accuracy_result(f.accuracy_graph),
        verdict="proven" if f.graph.proof.proven else "unproven",
        remarks=_remarks(f),
        seconds={"read": read_s, **f.seconds},
        versions=package_versions(),
    )


def print_front_end(result: FrontEndResult, console: Console) -> None:
    """Print log, evidence, accuracy and verdict."""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    add_log(table, result.log)
    add_scan_odometry(table, result.odometry, result.increments)
    table.add_row("loops", f"{result.loops.closed} closed of {result.loops.tried} tried")
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
    return remarks + increment_remarks(f.increments)
