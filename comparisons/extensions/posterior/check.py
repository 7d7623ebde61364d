"""The Gaussians of both estimators against draws of the exact posterior."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Index
from comparisons.estimates.estimate import Estimate
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


class Judged(NamedTuple):
    """One estimator's Gaussian: the last pose, every landmark, and all of these together."""

    pose: Judgement
    landmarks: tuple[Judgement, ...]
    whole: Judgement

    def worst_landmark(self) -> int:
        """Return the landmark whose ellipsoid holds the least of the posterior."""
        return int(np.argmin([one.coverage.value for one in self.landmarks]))


@dataclass(frozen=True)
class PosteriorCheck:
    """draws: with their evidence. ekf, smoother: None where the draws did not converge."""

    draws: PosteriorDraws
    ekf: Judged | None
    smoother: Judged | None


def check_posterior(draws: PosteriorDraws, ekf: Estimate, smoothed: Estimate) -> PosteriorCheck:
    """Judge both Gaussians, unless the draws did not converge."""
    if not draws.converged:
        return PosteriorCheck(draws, None, None)
    return PosteriorCheck(draws, judged(draws, ekf), judged(draws, smoothed))


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
