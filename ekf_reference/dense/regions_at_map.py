"""The regions where their landmarks are now: which of them is a point in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.dense.box_tree import BoxTree, boxes
from ekf_reference.dense.conditions import crosses, overlap
from ekf_reference.dense.triangles import axes, contains, is_degenerate, solve

ON_AN_EDGE = 1e-12
"""Rounding of local coordinates: without it points on a shared edge fall between the regions."""


class Located(NamedTuple):
    """Where points are. region: (N,) number, -1 outside all. local: (N, 2), NaN outside all."""

    region: Index
    local: Array


@dataclass(frozen=True)
class RegionsAtMap:
    """Regions with their landmarks where these are now; a snapshot.

    triangle: (R, 3, 2) [m]. tree: over their boxes.
    """

    triangle: Array
    tree: BoxTree

    def locate(self, point: Array) -> Located:
        """Find the regions of points (N, 2) [m], in logarithmic time each.

        A point in several regions, on a shared edge or where regions overlap by now, is in the
        oldest. Points that are not finite are outside all.
        """
        reach = ON_AN_EDGE * self._extent
        asked = np.where(np.isfinite(point).all(axis=1, keepdims=True), point, np.nan)
        asked = np.concatenate((asked - reach, asked + reach), axis=1)
        near, tree = self._around(asked)
        query, place = tree.meeting(asked)
        item = near[place]
        usable = ~is_degenerate(self.triangle[item])
        query, item = query[usable], item[usable]
        coordinates = solve(self.triangle[item], point[query])
        inside = np.flatnonzero(contains(coordinates, ON_AN_EDGE))
        inside = inside[np.argsort(item[inside], kind="stable")[::-1]]
        region = np.full(len(point), -1, dtype=np.intp)
        local = np.full((len(point), 2), np.nan)
        region[query[inside]] = item[inside]  # the oldest is written last
        local[query[inside]] = coordinates[inside]
        return Located(region, local)

    def _around(self, asked: Array) -> tuple[Index, BoxTree]:
        """Regions near the boxes (N, 4) and a tree over them: a scan sees little of a large map."""
        known = asked[~np.isnan(asked[:, 0])]
        hull = np.concatenate(
            (known[:, :2].min(axis=0, initial=np.inf), known[:, 2:].max(axis=0, initial=-np.inf))
        )
        near = self.tree.meeting(hull[None]).item
        if 2 * len(near) > len(self.triangle):
            return np.arange(len(self.triangle)), self.tree
        return near, BoxTree.pack(boxes(self.triangle[near]), np.arange(len(near)))

    def meeting(self, triangle: Array) -> tuple[Index, Index]:
        """Pairs (k,), (k,) of triangles (C, 3, 2) and regions that overlap."""
        near = self.tree.meeting(boxes(triangle))
        common = overlap(triangle[near.query], self.triangle[near.item])
        return near.query[common], near.item[common]

    def crossed(self, segment: Array) -> Mask:
        """Which of segments (k, 2, 2) run through the inside of a region; (k,)."""
        near = self.tree.meeting(boxes(segment[:, [0, 1, 1]]))
        through = crosses(segment[near.query], self.triangle[near.item])
        return np.bincount(near.query[through], minlength=len(segment)) > 0

    @cached_property
    def frames(self) -> tuple[Array, Array, Array]:
        """L1, a and b (R, 2) of every region [m]."""
        return self.triangle[:, 0], *axes(self.triangle)

    @property
    def _extent(self) -> float:
        top = self.tree.levels[-1]
        size = float((top[2:].max(axis=1) - top[:2].min(axis=1)).max())
        return size if np.isfinite(size) else 0.0
