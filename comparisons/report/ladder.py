"""The chain of estimates as a ladder: EKF, both linear problems, smoother, truth, and the gaps."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from comparisons.checks.agreement import (
    LARGEST_DISTANCE,
    Agreement,
    GapFigures,
)
from comparisons.checks.causes import FILTER_FAULTS
from comparisons.checks.qualifiers import TruthGap
from comparisons.figures import finite
from comparisons.report.models import Result

EKF = "EKF"
LINEAR = "linear problem, EKF's matrices"
LINEAR_MODEL = "linear problem, smoother's factors"
SMOOTHER = "smoother"
OWN_ASSOCIATION = "smoother, its own association"
TRUTH = "truth"


@dataclass(frozen=True, kw_only=True)
class LadderStep:
    """One gap between two neighbouring estimates.

    above, below: the two estimates. A step whose `above` is not the `below` of the step before
    branches off from an earlier estimate. sigma: the largest difference of the means, in the
    smoother's sigma; for the truth the root of the mean NEES over its degrees of freedom; for an
    association the distance of the last poses; None where infinite. covariance: the largest
    relative difference of the covariances, None where there is none to compare. error_m: root mean
    square error, for an association the distance of the last poses. fails: the gap is a cause of
    the outcome. judged: it was compared with a limit at all. limit: the largest sigma that passes,
    None where no single number is.
    """

    gap: str
    above: str
    below: str
    sigma: float | None
    covariance: float | None = None
    error_m: float | None = None
    fails: bool = False
    judged: bool = True
    limit: float | None = None

    @property
    def mean(self) -> str:
        """The difference of the means in words."""
        if self.sigma is not None:
            return f"{self.sigma:.2g} sigma"
        return "infinite" if self.judged or self.fails or self.gap != "algebra" else "unknown"

    @property
    def state(self) -> str:
        """`fails`, `passes`, or `not judged`."""
        if self.fails:
            return "fails"
        return "passes" if self.judged else "not judged"

    @property
    def deciding(self) -> float | None:
        """The limit, where it alone explains the outcome.

        Rounding of stored numbers, or a filter that is conservative on purpose, is allowed more.
        """
        if self.limit is None or self.sigma is None:
            return None
        passes = self.state == "passes" and self.sigma > self.limit
        return None if passes else self.limit


def ladder(result: Result) -> list[LadderStep]:
    """Return the gaps of a run from the EKF down to the truth, if the log has it."""
    failed = {cause.gap for cause in result.causes}
    return [
        *gap_steps(result.agreement, failed, verified=result.smoother.verified),
        *_association_steps(result, failed),
        *truth_steps(result.truth_gap, failed),
    ]


def gap_steps(
    gaps: GapFigures,
    failed: Collection[str],
    *,
    verified: bool = True,
    first: str = EKF,
) -> list[LadderStep]:
    """Return the three gaps between filter and smoother.

    failed: gaps of the causes. verified: of the smoother's optimum. first: the filter's name. The
    last gap is judged at a verified optimum only, and where algebra and models are right.
    """
    right = verified and FILTER_FAULTS.isdisjoint(failed)
    return [
        LadderStep(
            gap=name,
            above=above,
            below=below,
            sigma=finite(sigma),
            covariance=finite(covariance),
            fails=name in failed,
            judged=judged,
            limit=limit,
        )
        for name, above, below, sigma, covariance, judged, limit in (
            (
                "algebra",
                first,
                LINEAR,
                gaps.algebra_gap_sigma,
                gaps.algebra_gap_covariance,
                isinstance(gaps, Agreement) or finite(gaps.algebra_gap_sigma) is not None,
                gaps.algebra_limit_sigma,
            ),
            (
                "model",
                LINEAR,
                LINEAR_MODEL,
                gaps.model_gap_sigma,
                gaps.model_gap_covariance,
                True,
                gaps.model_limit_sigma,
            ),
            (
                "linearisation",
                LINEAR_MODEL,
                SMOOTHER,
                gaps.linearisation_gap_sigma,
                gaps.linearisation_gap_covariance,
                right,
                None,  # judged by blocks, not by its largest coordinate
            ),
        )
    ]


def truth_steps(truth: TruthGap | None, failed: Collection[str]) -> list[LadderStep]:
    """Return the gap between the smoother and the truth, by what is farthest off; none without."""
    if truth is None or not truth.distances:
        return []
    worst = max(truth.distances, key=lambda distance: (distance.sigma or 0.0) / distance.limit)
    return [
        LadderStep(
            gap="truth",
            above=SMOOTHER,
            below=TRUTH,
            sigma=worst.sigma,
            error_m=worst.error_m,
            fails=truth.stands or "truth" in failed,
            limit=worst.limit,
        )
    ]


def _association_steps(result: Result, failed: Collection[str]) -> list[LadderStep]:
    """The smoother against itself with its own association, where that ran."""
    entry = result.model_dump(include={"own_association"}).get("own_association")
    if not isinstance(entry, dict):
        return []
    return [
        LadderStep(
            gap="association",
            above=SMOOTHER,
            below=OWN_ASSOCIATION,
            sigma=entry["pose_distance_sigma"],
            error_m=entry["pose_difference_m"],
            fails="association" in failed,
            judged=entry["verified"],
            limit=LARGEST_DISTANCE,
        )
    ]
