"""A graph's linearisation as a sparse matrix, its columns in the order of the keys."""

from __future__ import annotations

import gtsam
import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags, identity
from scipy.sparse.linalg import SuperLU, splu

from graphslam.arrays import Array

_RIDGE = 1e-14
"""Added to normal matrices of unit columns."""


def sparse_system(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, height: int = 1
) -> tuple[csr_matrix, Array]:
    """Return the whitened Jacobian and right-hand side of a graph.

    Args:
        graph: Its factors touch no other keys than the values'.
        values: Where it is linearised.
        height: Rows that it has at least: gtsam leaves out entries that are zero.

    Returns:
        (m, n) Jacobian, its rows in the order of the factors; (m,) right-hand side.
    """
    row, column, value = graph.linearize(values).sparseJacobian_()
    row, column = row.astype(np.intp) - 1, column.astype(np.intp) - 1
    height, width = max(height, int(row.max(initial=0)) + 1), values.dim()
    inside = column < width  # the last column is the right-hand side
    jacobian = coo_matrix(
        (value[inside], (row[inside], column[inside])), shape=(height, width)
    ).tocsr()
    right = np.zeros(height)
    right[row[~inside]] = value[~inside]
    return jacobian, right


def factorised(normal: csr_matrix) -> SuperLU:
    """Return the factors of a normal matrix (n, n). Raises RuntimeError where it is singular."""
    return splu(
        normal.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


def normal_factors(jacobian: csr_matrix) -> SuperLU:
    """Return the factors of J^T J (n, n) for J (m, n) of unit columns, with a ridge of rounding.

    Raises RuntimeError where it is singular all the same.
    """
    return factorised(jacobian.T @ jacobian + _RIDGE * identity(jacobian.shape[1]))


def column_lengths(jacobian: csr_matrix) -> Array:
    """Return the norms (n,) of the columns of a sparse matrix (m, n)."""
    lengths: Array = np.sqrt(np.asarray(jacobian.multiply(jacobian).sum(axis=0)).ravel())
    return lengths


def scaled_columns(jacobian: csr_matrix, lengths: Array) -> csr_matrix:
    """Return a sparse matrix (m, n) with each column divided by its length."""
    return (jacobian @ diags(1.0 / lengths)).tocsr()
