"""The partition of the map into local triangular regions, maintained as landmarks arrive.

A region is three landmarks, for good: dense data keeps its local coordinates, so a region that
holds any must never be split, flipped or dropped. That rules out what an incremental Delaunay
triangulation does (scipy's included): a landmark that arrives flips edges around it. Instead
regions are only ever appended: of the triples of nearby landmarks that meet the conditions of
Nieto 2005, section 3.5, the roundest first, all that fit between the regions that exist. So no
gap stays open that a permitted triple fills, and a landmark inside a region is no corner
(Fig. 3.1).

Landmarks move with every update of the filter. A history of the triangulation would locate points
among landmarks where they once were; a tree of boxes is refitted to where they are now, which
costs a pass over the regions, less than the update that moved them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ekf_reference.dense.box_tree import BoxTree, boxes, tiled
from ekf_reference.dense.conditions import Conditions, overlap
from ekf_reference.dense.triangles import (
    Array,
    axes,
    contains,
    determinant,
    is_degenerate,
    solve,
)

Index = NDArray[np.intp]

ON_AN_EDGE = 1e-12
"""Rounding of local coordinates: without it points on a shared edge fall between the regions."""


class Located(NamedTuple):
    """Where points are. region: (N,) number, -1 outside all. local: (N, 2), NaN outside all."""

    region: Index
    local: Array


@dataclass(frozen=True)
class PlacedRegions:
    """Regions with their landmarks where these are now; a snapshot.

    triangle: (R, 3, 2) [m]. tree: over their boxes.
    """

    triangle: Array
    tree: BoxTree

    def locate(self, point: Array) -> Located:
        """Find the regions of points (N, 2) [m], in logarithmic time each.

        A point on a shared edge, or where landmarks have moved so that regions overlap, is in
        the oldest of its regions: never in two. Not finite points are outside all.
        """
        reach = ON_AN_EDGE * self._extent
        asked = np.where(np.isfinite(point).all(axis=1, keepdims=True), point, np.nan)
        asked = np.concatenate((asked - reach, asked + reach), axis=1)
        near, tree = self._around(asked)
        query, place, _ = tree.meeting(asked)
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

    @cached_property
    def frames(self) -> tuple[Array, Array, Array]:
        """L1, a and b (R, 2) of every region [m]."""
        return self.triangle[:, 0], *axes(self.triangle)

    @property
    def _extent(self) -> float:
        top = self.tree.levels[-1]
        size = float((top[2:].max(axis=1) - top[:2].min(axis=1)).max())
        return size if np.isfinite(size) else 0.0


@dataclass
class LocalRegions:
    """The regions, oldest first; `extend` appends, nothing else changes.

    base: (R, 3) places of L1, L2, L3 in the map, counter-clockwise when the region was made.
    """

    conditions: Conditions = field(default_factory=Conditions)
    base: Index = field(default_factory=lambda: np.empty((0, 3), dtype=np.intp))
    _order: Index = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    _tiled: int = 0

    def placed(self, landmark: Array) -> PlacedRegions:
        """The regions with the map's landmarks (L, 2) [m] where they are now."""
        triangle = landmark[self.base]
        return PlacedRegions(triangle, BoxTree.pack(boxes(triangle), self._order))

    def flipped(self, landmark: Array) -> Index:
        """Numbers of the regions that have turned over, or lost their area, since they were made.

        landmark: (L, 2) [m]. What the second condition is there to prevent.
        """
        triangle = landmark[self.base]
        return np.flatnonzero((determinant(triangle) >= 0.0) | is_degenerate(triangle))

    def extend(self, landmark: Array, slot: Index, covariance: Array) -> Index:
        """Append the regions that landmarks near the vehicle now permit; returns their numbers.

        landmark: (L, 2) [m], the whole map. slot: (m,) the landmarks to consider. covariance:
        (2 m, 2 m) [m^2] of these with each other.
        """
        triple = self._permitted(landmark[slot], covariance)
        base = _counter_clockwise(slot[triple], landmark)
        triangle = landmark[base]
        free = np.ones(len(base), dtype=bool)
        free[self.placed(landmark).meeting(triangle)[0]] = False
        base, triangle = base[free], triangle[free]
        roundest = np.argsort(circumradius(triangle), kind="stable")
        chosen = []
        while len(roundest):
            chosen.append(roundest[0])
            rest = roundest[1:]
            roundest = rest[~overlap(triangle[chosen[-1]], triangle[rest])]
        return self._append(base[np.array(chosen, dtype=np.intp)], landmark)

    def _permitted(self, landmark: Array, covariance: Array) -> Index:
        """Triples (C, 3) of local landmarks that meet the first two conditions."""
        pair = np.triu(self.conditions.pairs(landmark, covariance))
        first, second = np.nonzero(pair)
        edge, third = np.nonzero(pair[first] & pair[second])
        triple = np.stack((first[edge], second[edge], third), axis=1)
        columns = (2 * triple[..., None] + np.arange(2)).reshape(-1, 6)
        joint = covariance[columns[:, :, None], columns[:, None, :]]
        fit = ~is_degenerate(landmark[triple])
        fit[fit] = self.conditions.well_conditioned(landmark[triple[fit]], joint[fit])
        return triple[fit]

    def _append(self, base: Index, landmark: Array) -> Index:
        number = np.arange(len(self.base), len(self.base) + len(base))
        self.base = np.concatenate((self.base, base))
        self._order = np.concatenate((self._order, number))
        if len(self.base) > 2 * self._tiled:  # regions come in driving order: tidy up seldom
            self._order = tiled(landmark[self.base].mean(axis=1))
            self._tiled = len(self.base)
        return number


def circumradius(triangle: Array) -> Array:
    """Radius [m] of the circle through the corners of triangles (C, 3, 2); (C,)."""
    edge = np.linalg.norm(triangle - np.roll(triangle, 1, axis=1), axis=-1)
    radius: Array = edge.prod(axis=1) / (2.0 * np.abs(determinant(triangle)))
    return radius


def _counter_clockwise(base: Index, landmark: Array) -> Index:
    """Triples (C, 3) with the second and third exchanged where they run clockwise."""
    clockwise = determinant(landmark[base]) > 0.0
    return np.where(clockwise[:, None], base[:, (0, 2, 1)], base)
