"""From a solution to the model of `solution.json`, and to a short table for a terminal."""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from comparisons.pipeline.solve import Solution
from comparisons.report.models import SolutionResult
from comparisons.report.result import (
    accuracy_result,
    association_result,
    log_result,
    package_versions,
    smoother_result,
)
from comparisons.report.summary import add_accuracy, add_association, add_log, add_smoother


def build_solution_result(solution: Solution, read_s: float) -> SolutionResult:
    """The findings, read_s being the seconds that reading the log took."""
    s, proof = solution, solution.result.proof
    test = proof.chi_square
    remarks = []
    if test.reading != "plausible":
        remarks.append(
            f"chi-square {test.chi2:.0f} for {test.dof} degrees of freedom is {test.reading} "
            f"(band {test.lower:.0f} to {test.upper:.0f})"
        )
    if not proof.stationarity.holds:
        remarks.append("the best result is not a strict local minimum")
    return SolutionResult(
        log=log_result(s.log),
        association_by=s.association_by,
        landmarks=len(s.estimate.landmark),
        sightings_used=int(np.count_nonzero(s.slot >= 0)),
        gps=s.gps,
        smoother=smoother_result(s.result),
        accuracy=accuracy_result(s.accuracy),
        dead_reckoning=accuracy_result(s.accuracy_dead_reckoned),
        association=association_result(s.association),
        verdict="proven" if proof.proven else "unproven",
        remarks=remarks,
        seconds={"read": read_s, **s.seconds},
        versions=package_versions(),
    )


def print_solution(result: SolutionResult, console: Console) -> None:
    """Print log, evidence, accuracy and verdict."""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    add_log(table, result.log)
    total = result.log.records["sightings"]
    table.add_row(
        "map",
        f"{result.landmarks} landmarks from {result.sightings_used:,} of {total:,} sightings "
        f"({result.association_by})",
    )
    add_smoother(table, result.smoother)
    add_accuracy(table, "accuracy", result.accuracy)
    add_accuracy(table, "dead reckoning", result.dead_reckoning)
    add_association(table, result.association)
    table.add_row("seconds", ", ".join(f"{stage} {s:.2f}" for stage, s in result.seconds.items()))
    console.print(table)
    colour = "green" if result.verdict == "proven" else "yellow"
    console.print(f"verdict: [bold {colour}]{result.verdict}[/]", highlight=False)
    for remark in result.remarks:
        console.print(f"  note: {escape(remark)}", highlight=False)
