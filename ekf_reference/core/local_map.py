"""Parts of a filter's state, as its readers need them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, Index


@dataclass(frozen=True)
class LocalMap:
    """Some landmarks of one kind, such as those that may be seen from here.

    pose: (p,). slot: (L,) places in the map. landmark: (L, w), w being 2 for points and 3 for
    those with a direction. covariance: (p + w L, p + w L) of the pose and these landmarks.
    columns: (p + w L,) their state entries.
    """

    pose: Array
    slot: Index
    landmark: Array
    covariance: Array
    columns: Index

    @property
    def vehicle(self) -> Array:
        """(p, p) P_vv."""
        p = len(self.pose)
        return self.covariance[:p, :p]

    @property
    def cross(self) -> Array:
        """(L, p, w) P_vl of each landmark."""
        p, (count, width) = len(self.pose), self.landmark.shape
        return self.covariance[:p, p:].reshape(p, count, width).transpose(1, 0, 2)

    @property
    def own(self) -> Array:
        """(L, w, w) P_ll of each landmark."""
        p, (count, width) = len(self.pose), self.landmark.shape
        own = np.empty((count, width, width))
        for offset in range(width):
            diagonal = self.covariance.diagonal(offset)
            for i in range(width - offset):
                own[:, i, i + offset] = own[:, i + offset, i] = diagonal[p + i :: width]
        return own


class MapSnapshot(NamedTuple):
    """Pose and places of landmarks, read without a change: what dense maps are placed by.

    landmark: (L, 2) by number (see Layout.numbered), NaN where there is none. slot: (m,) the
    numbers of those whose covariance is current, ascending. covariance: (p + 2 m, p + 2 m) of the
    pose and these. Read-only; it changes with the next write.
    """

    landmark: Array
    slot: Index
    covariance: Array


def by_number(kinds: Sequence[Array]) -> Array:
    """(L, 2) places by number (see Layout.numbered) of landmarks (L_k, 2 or 3) of each kind.

    NaN where no landmark has the number.
    """
    count = max((len(kinds) * len(each) for each in kinds), default=0)
    place = np.full((count, 2), np.nan)
    for k, each in enumerate(kinds):
        place[k :: len(kinds)][: len(each)] = each[:, :2]
    return place
