"""One occupancy grid in the global frame: the baseline that local regions improve on.

A pose's error stays in the cells. After the filter has corrected its poses an object is drawn a
second time (Nieto 2005, section 4.1.3, Figs. 4.3 a and 4.5).
"""

from __future__ import annotations

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.dense.layers.grid_update import GridUpdate, known, unknown
from ekf_reference.dense.layers.layer import Samples
from ekf_reference.dense.scan import Scan, Single
from ekf_reference.dense.sensor_model import InverseSensorModel, probability

_SIDE = 64
"""Cells along a side of a tile."""


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
        self.tiles: dict[tuple[int, int], Single] = {}
        inside = (np.arange(_SIDE) + 0.5) * resolution_m
        self._center = np.stack(np.meshgrid(inside, inside, indexing="ij"), axis=-1).reshape(-1, 2)

    def fuse(self, scan: Scan) -> None:
        """Occupied where returns come from, free before them, as if the pose were known."""
        if not len(scan.range_m):
            return
        edge = scan.box(3.0 * self.update.sigma_m(scan)) / (_SIDE * self.update.resolution_m)
        west, south, east, north = np.floor(edge).astype(int).tolist()
        for tile in ((i, j) for i in range(west, east + 1) for j in range(south, north + 1)):
            ahead, left = ((self._corner(tile) - scan.origin + self._center) @ scan.axes).T
            change = self.update.change(scan, ahead.astype(np.float32), left.astype(np.float32))
            if change.any():
                odds = self.tiles.setdefault(tile, unknown(_SIDE * _SIDE))
                self.update.add(odds, change)

    def samples(self) -> Samples:
        """The centres of all cells that were ever seen; they lie in no region, -1."""
        point, occupancy = [np.empty((0, 2))], [np.empty(0)]
        for tile in sorted(self.tiles):
            odds = self.tiles[tile]
            seen = known(odds)
            point.append(self._corner(tile) + self._center[seen])
            occupancy.append(probability(odds[seen].astype(float)))
        places = np.concatenate(point)
        return Samples(places, np.concatenate(occupancy), np.full(len(places), -1, dtype=np.intp))

    def _corner(self, tile: tuple[int, int]) -> Array:
        return np.array(tile) * (_SIDE * self.update.resolution_m)
