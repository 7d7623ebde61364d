"""The clouds of independent FastSLAMs against the smoother's posterior, over stretches of a log.

Particles of one cloud share ancestors, so that the number of particles, and the effective sample
size, say too much of how well a cloud samples. Independent clouds do not: one particle of each is
an independent draw. Where FastSLAM and the smoother have the same posterior, these draws, whitened
by the smoother's Gaussian, are standard normal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, stdtrit

from comparisons.arrays import Array
from comparisons.extensions.fastslam.energy import SIMULATIONS, energy, simulated
from comparisons.extensions.fastslam.stretches import StretchClouds

LEVEL = 1e-3
"""Probability of a disagreement where both posteriors are the same."""
LARGEST_SKEWNESS = 0.5
LEAST_KURTOSIS = -0.8
"""Excess kurtosis below which a distribution is flat or has several modes; a uniform has -1.2."""
AXES = ("east", "north", "heading")


@dataclass(frozen=True, kw_only=True)
class StretchCheck:
    """One stretch: a Gaussian of d = 3 + 2 D numbers, the last pose and D landmarks.

    energy: of the draws, over its mean where the posteriors are one. shift: distance of the clouds'
    mean last pose from the smoother's, in sigma. spread: variance of the draws over the smoother's,
    mean of all d directions.
    """

    begin_s: float
    end_s: float
    landmarks: int
    energy: float
    shift: float
    spread: float


@dataclass(frozen=True, kw_only=True)
class CloudCheck:
    """Clouds against the smoother, all stretches together.

    stretches: one by one. clouds: of all stretches. energy: as of one. p: probability of so much
    energy where the posteriors are one. mean, mean_limit: squared distance of the draws' means from
    the smoother's, over its expectation, and what it exceeds with a probability of LEVEL.
    independent: least number, over all directions, of independent particles that know the last pose
    as well as a cloud. agrees: None where the clouds are too small to tell. shape: what is not
    Gaussian.
    """

    stretches: tuple[StretchCheck, ...]
    clouds: int
    energy: float
    p: float
    mean: float
    mean_limit: float
    independent: float
    agrees: bool | None
    shape: tuple[str, ...]

    @property
    def worst(self) -> StretchCheck:
        """The stretch with the most energy."""
        return max(self.stretches, key=lambda one: one.energy)

    @property
    def spread(self) -> float:
        """Variance of the draws over the smoother's, mean of all stretches and directions."""
        dimension = [3 + 2 * one.landmarks for one in self.stretches]
        return float(np.average([one.spread for one in self.stretches], weights=dimension))


def check_clouds(stretches: Sequence[StretchClouds]) -> CloudCheck:
    """Compare. The test is exact for draws that are independent; the energies of stretches add up.

    A disagreement needs clouds that know the pose as well as one independent particle. Draws whose
    means agree, from clouds that are not Gaussian, differ in shape alone: no disagreement.
    """
    generator = np.random.default_rng(0)
    found, null, observed = [], np.zeros(SIMULATIONS), 0.0
    mean, size = 0.0, 0
    for one in stretches:
        m, d = one.draw.shape
        own, expected = float(energy(one.draw)), simulated(m, d, generator)
        observed, null = observed + own, null + expected
        centre = one.draw.mean(axis=0)
        mean, size = mean + m * float(centre @ centre), size + d
        found.append(
            StretchCheck(
                begin_s=one.begin_s,
                end_s=one.end_s,
                landmarks=(d - 3) // 2,
                energy=own / float(expected.mean()),
                shift=float(np.linalg.norm(one.mean[:, :3].mean(axis=0))),
                spread=float(((one.draw - centre) ** 2).sum() / ((m - 1) * d)),
            )
        )
    p = float(1 + np.count_nonzero(null >= observed)) / (SIMULATIONS + 1)
    limit = float(chdtri(size, LEVEL)) / size
    scatter = np.mean([np.cov(one.mean[:, :3].T) for one in stretches], axis=0)
    independent = 1.0 / float(np.linalg.eigvalsh(scatter)[-1])
    shape = tuple(words for one in stretches for words in _shape(one, len(stretches)))
    same = p > LEVEL or (mean / size <= limit and bool(shape))
    return CloudCheck(
        stretches=tuple(found),
        clouds=sum(len(one.draw) for one in stretches),
        energy=observed / float(null.mean()),
        p=p,
        mean=mean / size,
        mean_limit=limit,
        independent=independent,
        agrees=same if independent >= 1.0 else None,
        shape=shape,
    )


def _shape(stretch: StretchClouds, stretches: int) -> list[str]:
    """What a stretch's moments say together, at LEVEL shared among the six of every stretch."""
    moments = stretch.moments
    count = len(moments)
    mean: Array = moments.mean(axis=0)
    error: Array = moments.std(axis=0, ddof=1) / np.sqrt(count)
    times = float(stdtrit(count - 1, 1.0 - LEVEL / (12.0 * stretches)))
    where = f"from {stretch.begin_s:.1f} to {stretch.end_s:.1f} s"
    found = []
    for axis, skewness, kurtosis, by, width in zip(AXES, *mean, *error, strict=True):
        if abs(skewness) - times * by > LARGEST_SKEWNESS:
            found.append(f"{axis} {where} is skew (skewness {skewness:.2f})")
        if kurtosis + times * width < LEAST_KURTOSIS:
            found.append(
                f"{axis} {where} is flat or has several modes (excess kurtosis {kurtosis:.2f})"
            )
    return found
