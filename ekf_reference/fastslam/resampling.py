"""Resampling of weighted particles."""

from __future__ import annotations

import numpy as np

from ekf_reference.core.geometry import Array, Index


def normalised(log_weight: Array) -> Array:
    """Return weights (N,) that sum to one, of log_weight (N,), known up to a constant."""
    raw = np.exp(log_weight - log_weight.max())
    weight: Array = raw / raw.sum()
    return weight


def log_mean_exp(log_weight: Array) -> float:
    """Return ln(sum(exp(log_weight)) / N) of log_weight (N,), without overflow."""
    most = float(log_weight.max())
    return most + float(np.log(np.mean(np.exp(log_weight - most))))


def effective_sample_size(weight: Array) -> float:
    """Return 1 / sum w^2 of a weight (N,) of sum one (Kong, Liu and Wong 1994)."""
    return 1.0 / float(weight @ weight)


def systematic_parents(weight: Array, generator: np.random.Generator) -> Index:
    """Return the parents (N,) of a new generation, drawn by low-variance (systematic) resampling.

    weight: (N,) that sum to one. generator: gives one uniform number, which places N equally spaced
    pointers on the weights' cumulative sum, so particle i has floor(N w_i) or ceil(N w_i) children,
    N w_i on average. A survivor keeps its place; other children take the places of particles
    without children, so only these maps have to be copied.
    """
    n = len(weight)
    pointers = (generator.random() + np.arange(n)) / n
    bounds = np.cumsum(weight)
    chosen = np.searchsorted(bounds / bounds[-1], pointers, side="right")
    children = np.bincount(np.minimum(chosen, n - 1), minlength=n)
    parents = np.arange(n)
    parents[children == 0] = np.repeat(parents, np.maximum(children - 1, 0))
    return parents
