"""Dynamic regions: where occupancy changes with time (Nieto 2005, section 6.3).

Occupancy maps of one region at two times are differenced, low-pass filtered, thresholded, and
united with what was found before. Fast motion shows between maps a second apart, slow motion
between two visits. Only local errors part two maps of one region, whatever the vehicle's drift
(section 6.3.1), as long as its landmarks stand still: regions that deform are not compared.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.dense.layers.layer import Hits
from ekf_reference.dense.layers.occupancy import OccupancyGrid, RegionGrid
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan, Single
from ekf_reference.dense.sensor_model import InverseSensorModel, probability
from ekf_reference.dense.triangles import determinant, to_global

_UNKNOWN = 0.5
_NO_PAIRS = np.zeros((0, 2), dtype=np.intp)
_CLOCK_S = 1e-6
_MODEL = InverseSensorModel(p_occupied=0.9, p_free=0.3)
_CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True)
class Differencing:
    """Which maps are differenced, and what counts as a change.

    fast_s: between two maps for fast motion (1 s in the thesis). look_s: how often maps are
    differenced; every second in the thesis. absence_s: a region not seen for so long is visited
    anew; slow motion is what differs from the end of the last visit. The thesis takes maps 150 s
    apart instead, which is longer than its loop.

    lowpass, slow_lowpass: standard deviation of the Gaussian low-pass, in units of the standard
    deviation of where the grid puts a return (GridUpdate.sigma_m), or of a cell if that is more.
    A changed band of width w keeps erf(w / (2 sqrt(2) lowpass)) of its height. Surfaces are bands
    of 2.4 units: of one that came or went two thirds (fast) or half (slow) are left, of one that
    noise has moved by a quarter of its width less than 0.2.
    threshold, slow_threshold: least change of occupancy, between the two. The thesis has 0.5, for
    a filter that it does not give. least: smallest connected change, in squares of the same unit.

    deformed_m: greatest change of a region's edge between two maps that are compared.
    known_m: greatest standard deviation of the vehicle relative to a region's landmarks at which
    a scan counts; it is larger before a loop is closed.
    """

    fast_s: float = 1.0
    look_s: float = 0.25
    absence_s: float = 10.0
    lowpass: float = 1.2
    slow_lowpass: float = 1.7
    threshold: float = 0.3
    slow_threshold: float = 0.35
    least: float = 5.0
    deformed_m: float = 0.3
    known_m: float = 0.3


class _Map(NamedTuple):
    """A region's occupancy at one time. edge_m: (3,) of the region then."""

    time_s: float
    occupancy: Single
    edge_m: Array


@dataclass(kw_only=True)
class _History:
    """What is remembered of a region.

    recent: maps of the last `fast_s` and one that is older, in order. looked_s: when maps were last
    differenced. visit: the end of the last visit.
    """

    dynamic: Mask
    brief: LowPass
    lasting: LowPass
    least_m2: float
    recent: deque[_Map]
    looked_s: float
    seen_s: float
    visit: _Map | None = None


@dataclass
class Counters:
    """compared: pairs of maps. deformed: pairs that were not, since the region had changed shape.

    fast, slow: cells flagged for the first time, by what showed them.
    """

    compared: int = 0
    deformed: int = 0
    fast: int = 0
    slow: int = 0


