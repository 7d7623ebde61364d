"""High level landmarks, found in the dense map and not in a single scan (Nieto 2005, 6.1).

A corner of the occupancy layer is paired with the nearest one; a rectangle is drawn around the two
(Fig. 6.4); the Gaussians of the sum-of-Gaussians layer inside it, if there are enough, are the
template of a pose landmark (6.1.2). Only regions around the vehicle are searched (6.1.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from ekf_reference.core.geometry import Array, Index, Mask, to_frame
from ekf_reference.dense.layers.gaussians import Ellipses, Gaussians
from ekf_reference.dense.layers.layer import Layer
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.triangles import turned
from ekf_reference.models.relative_pose import RelativePose
from ekf_reference.scan_landmarks.templates import Template
from ekf_reference.scan_matching.sog import SumOfGaussians


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """Settings of the search; lengths and the least number are those of Nieto 2005, 6.1.3.

    reach_m: how far from the vehicle, along the axes. cell_m: of the grid that is searched.
    pair_m: greatest distance of two corners. margin_m: from the corners to the rectangle's sides.
    least: Gaussians in it. thin_m: cells in which these are merged, 0 for none, since a match's
    cost grows with their number. occupied: least occupancy of the cell that a Gaussian lies in.
    clear_m: corners and Gaussians so near to a point landmark are left out.
    """

    reach_m: float = 30.0
    cell_m: float = 0.25
    pair_m: float = 12.0
    margin_m: float = 5.0
    least: int = 200
    occupied: float = 0.5
    clear_m: float = 1.0
    thin_m: float = 0.3


class PlacedTemplate(NamedTuple):
    """A landmark's template and where it is now.

    place: (3,) of its axis in the world: centroid of the template and the vehicle's heading.
    rectangle: (4, 2) corners of it, corner: (2, 2) that it was drawn around, both in the axis.
    region: that holds most of the template. gaussians: of the layer that the template is made of.
    """

    template: Template
    place: Array
    rectangle: Array
    corner: Array
    region: int
    gaussians: int


@dataclass(frozen=True)
class Search:
    """What one search came to.

    corner: (C, 2) all, in the world. candidate: (n, 4, 2) rectangles, known ones left out.
    gaussians: (n,) that stand in them. found: accepted. known: those of landmarks that there are
    already.
    """

    corner: Array
    candidate: Array
    gaussians: Index
    found: tuple[PlacedTemplate, ...]
    known: int

    @property
    def poor(self) -> int:
        """Candidates with too few Gaussians."""
        return len(self.candidate) - len(self.found)


@dataclass(frozen=True)
class Around:
    """What a search reads: two layers, the regions where they are, the filter's pose and points.

    pose: (3,). landmark: (L, 2) [m], NaN where one has left the map.
    """

    occupancy: Layer
    gaussians: Gaussians
    placed: RegionsAtMap
    pose: Array
    landmark: Array


def search(around: Around, known: Array, options: SearchOptions | None = None) -> Search:
    """Candidates around the vehicle whose rectangles overlap none of the known (K, 4, 2).

    Known ones that are NaN have left the map.
    """
    o = options or SearchOptions()
    corner = _corners(around, o)
    taken = list(known[np.isfinite(known).all(axis=(1, 2))])
    shown, count, found, old = [], list[int](), list[PlacedTemplate](), 0
    for pair in corner[pairs(corner, o.pair_m)]:
        area = rectangle(pair, o.margin_m)
        if any(overlapping(area, other) for other in taken):
            old += 1
            continue
        standing = _standing(around, area, o)
        shown.append(area)
        count.append(len(standing.mean))
        if count[-1] >= o.least:
            found.append(_landmark(around, pair, area, standing, o))
            taken.append(area)
    candidate = np.reshape(shown, (-1, 4, 2))
    return Search(corner, candidate, np.array(count, dtype=np.intp), tuple(found), old)


def pairs(corner: Array, most_m: float) -> Index:
    """(n, 2) corners (C, 2), each with the nearest that is left, the closest two first."""
    apart = np.linalg.norm(corner[:, None] - corner, axis=2)
    first, second = np.nonzero(np.triu(apart <= most_m, 1))
    free, chosen = np.ones(len(corner), dtype=bool), []
    for k in np.argsort(apart[first, second], kind="stable"):
        if free[first[k]] and free[second[k]]:
            free[[first[k], second[k]]] = False
            chosen.append((first[k], second[k]))
    return np.array(chosen, dtype=np.intp).reshape(-1, 2)


def rectangle(pair: Array, margin_m: float) -> Array:
    """(4, 2) counter-clockwise, along two corners (2, 2), its sides so far from them."""
    ahead = pair[1] - pair[0]
    ahead = margin_m * ahead / np.linalg.norm(ahead)
    left = turned(ahead)
    return np.array(
        (
            pair[0] - ahead - left,
            pair[1] + ahead - left,
            pair[1] + ahead + left,
            pair[0] - ahead + left,
        )
    )


def within(area: Array, point: Array) -> Mask:
    """(N,) which points (N, 2) lie in a convex area (K, 2), counter-clockwise."""
    side = np.roll(area, -1, axis=0) - area
    inwards = np.einsum("kj,nkj->nk", turned(side), point[:, None] - area)
    inside: Mask = (inwards >= 0.0).all(axis=1)
    return inside


def overlapping(first: Array, second: Array) -> bool:
    """Whether two convex areas (K, 2) have ground in common: no side separates them."""
    for one, other in ((first, second), (second, first)):
        side = np.roll(one, -1, axis=0) - one
        inwards = np.einsum("kj,nkj->nk", turned(side), other[:, None] - one)
        if (inwards <= 0.0).all(axis=0).any():
            return False
    return True


def _corners(around: Around, o: SearchOptions) -> Array:
    """(C, 2) in the world."""
    steps = np.arange(2 * int(o.reach_m / o.cell_m) + 1)
    origin = around.pose[:2] - o.cell_m * steps[-1] / 2.0
    place = origin + o.cell_m * np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    share = around.occupancy.occupancy(place.reshape(-1, 2), around.placed)
    stands = np.clip(2.0 * np.nan_to_num(share, nan=0.5) - 1.0, 0.0, 1.0)
    found = origin + harris(stands.reshape(len(steps), -1), o.cell_m)
    clear: Array = found[_clear(found, around.landmark, o.clear_m)]
    return clear


def _standing(around: Around, area: Array, o: SearchOptions) -> Ellipses:
    """The Gaussians in a rectangle (4, 2) that are something that stands, and no point landmark."""
    box = np.concatenate((area.min(axis=0), area.max(axis=0)))
    near = np.sort(around.placed.tree.meeting(box[None]).item)
    there = around.gaussians.ellipses(around.placed, near)
    kept = np.flatnonzero(within(area, there.mean))
    kept = kept[_clear(there.mean[kept], around.landmark, o.clear_m)]
    share = around.occupancy.occupancy(there.mean[kept], around.placed)
    kept = kept[share >= o.occupied]
    return Ellipses(there.mean[kept], there.covariance[kept], there.region[kept])


def _landmark(
    around: Around, pair: Array, area: Array, standing: Ellipses, o: SearchOptions
) -> PlacedTemplate:
    """The landmark of a rectangle (4, 2) and what stands in it."""
    shape = SumOfGaussians.of_equal_height(standing.mean, standing.covariance)
    if o.thin_m > 0.0:
        shape = shape.thinned(o.thin_m)
    back = RelativePose().predict(around.pose, np.zeros((1, 3))).z[0]
    template = Template.of_segment(shape.transformed(back), np.arange(len(shape)))
    place = RelativePose().invert(around.pose, template.pose[None]).landmark[0]
    region, count = int(np.bincount(standing.region).argmax()), len(standing.mean)
    return PlacedTemplate(
        template, place, to_frame(place, area), to_frame(place, pair), region, count
    )


def _clear(point: Array, landmark: Array, least_m: float) -> Mask:
    """(N,) which points (N, 2) are no nearer than that to any landmark (L, 2)."""
    apart = np.linalg.norm(point[:, None] - landmark[np.isfinite(landmark[:, 0])], axis=2)
    clear: Mask = apart.min(axis=1, initial=np.inf) >= least_m
    return clear


_GRADIENT_M = 0.3
"""Sigma at which derivatives are taken; in metres, so that it holds for every resolution."""
_WINDOW_M = 0.8
"""Sigma of the window over which their products are averaged."""
_APART_M = 2.0
"""Of two corners nearer than that, the stronger counts."""
_BLOCK = 12
"""Size in window sigmas of the block whose corner sets the scale."""


def harris(occupied: Array, cell_m: float, trace: float = 0.06, least: float = 0.01) -> Array:
    """Corners (C, 2) [m] of an occupancy grid, the strongest first.

    Each lies at the peak of the parabolas through the response at a cell and its neighbours.

    Args:
        occupied: (I, J) cells from 0, free or unknown, to 1. What touches the border goes on
            beyond it. Rows go along the first axis of the points, the first cell's centre is 0.
        cell_m: size of a cell.
        trace: k.
        least: response of the weakest corner over that of a solid block's right angle; walls as
            thin as scans draw them have 0.1 and more there, and 0.02 to 0.05 where they end.
    """
    height = _response(occupied, cell_m, trace) / _of_a_block(cell_m, trace)
    peak = (height == maximum_filter(height, 3, mode="nearest")) & (height >= least)
    peak[[0, -1]] = peak[:, [0, -1]] = False
    row = np.argwhere(peak)
    row = row[np.argsort(-height[peak], kind="stable")]
    point = cell_m * (row + _offset(height, row))
    return point[_apart(point, _APART_M)]


def _response(value: Array, cell_m: float, trace: float) -> Array:
    fine, window = _GRADIENT_M / cell_m, _WINDOW_M / cell_m
    first = gaussian_filter(value, fine, order=(1, 0), mode="nearest")
    second = gaussian_filter(value, fine, order=(0, 1), mode="nearest")
    xx, xy, yy = (
        gaussian_filter(product, window, mode="nearest")
        for product in (first * first, first * second, second * second)
    )
    response: Array = xx * yy - xy * xy - trace * np.square(xx + yy)
    return response


@lru_cache
def _of_a_block(cell_m: float, trace: float) -> float:
    """Response at the right angle of a solid block."""
    half = max(int(_BLOCK * max(_WINDOW_M, _GRADIENT_M) / cell_m), 4)
    block = np.zeros((2 * half, 2 * half))
    block[half:, half:] = 1.0
    return float(_response(block, cell_m, trace).max())


def _apart(point: Array, least_m: float) -> Index:
    """Of points (C, 2), the first first, those not near to one chosen before; (k,)."""
    chosen: list[int] = []
    for i, place in enumerate(point):
        if not chosen or np.square(point[chosen] - place).sum(axis=1).min() >= least_m**2:
            chosen.append(i)
    return np.array(chosen, dtype=np.intp)


def _offset(height: Array, row: Index) -> Array:
    """(C, 2) how far in cells the peaks lie from the middles of their cells."""
    here = height[tuple(row.T)]
    offset = np.zeros((len(row), 2))
    for axis in range(2):
        step = np.eye(2, dtype=np.intp)[axis]
        before, after = height[tuple((row - step).T)], height[tuple((row + step).T)]
        bend = before - 2.0 * here + after
        curved = bend < 0.0
        slope = 0.5 * (before - after)
        offset[curved, axis] = np.clip(slope[curved] / bend[curved], -0.5, 0.5)
    return offset
