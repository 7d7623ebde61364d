"""How far two covariances are apart, and the units of it: for `run`, `check` and `audit`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky, eigh, eigvalsh, solve_triangular

from comparisons.arrays import Array

ROUNDING = 1e-6
"""Largest algebra and model gap, in sigma and in covariance, that rounding explains, unless a wide
prior explains more."""
DENSE = 2000
"""States up to which all eigenvalues of a pair are computed; of more only the ends are sought."""


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
    such a pair may pass.
    """
    try:
        if len(first) > DENSE:
            return _extremes(first, second)
        values = eigh(first, second, eigvals_only=True)
    except (LinAlgError, ValueError):
        return float("-inf"), float("inf")
    return float(values[0]), float(values[-1])


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


def units(recorded: Array, expected: Array) -> Array:
    """Return the standard deviations (n,) that differences are measured in."""
    variance = np.maximum(expected.diagonal(), 0.0)
    other = np.abs(recorded.diagonal())
    variance = np.where(variance > 0.0, variance, np.where(other > 0.0, other, 1.0))
    found: Array = np.sqrt(variance)
    return found
