"""The partition of the map into local triangular regions, maintained as landmarks arrive.

Dense data keeps its local coordinates, so a region's three landmarks never change. An incremental
Delaunay triangulation would flip edges; here regions are only appended: all triples of nearby
landmarks that meet the conditions of Nieto 2005, section 3.5, and overlap no region, the roundest
first. So no gap stays open that a permitted triple fills, and a landmark inside a region is no
corner (Fig. 3.1).

Points are located by a tree of boxes, fitted anew whenever landmarks have moved. A landmark that
leaves the map is a row of NaN: its regions are empty from then on, and their ground is free.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.dense.box_tree import BoxTree, boxes, tiled
from ekf_reference.dense.conditions import Conditions, overlap
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.triangles import circumradius, contains, determinant, is_degenerate, solve
from ekf_reference.dense.virtual_landmarks import VirtualLandmarks, behind


class Potential(NamedTuple):
    """Triangles that may become regions once they meet the first condition.

    axis: (C, 2) landmarks of a triangle's longest edge, or of its only edge between real landmarks.
    placed: the triangles, those with three real landmarks first, each kind roundest first.
    """

    axis: Index
    placed: RegionsAtMap


@dataclass(kw_only=True)
class LocalRegions:
    """The regions, oldest first; `extend` and `extend_virtual` append, nothing else changes.

    depths: that virtual landmarks may have behind their pair, as shares of its length; the first
    is equilateral. base: (R, 3) places of L1, L2, L3 among `corners`, counter-clockwise when the
    region was made; -1 - k is virtual landmark k. by_correlation: (R,) whether, when the region was
    made, all its pairs met the first condition by correlation, as the thesis asks; the others met
    it by their relative sigma. The vehicle counts where there is a virtual landmark.
    """

    conditions: Conditions = field(default_factory=Conditions)
    depths: tuple[float, ...] = (math.sqrt(0.75), 1.3, 2.0)
    base: Index = field(default_factory=lambda: np.empty((0, 3), dtype=np.intp))
    virtual: VirtualLandmarks = field(default_factory=VirtualLandmarks)
    by_correlation: Mask = field(default_factory=lambda: np.empty(0, dtype=bool))
    _order: Index = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    _tiled: int = 0
    _last: tuple[Array, Index, RegionsAtMap] | None = field(default=None, repr=False, compare=False)

    def corners(self, landmark: Array) -> Array:
        """The map's landmarks (L, 2) [m], then the virtual ones, newest first; (L + V, 2).

        So `base` indexes it, a virtual landmark from the end.
        """
        return np.concatenate((landmark, self.virtual.point(landmark)[::-1]))

    def placed(self, landmark: Array) -> RegionsAtMap:
        """Return the regions with the map's landmarks (L, 2) [m] where they are now; cached."""
        if self._last is not None:
            asked, base, placed = self._last
            if base is self.base and np.array_equal(asked, landmark, equal_nan=True):
                return placed
        triangle = self.corners(landmark)[self.base]
        placed = RegionsAtMap(triangle, BoxTree.pack(boxes(triangle), self._order))
        self._last = landmark.copy(), self.base, placed
        return placed

    def extend(self, landmark: Array, landmark_index: Index, covariance: Array) -> Index:
        """Append the regions that landmarks near the vehicle now permit; returns their numbers.

        landmark: (L, 2) [m], the whole map. landmark_index: (m,) the landmarks to consider.
        covariance: (2 m, 2 m) [m^2] of these with each other.
        """
        landmark_index, covariance = _in_the_map(landmark, landmark_index, covariance)
        pair = self._open(
            landmark, landmark_index, self.conditions.pairs(landmark[landmark_index], covariance)
        )
        base = self._triples(landmark, landmark_index, covariance, pair)
        base = base[_apart(landmark[base])]
        alike = self.conditions.highly_correlated(covariance)
        return self._append(base, landmark, _all_pairs(alike, landmark_index, base))

    def extend_virtual(
        self,
        landmark: Array,
        landmark_index: Index,
        pose: Array,
        covariance: Array,
        point: Array,
        least_points: int = 1,
    ) -> Index:
        """Append regions of two landmarks and a virtual one behind them; returns their numbers.

        Source: Nieto 2005, section 3.5.1: created "at a moment where the vehicle is highly
        correlated with the other two landmarks", so the first condition is asked of the vehicle's
        position too. Triangles that contain more of the points come first.

        landmark: (L, 2) [m], the whole map. landmark_index: (m,) the landmarks to consider. pose:
        (3,).
        covariance: (3 + 2 m, 3 + 2 m) of the pose and these. point: (N, 2) [m] what is to be
        covered. least_points: how many of them a new region must contain.
        """
        landmark_index, covariance = _in_the_map(landmark, landmark_index, covariance)
        position = np.delete(np.arange(len(covariance)), 2)
        alike = self.conditions.correlated(covariance[position[:, None], position])
        allowed = alike[1:, 1:] & alike[0, 1:, None] & alike[0, 1:]
        pair = self._open(
            landmark,
            landmark_index,
            self.conditions.within_reach(landmark[landmark_index]) & allowed,
        )
        new, triangle = self._behind(landmark, landmark_index, pose, covariance, pair)
        near = BoxTree.pack(boxes(triangle), np.arange(len(triangle))).meeting(np.tile(point, 2))
        within = contains(solve(triangle[near.item], point[near.query]))
        inside = np.bincount(near.item[within], minlength=len(triangle))
        wanted = np.argsort(-inside, kind="stable")[: np.count_nonzero(inside >= least_points)]
        chosen = wanted[_apart(triangle[wanted])]
        number = len(self.virtual.depth) + np.arange(len(chosen))
        self.virtual = self.virtual.joined(new[chosen])
        base = np.column_stack((new.pair[chosen], -1 - number))
        alike = self.conditions.highly_correlated(covariance[position[:, None], position])
        with_vehicle = np.column_stack((new.pair[chosen], np.full(len(chosen), -1)))
        by_correlation = _all_pairs(alike, np.append(-1, landmark_index), with_vehicle)
        base = _counter_clockwise(base, self.corners(landmark))
        return self._append(base, landmark, by_correlation)

    def potential(
        self, landmark: Array, landmark_index: Index, pose: Array, covariance: Array
    ) -> Potential:
        """Triangles that meet the second and third condition, whether or not the first.

        Called after `extend`, it lists what waits for correlation (Nieto 2005, section 3.7.3).
        They may overlap each other. Arguments as of `extend_virtual`.
        """
        landmark_index, covariance = _in_the_map(landmark, landmark_index, covariance)
        pair = self._open(
            landmark, landmark_index, self.conditions.within_reach(landmark[landmark_index])
        )
        base = self._triples(landmark, landmark_index, covariance[3:, 3:], pair)
        ahead = np.roll(base, -1, axis=1)
        longest = np.linalg.norm(landmark[base] - landmark[ahead], axis=2).argmax(axis=1)[:, None]
        axis = np.column_stack(
            (np.take_along_axis(base, longest, 1), np.take_along_axis(ahead, longest, 1))
        )
        new, triangle = self._behind(landmark, landmark_index, pose, covariance, pair)
        roundest = np.argsort(circumradius(triangle), kind="stable")
        axis = np.sort(np.concatenate((axis, new.pair[roundest])), axis=1)
        triangle = np.concatenate((landmark[base], triangle[roundest]))
        tree = BoxTree.pack(boxes(triangle), tiled(triangle.mean(axis=1)))
        return Potential(axis, RegionsAtMap(triangle, tree))

    def _triples(
        self, landmark: Array, landmark_index: Index, covariance: Array, pair: Mask
    ) -> Index:
        """Triples (C, 3) of `_open` pairs that meet the last two conditions, roundest first."""
        local = landmark[landmark_index]
        first, second = np.nonzero(pair)
        edge, third = np.nonzero(pair[first] & pair[second])
        triple = np.stack((first[edge], second[edge], third), axis=1)
        triple = triple[~is_degenerate(local[triple])]
        columns = (2 * triple[..., None] + np.arange(2)).reshape(-1, 6)
        joint = covariance[columns[:, :, None], columns[:, None, :]]
        fit = self._fit(landmark, local[triple], joint)
        base = _counter_clockwise(landmark_index[triple[fit]], landmark)
        return base[np.argsort(circumradius(landmark[base]), kind="stable")]

    def _behind(
        self, landmark: Array, landmark_index: Index, pose: Array, covariance: Array, pair: Mask
    ) -> tuple[VirtualLandmarks, Array]:
        """Virtual landmarks behind `_open` pairs, and triangles (C, 3, 2) that fit."""
        local = landmark[landmark_index]
        new = VirtualLandmarks()
        for depth in self.depths:
            new = new.joined(behind(np.argwhere(pair), local, pose[:2], depth))
        triangle = np.concatenate((local[new.pair], new.point(local)[:, None]), axis=1)
        columns = 3 + (2 * new.pair[..., None] + np.arange(2)).reshape(-1, 4)
        real = np.broadcast_to(np.eye(4), (len(columns), 4, 4))
        lift = np.concatenate((real, new.jacobian()), axis=1)
        joint = covariance[columns[:, :, None], columns[:, None, :]]
        fit = self._fit(landmark, triangle, lift @ joint @ np.swapaxes(lift, 1, 2))
        return VirtualLandmarks(landmark_index[new.pair[fit]], new.depth[fit]), triangle[fit]

    def _open(self, landmark: Array, landmark_index: Index, pair: Mask) -> Mask:
        """The pairs (m, m), each once, that may be a new region's edge: no region lies between."""
        pair = np.triu(pair)
        first, second = np.nonzero(pair)
        between = self.placed(landmark).crossed(
            landmark[np.stack((landmark_index[first], landmark_index[second]), 1)]
        )
        pair[first[between], second[between]] = False
        return pair

    def _fit(self, landmark: Array, triangle: Array, covariance: Array) -> Mask:
        """Which triangles (C, 3, 2), with covariances (C, 6, 6), meet the last two conditions."""
        edge = np.linalg.norm(triangle - np.roll(triangle, 1, axis=1), axis=2)
        small = edge.max(axis=1, initial=0.0) <= self.conditions.longest_edge_m
        fit: Mask = small & self.conditions.well_conditioned(triangle, covariance)
        placed = self.placed(landmark)
        kept = np.flatnonzero(fit)
        taken = placed.locate(triangle[kept].mean(axis=1)).region >= 0  # settles most, cheaply
        fit[kept[taken]] = False
        kept = kept[~taken]
        fit[kept[placed.meeting(triangle[kept])[0]]] = False
        return fit

    def _append(self, base: Index, landmark: Array, by_correlation: Mask) -> Index:
        self.by_correlation = np.concatenate((self.by_correlation, by_correlation))
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


