"""Which of a layer's old points a scan's new points meet (Nieto 2005, eq. 4.10)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.geometry import Array, Index, Mask

_SIDE = 512
"""Cells along a side of the hash; farther points share cells, which costs time, not exactness."""
_SAME = 0.1
"""Share of d_min, closer than which two old points that move to one new point are one."""
_AROUND = np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), axis=-1).reshape(1, 9, 2)


class Associated(NamedTuple):
    """Pairs of an old point and its nearest new one, closer than d_min.

    old: (k,) ascending. new: (k,) the nearest of all new ones; one may serve many old ones.
    apart_m: (k,) between the two. met: (m,) whether a new point has any old one closer than
    d_min, taken by it or not.
    """

    old: Index
    new: Index
    apart_m: Array
    met: Mask


def associate(old: Array, new: Array, d_min_m: float) -> Associated:
    """Old points (n, 2) [m] with new points (m, 2) [m]: all in all, as brute force has it.

    Of new points at the same distance the first one counts. Cells as long as d_min are hashed,
    new points written to their own and the eight around it, so that an old point looks at one.
    """
    key = _key((np.floor(new / d_min_m).astype(np.int64)[:, None] + _AROUND).reshape(-1, 2))
    order = np.argsort(key, kind="stable")
    key = key[order]
    first = np.flatnonzero(np.diff(key, prepend=-1))
    count = np.diff(first, append=len(key))
    bucket = np.zeros(_SIDE * _SIDE, dtype=np.int32)
    bucket[key[first]] = np.arange(1, len(first) + 1)

    here = bucket[_key(np.floor(old / d_min_m).astype(np.int64))]
    row = np.flatnonzero(here)
    here = here[row] - 1
    tried = count[here]
    begin = np.cumsum(tried) - tried
    candidate = np.repeat(first[here] - begin, tried) + np.arange(tried.sum())
    pair_new = (order // 9).take(candidate)
    asked = np.repeat(np.arange(len(row)), tried)
    apart = old.take(row, axis=0).take(asked, axis=0) - new.take(pair_new, axis=0)
    square = apart[:, 0] ** 2 + apart[:, 1] ** 2

    met = np.zeros(len(new), dtype=bool)
    met[pair_new[square < d_min_m**2]] = True
    if not len(row):
        return Associated(row, row, np.empty(0), met)
    least = np.minimum.reduceat(square, begin)
    close = least < d_min_m**2
    nearest = np.empty(len(row), dtype=np.intp)
    best = np.flatnonzero(square == least.take(asked))[::-1]
    nearest[asked[best]] = pair_new[best]  # the first is written last
    return Associated(row[close], nearest[close], np.sqrt(least[close]), met)


def doubled(pair: Associated, d_min_m: float, worth: Array) -> Index:
    """Which old points (d,) share their new one with an old one of more weight (k,).

    Only pairs closer than a tenth of d_min count. If kept, points that converge to one place would
    leave gaps, which new points fill, without end.
    """
    row = np.flatnonzero(pair.apart_m < _SAME * d_min_m)
    row = row[np.lexsort((-worth[row], pair.new[row]))]
    second = np.diff(pair.new[row], prepend=-1) == 0
    lighter: Index = pair.old[row[second]]
    return lighter


def _key(cell: NDArray[np.int64]) -> NDArray[np.int64]:
    wrapped = cell & (_SIDE - 1)
    return wrapped[:, 0] * _SIDE + wrapped[:, 1]
