"""The chain of estimates as a ladder: EKF, both linear problems, smoother, truth, and the gaps."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING

from comparisons.report.models import AgreementResult, Result, TruthGapResult

if TYPE_CHECKING:
    from comparisons.report.check import TraceResult

EKF = "EKF"
LINEAR = "linear problem, EKF's matrices"
LINEAR_MODEL = "linear problem, smoother's factors"
SMOOTHER = "smoother"
TRUTH = "truth"


@dataclass(frozen=True, kw_only=True)
class Step:
    """One gap between two neighbouring estimates.

    above, below: the two estimates. sigma: the largest difference of the means, in the smoother's
    sigma; for the truth the root of the mean NEES over its degrees of freedom; None where
    infinite. covariance: the largest relative difference of the covariances, None where there is
    none to compare. error_m: root mean square error, for the truth. fails: the gap is a cause of
    the outcome.
    """

    gap: str
    above: str
    below: str
    sigma: float | None
    covariance: float | None = None
    error_m: float | None = None
    fails: bool = False


def ladder(result: Result) -> list[Step]:
    """Return the gaps of a run from the EKF down to the truth, if the log has it."""
    failed = {cause.gap for cause in result.causes}
    return [*gap_steps(result.agreement, failed), *truth_steps(result.truth_gap, failed)]


def gap_steps(gaps: AgreementResult | TraceResult, failed: Collection[str]) -> list[Step]:
    """Return the three gaps between EKF and smoother. failed: gaps of the causes."""
    return [
        Step(
            gap=name,
            above=above,
            below=below,
            sigma=sigma,
            covariance=covariance,
            fails=name in failed,
        )
        for name, above, below, sigma, covariance in (
            ("algebra", EKF, LINEAR, gaps.algebra_gap_sigma, gaps.algebra_gap_covariance),
            ("model", LINEAR, LINEAR_MODEL, gaps.model_gap_sigma, gaps.model_gap_covariance),
            (
                "linearisation",
                LINEAR_MODEL,
                SMOOTHER,
                gaps.linearisation_gap_sigma,
                gaps.linearisation_gap_covariance,
            ),
        )
    ]


def truth_steps(truth: TruthGapResult | None, failed: Collection[str]) -> list[Step]:
    """Return the gap between the smoother and the truth, by what is farthest off; none without."""
    if truth is None or not truth.distances:
        return []
    worst = max(truth.distances, key=lambda one: (one.sigma or 0.0) / one.limit)
    return [
        Step(
            gap="truth",
            above=SMOOTHER,
            below=TRUTH,
            sigma=worst.sigma,
            error_m=worst.error_m,
            fails=truth.stands or "truth" in failed,
        )
    ]
