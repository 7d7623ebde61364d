"""The posterior in `result.json` and in the table of figures."""

from __future__ import annotations

import numpy as np

from comparisons.extensions.posterior.check import Judged, PosteriorCheck
from comparisons.figures import Model, finite
from comparisons.words import Row
from graphslam.chain_diagnostics import Estimated
from graphslam.sampling import (
    LARGEST_R_HAT,
    LEAST_ACCEPTANCE,
    LEAST_SAMPLE_SIZE,
    Judgement,
)

GROUP = "Posterior (draws)"


class FigureResult(Model):
    """A figure from draws.

    Attributes:
        value: the figure.
        error: its Monte Carlo standard error.
    """

    value: float
    error: float


class JudgementResult(Model):
    """A Gaussian of some numbers against the posterior.

    Attributes:
        coverage: share of the posterior in the Gaussian's 95 % ellipsoid.
        least: least variance ratio, Gaussian to posterior, over all directions; below 1 is
            optimistic.
        largest: largest variance ratio.
    """

    coverage: FigureResult
    least: FigureResult
    largest: FigureResult


class JudgedResult(Model):
    """One estimator's Gaussian against the posterior.

    Attributes:
        pose: of the last pose.
        landmarks: of every landmark, in the order of the map.
        whole: of the last pose and all landmarks together.
    """

    pose: JudgementResult
    landmarks: list[JudgementResult]
    whole: JudgementResult


class MomentsResult(Model):
    """Mean and spread of the posterior of the last pose and all landmarks, (m,) numbers each.

    Attributes:
        mean: x, y [m], heading [rad] of the last pose, then x, y [m] of the landmarks.
        mean_error: Monte Carlo standard errors.
        covariance: (m, m).
        covariance_error: Monte Carlo standard errors.
        skewness: of every number.
        skewness_error: Monte Carlo standard errors.
    """

    mean: list[float]
    mean_error: list[float]
    covariance: list[list[float]]
    covariance_error: list[list[float]]
    skewness: list[float]
    skewness_error: list[float]


class PosteriorResult(Model):
    """Entry `posterior`: draws of the smoother's exact posterior, see graphslam.sampling.

    Attributes:
        draws: of all chains together.
        chains: run at once.
        unknowns: numbers that were drawn together.
        acceptance: mean of all proposals.
        step_rad: rotation that one step integrates.
        r_hat: largest of all unknowns.
        bulk: least effective sample size of the bulk of any unknown.
        tail: least effective sample size of the tails of any unknown.
        converged: whether all limits are kept.
        lacks: the first limit that is not, in words.
        moments: mean and spread; none where the draws did not converge.
        ekf: the filter's Gaussian against the posterior.
        smoother: the smoother's.
    """

    draws: int
    chains: int
    unknowns: int
    acceptance: float
    step_rad: float
    r_hat: float | None
    bulk: float | None
    tail: float | None
    converged: bool
    lacks: str
    moments: MomentsResult | None
    ekf: JudgedResult | None
    smoother: JudgedResult | None


def posterior_result(check: PosteriorCheck) -> PosteriorResult:
    """Return what was found."""
    draws = check.draws
    chains, length, _ = draws.draws.shape
    r_hat, bulk, tail = draws.evidence
    return PosteriorResult(
        draws=chains * length,
        chains=chains,
        unknowns=len(r_hat) - 1,
        acceptance=draws.acceptance,
        step_rad=draws.step,
        r_hat=finite(float(r_hat.max())),
        bulk=finite(float(bulk.min())),
        tail=finite(float(tail.min())),
        converged=draws.converged,
        lacks=draws.lacks,
        moments=_moments(check) if draws.converged else None,
        ekf=_judged(check.ekf),
        smoother=_judged(check.smoother),
    )


def posterior_rows(check: PosteriorCheck, result: PosteriorResult) -> list[Row]:
    """Return the evidence of convergence, then both Gaussians."""
    rows = [
        Row(GROUP, "draws, unknowns", f"{result.draws:,}, {result.unknowns:,}"),
        _limited("acceptance", result.acceptance, LEAST_ACCEPTANCE, "at least", ".2f"),
        _limited("largest R-hat", result.r_hat, LARGEST_R_HAT, "at most", ".3f"),
        _limited(
            "least effective sample size, bulk", result.bulk, LEAST_SAMPLE_SIZE, "at least", ".0f"
        ),
        _limited(
            "least effective sample size, tails", result.tail, LEAST_SAMPLE_SIZE, "at least", ".0f"
        ),
    ]
    if result.moments is None:
        return [*rows, Row(GROUP, "judgement of the Gaussians", "not converged")]
    skewness = np.abs(result.moments.skewness)
    rows.append(Row(GROUP, "largest skewness", f"{skewness.max():.2f}"))
    for name, judged in (("EKF", check.ekf), ("smoother", check.smoother)):
        rows += _judged_rows(name, judged) if judged is not None else []
    return rows


def _limited(quantity: str, value: float | None, limit: float, side: str, form: str) -> Row:
    inside = value is not None and (value <= limit if side == "at most" else value >= limit)
    shown = "undefined" if value is None else format(value, form)
    return Row(GROUP, quantity, shown, f"{side} {limit:g}", inside)


def _judged_rows(name: str, judged: Judged) -> list[Row]:
    blocks = [("last pose", judged.pose), ("whole", judged.whole)]
    if judged.landmarks:
        blocks.insert(1, ("worst landmark", judged.landmarks[judged.worst_landmark()]))
    rows = []
    for block, one in blocks:
        rows.append(
            Row(
                GROUP,
                f"{name}, {block}: posterior in the 95 % ellipsoid",
                f"{100.0 * one.coverage.value:.1f} +- {100.0 * one.coverage.error:.1f} %",
            )
        )
        rows.append(
            Row(
                GROUP,
                f"{name}, {block}: variance ratio (1 is exact)",
                f"{_shown(one.least)} to {_shown(one.largest)}",
            )
        )
    return rows


def _shown(figure: Estimated) -> str:
    return f"{figure.value:.2f} +- {figure.error:.2f}"


def _judged(judged: Judged | None) -> JudgedResult | None:
    if judged is None:
        return None
    return JudgedResult(
        pose=_judgement(judged.pose),
        landmarks=[_judgement(one) for one in judged.landmarks],
        whole=_judgement(judged.whole),
    )


def _judgement(one: Judgement) -> JudgementResult:
    return JudgementResult(**{k: FigureResult(**v._asdict()) for k, v in one._asdict().items()})


def _moments(check: PosteriorCheck) -> MomentsResult:
    mean, mean_error = check.draws.mean()
    covariance, covariance_error = check.draws.covariance()
    skewness, skewness_error = check.draws.skewness()
    return MomentsResult(
        mean=mean.tolist(),
        mean_error=mean_error.tolist(),
        covariance=covariance.tolist(),
        covariance_error=covariance_error.tolist(),
        skewness=skewness.tolist(),
        skewness_error=skewness_error.tolist(),
    )
