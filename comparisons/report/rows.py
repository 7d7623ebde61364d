"""Rows of figures that several jobs print, and the table that they make on a terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from comparisons.checks.causes import GAPS
from comparisons.checks.verdict import rounded
from comparisons.extensions.interface import Row
from comparisons.report.models import (
    AccuracyResult,
    AssociationCheckResult,
    AssociationResult,
    BlockResult,
    CauseResult,
    EkfResult,
    LogResult,
    SmootherResult,
)

_STYLE = {
    "agree": "bold green",
    "verified": "bold green",
    "disagree": "bold red",
    "unverified": "bold yellow",
}


def print_rows(rows: Iterable[Row], console: Console) -> None:
    """Print a table of names and texts."""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in rows:
        table.add_row(escape(name), escape(text))
    console.print(table)


def print_verdict(
    verdict: str,
    console: Console,
    causes: Sequence[CauseResult] = (),
    remarks: Sequence[str] = (),
    *,
    qualifiers: Sequence[str] = (),
    summary: str = "",
    failed_on: Sequence[str] = (),
) -> None:
    """Print the outcome, why, and what else there is to know. summary: in the outcome's place."""
    style = "bold yellow" if qualifiers and verdict == "agree" else _STYLE[verdict]
    headline = escape(summary or verdict)
    failed = f" (fails on {', '.join(failed_on)})" if failed_on else ""
    console.print(f"verdict: [{style}]{headline}[/]{failed}", highlight=False)
    for cause in causes:
        name = f"{cause.gap} gap" if cause.gap in GAPS else cause.gap
        console.print(f"  {name}: {escape(cause.evidence)}", highlight=False)
        console.print(f"    {escape(cause.hint)}", style="dim", highlight=False)
    print_remarks(remarks, console)


def print_remarks(remarks: Sequence[str], console: Console) -> None:
    """Print sentences that change no verdict."""
    for remark in remarks:
        console.print(f"  note: {escape(remark)}", highlight=False)


def log_rows(log: LogResult) -> list[Row]:
    """What was read."""
    times = log.provenance.get("times")
    note = f", {times}" if times else ""
    return [
        Row("log", f"{log.name} ({log.format}), {log.duration_s:.0f} s{note}"),
        Row("records", ", ".join(f"{n:,} {name}" for name, n in log.records.items())),
    ]


def ekf_rows(ekf: EkfResult) -> list[Row]:
    """The filter and what it used."""
    attributes = {"on": ", attributes", "layer": ", attributes of a layer"}
    rows = [
        Row(
            "EKF",
            f"{ekf.filter}, {ekf.landmarks} landmarks; measurements {ekf.rejected} rejected, "
            f"{ekf.ambiguous} ambiguous, {ekf.candidate} of candidates ({ekf.association}"
            + attributes.get(ekf.attributes, "")
            + ")",
        )
    ]
    if ekf.dynamic or ekf.deactivated:
        found = f"{ekf.dynamic} measurements discarded, {ekf.deactivated} landmarks deactivated"
        rows.append(Row("dynamic", found))
    if ekf.global_updates:
        spared = f"sparing {100 * ekf.global_update_spared:.0f} % of the passive covariance"
        rows.append(Row("global updates", f"{ekf.global_updates}, {spared}"))
    if ekf.gps != "off":
        used = f"{ekf.fixes_fused} fused, {ekf.fixes_rejected} rejected"
        if ekf.longest_streak:
            used += (
                f" ({ekf.fixes_in_streaks} in streaks of 5 or more, longest {ekf.longest_streak}; "
                f"{ekf.fixes_rejected_by_smoother} by the smoother, too)"
            )
        rows.append(Row("positions", used))
    return rows


def smoother_rows(smoother: SmootherResult) -> list[Row]:
    """The smoother's evidence."""
    # A robust kernel changes chi-square.
    tested = f"for {smoother.dof} dof" if smoother.dof else "under a robust kernel, not tested"
    rows = [
        Row(
            "smoother",
            f"{smoother.poses:,} poses, error {smoother.error:.2f}, "
            f"{'optimum verified' if smoother.verified else 'optimum NOT verified'} "
            f"(chi2 {rounded(smoother.chi2)} {tested})",
        ),
        Row("starts", _starts(smoother)),
    ]
    if len(smoother.minima) > 1:
        rows.append(Row("minima", _minima(smoother)))
    if smoother.method != "batch":
        far = f"{shown(smoother.distance_sigma, '.2g')} sigma from the optimum at most"
        rows.append(Row(smoother.method, far))
    if smoother.robust != "none":
        rows.append(
            Row(
                "robust",
                f"{smoother.robust}: {smoother.rejected_measurements} measurements and "
                f"{smoother.rejected_positions} positions left out",
            )
        )
    return rows


