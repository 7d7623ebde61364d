"""Resampling of weighted particles."""

from __future__ import annotations

import numpy as np

from ekf_reference.core.geometry import Array, Index


def normalised(log_weight: Array) -> Array:
    """Return weights that sum to one.

    Args:
        log_weight: (N,) their logarithms, up to a constant.

    Returns:
        (N,) weights.
    """
    raw = np.exp(log_weight - log_weight.max())
    weight: Array = raw / raw.sum()
    return weight


def log_mean_exp(log_weight: Array) -> float:
    """Return ln of the mean of the weights, without overflow.

    Args:
        log_weight: (N,) their logarithms.

    Returns:
        ln(sum(exp(log_weight)) / N).
    """
    most = float(log_weight.max())
    return most + float(np.log(np.mean(np.exp(log_weight - most))))


def effective_sample_size(weight: Array) -> float:
    """Return 1 / sum w^2.

    Args:
        weight: (N,) that sum to one.

    Returns:
        N where all are equal, 1 where one particle has all.

    Source: Kong, Liu and Wong 1994.
    """
    return 1.0 / float(weight @ weight)


def systematic_parents(weight: Array, generator: np.random.Generator) -> Index:
    """Draw the parents of a new generation by low-variance (systematic) resampling.

    One uniform number places N equally spaced pointers on the weights' cumulative sum, so particle
    i has floor(N w_i) or ceil(N w_i) children, N w_i on average. A survivor keeps its place; other
    children take the places of particles without children, so only these maps have to be copied.

    Args:
        weight: (N,) that sum to one.
        generator: Gives one uniform number.

    Returns:
        (N,) the parent of each particle of the new generation.
    """
    n = len(weight)
    pointers = (generator.random() + np.arange(n)) / n
    bounds = np.cumsum(weight)
    chosen = np.searchsorted(bounds / bounds[-1], pointers, side="right")
    children = np.bincount(np.minimum(chosen, n - 1), minlength=n)
    parents = np.arange(n)
    parents[children == 0] = np.repeat(parents, np.maximum(children - 1, 0))
    return parents
