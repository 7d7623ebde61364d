"""From a comparison to the model of `result.json`, and to the rows of its table."""

from __future__ import annotations

from rich.console import Console

from comparisons.extensions.interface import Row
from comparisons.pipeline.compare import Comparison
from comparisons.pipeline.prepare import Clock
from comparisons.report.consistency_result import consistency_result, consistency_rows
from comparisons.report.model import finite
from comparisons.report.models import (
    SCHEMA,
    Accuracies,
    AccuracyResult,
    AgreementResult,
    BlockResult,
    LandmarkResult,
    Result,
)
from comparisons.report.rows import (
    accuracy_rows,
    association_rows,
    ekf_rows,
    gap_row,
    last_pose_row,
    log_rows,
    print_rows,
    print_verdict,
    seconds_rows,
    shown,
    smoother_rows,
)
from comparisons.report.sections import (
    accuracy_result,
    association_result,
    block_fields,
    cause_result,
    ekf_result,
    log_result,
    package_versions,
    smoother_result,
    truth_gap_result,
)
from comparisons.report.settings import settings_result, settings_rows


def build_result(comparison: Comparison, read: Clock | None = None) -> Result:
    """Return the findings of a run, read being the time that reading the log took."""
    c = comparison
    entries = {key: entry for found in c.findings.values() for key, entry in found.entries.items()}
    return Result(
        schema_version=SCHEMA,
        config=c.prepared.config.model_dump(mode="json"),
        settings=settings_result(c.prepared.config, c.log.format, c.prepared.ekf),
        log=log_result(c.log),
        ekf=ekf_result(c.ekf, c.prepared.ekf, c.assessment.fixes),
        smoother=smoother_result(c.smoother, c.smoothed),
        agreement=_agreement(c),
        consistency=consistency_result(c.consistency),
        accuracy=_accuracies(c),
        association=association_result(c.assessment.association),
        truth_gap=truth_gap_result(c.assessment.truth_gap),
        verdict=c.verdict.outcome,
        summary=c.verdict.summary,
        qualifiers=list(c.verdict.qualifiers),
        inconsistent=None if c.verdict.inconsistent is None else list(c.verdict.inconsistent),
        failed_on=list(c.verdict.failed_on),
        causes=[cause_result(cause) for cause in c.verdict.causes],
        remarks=list(c.verdict.remarks),
        **c.prepared.clock.after(read),
        versions=package_versions(),
        **entries,
    )


def run_rows(comparison: Comparison, result: Result) -> list[Row]:
    """Return log, evidence, gaps and accuracy, then what the extensions found."""
    extensions = [row for found in comparison.findings.values() for row in found.rows()]
    accuracy = result.accuracy
    figures: list[Row] = []
    if accuracy is not None:
        figures += accuracy_rows("EKF accuracy", accuracy.ekf)
        figures += accuracy_rows("smoother accuracy", accuracy.smoother)
        figures += accuracy_rows("dead reckoning", accuracy.dead_reckoning)
    return [
        *log_rows(result.log),
        *(settings_rows(result.settings) if result.settings else ()),
        *ekf_rows(result.ekf),
        *smoother_rows(result.smoother),
        *gap_rows(result.agreement),
        *(Row(*row) for row in consistency_rows(result.consistency)),
        *figures,
        *association_rows(result.association),
        *extensions,
    ]


def gap_rows(gaps: AgreementResult) -> list[Row]:
    """Return the gaps, and how many landmarks agree."""
    rows = [
        gap_row(name, sigma, covariance)
        for name, sigma, covariance in (
            ("algebra gap", gaps.algebra_gap_sigma, gaps.algebra_gap_covariance),
            ("model gap", gaps.model_gap_sigma, gaps.model_gap_covariance),
            ("linearisation gap", gaps.linearisation_gap_sigma, gaps.linearisation_gap_covariance),
        )
    ]
    agreeing = sum(row.agrees for row in gaps.landmarks)
    return [
        *rows,
        Row(
            "optimism",
            f"{shown(gaps.optimism, '.3g')} (EKF's variance over the smoother's, worst direction; "
            f"largest {shown(gaps.pessimism, '.3g')})",
        ),
        Row(
            "landmarks",
            f"{agreeing} of {len(gaps.landmarks)} agree; EKF and smoother "
            f"{gaps.landmark_difference_rms_m:.3f} m apart (rms)",
        ),
        last_pose_row(gaps.pose),
    ]


def print_run(comparison: Comparison, result: Result, console: Console) -> None:
    """Print the table, the verdict and its causes."""
    print_rows(
        [*run_rows(comparison, result), *seconds_rows(result.seconds, result.cpu_s)], console
    )
    print_verdict(
        result.verdict,
        console,
        result.causes,
        result.remarks,
        qualifiers=result.qualifiers,
        summary=result.summary,
        failed_on=result.failed_on,
    )


def _agreement(c: Comparison) -> AgreementResult:
    a, ekf = c.agreement, c.ekf.estimate
    return AgreementResult(
        algebra_gap_sigma=finite(a.algebra.sigma),
        algebra_gap_covariance=finite(a.algebra.covariance),
        model_gap_sigma=finite(a.model.sigma),
        model_gap_covariance=finite(a.model.covariance),
        linearisation_gap_sigma=finite(a.linearisation.sigma),
        linearisation_gap_covariance=finite(a.linearisation.covariance),
        optimism=finite(a.whole.least),
        pessimism=finite(a.whole.largest),
        landmark_difference_rms_m=a.landmark_difference_rms_m,
        pose=BlockResult(**block_fields(a.pose)),
        map=BlockResult(**block_fields(a.whole)),
        landmarks=[
            LandmarkResult(
                id=int(ekf.landmark_id[i]),
                ekf_m=tuple(ekf.landmark[i].tolist()),
                smoother_m=tuple(c.smoothed.landmark[i].tolist()),
                **block_fields(b),
            )
            for i, b in enumerate(a.landmarks)
        ],
    )


def _accuracies(c: Comparison) -> Accuracies | None:
    a = c.assessment
    if a.ekf is None or a.smoother is None:
        return None
    return Accuracies(
        ekf=AccuracyResult(**vars(a.ekf)),
        smoother=AccuracyResult(**vars(a.smoother)),
        dead_reckoning=accuracy_result(a.dead_reckoned),
    )


def metrics(result: Result) -> dict[str, float | None]:
    """The figures of a run that a baseline keeps, by name; None where a log has no such figure."""
    found: dict[str, float | None] = {}
    for part, model in (
        ("agreement", result.agreement),
        ("ekf", result.ekf),
        ("smoother", result.smoother),
    ):
        for name, value in model.model_dump().items():
            if isinstance(value, bool) or name in ("iterations", "rank", "distance_sigma"):
                continue
            if value is None or isinstance(value, int | float):
                found[f"{part}.{name}"] = value
    if result.accuracy is not None:
        for name, figures in (
            ("ekf", result.accuracy.ekf),
            ("smoother", result.accuracy.smoother),
        ):
            found |= {f"accuracy.{name}.{key}": v for key, v in figures.model_dump().items()}
    return found