def _starts(smoother: SmootherResult) -> str:
    reported = [s for s in smoother.starts if not s.name.startswith("random")]
    parts = [f"{s.name} {shown(s.error, '.2f')}" for s in reported]
    if smoother.random_starts:
        parts.append(
            f"{smoother.random_starts} random ({smoother.chance_missed:.1%} chance of missing a "
            "basin as wide)"
        )
    if smoother.hops:
        parts.append(f"{smoother.hops} hops")
    return ", ".join(parts)


def _minima(smoother: SmootherResult) -> str:
    second = smoother.minima[1]
    place = f"pose at {second.time_s:.1f} s by {second.pose_m:.3g} m"
    if second.landmark is not None and second.landmark_m > second.pose_m:
        place = f"landmark {second.landmark} by {second.landmark_m:.3g} m"
    return (
        f"{len(smoother.minima)} found; the next has error {second.error:.2f} and moves the {place}"
    )


def association_rows(association: AssociationResult | None) -> list[Row]:
    """How an association made without labels scores."""
    if association is None:
        return []
    count = "" if association.used is None else f" ({association.used} for {association.labelled})"
    parts = [(f"landmarks{count}", association.landmarks)]
    if association.clusters is not None:
        parts.append(("clusters", association.clusters))
    scores = (f"{n}: precision {p.precision:.3f}, recall {p.recall:.3f}" for n, p in parts)
    return [Row("association", "; ".join(scores) + " (pairs of measurements)")]


def association_check_rows(check: AssociationCheckResult | None) -> list[Row]:
    """How an association compares with others of the same measurements."""
    if check is None:
        return []
    parts = (
        f"{v.name} {100.0 * v.agreement:.1f} % of pairs, {shown(v.apart_sigma, '.2g')} sigma"
        + (" AGAINST" if v.against else "")
        for v in check.variants
    )
    return [Row("association check", "; ".join(parts))]


def accuracy_rows(name: str, accuracy: AccuracyResult | None) -> list[Row]:
    """Errors against truth or GPS."""
    return [] if accuracy is None else [Row(name, _accuracy(accuracy))]


def seconds_rows(seconds: Mapping[str, float], cpu_s: Mapping[str, float] | None) -> list[Row]:
    """The time of each stage on the wall, which a busy machine stretches, and of the processor."""
    spent = {"seconds": seconds, "seconds of CPU": cpu_s or {}}
    return [
        Row(name, ", ".join(f"{stage} {s:.2f}" for stage, s in each.items()))
        for name, each in spent.items()
        if each
    ]


def gap_row(name: str, sigma: float | None, covariance: float | None) -> Row:
    """Return a gap between two estimates, None being infinite."""
    return Row(name, f"{shown(sigma, '.2g')} sigma, {shown(covariance, '.2g')} in covariance")


def last_pose_row(pose: BlockResult) -> Row:
    """Return how two estimates agree in the last pose."""
    return Row(
        "last pose",
        f"{'agrees' if pose.agrees else 'disagrees'}: {pose.difference_m:.3f} m apart, "
        f"{pose.distance_sigma:.2g} sigma",
    )


def shown(value: float | None, form: str) -> str:
    """A number in a format; `none` where there is none."""
    return "none" if value is None else format(value, form)


def _accuracy(a: AccuracyResult) -> str:
    parts = []
    if a.ate_m is not None:
        parts.append(f"ATE {a.ate_m:.3f} m (aligned {shown(a.ate_aligned_m, '.3f')})")
    if a.rpe_10m_m is not None and a.rpe_10m_rad is not None:
        turned = math.degrees(a.rpe_10m_rad)
        parts.append(f"RPE over 10 m {a.rpe_10m_m:.3f} m, {turned:.2f} degrees")
    for name, plain, aligned in (
        ("landmarks", a.landmark_rmse_m, a.landmark_rmse_aligned_m),
        ("GPS median", a.gps_median_m, a.gps_median_aligned_m),
    ):
        if plain is not None:
            parts.append(f"{name} {plain:.3f} m (aligned {shown(aligned, '.3f')})")
    if a.gps_rms_aligned_m is not None:
        parts.append(f"GPS RMS aligned {a.gps_rms_aligned_m:.3f} m")
    if a.landmarks_true is not None:
        parts.append(f"{a.landmarks_found} of {a.landmarks_true} true landmarks found")
    if a.coverage is not None:
        parts.append(f"coverage {100 * a.coverage:.1f} %")
    return ", ".join(parts)
