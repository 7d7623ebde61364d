"""Draws of the smoother's exact posterior, which judge the Gaussians of both estimators."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Index
from comparisons.checks.finding import Finding
from comparisons.config import Configured
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.extensions.posterior.config import PosteriorConfig
from comparisons.figures import Aside, LeftOut, finite
from comparisons.pipeline.extension import Extension
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepared import Prepared
from comparisons.words import Row
from graphslam.chain_diagnostics import SampledFigure
from graphslam.sampling import (
    LARGEST_DIMENSION,
    LARGEST_R_HAT,
    LEAST_ACCEPTANCE,
    LEAST_SAMPLE_SIZE,
    PosteriorComparison,
    PosteriorDraws,
    SamplingOptions,
    sample_posterior,
)

_GROUP = "Posterior (draws)"


LEVEL = 0.95
"""Probability of the ellipsoids whose coverage is measured."""
LEAST_COVERAGE = 0.9
LEAST_RATIO = 0.8
"""A Gaussian fails a block where its ellipsoid holds less than this share of the posterior, or a
direction's variance is below this share of the posterior's, by more than chance allows."""
ERRORS = 4.0
"""Standard errors that chance allows; among some hundred blocks, one false alarm in fifty runs."""


@dataclass(frozen=True)
class GaussianJudgement:
    """One estimator's Gaussian against the posterior.

    Attributes:
        pose: of the last pose.
        landmarks: of every landmark, in the order of the map.
        whole: of the last pose and all landmarks together.
    """

    pose: PosteriorComparison
    landmarks: tuple[PosteriorComparison, ...]
    whole: PosteriorComparison


@dataclass(frozen=True, kw_only=True)
class Moments:
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

    @classmethod
    def of(cls, draws: PosteriorDraws) -> Moments:
        """Return them from draws that converged."""
        found = {name: getattr(draws, name)() for name in ("mean", "covariance", "skewness")}
        values = {name: value.tolist() for name, (value, _) in found.items()}
        errors = {f"{name}_error": error.tolist() for name, (_, error) in found.items()}
        return cls(**values, **errors)


@dataclass(frozen=True, kw_only=True)
class PosteriorCheck:
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
        ekf: the filter's Gaussian against the posterior; none where the draws did not converge.
        smoother: the smoother's.
    """

    draws: int
    chains: int
    unknowns: int
    acceptance: LeftOut[float]
    step_rad: LeftOut[float]
    r_hat: LeftOut[float | None]
    bulk: LeftOut[float | None]
    tail: LeftOut[float | None]
    converged: bool
    lacks: str
    moments: Moments | None
    ekf: LeftOut[GaussianJudgement | None]
    smoother: LeftOut[GaussianJudgement | None]
    posterior: Aside[PosteriorDraws]


def check_posterior(draws: PosteriorDraws, ekf: Estimate, smoothed: Estimate) -> PosteriorCheck:
    """Judge both Gaussians, unless the draws did not converge."""
    chains, length, _ = draws.draws.shape
    r_hat, bulk, tail = draws.evidence
    return PosteriorCheck(
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
        moments=Moments.of(draws) if draws.converged else None,
        ekf=judged(draws, ekf) if draws.converged else None,
        smoother=judged(draws, smoothed) if draws.converged else None,
        posterior=draws,
    )


def judged(draws: PosteriorDraws, estimate: Estimate) -> GaussianJudgement:
    """Judge an estimator's Gaussian of the last pose and all points."""
    mean = np.concatenate((estimate.pose[-1], estimate.landmark.ravel()))
    pose, *landmarks, whole = (
        draws.judge(mean, estimate.joint_covariance, numbers, LEVEL)
        for numbers in _blocks(len(mean))
    )
    return GaussianJudgement(pose, tuple(landmarks), whole)


def _blocks(size: int) -> Iterator[Index]:
    yield np.arange(3)
    for first in range(3, size, 2):
        yield np.arange(first, first + 2)
    yield np.arange(size)


def fails(block: PosteriorComparison) -> bool:
    """Whether a Gaussian is too small for the posterior, by more than chance."""
    return _below(block.coverage, LEAST_COVERAGE) or _below(block.least, LEAST_RATIO)


def _below(figure: SampledFigure, limit: float) -> bool:
    return figure.value + ERRORS * figure.error < limit


def failures(judgement: GaussianJudgement, ids: NDArray[np.int64]) -> list[str]:
    """Return the blocks that fail, in words. ids: (L,) of the landmarks."""
    found = ["the last pose"] if fails(judgement.pose) else []
    failed = [
        i
        for i, comparison in zip(ids.tolist(), judgement.landmarks, strict=True)
        if fails(comparison)
    ]
    if len(failed) > 3:
        found.append(f"{len(failed)} of {len(judgement.landmarks)} landmarks")
    else:
        found += [f"landmark {i}" for i in failed]
    if not found and fails(judgement.whole):
        found.append("the last pose and all landmarks together")
    return found


