"""Occupancy grids, one in every region (Nieto 2005, section 4.1)."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.dense.layers.grid_update import GridUpdate, known, unknown
from ekf_reference.dense.layers.layer import Hits, LayerSamples
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan, Single
from ekf_reference.dense.sensor_model import InverseSensorModel, log_odds, probability

_WITHIN = 1e-9
"""Sum of local coordinates, short of one, that still lies in the last cell."""
_BLOCK = 16
"""Cells along a side of a block; what a scan does not reach is left out by blocks."""

_NONE = np.empty(0, dtype=np.intp)


@dataclass(kw_only=True)
class RegionGrid:
    """One region's cells, with edges along its axes; those outside the triangle are left out.

    cells: (2,) counted along a and along b. weight: (3, n) of L1, a and b in every cell's centre.
    place: (cells) number of a cell among the n, -1 where left out. odds: (n,) log-odds. block: the
    cells of each of b blocks. middle: (b, 2) of a and b in the middles of these.
    """

    cells: tuple[int, int]
    weight: Single
    place: Index
    odds: Single
    block: list[Index]
    middle: Single

    @classmethod
    def over(cls, triangle: Array, resolution_m: float) -> Self:
        """An unknown grid over a triangle (3, 2), cells no longer than the resolution."""
        edge = np.linalg.norm(triangle[1:] - triangle[0], axis=1)
        along_a, along_b = np.maximum(np.ceil(edge / resolution_m), 1.0).astype(int).tolist()
        i, j = np.meshgrid(np.arange(along_a), np.arange(along_b), indexing="ij")
        inside = i / along_a + j / along_b < 1.0 - 0.5 * _WITHIN
        place = np.full((along_a, along_b), -1, dtype=np.intp)
        place[inside] = np.arange(np.count_nonzero(inside))
        alpha, beta = (i[inside] + 0.5) / along_a, (j[inside] + 0.5) / along_b
        weight = np.stack((np.ones_like(alpha), alpha, beta))
        block, middle = _blocks(i[inside], j[inside], (along_a, along_b))
        return cls(
            cells=(along_a, along_b),
            weight=weight.astype(np.float32),
            place=place,
            odds=unknown(len(alpha)),
            block=block,
            middle=middle,
        )

    def cell(self, local: Array) -> Index:
        """(N,) cells that hold local coordinates (N, 2); beyond the edge from L2 to L3, nearby."""
        within = (1.0 - _WITHIN) / np.maximum(local.sum(axis=1), 1.0 - _WITHIN)
        steps = (np.maximum(local, 0.0) * within[:, None] * self.cells).astype(np.intp)
        found: Index = self.place[steps[:, 0], steps[:, 1]]
        return found


def _blocks(i: Index, j: Index, cells: tuple[int, int]) -> tuple[list[Index], Single]:
    """`block` and `middle` of a RegionGrid with cells i, j (n,) along a and b."""
    number = i // _BLOCK * -(-cells[1] // _BLOCK) + j // _BLOCK
    order = np.argsort(number, kind="stable")
    _, first = np.unique(number[order], return_index=True)
    one = order[first]
    middle = (np.column_stack((i[one], j[one])) // _BLOCK + 0.5) * _BLOCK / np.array(cells)
    return np.split(order, first[1:]), middle.astype(np.float32)


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
        if not grids:
            return
        frame = np.stack([column[near] for column in placed.frames], axis=1)
        frame[:, 0] -= scan.origin
        own = np.swapaxes(frame @ scan.axes, 1, 2).astype(np.float32)  # (r, 2, 3): ahead, left
        parts, end = [], 0
        for grid, axes, cells in zip(grids, own, self._reached(scan, grids, own), strict=True):
            first, end = end, end + (len(grid.odds) if cells is None else len(cells))
            parts.append((grid, axes, cells, slice(first, end)))
        where, odds = np.empty((2, end), dtype=np.float32), np.empty(end, dtype=np.float32)
        for grid, axes, cells, rows in parts:
            weight = grid.weight if cells is None else grid.weight.take(cells, axis=1)
            np.matmul(axes, weight, out=where[:, rows])
            odds[rows] = grid.odds if cells is None else grid.odds.take(cells)
        self.update.add(odds, self.update.change(scan, where[0], where[1]))
        for grid, _, cells, rows in parts:
            grid.odds[slice(None) if cells is None else cells] = odds[rows]

    def _reached(self, scan: Scan, grids: list[RegionGrid], own: Single) -> list[Index | None]:
        """The cells of each grid that a scan may change, None for all.

        own: (r, 2, 3) L1, a and b of the grids' regions, ahead and left of the scanner.
        """
        count = np.array([len(grid.block) for grid in grids])
        cells = np.array([grid.cells for grid in grids])
        half = own[:, :, 1:] * (0.5 * _BLOCK / cells[:, None])
        corner = np.stack((half[..., 0] + half[..., 1], half[..., 0] - half[..., 1]))
        radius = np.sqrt(np.square(corner).sum(axis=2).max(axis=0)).astype(np.float32)
        of_block = np.repeat(own, count, axis=0)
        weight = np.concatenate([grid.middle for grid in grids])
        ahead, left = (of_block[..., 0] + (of_block[..., 1:] * weight[:, None]).sum(axis=2)).T
        reached = self.update.reached(scan, ahead, left, np.repeat(radius, count))
        first = np.cumsum(count) - count
        chosen: list[Index | None] = []
        for grid, begin, total, met in zip(
            grids,
            first.tolist(),
            count.tolist(),
            np.add.reduceat(reached, first, dtype=int).tolist(),
            strict=True,
        ):
            if met == total:
                chosen.append(None)
                continue
            few = np.flatnonzero(reached[begin : begin + total]).tolist()
            chosen.append(np.concatenate([_NONE, *(grid.block[k] for k in few)]))
        return chosen

    def samples(self, placed: RegionsAtMap, regions: Index | None = None) -> LayerSamples:
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
        return LayerSamples(
            np.concatenate(point), np.concatenate(occupancy), np.concatenate(region)
        )

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
