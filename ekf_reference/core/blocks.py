"""Stacked measurements: m of them as one, and one as m."""

from __future__ import annotations

import numpy as np

from ekf_reference.core.geometry import Array


def stack(jacobian_pose: Array, jacobian_landmark: Array) -> Array:
    """Return one Jacobian (r m, p + w m) of m measurements, in the order of Layout.columns.

    jacobian_pose: (m, r, p) of each by the pose. jacobian_landmark: (m, r, w) of each by its own
    landmark. Two measurements of one landmark get two sets of columns with the same state entries,
    which sums their effect on S and on the gain as it should. Source: Guivant 2002, eq. 3.
    """
    by_pose = jacobian_pose.reshape(-1, jacobian_pose.shape[2])
    return np.hstack((by_pose, block_diagonal(jacobian_landmark)))


def diagonal_blocks(matrix: Array, m: int) -> Array:
    """Return the m blocks (m, r, w) on the diagonal of a matrix (r m, w m)."""
    which = np.arange(m)
    return matrix.reshape(m, len(matrix) // m, m, -1)[which, :, which]


def block_diagonal(blocks: Array) -> Array:
    """Return the matrix (r m, w m) with blocks (m, r, w) on its diagonal, zero elsewhere."""
    m, r, w = blocks.shape
    full, which = np.zeros((m, r, m, w)), np.arange(m)
    full[which, :, which] = blocks
    return full.reshape(r * m, w * m)
