"""Stacked measurements: m of them as one, and one as m."""

from __future__ import annotations

import numpy as np

from ekf_reference.core.geometry import Array


def stack(jacobian_pose: Array, jacobian_landmark: Array) -> Array:
    """Return one Jacobian of m measurements, in the order of Layout.columns.

    Two measurements of one landmark get two sets of columns with the same state entries, which sums
    their effect on S and on the gain as it should.

    Args:
        jacobian_pose: (m, r, p) of each measurement by the pose.
        jacobian_landmark: (m, r, w) of each by its own landmark.

    Returns:
        (r m, p + w m).

    Source: Guivant 2002, eq. 3.
    """
    by_pose = jacobian_pose.reshape(-1, jacobian_pose.shape[2])
    return np.hstack((by_pose, block_diagonal(jacobian_landmark)))


def diagonal_blocks(matrix: Array, m: int) -> Array:
    """Return the blocks on the diagonal of a matrix.

    Args:
        matrix: (r m, w m).
        m: Number of blocks.

    Returns:
        (m, r, w).
    """
    which = np.arange(m)
    return matrix.reshape(m, len(matrix) // m, m, -1)[which, :, which]


def block_diagonal(blocks: Array) -> Array:
    """Return the matrix with blocks on its diagonal, zero elsewhere.

    Args:
        blocks: (m, r, w).

    Returns:
        (r m, w m).
    """
    m, r, w = blocks.shape
    full, which = np.zeros((m, r, m, w)), np.arange(m)
    full[which, :, which] = blocks
    return full.reshape(r * m, w * m)