@dataclass
class DynamicLayer:
    """Mask of dynamic cells per region, on occupancy grids of their own.

    With p_occupied 0.9, p_free 0.3 and a confidence of 0.95 two returns make free ground occupied,
    and four scans past it make it free again.
    """

    resolution_m: float = 0.2
    rule: Differencing = field(default_factory=Differencing)
    counters: Counters = field(default_factory=Counters)
    grid: OccupancyGrid = field(init=False)
    _history: dict[int, _History] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raises ValueError for a resolution that is not above zero."""
        self.grid = OccupancyGrid(self.resolution_m, _MODEL, _CONFIDENCE)

    def fuse(
        self, hits: Hits, placed: RegionsAtMap, scan: Scan, near: Index, time_s: float
    ) -> None:
        """Take in a scan at a time [s], not before the last; see dense.layers.layer.Layer.

        near: (r,) the regions that it may speak about, and relative to which the vehicle is known.
        """
        before = {n: self.grid.grids[n].odds.copy() for n in near.tolist() if n in self.grid.grids}
        self.grid.fuse(hits, placed, scan, near)
        sigma_m = max(self.grid.update.sigma_m(scan), self.resolution_m)
        for region in near.tolist():
            grid = self.grid.grids[region]
            old = before.get(region, np.zeros_like(grid.odds))
            if not np.array_equal(old, grid.odds):
                self._seen(region, old, placed.triangle[region], sigma_m, time_s)

    def mask(self, region: int) -> Mask:
        """(n,) which of a region's cells are dynamic; empty for a region that was never seen."""
        history = self._history.get(region)
        return np.zeros(0, dtype=bool) if history is None else history.dynamic

    @property
    def regions(self) -> Index:
        """(r,) numbers of the regions with dynamic cells, ascending."""
        found = [number for number, h in self._history.items() if h.dynamic.any()]
        return np.array(sorted(found), dtype=np.intp)

    def points(self, placed: RegionsAtMap, regions: Iterable[int] | None = None) -> Array:
        """(k, 2) [m] the dynamic cells in the world, of all regions or of some."""
        parts = [np.empty((0, 2))]
        for region in self.regions.tolist() if regions is None else regions:
            mask = self.mask(region)
            if mask.any():
                local = self.grid.grids[region].weight[1:, mask].T.astype(float)
                parts.append(to_global(placed.triangle[region], local))
        return np.concatenate(parts)

    def area_m2(self, placed: RegionsAtMap) -> float:
        """Of all dynamic cells."""
        whole = np.abs(determinant(placed.triangle))
        return sum(
            float(whole[n] * self.mask(n).sum() / np.prod(self.grid.grids[n].cells))
            for n in self.regions.tolist()
        )

    def covers(self, point: Array, placed: RegionsAtMap, margin_m: float = 0.0) -> Mask:
        """(N,) which points (N, 2) [m] lie in a dynamic cell, or so near to the middle of one.

        Points that are not finite lie nowhere.
        """
        covered = np.zeros(len(point), dtype=bool)
        if not len(self.regions):
            return covered
        found = placed.locate(point)
        for region in np.unique(found.region[found.region >= 0]).tolist():
            mask = self.mask(region)
            if mask.any():
                rows = np.flatnonzero(found.region == region)
                covered[rows] = mask[self.grid.grids[region].cell(found.local[rows])]
        rest = np.flatnonzero(~covered & np.isfinite(point).all(axis=1))
        if margin_m > 0.0 and len(rest):
            box = np.concatenate((point[rest] - margin_m, point[rest] + margin_m), axis=1)
            near = np.intersect1d(placed.tree.meeting(box).item, self.regions)
            cells = self.points(placed, near.tolist())
            if len(cells):
                covered[rest] = cKDTree(cells).query(point[rest])[0] <= margin_m
        return covered

    def occupancy(self, point: Array, placed: RegionsAtMap) -> Array:
        """(N,) 1 in dynamic cells, 0 in others, NaN where nothing was ever seen: to be drawn."""
        known = np.isfinite(self.grid.occupancy(point, placed))
        return np.where(known, self.covers(point, placed).astype(float), np.nan)

    def _seen(self, region: int, old: Single, triangle: Array, sigma_m: float, now: float) -> None:
        """A scan, with returns so exact, has changed a region's grid, which was `old` before."""
        grid = self.grid.grids[region]
        edge_m = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1)
        history = self._history.get(region)
        if history is None:
            widths = self.rule.lowpass * sigma_m, self.rule.slow_lowpass * sigma_m
            brief, lasting = (LowPass.over(grid, triangle, width_m) for width_m in widths)
            history = self._history[region] = _History(
                dynamic=np.zeros(len(old), dtype=bool),
                brief=brief,
                lasting=lasting,
                least_m2=self.rule.least * sigma_m**2,
                recent=deque((_Map(now, _occupancy(old), edge_m),)),
                looked_s=now,
                seen_s=now,
            )
        elif now - history.seen_s > self.rule.absence_s:
            history.visit = _Map(history.seen_s, _occupancy(old), edge_m)
            history.recent = deque((_Map(now, _occupancy(old), edge_m),))
        history.seen_s = now
        if now - history.looked_s < self.rule.look_s - _CLOCK_S:
            return
        history.looked_s = now
        current, recent = _Map(now, _occupancy(grid.odds), edge_m), history.recent
        recent.append(current)
        while recent[1].time_s <= now - self.rule.fast_s + _CLOCK_S:
            recent.popleft()
        if history.visit is not None:
            self.counters.slow += self._unite(history, grid, current, history.visit, slow=True)
        if recent[0].time_s <= now - self.rule.fast_s + _CLOCK_S:
            self.counters.fast += self._unite(history, grid, current, recent[0], slow=False)

    def _unite(self, history: _History, grid: RegionGrid, new: _Map, old: _Map, slow: bool) -> int:
        """OR what two maps differ by to what is dynamic; returns the number of new cells."""
        rule = self.rule
        if np.abs(new.edge_m - old.edge_m).max() > rule.deformed_m:
            self.counters.deformed += 1
            return 0
        self.counters.compared += 1
        known = (new.occupancy != _UNKNOWN) & (old.occupancy != _UNKNOWN)
        inside = grid.place >= 0
        difference = np.zeros(grid.place.shape)
        difference[inside] = np.where(known, new.occupancy - old.occupancy, 0.0)
        threshold = rule.slow_threshold if slow else rule.threshold
        if np.abs(difference).max() <= threshold:
            return 0
        lowpass = history.lasting if slow else history.brief
        changed = inside & (np.abs(lowpass(difference)) > threshold)
        fresh = _large(changed, history.least_m2 / lowpass.cell_m2)[inside] & ~history.dynamic
        history.dynamic |= fresh
        return int(np.count_nonzero(fresh))


