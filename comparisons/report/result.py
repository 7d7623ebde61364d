"""From a comparison to the model of `result.json`, to rows of figures, and to what is printed."""

from __future__ import annotations

from dataclasses import replace

from comparisons.checks.check import value_of
from comparisons.checks.position_gate import PositionsFinding
from comparisons.figures import stored
from comparisons.pipeline.compare import Comparison
from comparisons.pipeline.prepare import Clock
from comparisons.report.ladder import ladder
from comparisons.report.models import SCHEMA, Result
from comparisons.report.rows import (
    AGREEING_RATIOS,
    agreeing,
    block_rows,
    ekf_rows,
    gap_rows,
    log_rows,
    pose_words,
    seconds_rows,
    smoother_rows,
)
from comparisons.report.sections import about_job, ekf_result, smoother_result
from comparisons.report.settings import settings_rows
from comparisons.report.terminal import STYLES, Summary
from comparisons.words import Row


def build_result(comparison: Comparison, read: Clock | None = None) -> Result:
    """Return the findings of a run, read being the time that reading the log took."""
    c, fixes = comparison, value_of(comparison.findings, PositionsFinding)
    entries = {
        key: entry if key in Result.model_fields else stored(entry)
        for found in c.findings.values()
        for key, entry in found.entries.items()
    }
    return Result(
        schema_version=SCHEMA,
        ekf=ekf_result(c.ekf, c.prepared.ekf, fixes),
        smoother=smoother_result(c.smoother, c.smoothed),
        agreement=replace(
            c.agreement,
            algebra_limit_sigma=c.gaps.algebra_rounding.sigma,
            model_limit_sigma=c.gaps.model_rounding.sigma,
        ),
        verdict=c.verdict.outcome,
        summary=c.verdict.summary,
        qualifiers=list(c.verdict.qualifiers),
        inconsistent=None if c.verdict.inconsistent is None else list(c.verdict.inconsistent),
        failed_on=list(c.verdict.failed_on),
        not_checked=dict(c.absent),
        causes=c.verdict.causes,
        remarks=list(c.verdict.remarks),
        **about_job(c.prepared, c.prepared.clock.after(read), c.prepared.ekf),
        **entries,
    )


def run_rows(comparison: Comparison, result: Result) -> list[Row]:
    """Return log, evidence and gaps, then what the checks found, and what they lack."""
    gaps = result.agreement
    return [
        *log_rows(result.log),
        *settings_rows(result.settings),
        *ekf_rows(result.ekf),
        *smoother_rows(result.smoother),
        *gap_rows(ladder(result)),
        *agreeing(gaps.landmarks, "EKF"),
        Row(
            "Map, EKF and smoother",
            "difference of the landmarks (rms)",
            f"{gaps.landmark_difference_rms_m:.3f} m",
        ),
        *block_rows("Last pose", "EKF", gaps.pose, AGREEING_RATIOS),
        *block_rows("Last pose and map jointly", "EKF", gaps.map, AGREEING_RATIOS),
        *(row for found in comparison.findings.values() for row in found.rows()),
        *(
            Row("Not checked", name.replace("_", " "), why)
            for name, why in comparison.absent.items()
        ),
    ]


def run_summary(comparison: Comparison, result: Result) -> Summary:
    """Return what the command prints."""
    gaps = result.agreement
    landmarks = [*gaps.landmarks, *gaps.pose_landmarks]
    agree = sum(row.agrees for row in landmarks)
    failed = f" (fails on {', '.join(result.failed_on)})" if result.failed_on else ""
    qualified = result.verdict == "agree" and result.qualifiers
    return Summary(
        headline=f"verdict: {result.summary.partition(' (')[0] or result.headline}{failed}",
        style=STYLES["unverified" if qualified else result.verdict],
        causes=result.causes,
        remarks=result.remarks,
        steps=ladder(result),
        lines=[
            (
                "agreement",
                f"{agree} of {len(landmarks)} landmarks "
                f"({gaps.landmark_difference_rms_m:.3f} m rms); {pose_words(gaps.pose)}",
            ),
            *finding_lines(comparison),
        ],
        rows=[*run_rows(comparison, result), *seconds_rows(result.seconds, result.cpu_s)],
    )


def finding_lines(comparison: Comparison) -> list[tuple[str, str]]:
    """Return the lines of the summary that findings have, a name and words each."""
    return [found.line for found in comparison.findings.values() if found.line is not None]


def metrics(result: Result) -> dict[str, float | None]:
    """The figures of a run that a baseline keeps, by name; None where a log has no such figure."""
    found: dict[str, float | None] = {}
    for part, model in (
        ("agreement", result.agreement),
        ("ekf", result.ekf),
        ("smoother", result.smoother),
    ):
        for name, value in stored(model).items():
            if isinstance(value, bool) or name in ("iterations", "rank", "distance_sigma"):
                continue
            if value is None or isinstance(value, int | float):
                found[f"{part}.{name}"] = value
    if result.accuracy is not None:
        for name, figures in (
            ("ekf", result.accuracy.ekf),
            ("smoother", result.accuracy.smoother),
        ):
            found |= {f"accuracy.{name}.{key}": v for key, v in vars(figures).items()}
    return found
