"""The clouds of independent FastSLAMs against the smoother's posterior, over stretches of a log.

Particles of one cloud share ancestors, so that the number of particles, and the effective sample
size, say too much of how well a cloud samples. Independent clouds do not: one particle of each is
an independent draw. Where FastSLAM and the smoother have the same posterior, these draws, whitened
by the smoother's Gaussian, are standard normal.

Where they are not, the smoother's Gaussian may be what is wrong. Then they are compared with draws
of the smoother's exact posterior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, fdtri, gammaln, hyp1f1, stdtrit

from comparisons.arrays import Array
from comparisons.extensions.fastslam.stretches import StretchClouds
from comparisons.figures import LeftOut, Less, More, Nominal

LEVEL = 1e-3
"""Probability of a disagreement where both posteriors are the same."""
LARGEST_RATIO = 1.25
"""Of the draws' variance to the smoother's, or the inverse, that is no disagreement: the energy
distance alone hardly sees variances that are too small."""
LARGEST_SKEWNESS = 0.5
LEAST_KURTOSIS = -0.8
"""Excess kurtosis below which a distribution is flat or has several modes; a uniform has -1.2."""
AXES = ("east", "north", "heading")


@dataclass(frozen=True, kw_only=True)
class StretchCheck:
    """Clouds against the smoother over one stretch of the log, in its last pose and its landmarks.

    Attributes:
        begin_s: time at which the pose is known.
        end_s: time of the last pose.
        landmarks: point landmarks of the stretch.
        energy: energy distance over its mean where both posteriors are one.
        shift: distance of the clouds' mean last pose from the smoother's, in sigma.
        spread: variance of pose and map over the smoother's, mean of all directions.
    """

    begin_s: float
    end_s: float
    landmarks: int
    energy: float
    shift: float
    spread: float


@dataclass(frozen=True, kw_only=True)
class ExactCheck:
    """Draws of the smoother's exact posterior, which stretches that are short enough have.

    Attributes:
        stretches: stretches that could be sampled.
        clouds: p of the energy distance between them and the clouds.
        gaussian: p of the energy distance between them and the smoother's Gaussian.
    """

    stretches: int
    clouds: LeftOut[LeftOut[float]]
    gaussian: LeftOut[LeftOut[float]]

    @property
    def explains(self) -> bool:
        """Whether it is the Gaussian that differs, and not the clouds."""
        return self.clouds > LEVEL >= self.gaussian


@dataclass(frozen=True, kw_only=True)
class CloudCheck:
    """Clouds against the smoother, all stretches together.

    Attributes:
        stretches: stretches that were compared.
        clouds: independent clouds of all stretches together, one draw each.
        energy: energy distance of all stretches over its mean where both posteriors are one.
        p: probability of so large an energy distance where both posteriors are one.
        squared_shift: squared distance of the draws' means from the smoother's, over what their
            scatter explains.
        largest_shift: what `squared_shift` exceeds with probability `level`.
        spread: variance of pose and map over the smoother's, mean of all directions.
        independent: independent particles that know the last pose as well as one cloud, in the
            direction in which they are fewest.
        agrees: whether the clouds agree with the smoother; null where they are too small to tell.
        exact: the smoother's exact posterior; null where the clouds agree with its Gaussian.
        shape: what of the clouds is not Gaussian.
    """

    stretches: tuple[StretchCheck, ...]
    clouds: int
    energy: Less[float]
    p: LeftOut[float]
    squared_shift: Less[float]
    largest_shift: LeftOut[float]
    spread: Nominal[float]
    independent: More[float]
    agrees: bool | None
    exact: ExactCheck | None
    shape: tuple[str, ...]

    @property
    def worst(self) -> StretchCheck:
        """The stretch with the most energy."""
        return max(self.stretches, key=lambda stretch: stretch.energy)


def check_clouds(stretches: Sequence[StretchClouds]) -> CloudCheck:
    """Compare. The test is exact for draws that are independent; the energies of stretches add up.

    A disagreement is an energy distance at LEVEL, or a variance beyond LARGEST_RATIO by more than
    chance; unless the exact posterior, too, differs from the smoother's Gaussian, and not from the
    clouds. A verdict needs clouds that know the pose as well as one independent particle; agreement
    needs stretches that most clouds get through.
    """
    generator = np.random.default_rng(0)
    found, energies = [], np.zeros(SIMULATIONS + 1)
    shifts, scatter, size, freedom = 0.0, 0.0, 0, 0
    for stretch in stretches:
        m, d = stretch.draw.shape
        own, expected = float(energy(stretch.draw)), simulated(m, d, generator)
        energies += np.concatenate(([own], expected))
        centre = stretch.draw.mean(axis=0)
        shifts, size = shifts + m * float(centre @ centre), size + d
        within = float(((stretch.draw - centre) ** 2).sum())
        scatter, freedom = scatter + within, freedom + (m - 1) * d
        found.append(
            StretchCheck(
                begin_s=stretch.begin_s,
                end_s=stretch.end_s,
                landmarks=(d - 3) // 2,
                energy=own / float(expected.mean()),
                shift=float(np.linalg.norm(stretch.mean[:, :3].mean(axis=0))),
                spread=within / ((m - 1) * d),
            )
        )
    p = _p(energies)
    spread = scatter / freedom
    of_means = np.mean([np.cov(stretch.mean[:, :3].T) for stretch in stretches], axis=0)
    independent = 1.0 / float(np.linalg.eigvalsh(of_means)[-1])
    shape = tuple(words for stretch in stretches for words in _shape(stretch, len(stretches)))
    same, exact = p > LEVEL and not _beyond(spread, freedom), None
    if not same and independent >= 1.0:
        exact = check_exact(stretches)
        same = exact.explains
    enough = not same or np.mean([stretch.depleted for stretch in stretches]) <= 0.5
    return CloudCheck(
        stretches=tuple(found),
        clouds=sum(len(stretch.draw) for stretch in stretches),
        energy=float(energies[0] / energies[1:].mean()),
        p=p,
        squared_shift=shifts / size / spread,
        largest_shift=float(fdtri(size, freedom, 1.0 - LEVEL)),
        spread=spread,
        independent=independent,
        agrees=same if enough and independent >= 1.0 else None,
        exact=exact,
        shape=shape,
    )


def check_exact(stretches: Sequence[StretchClouds]) -> ExactCheck:
    """Compare with draws of the exact posterior, of the stretches that can be sampled."""
    generator = np.random.default_rng(1)
    sampled, clouds, gaussian = 0, np.zeros(SIMULATIONS + 1), np.zeros(SIMULATIONS + 1)
    for stretch in stretches:
        exact = stretch.exact(generator)
        if exact is None:
            continue
        sampled += 1
        own, chance = permuted(stretch.draw, exact, generator)
        clouds += np.concatenate(([own], chance))
        own, chance = float(energy(exact)), simulated(len(exact), exact.shape[1], generator)
        gaussian += np.concatenate(([own], chance))
    return ExactCheck(stretches=sampled, clouds=_p(clouds), gaussian=_p(gaussian))


def _p(energies: Array) -> float:
    """Share of energies that reach the first one, itself among them."""
    return float(np.mean(energies >= energies[0]))


def _beyond(ratio: float, freedom: int) -> bool:
    """Whether a ratio of variances, with so many degrees of freedom, lies outside the limits."""
    low, high = ratio * freedom / chdtri(freedom, np.array((LEVEL / 2, 1.0 - LEVEL / 2)))
    return bool(low > LARGEST_RATIO or high < 1.0 / LARGEST_RATIO)


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


SIMULATIONS = 1999
"""Of draws that are standard normal; with them an exact test at 0.1 % refuses above all but one."""
_SERIES_FROM = 100
_ENTRIES = 2_000_000


def energy(draw: Array) -> Array:
    """Return M times the energy distance of draws (..., M, d) from N(0, I).

    2 E|u - y| - E|y - y'| - E|u - u'| with y, y' of N(0, I), and u, u' of the draws; zero only
    where the distributions are one.
    """
    m, d = draw.shape[-2:]
    square = (draw * draw).sum(axis=-1)
    among = _distances(draw).mean(axis=(-1, -2))
    normal = float(np.sqrt(2.0) * _distance(np.zeros(1), d)[0])
    found: Array = m * (2.0 * _distance(square, d).mean(axis=-1) - normal - among)
    return found


def simulated(draws: int, dimension: int, generator: np.random.Generator) -> Array:
    """Return the energies (SIMULATIONS,) of so many draws of N(0, I)."""
    part = max(1, _ENTRIES // (draws * max(dimension, draws)))
    found = []
    for first in range(0, SIMULATIONS, part):
        count = min(part, SIMULATIONS - first)
        found.append(energy(generator.standard_normal((count, draws, dimension))))
    return np.concatenate(found)


def permuted(first: Array, second: Array, generator: np.random.Generator) -> tuple[float, Array]:
    """Return the energy between draws (M, d) and (N, d), and those (SIMULATIONS,) of permutations.

    M N / (M + N) times 2 E|u - v| - E|u - u'| - E|v - v'|.
    """
    m, n = len(first), len(second)
    apart = _distances(np.vstack((first, second)))
    of_first = np.tile(np.arange(m + n) < m, (SIMULATIONS + 1, 1))
    generator.permuted(of_first[1:], axis=1, out=of_first[1:])
    # x^T A x with x = 1 / M on the first and -1 / N on the second is minus the distance.
    x = np.where(of_first, 1.0 / m, -1.0 / n)
    found: Array = -(m * n / (m + n)) * ((x @ apart) * x).sum(axis=1)
    return float(found[0]), found[1:]


def _distances(draw: Array) -> Array:
    """Distances (..., M, M) between draws (..., M, d)."""
    square = (draw * draw).sum(axis=-1)
    inner = draw @ draw.swapaxes(-1, -2)
    apart = square[..., :, None] + square[..., None, :] - 2.0 * inner
    np.einsum("...ii->...i", apart)[...] = 0.0
    return np.asarray(np.sqrt(np.maximum(apart, 0.0)))


def _distance(square: Array, d: int) -> Array:
    """E|u - y| over y of N(0, I), from |u|^2; the mean of the noncentral chi distribution."""
    if d > _SERIES_FROM:  # to 3e-6 of it; the function below overflows
        mean = d + square
        return np.asarray(np.sqrt(mean) * (1.0 - (d + 2.0 * square) / (4.0 * mean * mean)))
    factor = np.sqrt(2.0) * np.exp(gammaln((d + 1) / 2) - gammaln(d / 2))
    return np.asarray(factor * hyp1f1(-0.5, d / 2, -square / 2))
