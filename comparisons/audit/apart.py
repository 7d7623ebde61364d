"""How far a recorded covariance is from what it should be."""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.events import Blocks

ROUNDING = 1e-6
"""Largest difference that rounding explains, relative to the standard deviations."""
_SINGULAR = 1e-11
"""Eigenvalue of a correlation matrix, relative to the largest, below which it has no inverse."""


def apart(recorded: Array, expected: Array) -> Array:
    """Return the differences (n, n) of two covariances, in units of the expected sigmas.

    A variance that is expected to be zero has the recorded one as its unit.
    """
    unit = units(recorded, expected)
    scaled: Array = np.abs(recorded - expected) / (unit[:, None] * unit)
    return scaled


def units(recorded: Array, expected: Array) -> Array:
    """Return the standard deviations (n,) that differences are measured in."""
    variance = np.maximum(expected.diagonal(), 0.0)
    other = np.abs(recorded.diagonal())
    variance = np.where(variance > 0.0, variance, np.where(other > 0.0, other, 1.0))
    found: Array = np.sqrt(variance)
    return found


def covariance_gap(recorded: Array, expected: Array) -> float:
    """Return the largest |lambda - 1| of a covariance pair, or the largest asymmetry if more.

    lambda: generalised eigenvalues, as of the algebra gap of `run`. Along directions that the
    expected covariance has no variance in, the recorded one's entries count, in sigmas.
    """
    unit = units(recorded, expected)
    scale = np.outer(unit, unit)
    a, b = recorded / scale, expected / scale
    skew = float(np.abs(a - a.T).max())
    values, axes = np.linalg.eigh(b)
    some = values > _SINGULAR * values[-1]
    root = axes[:, some] / np.sqrt(values[some])
    inner = root.T @ a @ root
    found = max(skew, float(np.abs(np.linalg.eigvalsh(0.5 * (inner + inner.T)) - 1.0).max()))
    if not some.all():
        found = max(found, float(np.abs(a @ axes[:, ~some]).max()))
    return found


def largest_pair(scaled: Array, blocks: Blocks, dims: tuple[int, ...]) -> tuple[str, str]:
    """Return the two blocks between which differences (n, n) are largest; the same one twice."""
    starts = np.cumsum([0, *dims[:-1]])
    by_block = np.maximum.reduceat(np.maximum.reduceat(scaled, starts, axis=0), starts, axis=1)
    by_block = np.maximum(by_block, by_block.T)
    i, j = np.unravel_index(int(np.argmax(by_block)), by_block.shape)
    return blocks[min(i, j)], blocks[max(i, j)]
