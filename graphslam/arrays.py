"""Array types, the wrap of angles and Gaussians, which the whole package shares."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]
_RANK = 1e-12
"""Of a covariance scaled to unit variances: below it a direction has no variance."""


class Marginal(NamedTuple):
    """Mean (n,) and covariance (n, n) of the last pose and all landmarks, points first."""

    mean: Array
    covariance: Array


def wrap_angle(angle_rad: Array) -> Array:
    """Wrap angles of any shape to (-pi, pi]."""
    return np.pi - np.mod(np.pi - angle_rad, 2.0 * np.pi)


def conditional_covariance(covariance: Array, basis: Array) -> Array:
    """Return the covariance of what an error is beside some directions of it.

    With e = N alpha + c and alpha unknown, c is what the prior says given alpha. A direction that
    the prior has no variance in leaves it as it is.

    Args:
        covariance: (n, n) P of e, positive semidefinite.
        basis: (n, d) N, of full rank.

    Returns:
        (n, n) P - N (N^T P^-1 N)^-1 N^T, for a singular P the limit of P + s I as s vanishes.
    """
    scale = np.sqrt(np.diag(covariance))
    unit = np.where(scale > 0.0, scale, 1.0)
    variance, axes = np.linalg.eigh(covariance / np.outer(unit, unit))
    known = variance > _RANK
    root = axes[:, known] * np.sqrt(variance[known])  # P = D root root^T D
    columns = basis / unit[:, None]
    columns = columns / np.linalg.norm(columns, axis=0)
    # Combinations of directions that lie where P has variance; of others alpha is known already.
    _, outside, turns = np.linalg.svd(axes[:, ~known].T @ columns, full_matrices=True)
    rank = int(np.count_nonzero(outside > np.sqrt(_RANK)))
    inside = columns @ turns[rank:].T
    whitened = (axes[:, known].T @ inside) / np.sqrt(variance[known])[:, None]
    across, size, _ = np.linalg.svd(whitened, full_matrices=False)
    across = across[:, size > _RANK * size.max(initial=0.0)]
    rest = unit[:, None] * (root - (root @ across) @ across.T)
    result: Array = rest @ rest.T
    return result
