"""How far two covariances are apart: by entry in sigmas, and along their directions.

By entry, a difference is in products of two of the expected one's standard deviations. Along
directions it is what the generalised eigenvalues of the pair are off one: variances of the first
over those of the second. Every job, check and audit asks here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cholesky, eigh, eigvalsh, solve_triangular

from comparisons.arrays import Array
from comparisons.rounding import NOTHING, ROUNDING

DENSE = 2000
"""States up to which all eigenvalues of a pair are computed; of more only the ends are sought."""


def units(recorded: Array, expected: Array, least: Array | None = None) -> Array:
    """Return the standard deviations (..., n) that differences are measured in.

    Args:
        recorded: (..., n, n) covariance. A variance of it is the unit where zero is expected.
        expected: (..., n, n) covariance.
        least: (..., n) variances below which there is nothing but rounding.
    """
    variance = np.maximum(np.diagonal(expected, 0, -2, -1), 0.0)
    other = np.abs(np.diagonal(recorded, 0, -2, -1))
    variance = np.where(variance > NOTHING, variance, np.where(other > NOTHING, other, 1.0))
    sigma: Array = np.sqrt(variance if least is None else np.maximum(variance, least))
    return sigma


def entry_differences(recorded: Array, expected: Array, least: Array | None = None) -> Array:
    """Return recorded - expected, covariances (..., n, n), in products of two `units`."""
    unit = units(recorded, expected, least)
    scaled: Array = (recorded - expected) / (unit[..., :, None] * unit[..., None, :])
    return scaled


def largest_pair(scaled: Array, blocks: tuple[str, ...], dims: tuple[int, ...]) -> tuple[str, str]:
    """Return the two blocks between which differences are largest; the same one twice.

    Args:
        scaled: (n, n) differences, not negative.
        blocks: Names of the state's blocks, in its order.
        dims: How many entries each has.
    """
    starts = np.cumsum([0, *dims[:-1]])
    by_block = np.maximum.reduceat(np.maximum.reduceat(scaled, starts, axis=0), starts, axis=1)
    by_block = np.maximum(by_block, by_block.T)
    i, j = np.unravel_index(int(np.argmax(by_block)), by_block.shape)
    return blocks[min(i, j)], blocks[max(i, j)]


class CovarianceGap(NamedTuple):
    """largest: |lambda - 1| of the pair's generalised eigenvalues, or the asymmetry if it is more.

    least: of the eigenvalues. asymmetry: of either covariance, in products of two units.
    """

    largest: float
    least: float
    asymmetry: float


def covariance_gap(
    first: Array, second: Array, unit: Array, singular: float = 0.0
) -> CovarianceGap:
    """Compare two covariances (n, n).

    unit: (n,) standard deviations. singular: eigenvalue of the second's correlation matrix, over
    the largest, below which it has no inverse, as with a clone: there the first's entries count.
    """
    scale = np.outer(unit, unit)
    skew = max(float(np.max(np.abs(p - p.T) / scale)) for p in (first, second))
    even, beside = 0.5 * (first + first.T), 0.0
    if singular and np.isfinite(first).all() and np.isfinite(second).all():
        a = even / scale
        values, axes = np.linalg.eigh(second / scale)
        some = values > singular * values[-1]
        root = axes[:, some] / np.sqrt(values[some])
        beside = float(np.abs(a @ axes[:, ~some]).max(initial=0.0))
        even, second = root.T @ a @ root, np.eye(root.shape[1])
    low, high = eigenvalue_range(even, second)
    return CovarianceGap(max(abs(low - 1.0), abs(high - 1.0), skew, beside), low, skew)


def eigenvalue_range(first: Array, second: Array) -> tuple[float, float]:
    """Least and largest generalised eigenvalue of a covariance pair.

    (-inf, inf) when `second` is not positive definite or either is not finite: no comparison of
    such a pair may pass. (1, 1) of no entries, as where no direction has a variance.
    """
    if not len(first):
        return 1.0, 1.0
    try:
        if len(first) > DENSE:
            return _extremes(first, second)
        values = eigh(first, second, eigvals_only=True)
    except (LinAlgError, ValueError):
        return float("-inf"), float("inf")
    return float(values[0]), float(values[-1])


def eigenvalue_ranges(first: Array | None, second: Array) -> tuple[Array, Array]:
    """Return least and largest generalised eigenvalue of each of many small covariance pairs.

    Args:
        first: (K, n, n); asymmetry of it, in the second's sigma squared, counts as if it were an
            eigenvalue beyond one. None where there are no covariances.
        second: (K, n, n).

    Returns:
        (K,) each; NaN without a first. (-inf, inf) where the second are not all positive definite,
        for no such comparison may pass.
    """
    count = len(second)
    if first is None:
        return np.full(count, np.nan), np.full(count, np.nan)
    try:
        inverse = np.linalg.inv(np.linalg.cholesky(second))
    except np.linalg.LinAlgError:
        return np.full(count, -np.inf), np.full(count, np.inf)
    return whitened_range(inverse @ first @ inverse.transpose(0, 2, 1))


def whitened_range(whitened: Array) -> tuple[Array, Array]:
    """Return the same (K,) of A^-1 P A^-T (K, n, n), where A A^T is the second covariance."""
    turned = whitened.transpose(0, 2, 1)
    values = np.linalg.eigvalsh(0.5 * (whitened + turned))
    skew = np.abs(whitened - turned).max(axis=(1, 2))
    least, largest = np.asarray(values[:, 0], dtype=float), np.asarray(values[:, -1], dtype=float)
    return least, np.where(skew > ROUNDING, np.fmax(largest, 1.0 + skew), largest)


def relative_difference(least: Array, largest: Array) -> Array:
    """Return the largest |lambda - 1| of eigenvalues between two ends, arrays of one shape."""
    difference: Array = np.maximum(np.abs(least - 1.0), np.abs(largest - 1.0))
    return difference


def definite(covariance: Array) -> NDArray[np.bool_]:
    """Return which of covariances (K, n, n) are finite and positive definite."""
    positive = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    positive[positive] = np.linalg.eigvalsh(covariance[positive])[:, 0] > 0.0
    return positive


def _extremes(first: Array, second: Array) -> tuple[float, float]:
    """Return the same by Lanczos iterations, on what the pair differs by: cubic work is left out.

    Raises as eigh; the ends are good to 1e-3 of their distance from one.
    """
    from scipy.sparse.linalg import ArpackError, eigsh

    root = cholesky(second, lower=True)
    half = solve_triangular(root, first, lower=True)
    apart = solve_triangular(root, half.T, lower=True)
    apart[np.diag_indices_from(apart)] -= 1.0
    apart = 0.5 * (apart + apart.T)
    start = np.random.default_rng(0).standard_normal(len(apart))
    try:
        low, high = (
            eigsh(apart, k=1, which=end, v0=start, tol=1e-3, return_eigenvectors=False)[0]
            for end in ("SA", "LA")
        )
    except ArpackError:
        low, high = eigvalsh(apart)[[0, -1]]
    return 1.0 + float(low), 1.0 + float(high)