def _occupancy(odds: Single) -> Single:
    return probability(odds.astype(float)).astype(np.float32)


def _large(changed: Mask, least: float) -> Mask:
    """Those of the cells whose connected piece, corners included, has at least so many."""
    piece, count = label(changed, np.ones((3, 3)))
    size = np.bincount(piece.ravel(), minlength=count + 1)
    size[0] = 0
    kept: Mask = (size >= least)[piece] & changed
    return kept


def places(point: Array, apart_m: float = 0.5) -> Index:
    """(N,) number of the connected place that each of points (N, 2) belongs to, from 0.

    Points at most so far apart are in one place.
    """
    pair = cKDTree(point).query_pairs(apart_m, output_type="ndarray") if len(point) else _NO_PAIRS
    links = coo_array((np.ones(len(pair)), (pair[:, 0], pair[:, 1])), (len(point),) * 2)
    number: Index = connected_components(links, directed=False)[1].astype(np.intp)
    return number


_SIGMAS = 3.0
_LEAST_INSIDE = 0.5


@dataclass(frozen=True)
class LowPass:
    """A Gaussian over a region's skewed cells.

    spectrum: of the kernel, over `size` cells so that nothing comes round from the other side.
    inside: the kernel's weight within the region at every cell, by which results are divided, so
    that along an edge the average is over the inside alone; at least half of the whole: in a
    corner few cells are left, and their noise would pass. cell_m2: area of a cell.
    """

    spectrum: NDArray[np.complex128]
    size: tuple[int, int]
    inside: Array
    cell_m2: float

    @classmethod
    def over(cls, grid: RegionGrid, triangle: Array, sigma_m: float) -> LowPass:
        """For a region's grid and triangle (3, 2) [m]."""
        axes = (triangle[1:] - triangle[0]) / np.array(grid.cells)[:, None]
        # |w_1 a_1 + w_2 a_2| <= r needs |w_i| <= r times the length of the dual axis
        reach = np.linalg.norm(np.linalg.inv(axes), axis=0) * _SIGMAS * sigma_m
        half = np.minimum(np.ceil(reach).astype(int), grid.cells)
        size = (grid.cells[0] + int(half[0]), grid.cells[1] + int(half[1]))
        steps = [np.arange(-h, h + 1) for h in half.tolist()]
        i, j = np.meshgrid(*steps, indexing="ij")
        offset = i[..., None] * axes[0] + j[..., None] * axes[1]
        weight = np.exp(-0.5 * np.square(offset).sum(axis=-1) / sigma_m**2)
        kernel = np.zeros(size)
        np.add.at(kernel, (i % size[0], j % size[1]), weight / weight.sum())
        spectrum, area_m2 = np.fft.rfft2(kernel), abs(float(np.linalg.det(axes)))
        whole = cls(spectrum, size, np.ones(grid.place.shape), area_m2)
        inside = whole((grid.place >= 0).astype(float))
        return replace(whole, inside=np.maximum(inside, _LEAST_INSIDE))

    def __call__(self, value: Array) -> Array:
        """The average around every cell, of values over the region's cells (along a, along b)."""
        rows, columns = value.shape
        smooth = np.fft.irfft2(np.fft.rfft2(value, self.size) * self.spectrum, self.size)
        return smooth[:rows, :columns] / self.inside
