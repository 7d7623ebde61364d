"""DenseSLAM: everything a scanner sees, kept between the landmarks (Nieto 2005, chapter 3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ekf_reference.dense.layers.layer import Hits, Layer
from ekf_reference.dense.regions import LocalRegions, PlacedRegions
from ekf_reference.dense.scan import Scan
from ekf_reference.dense.triangles import Array
from ekf_reference.dense.view import FilterView

Index = NDArray[np.intp]


@dataclass
class Tally:
    """What became of all returns. outside: where no region is or will be."""

    scans: int = 0
    returns: int = 0
    fused: int = 0
    outside: int = 0


@dataclass
class DenseMap:
    """Regions between a filter's landmarks, and layers in them, fed scan by scan.

    layers: by name; all are given the same scans. regions: made as landmarks arrive.
    reach_m: of the landmarks that may form regions, and of returns that are taken in.
    """

    layers: Mapping[str, Layer]
    regions: LocalRegions = field(default_factory=LocalRegions)
    reach_m: float = 50.0
    tally: Tally = field(default_factory=Tally)
    _landmark: Array = field(default_factory=lambda: np.empty((0, 2)))

    def updated(self, view: FilterView) -> None:
        """The filter has fused sightings: new regions may be possible."""
        self.place(view)
        slot = view.near(self.reach_m)
        self.regions.extend(self._landmark, slot, view.joint_of_landmarks(slot))

    def insert(self, view: FilterView, scan: Scan) -> None:
        """Take in a scan seen from the view's pose, at once and in every layer."""
        self.place(view)
        placed = self.regions.placed(self._landmark)
        found = placed.locate(scan.point)
        inside = np.flatnonzero(found.region >= 0)
        self.tally.scans += 1
        self.tally.returns += len(scan.range_m)
        self.tally.fused += len(inside)
        self.tally.outside += len(scan.range_m) - len(inside)
        hits = Hits(
            found.region[inside], found.local[inside], scan.point[inside], scan.covariance[inside]
        )
        near = np.sort(placed.tree.meeting(scan.box()[None]).item)
        for layer in self.layers.values():
            layer.fuse(hits, placed, scan, near)

    def place(self, view: FilterView) -> PlacedRegions:
        """The regions with the landmarks where a view has them: the whole map has moved along.

        A landmark that has left the filter's map stays where it was last.
        """
        gone = np.isnan(view.landmark)
        known = np.full_like(view.landmark, np.nan)
        known[: len(self._landmark)] = self._landmark
        self._landmark = np.where(gone, known, view.landmark)
        return self.regions.placed(self._landmark)
