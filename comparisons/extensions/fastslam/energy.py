"""The energy distance of draws from a standard normal distribution, or from others, as a test.

Source: Szekely and Rizzo 2005, "A new test for multivariate normality"; 2013, "Energy statistics".
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaln, hyp1f1

from comparisons.arrays import Array

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
