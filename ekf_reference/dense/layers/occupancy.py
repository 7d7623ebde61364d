"""Occupancy grids, one in every region (Nieto 2005, section 4.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.dense.layers.grid_update import GridUpdate, known, unknown
from ekf_reference.dense.layers.layer import Hits, Samples
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan, Single
from ekf_reference.dense.sensor_model import InverseSensorModel, log_odds, probability

_WITHIN = 1e-9
"""Sum of local coordinates, short of one, that still lies in the last cell."""


@dataclass
class RegionGrid:
    """One region's cells, with edges along its axes; those outside the triangle are left out.

    cells: (2,) counted along a and along b. weight: (3, n) of L1, a and b in every cell's centre.
    place: (cells) number of a cell among the n, -1 where left out. odds: (n,) log-odds.
    """

    cells: tuple[int, int]
    weight: Single
    place: Index
    odds: Single

    @classmethod
    def over(cls, triangle: Array, resolution_m: float) -> RegionGrid:
        """An unknown grid over a triangle (3, 2), cells no longer than the resolution."""
        edge = np.linalg.norm(triangle[1:] - triangle[0], axis=1)
        along_a, along_b = np.maximum(np.ceil(edge / resolution_m), 1.0).astype(int).tolist()
        i, j = np.meshgrid(np.arange(along_a), np.arange(along_b), indexing="ij")
        inside = i / along_a + j / along_b < 1.0 - 0.5 * _WITHIN
        place = np.full((along_a, along_b), -1, dtype=np.intp)
        place[inside] = np.arange(np.count_nonzero(inside))
        alpha, beta = (i[inside] + 0.5) / along_a, (j[inside] + 0.5) / along_b
        weight = np.stack((np.ones_like(alpha), alpha, beta))
        return cls((along_a, along_b), weight.astype(np.float32), place, unknown(len(alpha)))

    def cell(self, local: Array) -> Index:
        """(N,) cells that hold local coordinates (N, 2); beyond the edge from L2 to L3, nearby."""
        within = (1.0 - _WITHIN) / np.maximum(local.sum(axis=1), 1.0 - _WITHIN)
        steps = (np.maximum(local, 0.0) * within[:, None] * self.cells).astype(np.intp)
        found: Index = self.place[steps[:, 0], steps[:, 1]]
        return found


@dataclass(frozen=True)
class Coarsening:
    """When a region's cells may grow: `share` of them below `least` occupancy (N, 4.1.3)."""

    resolution_m: float = 0.5
    share: float = 0.99
    least: float = 0.2
    every: int = 20


class OccupancyGrid:
    """A GridUpdate applied to cells along the axes of every region.

    resolution_m: of new regions. model and confidence: see GridUpdate. coarsening: None to keep
    all cells.
    """

    def __init__(
        self,
        resolution_m: float = 0.2,
        model: InverseSensorModel | None = None,
        confidence: float = 0.98,
        coarsening: Coarsening | None = None,
    ) -> None:
        """Raises ValueError for a resolution or a confidence that GridUpdate refuses."""
        self.update = GridUpdate(resolution_m, model or InverseSensorModel(), confidence)
        self.coarsening = coarsening
        self.grids: dict[int, RegionGrid] = {}
        self._scans = 0

    def fuse(self, hits: Hits, placed: RegionsAtMap, scan: Scan | None, near: Index) -> None:
        """Occupied where returns come from, free before them; late returns by the same rule."""
        if scan is None:
            for late in hits.late:
                self._fuse_scan(placed, *late)
            return
        self._fuse_scan(placed, scan, near)
        self._scans += 1
        if self.coarsening and self._scans % self.coarsening.every == 0:
            for region in near.tolist():
                self._coarsen(region, placed, self.coarsening)

    def _fuse_scan(self, placed: RegionsAtMap, scan: Scan, near: Index) -> None:
        grids = [self._grid(region, placed) for region in near.tolist()]
        ends = np.cumsum([0, *(len(grid.odds) for grid in grids)])
        if not ends[-1]:
            return
        frame = np.stack([column[near] for column in placed.frames], axis=1)
        frame[:, 0] -= scan.origin
        own = np.swapaxes(frame @ scan.axes, 1, 2).astype(np.float32)  # (r, 2, 3): ahead, left
        where = np.empty((2, ends[-1]), dtype=np.float32)
        for grid, axes, first, last in zip(grids, own, ends[:-1], ends[1:], strict=True):
            np.matmul(axes, grid.weight, out=where[:, first:last])
        change = self.update.change(scan, where[0], where[1])
        for grid, first, last in zip(grids, ends[:-1], ends[1:], strict=True):
            self.update.add(grid.odds, change[first:last])

    def samples(self, placed: RegionsAtMap, regions: Index | None = None) -> Samples:
        """The centres of all cells that were ever seen."""
        wanted = sorted(self.grids) if regions is None else regions.tolist()
        point, occupancy, region = [np.empty((0, 2))], [np.empty(0)], [np.empty(0, dtype=np.intp)]
        frames = np.stack(placed.frames, axis=2)
        for number in wanted:
            grid = self.grids.get(number)
            if grid is not None:
                seen = known(grid.odds)
                point.append((frames[number] @ grid.weight[:, seen]).T)
                occupancy.append(probability(grid.odds[seen].astype(float)))
                region.append(np.full(len(seen), number, dtype=np.intp))
        return Samples(np.concatenate(point), np.concatenate(occupancy), np.concatenate(region))

    def occupancy(self, point: Array, placed: RegionsAtMap) -> Array:
        """P(occupied) of the cells that points (N, 2) lie in."""
        found = placed.locate(point)
        result = np.full(len(point), np.nan)
        for region in np.unique(found.region[found.region >= 0]).tolist():
            grid = self.grids.get(region)
            if grid is not None:
                rows = np.flatnonzero(found.region == region)
                odds = grid.odds[grid.cell(found.local[rows])].astype(float)
                result[rows] = np.where(odds == 0.0, np.nan, probability(odds))
        return result

    def _grid(self, region: int, placed: RegionsAtMap) -> RegionGrid:
        grid = self.grids.get(region)
        if grid is None:
            grid = self.grids[region] = RegionGrid.over(
                placed.triangle[region], self.update.resolution_m
            )
        return grid

    def _coarsen(self, region: int, placed: RegionsAtMap, rule: Coarsening) -> None:
        """Larger cells, each as occupied as the most occupied of those whose centres it holds."""
        fine = self.grids[region]
        free: Mask = fine.odds < log_odds(rule.least)
        coarse = RegionGrid.over(placed.triangle[region], rule.resolution_m)
        if free.mean() <= rule.share or len(coarse.odds) >= len(fine.odds):
            return
        cell = coarse.cell(fine.weight[1:].T.astype(float))
        coarse.odds[:] = -np.inf
        np.maximum.at(coarse.odds, cell, fine.odds)
        coarse.odds[np.isneginf(coarse.odds)] = 0.0
        self.grids[region] = coarse