class Posterior(Extension):
    """How good are the two Gaussians beside draws of the posterior?

    Asks what neither Gaussian can say: how good they are.
    """

    name = "posterior"
    needs = "a short log"
    errs = "not at all: what it finds changes no verdict"
    figures = (("posterior", PosteriorCheck),)

    def __init__(self, settings: PosteriorConfig, config: Configured) -> None:
        """settings: how many draws, and the seed."""
        super().__init__(settings, config)
        self.options = SamplingOptions(draws=settings.draws // SamplingOptions.chains)
        self.seed = settings.seed

    def start(self, prepared: Prepared[Any], run: EkfRun) -> None:
        """Refuse a log that is too long before the smoother runs. Raises InputError."""
        unknowns = 3 * len(run.timeline.epoch_time_s) + 2 * len(run.estimate.landmark)
        if unknowns > LARGEST_DIMENSION:
            raise InputError(
                f"{prepared.log.name}: --posterior samples draws at most {LARGEST_DIMENSION:,} "
                f"unknowns (3 a pose, 2 a landmark), not {unknowns:,}; --end S takes a shorter "
                "stretch"
            )

    def find(self, known: Known) -> PosteriorFinding:
        """Draw around the smoother's optimum and judge. Raises InputError."""
        prepared, gaps = known.prepared, known.gaps
        rng = np.random.default_rng(self.seed)
        with prepared.clock.stage("posterior"):
            try:
                draws = sample_posterior(
                    gaps.result.problem,
                    gaps.result.poses,
                    gaps.result.landmarks,
                    rng,
                    self.options,
                    lambda done, total: prepared.progress("posterior", done, total),
                )
            except ValueError as error:
                raise InputError(f"{prepared.log.name}: --posterior samples: {error}") from None
            check = check_posterior(draws, known.ekf.estimate, gaps.smoothed)
        return PosteriorFinding(check, gaps.smoothed.landmark_id)


class PosteriorFinding(Finding):
    """What the draws say of both Gaussians."""

    def __init__(self, check: PosteriorCheck, landmark_id: NDArray[np.int64]) -> None:
        """Only remarks: what the draws say changes no verdict. landmark_id: (L,)."""
        self.check = check
        self.entries = {"posterior": check}
        if check.smoother is None:
            self.remarks = [f"the draws of the posterior did not converge: {check.lacks}"]
            return
        if check.ekf is not None:
            self.lines = [("posterior", _line(check.ekf, check.smoother))]
        failed = failures(check.smoother, landmark_id)
        if failed:
            self.remarks = [
                "the smoother's own covariance is too small for its exact posterior: "
                f"{', '.join(failed)}; the filter is compared with a Gaussian that fails there"
            ]

    def rows(self) -> Sequence[Row]:
        """Return the evidence of convergence, then both Gaussians."""
        check, size = self.check, "least effective sample size"
        rows = [
            Row(_GROUP, "draws, unknowns", f"{check.draws:,}, {check.unknowns:,}"),
            _limited("acceptance", check.acceptance, LEAST_ACCEPTANCE, "at least", ".2f"),
            _limited("largest R-hat", check.r_hat, LARGEST_R_HAT, "at most", ".3f"),
            _limited(f"{size}, bulk", check.bulk, LEAST_SAMPLE_SIZE, "at least", ".0f"),
            _limited(f"{size}, tails", check.tail, LEAST_SAMPLE_SIZE, "at least", ".0f"),
        ]
        if check.moments is None:
            return [*rows, Row(_GROUP, "judgement of the Gaussians", "not converged")]
        skewness = np.abs(check.moments.skewness)
        rows.append(Row(_GROUP, "largest skewness", f"{skewness.max():.2f}"))
        for name, judged in (("EKF", check.ekf), ("smoother", check.smoother)):
            rows += _judged_rows(name, judged) if judged is not None else []
        return rows


def _limited(quantity: str, value: float | None, limit: float, side: str, form: str) -> Row:
    inside = value is not None and (value <= limit if side == "at most" else value >= limit)
    shown = "undefined" if value is None else format(value, form)
    return Row(_GROUP, quantity, shown, f"{side} {limit:g}", inside)


def _judged_rows(name: str, judged: GaussianJudgement) -> list[Row]:
    blocks = [("last pose", judged.pose), ("whole", judged.whole)]
    if judged.landmarks:
        worst = min(judged.landmarks, key=lambda landmark: landmark.coverage.value)
        blocks.insert(1, ("worst landmark", worst))
    rows = []
    for block, comparison in blocks:
        held = (
            f"{100.0 * comparison.coverage.value:.1f} +- {100.0 * comparison.coverage.error:.1f} %"
        )
        ratios = f"{_shown(comparison.least)} to {_shown(comparison.largest)}"
        rows += [
            Row(_GROUP, f"{name}, {block}: posterior in the 95 % ellipsoid", held),
            Row(_GROUP, f"{name}, {block}: variance ratio (1 is exact)", ratios),
        ]
    return rows


def _shown(figure: SampledFigure) -> str:
    return f"{figure.value:.2f} +- {figure.error:.2f}"


def _line(ekf: GaussianJudgement, smoother: GaussianJudgement) -> str:
    held = (100.0 * judged.whole.coverage.value for judged in (ekf, smoother))
    of_ekf, of_smoother = (f"{share:.0f} %" for share in held)
    return f"95 % ellipsoids hold {of_ekf} (EKF) and {of_smoother} (smoother) of the draws"
