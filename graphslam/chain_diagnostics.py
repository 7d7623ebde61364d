"""Did Markov chains converge, and how many independent draws are they worth?

Vehtari, Gelman, Simpson, Carpenter, Buerkner 2021, "Rank-normalization, folding, and localization:
an improved R-hat for assessing convergence of MCMC", Bayesian Analysis 16(2). Draws are (C, N, n):
C chains of N draws of n numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri
from scipy.stats import rankdata

from graphslam.arrays import Array

TAILS = (0.05, 0.95)
"""Quantiles whose effective sample size is that of the tails."""
_BLOCK = 64
"""Numbers whose autocovariances are computed at once, for memory."""


@dataclass(frozen=True)
class SampledFigure:
    """A figure from draws.

    Attributes:
        value: the figure.
        error: its Monte Carlo standard error.
    """

    value: float
    error: float


class ChainEvidence(NamedTuple):
    """Evidence of n numbers: R-hat, effective sample sizes of the bulk and of the tails, (n,)."""

    r_hat: Array
    bulk: Array
    tail: Array


def chain_evidence(draws: Array) -> ChainEvidence:
    """Return the convergence diagnostics of every number.

    Args:
        draws: (C, N, n).

    Returns:
        (n,) each. NaN where a number never changes.

    Source: Vehtari et al. 2021, sections 3 and 4: R-hat is the larger of the rank-normalised split
    one and that of the folded draws.
    """
    ranked = _rank_normalised(draws)
    folded = np.abs(draws - np.median(draws, axis=(0, 1)))
    low, high = np.quantile(draws, TAILS, axis=(0, 1))
    tails = [effective_sample_size((draws <= edge).astype(np.float64)) for edge in (low, high)]
    return ChainEvidence(
        np.maximum(split_r_hat(ranked), split_r_hat(_rank_normalised(folded))),
        effective_sample_size(ranked),
        np.minimum(*tails),
    )


def split_r_hat(draws: Array) -> Array:
    """Return R-hat of chains cut in halves.

    Args:
        draws: (C, N, n).

    Returns:
        (n,), 1 where all halves have one distribution.
    """
    halves = half_chains(draws)
    count = halves.shape[1]
    within = halves.var(axis=1, ddof=1).mean(axis=0)
    between = halves.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        r_hat: Array = np.sqrt((count - 1.0) / count + between / within)
    return r_hat


def effective_sample_size(draws: Array) -> Array:
    """Return how many independent draws have the same error of the mean.

    Args:
        draws: (C, N, n).

    Returns:
        (n,), NaN where a number never changes.

    Source: Vehtari et al. 2021, section 3.2, with Geyer's initial monotone sequence.
    """
    size = draws.shape[2]
    blocks = [_effective(half_chains(draws[:, :, i : i + _BLOCK])) for i in range(0, size, _BLOCK)]
    return np.concatenate(blocks)


def monte_carlo_error(values: Array) -> Array:
    """Return the standard errors of means over all draws, by the means of half chains.

    Args:
        values: (C, N, ...) of every draw.

    Returns:
        (...); right where a half chain is longer than the chains remember.
    """
    means = half_chains(values).mean(axis=1)
    error: Array = means.std(axis=0, ddof=1) / np.sqrt(len(means))
    return error


def estimated(values: Array) -> SampledFigure:
    """Return the mean of one number over all draws, with its standard error.

    Args:
        values: (C, N).

    Returns:
        Mean and error.
    """
    return SampledFigure(float(values.mean()), float(monte_carlo_error(values)))


def half_chains(draws: Array) -> Array:
    """Cut every chain in two.

    Args:
        draws: (C, N, ...).

    Returns:
        (2 C, N // 2, ...): one in the middle is left out.
    """
    half = draws.shape[1] // 2
    return np.concatenate((draws[:, :half], draws[:, -half:]))


def _rank_normalised(draws: Array) -> Array:
    """Normal scores of the ranks among all draws of a number; equal draws share a rank."""
    chains, count, size = draws.shape
    rank = rankdata(draws.reshape(-1, size), axis=0)
    scores: Array = ndtri((rank - 0.375) / (chains * count + 0.25))
    return scores.reshape(draws.shape)


def _effective(chains: Array) -> Array:
    """Effective sample size (n,) of chains (C, N, n) that are already halves."""
    count, length, _ = chains.shape
    centred = chains - chains.mean(axis=1, keepdims=True)
    spectrum = np.fft.rfft(centred, n=2 * length, axis=1)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2, axis=1)[:, :length] / length
    within = covariance[:, 0].mean(axis=0) * length / (length - 1.0)
    total = within * (length - 1.0) / length + chains.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = 1.0 - (within - covariance.mean(axis=0)) / total
    rho[0] = 1.0
    pairs = rho[: length // 2 * 2].reshape(length // 2, 2, -1).sum(axis=1)
    positive = np.logical_and.accumulate(pairs > 0.0, axis=0)
    monotone = np.minimum.accumulate(pairs, axis=0)
    tau = -1.0 + 2.0 * np.sum(np.where(positive, monotone, 0.0), axis=0)
    every = count * length
    size: Array = every / np.maximum(tau, 1.0 / np.log10(every))
    return np.where(within > 0.0, size, np.nan)
