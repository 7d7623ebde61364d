"""Edges of a pose graph whose information is many powers of ten away from that of the others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graphslam.arrays import Array, Index

_FEWEST = 10
"""Of fewer edges none is called few."""
_FEW = 0.1
"""Share of the edges; more are a kind of their own."""
_APART = 4.0
"""Powers of ten of an information's geometric mean; those of a scan matcher span under two."""
_MOST_NAMED = 5


class ExtremeEdges(NamedTuple):
    """rows: (n,) of the edges. times: (n,) their information by the median of the others'."""

    rows: Index
    times: Array

    def words(self, names: list[str]) -> str:
        """Say which they are, and how far off. names: of all edges."""
        listed = [names[row] for row in self.rows[:_MOST_NAMED]]
        more = len(self.rows) - len(listed)
        listed += [f"{more} more"] if more else []
        which = " and ".join(filter(None, (", ".join(listed[:-1]), listed[-1])))
        low, high = f"{self.times.min():.2g}", f"{self.times.max():.2g}"
        span = low if low == high else f"{low} to {high}"
        return f"{which}: the stated information is {span} times that of the other edges"


def extreme_edges(covariance: Array) -> ExtremeEdges:
    """Return the few edges whose information is far from the median.

    Args:
        covariance: (N, n, n) of edges of one kind.

    Returns:
        None of fewer than ten edges, nor where more than a tenth are far off.
    """
    size = _size(covariance)
    apart = size - np.median(size) if len(size) else size
    rows = np.flatnonzero(np.abs(apart) >= _APART)
    if len(size) < _FEWEST or len(rows) > _FEW * len(size):
        rows = rows[:0]
    return ExtremeEdges(rows, 10.0 ** apart[rows])


def _size(covariance: Array) -> Array:
    """(N,) logarithm to 10 of the geometric mean of an information's eigenvalues."""
    size: Array = -np.linalg.slogdet(covariance)[1] / (covariance.shape[-1] * np.log(10.0))
    return size
