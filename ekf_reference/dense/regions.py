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
costs a pass over the regions, less than the update that moved them. A landmark that leaves the
map is a row of NaN: its regions are empty from then on, and their ground is free.
"""

from __future__ import annotations

import math
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
    circumradius,
    contains,
    determinant,
    is_degenerate,
    solve,
)
from ekf_reference.dense.virtual_landmarks import VirtualLandmarks, behind

Index = NDArray[np.intp]

_ALONG = (0.5, 0.25, 0.75, 0.1, 0.9)
"""Where on the way from landmark to landmark it is asked whether regions are in between."""
_WELL_INSIDE = 1e-6
"""Local coordinates so far from an edge are not on it, whatever rounding did."""
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


class Potential(NamedTuple):
    """Triangles that may become regions once they meet the first condition.

    axis: (C, 2) places in the map of the two real landmarks that a triangle is best told by, its
    longest edge, or its only real one. placed: the triangles, those with three real
    landmarks first, each kind roundest first.
    """

    axis: Index
    placed: PlacedRegions


@dataclass
class LocalRegions:
    """The regions, oldest first; `extend` and `extend_virtual` append, nothing else changes.

    depths: that virtual landmarks may have behind their pair, as shares of its length; the first
    is equilateral. base: (R, 3) places of L1, L2, L3 among `corners`, counter-clockwise when the
    region was made; -1 - k is virtual landmark k.
    """

    conditions: Conditions = field(default_factory=Conditions)
    depths: tuple[float, ...] = (math.sqrt(0.75), 1.3, 2.0)
    base: Index = field(default_factory=lambda: np.empty((0, 3), dtype=np.intp))
    virtual: VirtualLandmarks = field(default_factory=VirtualLandmarks)
    _order: Index = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    _tiled: int = 0

    def corners(self, landmark: Array) -> Array:
        """The map's landmarks (L, 2) [m], then the virtual ones, newest first; (L + V, 2).

        So `base` indexes it, a virtual landmark from the end.
        """
        return np.concatenate((landmark, self.virtual.point(landmark)[::-1]))

    def placed(self, landmark: Array) -> PlacedRegions:
        """The regions with the map's landmarks (L, 2) [m] where they are now."""
        triangle = self.corners(landmark)[self.base]
        return PlacedRegions(triangle, BoxTree.pack(boxes(triangle), self._order))

    def flipped(self, landmark: Array) -> Index:
        """Numbers of the regions that have turned over, or lost their area, since they were made.

        landmark: (L, 2) [m]. What the second condition is there to prevent; that a landmark has
        left the map is none of its business.
        """
        triangle = self.corners(landmark)[self.base]
        turned_over = (determinant(triangle) >= 0.0) | is_degenerate(triangle)
        return np.flatnonzero(turned_over & np.isfinite(triangle).all(axis=(1, 2)))

    def extend(self, landmark: Array, slot: Index, covariance: Array) -> Index:
        """Append the regions that landmarks near the vehicle now permit; returns their numbers.

        landmark: (L, 2) [m], the whole map. slot: (m,) the landmarks to consider. covariance:
        (2 m, 2 m) [m^2] of these with each other.
        """
        slot, covariance = _in_the_map(landmark, slot, covariance)
        pair = self._open(landmark, slot, self.conditions.pairs(landmark[slot], covariance))
        base = self._triples(landmark, slot, covariance, pair)
        return self._append(base[_apart(landmark[base])], landmark)

    def extend_virtual(
        self,
        landmark: Array,
        slot: Index,
        pose: Array,
        covariance: Array,
        point: Array,
        least_points: int = 1,
    ) -> Index:
        """Append regions of two landmarks and a virtual one behind them; returns their numbers.

        Source: Nieto 2005, section 3.5.1: created "at a moment where the vehicle is highly
        correlated with the other two landmarks", so the first condition is asked of the vehicle's
        position too. Triangles that contain more of the points come first.

        landmark: (L, 2) [m], the whole map. slot: (m,) the landmarks to consider. pose: (3,).
        covariance: (3 + 2 m, 3 + 2 m) of the pose and these. point: (N, 2) [m] what is to be
        covered. least_points: how many of them a new region must contain.
        """
        slot, covariance = _in_the_map(landmark, slot, covariance)
        position = np.delete(np.arange(len(covariance)), 2)
        alike = self.conditions.correlated(covariance[position[:, None], position])
        allowed = alike[1:, 1:] & alike[0, 1:, None] & alike[0, 1:]
        allowed &= self.conditions.within_reach(landmark[slot])
        allowed = self._open(landmark, slot, allowed)
        new, triangle = self._behind(landmark, slot, pose, covariance, allowed)
        near = BoxTree.pack(boxes(triangle), np.arange(len(triangle))).meeting(np.tile(point, 2))
        within = contains(solve(triangle[near.item], point[near.query]))
        inside = np.bincount(near.item[within], minlength=len(triangle))
        wanted = np.argsort(-inside, kind="stable")[: np.count_nonzero(inside >= least_points)]
        chosen = wanted[_apart(triangle[wanted])]
        number = len(self.virtual.depth) + np.arange(len(chosen))
        self.virtual = self.virtual.joined(new[chosen])
        base = np.column_stack((new.pair[chosen], -1 - number))
        return self._append(_counter_clockwise(base, self.corners(landmark)), landmark)

    def potential(self, landmark: Array, slot: Index, pose: Array, covariance: Array) -> Potential:
        """Triangles that meet the second and third condition, whether or not the first.

        Called after `extend`, it lists what waits for correlation (Nieto 2005, section 3.7.3).
        They may overlap each other. Arguments as of `extend_virtual`.
        """
        slot, covariance = _in_the_map(landmark, slot, covariance)
        pair = self._open(landmark, slot, self.conditions.within_reach(landmark[slot]))
        base = self._triples(landmark, slot, covariance[3:, 3:], pair)
        ahead = np.roll(base, -1, axis=1)
        longest = np.linalg.norm(landmark[base] - landmark[ahead], axis=2).argmax(axis=1)[:, None]
        axis = np.column_stack(
            (np.take_along_axis(base, longest, 1), np.take_along_axis(ahead, longest, 1))
        )
        new, triangle = self._behind(landmark, slot, pose, covariance, pair)
        roundest = np.argsort(circumradius(triangle), kind="stable")
        axis = np.sort(np.concatenate((axis, new.pair[roundest])), axis=1)
        triangle = np.concatenate((landmark[base], triangle[roundest]))
        tree = BoxTree.pack(boxes(triangle), tiled(triangle.mean(axis=1)))
        return Potential(axis, PlacedRegions(triangle, tree))

    def _open(self, landmark: Array, slot: Index, pair: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Pairs (m, m) but those with a region in between, which no triangle with them can fit.

        Cheap, and it spares most of the triples where many landmarks stand among regions.
        """
        first, second = np.nonzero(np.triu(pair))
        placed, result = self.placed(landmark), pair.copy()
        for share in _ALONG:
            start, end = landmark[slot[first]], landmark[slot[second]]
            local = placed.locate(start + share * (end - start)).local
            crossed = contains(local, -_WELL_INSIDE)
            result[first[crossed], second[crossed]] = False
            result[second[crossed], first[crossed]] = False
            first, second = first[~crossed], second[~crossed]
        return result

    def _triples(
        self, landmark: Array, slot: Index, covariance: Array, pair: NDArray[np.bool_]
    ) -> Index:
        """Triples (C, 3) of permitted pairs that meet the last two conditions, roundest first."""
        local, pair = landmark[slot], np.triu(pair)
        first, second = np.nonzero(pair)
        edge, third = np.nonzero(pair[first] & pair[second])
        triple = np.stack((first[edge], second[edge], third), axis=1)
        triple = triple[~is_degenerate(local[triple])]
        columns = (2 * triple[..., None] + np.arange(2)).reshape(-1, 6)
        joint = covariance[columns[:, :, None], columns[:, None, :]]
        fit = self._fit(landmark, local[triple], joint)
        base = _counter_clockwise(slot[triple[fit]], landmark)
        return base[np.argsort(circumradius(landmark[base]), kind="stable")]

    def _behind(
        self,
        landmark: Array,
        slot: Index,
        pose: Array,
        covariance: Array,
        pair: NDArray[np.bool_],
    ) -> tuple[VirtualLandmarks, Array]:
        """Virtual landmarks behind permitted pairs, and triangles (C, 3, 2) that fit."""
        local = landmark[slot]
        new = VirtualLandmarks()
        for depth in self.depths:
            new = new.joined(behind(np.argwhere(np.triu(pair)), local, pose[:2], depth))
        triangle = np.concatenate((local[new.pair], new.point(local)[:, None]), axis=1)
        columns = 3 + (2 * new.pair[..., None] + np.arange(2)).reshape(-1, 4)
        real = np.broadcast_to(np.eye(4), (len(columns), 4, 4))
        lift = np.concatenate((real, new.jacobian()), axis=1)
        joint = covariance[columns[:, :, None], columns[:, None, :]]
        fit = self._fit(landmark, triangle, lift @ joint @ np.swapaxes(lift, 1, 2))
        return VirtualLandmarks(slot[new.pair[fit]], new.depth[fit]), triangle[fit]

    def _fit(self, landmark: Array, triangle: Array, covariance: Array) -> NDArray[np.bool_]:
        """Which triangles (C, 3, 2), with covariances (C, 6, 6), meet the last two conditions."""
        edge = np.linalg.norm(triangle - np.roll(triangle, 1, axis=1), axis=2)
        small = edge.max(axis=1, initial=0.0) <= self.conditions.longest_edge_m
        fit: NDArray[np.bool_] = small & self.conditions.well_conditioned(triangle, covariance)
        placed = self.placed(landmark)
        kept = np.flatnonzero(fit)
        taken = placed.locate(triangle[kept].mean(axis=1)).region >= 0  # settles most, cheaply
        fit[kept[taken]] = False
        kept = kept[~taken]
        fit[kept[placed.meeting(triangle[kept])[0]]] = False
        return fit

    def _append(self, base: Index, landmark: Array) -> Index:
        number = np.arange(len(self.base), len(self.base) + len(base))
        self.base = np.concatenate((self.base, base))
        self._order = np.concatenate((self._order, number))
        if len(self.base) > 2 * self._tiled:  # regions come in driving order: tidy up seldom
            self._order = tiled(self.corners(landmark)[self.base].mean(axis=1))
            self._tiled = len(self.base)
        return number


def _counter_clockwise(base: Index, landmark: Array) -> Index:
    """Triples (C, 3) with the second and third exchanged where they run clockwise."""
    clockwise = determinant(landmark[base]) > 0.0
    return np.where(clockwise[:, None], base[:, (0, 2, 1)], base)


def _in_the_map(landmark: Array, slot: Index, covariance: Array) -> tuple[Index, Array]:
    """The landmarks (m,) that are still in the map, and the covariance that goes with them.

    covariance: (k + 2 m, k + 2 m), any k states before the landmarks.
    """
    there = np.isfinite(landmark[slot]).all(axis=1)
    if there.all():
        return slot, covariance
    before = np.ones(len(covariance) - 2 * len(slot), dtype=bool)
    kept = np.concatenate((before, np.repeat(there, 2)))
    return slot[there], covariance[kept][:, kept]


def _apart(triangle: Array) -> Index:
    """Triangles (C, 3, 2), the first first, that do not overlap those chosen before; (k,)."""
    rest, chosen = np.arange(len(triangle)), []
    while len(rest):
        chosen.append(rest[0])
        rest = rest[1:]
        rest = rest[~overlap(triangle[chosen[-1]], triangle[rest])]
    return np.array(chosen, dtype=np.intp)
