"""Parts of result files that several jobs and extensions share, from findings to models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from comparisons.adapters.ekf_run import EkfRun
from comparisons.checks.qualifiers import TruthGapFinding, against_optimum
from comparisons.checks.unused_positions import UnusedPositionsFinding
from comparisons.config import EkfConfig, JobConfig
from comparisons.estimates.estimate import Estimate
from comparisons.figures import finite, package_versions, stored
from comparisons.logs.hashing import log_hash
from comparisons.logs.log import Log
from comparisons.report.html.map import MapContent
from comparisons.report.html.page import PageContent, page_of
from comparisons.report.marks import Panel
from comparisons.report.models import (
    CheckedResult,
    EkfResult,
    JobResult,
    LogResult,
    MinimumResult,
    SmootherResult,
    StartResult,
)
from comparisons.report.panels import known_panels
from comparisons.report.settings import SettingLine, setting_lines, settings_result
from comparisons.report.terminal import Summary
from comparisons.report.track_errors import track_errors
from comparisons.words import cause_name
from graphslam import smoother

if TYPE_CHECKING:
    from comparisons.checks.position_gate import RejectedFixes
    from comparisons.pipeline.known import Known
    from comparisons.pipeline.prepared import Prepared


def about_job(
    prepared: Prepared[Any],
    clock: Mapping[str, Any],
    ekf: EkfConfig | None = None,
    log: Log | None = None,
) -> dict[str, Any]:
    """Return what results of every job on a log have.

    clock: `Clock.after`. ekf: as it ran. log: as it was read, where it was prepared with another
    integration or other times.
    """
    return {
        "config": prepared.config.model_dump(mode="json"),
        "settings": settings_result(prepared.config, prepared.log.format, ekf),
        "log": log_result(log or prepared.log),
        **clock,
        "versions": package_versions(),
    }


def log_result(log: Log) -> LogResult:
    """What was read."""
    return LogResult(
        name=log.name,
        format=log.format,
        records=log.records,
        duration_s=log.duration_s,
        sha256=log_hash(log),
        provenance=log.provenance,
    )


def found_entries(known: Known, result: type[JobResult]) -> dict[str, Any]:
    """Return what checks found as a result's arguments, and what they lack."""
    entries = {
        key: entry if key in result.model_fields else stored(entry)
        for key, entry in known.entries.items()
    }
    return {**entries, "not_checked": dict(known.absent)}


def optimum_findings(
    known: Known, result: type[CheckedResult], remarks: Sequence[str]
) -> dict[str, Any]:
    """Return the same for an optimum with which no filter is compared, and all remarks."""
    against = against_optimum(known.value(TruthGapFinding), known.value(UnusedPositionsFinding))
    said = [f"{cause_name(cause.gap)}: {cause.evidence}" for cause in against.values()]
    return {
        **found_entries(known, result),
        "qualifiers": list(against),
        "remarks": [*said, *remarks],
    }


def about_log(log: LogResult) -> str:
    """Return format and duration, and what stands in place of seconds, if anything does."""
    times = str(log.provenance.get("times", ""))
    said = f"; {times}" if "in place of seconds" in times else ""
    return f"{log.format}, {log.duration_s:,.0f} s{said}"


def ekf_result(
    run: EkfRun, prepared: Prepared[Any], fixes: RejectedFixes | None = None
) -> EkfResult:
    """The filter and what it used. fixes: what its gate rejected, where a smoother judged it."""
    config, streaks = prepared.ekf, {}
    if fixes is not None:
        streaks = {
            "fixes_in_streaks": fixes.in_streaks,
            "longest_streak": fixes.longest,
            "fixes_rejected_by_smoother": fixes.unfit_count,
        }
    compression: dict[str, Any] = {"global_updates": 0, "global_update_spared": 0.0}
    if run.compression is not None:
        compression = run.compression._asdict()
    return EkfResult(
        filter=config.filter,
        association=str(config.association),
        attributes=config.attributes,
        landmarks=len(run.estimate.landmark),
        **run.unused,
        deactivated=len(run.deactivated),
        cut_off=run.cut_off,
        gps=config.gps,
        fixes_fused=len(run.fix_number),
        fixes_rejected=run.rejected_fixes,
        fixes_outside_stretches=prepared.outside_stretches,
        **streaks,
        **compression,
    )


def smoother_result(result: smoother.SmootherEvidence, estimate: Estimate) -> SmootherResult:
    """The smoother and its evidence. estimate: its own, for times and names of landmarks."""
    options, optimality = result.options, result.optimality
    explored = optimality.exploration
    return SmootherResult(
        method=options.method,
        optimiser=options.optimiser,
        robust=options.robust,
        rejected_measurements=len(result.rejected.measurements),
        rejected_positions=len(result.rejected.positions),
        distance_sigma=finite(optimality.distance_sigma),
        rank=result.rank,
        poses=len(result.poses),
        error=result.error,
        chi2=optimality.chi_square.chi2,
        dof=optimality.chi_square.dof,
        chi2_band=(optimality.chi_square.lower, optimality.chi_square.upper),
        newton_decrement=optimality.stationarity.decrement,
        iterations=result.iterations,
        converged=result.converged,
        verified=optimality.verified,
        lacks=optimality.lacks,
        agreeing_starts=list(optimality.agreeing),
        starts=[
            StartResult(
                name=s.name,
                error=finite(s.error),
                iterations=s.iterations,
                converged=s.converged,
            )
            for s in result.starts
        ],
        minima=[
            MinimumResult(
                error=m.error,
                starts=m.starts,
                time_s=float(estimate.time_s[m.pose]),
                pose_m=m.pose_m,
                landmark=None if m.landmark < 0 else int(estimate.landmark_id[m.landmark]),
                landmark_m=m.landmark_m,
            )
            for m in explored.minima
        ],
        hops=explored.hops,
        random_starts=explored.draws,
        chance_missed=explored.missed,
    )


def job_page(
    result: JobResult,
    summary: Summary,
    job: str,
    drawn: MapContent,
    curves: tuple[str, Sequence[Panel]],
    settings: Sequence[SettingLine],
) -> PageContent:
    """Return the page of a job on a log: what it prints, a map, curves, settings and times.

    curves: what they show, in words, and their panels.
    """
    reported, panels = curves
    return replace(
        page_of(summary, result.log.name),
        job=job,
        about=about_log(result.log),
        map=drawn,
        reported=reported,
        panels=panels,
        settings=settings,
        seconds=result.seconds,
        cpu_s=result.cpu_s or {},
        versions=result.versions,
    )


def known_page(
    result: JobResult,
    summary: Summary,
    job: str,
    drawn: MapContent,
    config: JobConfig,
    known: Known,
) -> PageContent:
    """Return the page of a job with the curves of what it knows."""
    settings = setting_lines(config, result.settings)
    drawn = replace(drawn, errors=track_errors(known))
    return job_page(result, summary, job, drawn, known_panels(known), settings)
