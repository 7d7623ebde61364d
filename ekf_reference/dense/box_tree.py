"""A packed tree of boxes: which of many boxes does a point or a box meet."""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from ekf_reference.core.geometry import Array, Index

BRANCHES = 8

EMPTY = np.array((np.inf, np.inf, -np.inf, -np.inf))


class Meeting(NamedTuple):
    """Pairs that meet. query: (k,) which question. item: (k,) which box."""

    query: Index
    item: Index


@dataclass(frozen=True)
class BoxTree:
    """Levels of boxes, each the hull of `BRANCHES` consecutive ones below; one at the top.

    order: (n,) the item behind each of the lowest boxes. levels: lowest first, (4, b) west,
    south, east, north; padded with empty boxes. All points are asked level by level at once.
    """

    order: Index
    levels: tuple[Array, ...]

    @classmethod
    def pack(cls, box: Array, order: Index) -> Self:
        """A tree over boxes (n, 4) in a given order (n,), neighbours close to each other.

        A box that is not a number is empty, and its neighbours' hull is theirs alone.
        """
        column = np.take(box.T, order, axis=1)
        unknown = np.isnan(column).any(axis=0)
        levels = [_padded(np.where(unknown, EMPTY[:, None], column))]
        while levels[-1].shape[1] > BRANCHES:
            group = levels[-1].reshape(4, -1, BRANCHES)
            levels.append(_padded(np.concatenate((group[:2].min(axis=2), group[2:].max(axis=2)))))
        return cls(order, tuple(levels))

    def meeting(self, box: Array) -> Meeting:
        """Every pair of a box asked about (q, 4) and an item's box that touch.

        A point is a box without extent. NaN meets nothing.
        """
        query = np.repeat(np.arange(len(box)), BRANCHES)
        node = np.tile(np.arange(BRANCHES), len(box))
        west, south, east, north = box.T.copy()  # contiguous: several times faster to pick from
        for height in range(len(self.levels) - 1, -1, -1):
            here = self.levels[height]
            touch = np.flatnonzero(
                (west[query] <= here[2][node])
                & (here[0][node] <= east[query])
                & (south[query] <= here[3][node])
                & (here[1][node] <= north[query])
            )
            query, node = query[touch], node[touch]
            if height:
                query = np.repeat(query, BRANCHES)
                node = (node[:, None] * BRANCHES + np.arange(BRANCHES)).ravel()
        return Meeting(query, self.order[node])


def boxes(triangle: Array) -> Array:
    """Boxes (n, 4) west, south, east, north around triangles (n, 3, 2)."""
    first, second, third = np.moveaxis(triangle, 1, 0)  # several times faster than a reduction
    box = np.empty((len(triangle), 4))
    np.minimum(np.minimum(first, second), third, out=box[:, :2])
    np.maximum(np.maximum(first, second), third, out=box[:, 2:])
    return box


def tiled(center: Array) -> Index:
    """An order (n,) of points (n, 2) in which neighbours are close: slabs by east, then north."""
    slabs = max(1, int(np.sqrt(len(center) / BRANCHES)))
    rank = np.argsort(np.argsort(center[:, 0], kind="stable"), kind="stable")
    return np.lexsort((center[:, 1], rank * slabs // max(len(center), 1)))


def _padded(box: Array) -> Array:
    """Boxes (4, n), and empty ones up to a multiple of `BRANCHES`."""
    count = box.shape[1]
    padded = np.empty((4, max(BRANCHES, -(-count // BRANCHES) * BRANCHES)))
    padded[:, :count], padded[:, count:] = box, EMPTY[:, None]
    return padded