def _all_pairs(alike: Mask, landmark_index: Index, triple: Index) -> Mask:
    """(C,) whether all pairs of triples (C, 3) of indices (m,) are among `alike` (m, m)."""
    order = np.argsort(landmark_index)
    row = order[np.searchsorted(landmark_index[order], triple)]
    every: Mask = np.all(alike[row, np.roll(row, 1, axis=1)], axis=1)
    return every


def _in_the_map(landmark: Array, landmark_index: Index, covariance: Array) -> tuple[Index, Array]:
    """The landmarks (m,) that are still in the map, and the covariance that goes with them.

    covariance: (k + 2 m, k + 2 m), any k states before the landmarks.
    """
    there = np.isfinite(landmark[landmark_index]).all(axis=1)
    if there.all():
        return landmark_index, covariance
    before = np.ones(len(covariance) - 2 * len(landmark_index), dtype=bool)
    kept = np.concatenate((before, np.repeat(there, 2)))
    return landmark_index[there], covariance[kept][:, kept]


def _apart(triangle: Array) -> Index:
    """Triangles (C, 3, 2), the first first, that do not overlap those chosen before; (k,)."""
    rest, chosen = np.arange(len(triangle)), []
    while len(rest):
        chosen.append(rest[0])
        rest = rest[1:]
        rest = rest[~overlap(triangle[chosen[-1]], triangle[rest])]
    return np.array(chosen, dtype=np.intp)
