"""Stacked measurements: m of them as one, and one as m."""

from __future__ import annotations

import numpy as np

from ekf_reference.core.geometry import Array, Index


def stack(jacobian_pose: Array, jacobian_landmark: Array) -> Array:
    """Return one Jacobian (r m, p + w m) of m measurements, in the order of Layout.columns.

    Source: Guivant 2002, eq. 3.
    jacobian_pose: (m, r, p). jacobian_landmark: (m, r, w).

    Two measurements of one landmark get two sets of columns with the same state entries, which
    sums their effect on S and on the gain as it should.
    """
    (m, r, p), width = jacobian_pose.shape, jacobian_landmark.shape[2]
    jacobian = np.zeros((m, r, p + width * m))
    jacobian[:, :, :p] = jacobian_pose
    which = np.arange(m)
    for i in range(width):
        jacobian[which, :, p + i + width * which] = jacobian_landmark[:, :, i]
    return jacobian.reshape(r * m, -1)


def unstack(jacobian: Array, m: int, width: int) -> tuple[Array, Array]:
    """Return the blocks (m, r, p) and (m, r, w) that `stack` put together."""
    p = jacobian.shape[1] - width * m
    blocks, which = jacobian.reshape(m, -1, jacobian.shape[1]), np.arange(m)[:, None]
    by_landmark: Array = blocks[which, :, p + width * which + np.arange(width)].transpose(0, 2, 1)
    return blocks[:, :, :p], by_landmark


def diagonal_blocks(matrix: Array, m: int) -> Array:
    """Return the m blocks (m, r, r) on the diagonal of a matrix (r m, r m)."""
    r, which = len(matrix) // m, np.arange(m)
    blocks: Array = matrix.reshape(m, r, m, r)[which, :, which]
    return blocks


def block_diagonal(blocks: Array) -> Array:
    """Return the matrix (r m, r m) with blocks (m, r, r) on its diagonal."""
    m, r, _ = blocks.shape
    full = np.zeros((m, r, m, r))
    which = np.arange(m)
    full[which, :, which, :] = blocks
    return full.reshape(r * m, r * m)


def point_columns(slot: Index, pose_size: int = 3) -> Index:
    """Return the entries (p + 2 m,) of the pose and some points (m,) of a map of points alone."""
    columns = np.empty(pose_size + 2 * len(slot), dtype=np.intp)
    columns[:pose_size] = np.arange(pose_size)
    columns[pose_size::2] = pose_size + 2 * slot
    columns[pose_size + 1 :: 2] = pose_size + 1 + 2 * slot
    return columns
