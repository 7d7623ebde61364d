"""One occupancy grid in the global frame: the baseline that local regions improve on.

A pose's error stays in the cells. After the filter has corrected its poses an object is drawn a
second time (Nieto 2005, section 4.1.3, Figs. 4.3 a and 4.5).
"""

from __future__ import annotations

import math

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.layers.grid_update import GridUpdate, known, unknown
from ekf_reference.dense.layers.layer import LayerSamples
from ekf_reference.dense.scan import Scan
from ekf_reference.dense.sensor_model import InverseSensorModel, probability

_SIDE = 64
"""Cells along a side of a tile."""
_BLOCK = 8
"""Cells along a side of a block; what a scan does not reach is left out by blocks."""
_ALONG = _SIDE // _BLOCK


class ClassicGrid:
    """A GridUpdate applied to square cells; cell 0, 0 begins at the world's origin.

    The grid grows by tiles where scans reach, so its extent need not be known before.
    resolution_m, model, confidence: see GridUpdate.
    """

    def __init__(
        self,
        resolution_m: float = 0.2,
        model: InverseSensorModel | None = None,
        confidence: float = 0.98,
    ) -> None:
        """Raises ValueError for a resolution or a confidence that GridUpdate refuses."""
        self.update = GridUpdate(resolution_m, model or InverseSensorModel(), confidence)
        self.tiles: dict[tuple[int, int], int] = {}
        self._odds = unknown(0).reshape(0, _BLOCK * _BLOCK)  # by tile, there by block
        self._cell = _centers(_BLOCK, resolution_m)
        self._block = _centers(_ALONG, _BLOCK * resolution_m)

    def fuse(self, scan: Scan) -> None:
        """Occupied where returns come from, free before them, as if the pose were known."""
        if not len(scan.range_m):
            return
        edge = scan.box(3.0 * self.update.sigma_m(scan)) / (_SIDE * self.update.resolution_m)
        west, south, east, north = np.floor(edge).astype(int).tolist()
        tile = [(i, j) for i in range(west, east + 1) for j in range(south, north + 1)]
        middle = (self._corner(np.array(tile))[:, None] - scan.origin + self._block) @ scan.axes
        middle = middle.reshape(-1, 2)
        asked = middle.T.astype(np.float32)
        near = np.flatnonzero(self.update.reached(scan, asked[0], asked[1], self._radius_m))
        ahead, left = (
            (middle[near, axis, None] + cell).astype(np.float32).ravel()
            for axis, cell in enumerate((self._around @ scan.axes).T)
        )
        change = self.update.change(scan, ahead, left).reshape(len(near), len(self._cell))
        row = self._rows(tile, near)
        odds = self._odds[row]
        self.update.add(odds, change)
        self._odds[row] = odds

    def samples(self) -> LayerSamples:
        """The centres of all cells that were ever seen; they lie in no region, -1."""
        point, occupancy = [np.empty((0, 2))], [np.empty(0)]
        blocks = self._odds.reshape(-1, _ALONG, _ALONG, _BLOCK, _BLOCK)
        center = _centers(_SIDE, self.update.resolution_m)
        for tile in sorted(self.tiles):
            odds = blocks[self.tiles[tile]].swapaxes(1, 2).ravel()
            seen = known(odds)
            point.append(self._corner(np.array(tile)) + center[seen])
            occupancy.append(probability(odds[seen].astype(float)))
        places = np.concatenate(point)
        return LayerSamples(
            places, np.concatenate(occupancy), np.full(len(places), -1, dtype=np.intp)
        )

    @property
    def _around(self) -> Array:
        """(n, 2) [m] from the middle of a block to its cells."""
        return self._cell - 0.5 * _BLOCK * self.update.resolution_m

    @property
    def _radius_m(self) -> float:
        """From the middle of a block to the farthest of its cells' corners."""
        return _BLOCK * self.update.resolution_m / math.sqrt(2.0)

    def _rows(self, tile: list[tuple[int, int]], near: Index) -> Index:
        """Rows of the table for blocks (n,) of the tiles; these are made where there are none."""
        first = np.empty(len(tile), dtype=np.intp)
        for number in np.flatnonzero(np.bincount(near // _ALONG**2)).tolist():
            slot = self.tiles.setdefault(tile[number], len(self.tiles))
            first[number] = slot * _ALONG**2
        if (lacking := len(self.tiles) * _ALONG**2 - len(self._odds)) > 0:
            room = max(lacking, len(self._odds)) * _BLOCK * _BLOCK
            self._odds = np.concatenate((self._odds, unknown(room).reshape(-1, _BLOCK * _BLOCK)))
        return first[near // _ALONG**2] + near % _ALONG**2

    def _corner(self, tile: Index) -> Array:
        return tile.astype(float) * (_SIDE * self.update.resolution_m)


def _centers(count: int, step_m: float) -> Array:
    """(count x count, 2) [m] middles of squares, from the corner of all."""
    inside = (np.arange(count) + 0.5) * step_m
    return np.stack(np.meshgrid(inside, inside, indexing="ij"), axis=-1).reshape(-1, 2)
