"""From a check to the model of `check.json`, and to a short table for a terminal."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from comparisons.checks.given_agreement import Block
from comparisons.checks.given_trace import TraceCheck
from comparisons.pipeline.check import GivenCheck
from comparisons.report.check_models import (
    CheckResult,
    GivenBlockResult,
    GivenLandmarkResult,
    TraceResult,
)
from comparisons.report.finite import finite
from comparisons.report.models import CauseResult
from comparisons.report.result import (
    accuracy_result,
    log_result,
    package_versions,
    smoother_result,
)
from comparisons.report.summary import add_accuracy, add_log, add_smoother, print_verdict


def build_check_result(check: GivenCheck, read_s: float) -> CheckResult:
    """The findings, read_s being the seconds that reading log and estimate took."""
    found, solution = check.agreement, check.solution
    return CheckResult(
        log=log_result(solution.log),
        smoother=smoother_result(solution.result),
        association_by=solution.association_by,
        information=check.given.information,
        absent=check.given.absent,
        poses=len(found.time_s),
        rms_m=found.rms_m,
        rms_heading_rad=found.rms_heading_rad,
        outside=found.outside,
        last_pose=None
        if found.last is None
        else GivenBlockResult.model_validate(_block(found.last)),
        landmarks=[
            GivenLandmarkResult.model_validate({"id": int(number), **_block(block)})
            for number, block in zip(found.landmark_id, found.landmarks, strict=True)
        ],
        accuracy=accuracy_result(check.accuracy),
        smoother_accuracy=accuracy_result(solution.accuracy),
        trace=_trace(check.trace),
        verdict=check.outcome,
        causes=[CauseResult(**vars(cause)) for cause in check.causes],
        remarks=list(check.remarks),
        seconds={"read": read_s, **solution.seconds},
        versions=package_versions(),
    )


def print_check(result: CheckResult, console: Console) -> None:
    """Print what was compared, and the verdict."""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    add_log(table, result.log)
    add_smoother(table, result.smoother)
    own = (
        ""
        if result.outside is None
        else (f"; {100.0 * result.outside:.1f} % beyond their own 99.9 % region")
    )
    table.add_row(
        "poses",
        f"{result.poses:,} {result.information}, {result.rms_m:.3f} m and "
        f"{result.rms_heading_rad:.4f} rad from the smoother's (rms){own}",
    )
    if result.last_pose is not None:
        table.add_row(
            "last pose",
            f"{'agrees' if result.last_pose.agrees else 'disagrees'}: "
            f"{result.last_pose.difference_m:.3f} m apart, "
            f"{result.last_pose.distance_sigma:.2g} sigma",
        )
    if result.landmarks:
        agreeing = sum(row.agrees for row in result.landmarks)
        table.add_row("landmarks", f"{agreeing} of {len(result.landmarks)} agree")
    if result.trace is not None:
        _add_gaps(table, result.trace)
    add_accuracy(table, "accuracy", result.accuracy)
    add_accuracy(table, "smoother's", result.smoother_accuracy)
    table.add_row("seconds", ", ".join(f"{stage} {s:.2f}" for stage, s in result.seconds.items()))
    console.print(table)
    print_verdict(result.verdict, result.causes, result.remarks, console)


def _trace(check: TraceCheck | None) -> TraceResult | None:
    if check is None:
        return None
    algebra, model, rest = check.algebra, check.agreement.model, check.agreement.linearisation
    return TraceResult(
        steps=check.steps,
        updates=check.updates,
        begun=check.begun,
        positions=check.fixes,
        algebra_gap_sigma=None if algebra is None else finite(algebra.sigma),
        algebra_gap_covariance=None if algebra is None else finite(algebra.covariance),
        model_gap_sigma=finite(model.sigma),
        model_gap_covariance=finite(model.covariance),
        linearisation_gap_sigma=finite(rest.sigma),
        linearisation_gap_covariance=finite(rest.covariance),
    )


def _add_gaps(table: Table, trace: TraceResult) -> None:
    for name in ("algebra", "model", "linearisation"):
        if name == "algebra" and trace.algebra_gap_sigma is None:
            table.add_row("algebra gap", "not judged, there is no joint covariance")
            continue
        sigma, spread = (getattr(trace, f"{name}_gap_{part}") for part in ("sigma", "covariance"))
        told = [f"{value:.2g}" if value is not None else "none" for value in (sigma, spread)]
        table.add_row(f"{name} gap", f"{told[0]} sigma, {told[1]} in covariance")


def _block(block: Block) -> dict[str, float | bool | None]:
    return {
        "difference_m": block.difference_m,
        "distance_sigma": block.distance,
        "variance_ratio_least": None if block.least is None else finite(block.least),
        "variance_ratio_largest": None if block.largest is None else finite(block.largest),
        "agrees": block.near and block.sure_enough,
    }
