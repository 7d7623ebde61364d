"""The run's findings as a short table for a terminal."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from comparisons.checks.causes import GAPS
from comparisons.extensions.dense_maps.result import add_dense, high_level_text
from comparisons.extensions.own_matching.result import own_matching_rows
from comparisons.extensions.scan_landmarks.result import scan_slam_rows
from comparisons.extensions.scan_motion.result import add_scan_odometry
from comparisons.report.consistency_result import consistency_rows
from comparisons.report.models import (
    AccuracyResult,
    AssociationResult,
    CauseResult,
    EkfResult,
    LogResult,
    Result,
    SmootherResult,
)

_STYLE = {"agree": "bold green", "disagree": "bold red", "unproven": "bold yellow"}


def print_summary(result: Result, console: Console) -> None:
    """Print log, evidence, gaps, accuracy, verdict and causes."""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    gaps = result.agreement
    add_log(table, result.log)
    add_ekf(table, result.ekf)
    add_smoother(table, result.smoother)
    for name, sigma, covariance in (
        ("algebra gap", gaps.algebra_gap_sigma, gaps.algebra_gap_covariance),
        ("model gap", gaps.model_gap_sigma, gaps.model_gap_covariance),
        ("linearisation gap", gaps.linearisation_gap_sigma, gaps.linearisation_gap_covariance),
    ):
        table.add_row(
            name, f"{_number(sigma, '.2g')} sigma, {_number(covariance, '.2g')} in covariance"
        )
    table.add_row(
        "optimism",
        f"{_number(gaps.optimism, '.3g')} (EKF's variance over the smoother's, worst direction; "
        f"largest {_number(gaps.pessimism, '.3g')})",
    )
    agreeing = sum(row.agrees for row in gaps.landmarks)
    table.add_row(
        "landmarks",
        f"{agreeing} of {len(gaps.landmarks)} agree; EKF and smoother "
        f"{gaps.landmark_difference_rms_m:.3f} m apart (rms)",
    )
    table.add_row(
        "last pose",
        f"{'agrees' if gaps.pose.agrees else 'disagrees'}: {gaps.pose.difference_m:.3f} m apart, "
        f"{gaps.pose.distance_sigma:.2g} sigma",
    )
    for name, shown in consistency_rows(result.consistency):
        table.add_row(name, shown)
    if result.accuracy is not None:
        add_accuracy(table, "EKF accuracy", result.accuracy.ekf)
        add_accuracy(table, "smoother accuracy", result.accuracy.smoother)
        add_accuracy(table, "dead reckoning", result.accuracy.dead_reckoning)
    add_association(table, result.association)
    own = result.own_association
    if own is not None:
        table.add_row(
            "own association",
            f"{own.landmarks} landmarks; {100.0 * own.agreement:.1f} % of pairs as the filter's, "
            f"{own.splits} splits, {own.merges} merges; last pose {own.pose_difference_m:.3f} m "
            f"apart, {own.pose_distance_sigma:.2g} sigma",
        )
        add_accuracy(table, "with it", own.accuracy)
        add_association(table, own.association)
    if result.own_matching is not None:
        for name, shown in own_matching_rows(result.own_matching):
            table.add_row(name, shown)
        add_accuracy(table, "with it", result.own_matching.accuracy)
    if result.scan_odometry is not None:
        add_scan_odometry(table, result.scan_odometry, result.increments)
    three = result.three_way
    if three is not None:
        for name, pair in (("EKF on wheels", three.ekf), ("smoother on wheels", three.smoother)):
            table.add_row(
                "on scans",
                f"{name} {'agrees' if pair.agrees else 'disagrees'} with the smoother on scans: "
                f"{pair.rms_m:.3f} m apart (aligned {pair.rms_aligned_m:.3f}), {pair.outside} of "
                f"{pair.landmarks} landmarks beyond 99 %",
            )
        add_accuracy(table, "smoother on scans", three.accuracy)
    if result.scan_slam is not None:
        for name, shown in scan_slam_rows(result.scan_slam):
            table.add_row(name, shown)
    if result.dense is not None:
        add_dense(table, result.dense)
    if result.high_level is not None:
        table.add_row("high level", high_level_text(result.high_level))
    table.add_row("seconds", ", ".join(f"{stage} {s:.2f}" for stage, s in result.seconds.items()))
    console.print(table)
    print_verdict(result.verdict, result.causes, result.remarks, console)


def print_verdict(
    verdict: str, causes: list[CauseResult], remarks: list[str], console: Console
) -> None:
    """Print the outcome, why, and what else there is to know."""
    console.print(f"verdict: [{_STYLE[verdict]}]{verdict}[/]", highlight=False)
    for cause in causes:
        name = f"{cause.gap} gap" if cause.gap in GAPS else cause.gap
        console.print(f"  {name}: {escape(cause.evidence)}", highlight=False)
        console.print(f"    {escape(cause.hint)}", style="dim", highlight=False)
    for remark in remarks:
        console.print(f"  note: {escape(remark)}", highlight=False)


def add_log(table: Table, log: LogResult) -> None:
    """What was read."""
    times = log.provenance.get("times")
    note = f", {times}" if times else ""
    table.add_row("log", escape(f"{log.name} ({log.format}), {log.duration_s:.0f} s{note}"))
    table.add_row("records", ", ".join(f"{n:,} {name}" for name, n in log.records.items()))


def add_ekf(table: Table, ekf: EkfResult) -> None:
    """The filter and what it used."""
    table.add_row(
        "EKF",
        f"{ekf.filter}, {ekf.landmarks} landmarks; sightings {ekf.rejected} rejected, "
        f"{ekf.ambiguous} ambiguous, {ekf.candidate} of candidates ({ekf.association}"
        + {"on": ", attributes", "layer": ", attributes of a layer"}.get(ekf.attributes, "")
        + ")",
    )
    if ekf.dynamic or ekf.retired:
        table.add_row(
            "dynamic",
            f"{ekf.dynamic} sightings discarded, {ekf.retired} landmarks retired",
        )
    if ekf.global_updates:
        table.add_row(
            "global updates",
            f"{ekf.global_updates}, sparing {100 * ekf.global_update_spared:.0f} % of the passive "
            "covariance",
        )
    if ekf.gps != "off":
        table.add_row("positions", f"{ekf.fixes_fused} fused, {ekf.fixes_rejected} rejected")


def add_smoother(table: Table, smoother: SmootherResult) -> None:
    """The smoother's evidence."""
    table.add_row(
        "smoother",
        f"{smoother.poses:,} poses, error {smoother.error:.2f}, "
        f"{'optimum proven' if smoother.proven else 'optimum NOT proven'} "
        f"(chi2 {smoother.chi2:.0f} {_for(smoother.dof)}; starts: "
        + ", ".join(f"{s.name} {_number(s.error, '.2f')}" for s in smoother.starts)
        + ")",
    )
    if smoother.method != "batch":
        table.add_row(
            smoother.method,
            f"{_number(smoother.distance_sigma, '.2g')} sigma from the optimum at most",
        )
    if smoother.robust != "none":
        table.add_row(
            "robust",
            f"{smoother.robust}: {smoother.rejected_sightings} sightings and "
            f"{smoother.rejected_positions} positions left out",
        )


