"""The Gaussians of both estimators against draws of the exact posterior."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Index
from comparisons.estimates.estimate import Estimate
from comparisons.figures import Aside, finite
from graphslam.chain_diagnostics import Estimated
from graphslam.sampling import Judgement, PosteriorDraws

LEVEL = 0.95
"""Probability of the ellipsoids whose coverage is measured."""
LEAST_COVERAGE = 0.9
LEAST_RATIO = 0.8
"""A Gaussian fails a block where its ellipsoid holds less than this share of the posterior, or a
direction's variance is below this share of the posterior's, by more than chance allows."""
ERRORS = 4.0
"""Standard errors that chance allows; among some hundred blocks, one false alarm in fifty runs."""


@dataclass(frozen=True)
class Judged:
    """One estimator's Gaussian against the posterior.

    Attributes:
        pose: of the last pose.
        landmarks: of every landmark, in the order of the map.
        whole: of the last pose and all landmarks together.
    """

    pose: Judgement
    landmarks: tuple[Judgement, ...]
    whole: Judgement

    def worst_landmark(self) -> int:
        """Return the landmark whose ellipsoid holds the least of the posterior."""
        return int(np.argmin([one.coverage.value for one in self.landmarks]))


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
        found = {
            "mean": draws.mean(),
            "covariance": draws.covariance(),
            "skewness": draws.skewness(),
        }
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
    acceptance: float
    step_rad: float
    r_hat: float | None
    bulk: float | None
    tail: float | None
    converged: bool
    lacks: str
    moments: Moments | None
    ekf: Judged | None
    smoother: Judged | None
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


def judged(draws: PosteriorDraws, estimate: Estimate) -> Judged:
    """Judge an estimator's Gaussian of the last pose and all points."""
    mean = np.concatenate((estimate.pose[-1], estimate.landmark.ravel()))
    pose, *landmarks, whole = (
        draws.judge(mean, estimate.joint_covariance, numbers, LEVEL)
        for numbers in _blocks(len(mean))
    )
    return Judged(pose, tuple(landmarks), whole)


def _blocks(size: int) -> Iterator[Index]:
    yield np.arange(3)
    for first in range(3, size, 2):
        yield np.arange(first, first + 2)
    yield np.arange(size)


def fails(block: Judgement) -> bool:
    """Whether a Gaussian is too small for the posterior, by more than chance."""
    return _below(block.coverage, LEAST_COVERAGE) or _below(block.least, LEAST_RATIO)


def _below(figure: Estimated, limit: float) -> bool:
    return figure.value + ERRORS * figure.error < limit


def failures(judgement: Judged, ids: NDArray[np.int64]) -> list[str]:
    """Return the blocks that fail, in words. ids: (L,) of the landmarks."""
    found = ["the last pose"] if fails(judgement.pose) else []
    failed = [i for i, one in zip(ids.tolist(), judgement.landmarks, strict=True) if fails(one)]
    if len(failed) > 3:
        found.append(f"{len(failed)} of {len(judgement.landmarks)} landmarks")
    else:
        found += [f"landmark {i}" for i in failed]
    if not found and fails(judgement.whole):
        found.append("the last pose and all landmarks together")
    return found
