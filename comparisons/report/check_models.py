"""`check.json`, for machines. The models are the file's documentation."""

from __future__ import annotations

from typing import Literal

from comparisons.report.model import Model
from comparisons.report.models import (
    AccuracyResult,
    CauseResult,
    LogResult,
    SmootherResult,
)


class GivenBlockResult(Model):
    """See comparisons.checks.given_agreement.Block."""

    difference_m: float
    distance_sigma: float
    variance_ratio_least: float | None
    variance_ratio_largest: float | None
    agrees: bool


class GivenLandmarkResult(GivenBlockResult):
    """One landmark of both."""

    id: int


class TraceResult(Model):
    """See comparisons.checks.given_trace.TraceCheck; gaps as in `result.json`."""

    steps: int
    updates: int
    begun: int
    positions: int
    algebra_gap_sigma: float | None
    algebra_gap_covariance: float | None
    model_gap_sigma: float | None
    model_gap_covariance: float | None
    linearisation_gap_sigma: float | None
    linearisation_gap_covariance: float | None


class CheckResult(Model):
    """`check.json`: an estimate from elsewhere against the smoother's.

    absent: what was not handed in. outside: share of the poses beyond the 99.9 % region of their
    own covariance, None without covariances. trace: None without one.
    """

    log: LogResult
    smoother: SmootherResult
    association_by: str
    information: str
    absent: list[str]
    poses: int
    rms_m: float
    rms_heading_rad: float
    outside: float | None
    last_pose: GivenBlockResult | None
    landmarks: list[GivenLandmarkResult]
    accuracy: AccuracyResult | None
    smoother_accuracy: AccuracyResult | None
    trace: TraceResult | None
    verdict: Literal["agree", "disagree", "unproven"]
    causes: list[CauseResult]
    remarks: list[str]
    seconds: dict[str, float]
    versions: dict[str, str]