def _for(dof: int) -> str:
    """What chi-square is held against; nothing where a robust kernel has changed it."""
    return f"for {dof} dof" if dof else "under a robust kernel, not tested"


def add_association(table: Table, association: AssociationResult | None) -> None:
    """How an association made without labels scores."""
    if association is None:
        return
    parts = [("landmarks", association.landmarks)]
    if association.clusters is not None:
        parts.append(("clusters", association.clusters))
    scores = (f"{n}: precision {p.precision:.3f}, recall {p.recall:.3f}" for n, p in parts)
    table.add_row("association", "; ".join(scores) + " (pairs of sightings)")


def add_accuracy(table: Table, name: str, a: AccuracyResult | None) -> None:
    """Errors against truth or GPS."""
    if a is not None:
        table.add_row(name, _accuracy(a))


def _accuracy(a: AccuracyResult) -> str:
    parts = []
    for name, plain, aligned in (
        ("ATE", a.ate_m, a.ate_aligned_m),
        ("landmarks", a.landmark_rmse_m, a.landmark_rmse_aligned_m),
        ("GPS median", a.gps_median_m, a.gps_median_aligned_m),
    ):
        if plain is not None:
            parts.append(f"{name} {plain:.3f} m (aligned {_number(aligned, '.3f')})")
    if a.gps_rms_aligned_m is not None:
        parts.append(f"GPS RMS aligned {a.gps_rms_aligned_m:.3f} m")
    if a.landmarks_true is not None:
        parts.append(f"{a.landmarks_found} of {a.landmarks_true} true landmarks found")
    if a.coverage is not None:
        parts.append(f"coverage {100 * a.coverage:.1f} %")
    return ", ".join(parts)


def _number(value: float | None, form: str) -> str:
    return "none" if value is None else format(value, form)
