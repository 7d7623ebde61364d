"""High level landmarks beside the filter: found in a dense map of its own, seen in the scans."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from comparisons.logs.log import Log
from comparisons.runs.dense_run import DenseOptions, DenseWatcher
from comparisons.runs.estimate import Array
from comparisons.runs.oriented_sightings import OrientedLedger
from comparisons.runs.planar_scans import PlanarScans
from ekf_reference.dense.dense_map import DenseMap
from ekf_reference.dense.high_level import Around, Search, SearchOptions, search
from ekf_reference.dense.high_level_life import (
    Glimpse,
    HighLevelLandmarks,
    LifeOptions,
)
from ekf_reference.dense.layers.gaussians import Gaussians
from ekf_reference.dense.layers.occupancy import OccupancyGrid
from ekf_reference.full_ekf import NEW, FullEkf
from ekf_reference.scan_landmarks.scan_shape import of_scan
from ekf_reference.scan_landmarks.templates import View

_APART_S = 0.05
"""A scan farther from an epoch than that is not seen from its pose."""


@dataclass(frozen=True)
class HighLevelOptions:
    """every_s: between two searches, a minute in Nieto 2005, section 6.1.3."""

    every_s: float = 60.0
    search: SearchOptions = field(default_factory=SearchOptions)
    life: LifeOptions = field(default_factory=LifeOptions)
    dense: DenseOptions = field(default_factory=lambda: DenseOptions(("occupancy", "sog")))


class HighLevelSource(DenseWatcher):
    """Watches the filter, as it keeps a dense map, and sees the landmarks found in it."""

    def __init__(self, log: Log, options: HighLevelOptions | None = None) -> None:
        """Raises InputError for a log without scans."""
        self.choices = options or HighLevelOptions()
        super().__init__(log, self.choices.dense)
        self.landmarks = HighLevelLandmarks(self.choices.life)
        self.searches: list[Search] = []
        self._planar = PlanarScans(log)
        self._view = _view(log)
        self._last_s = log.prior.time_s

    def look(self, ekf: FullEkf, epoch: int, time_s: float, ledger: OrientedLedger) -> None:
        """Match the scan of the epoch, if there is one; search first when it is time to."""
        if time_s - self._last_s >= self.choices.every_s:
            self._last_s = time_s
            self._search(ekf)
        times = self._planar.time_s
        number = int(np.abs(times - time_s).argmin())
        if abs(float(times[number]) - time_s) > _APART_S or not self.landmarks.landmark:
            return
        scan = self._planar.scan(number, np.zeros(3))
        shape = of_scan(scan.bearing_rad, scan.range_m, scan.sensor)
        seen = self.landmarks.look(ekf, Glimpse(shape, scan.pose, self._view))
        if not seen:
            return
        slot = np.array([self.landmarks.landmark[one.number].slot for one in seen], dtype=np.intp)
        z, r = np.array([one.z for one in seen]), np.array([one.covariance for one in seen])
        self.landmarks.begun(seen, ledger.observe(ekf, epoch, z, r, slot))

    def _search(self, ekf: FullEkf) -> None:
        dense: DenseMap = self._dense
        placed = dense.regions.placed(dense.landmark)
        occupancy, gaussians = dense.layers["occupancy"], dense.layers["sog"]
        assert isinstance(occupancy, OccupancyGrid)
        assert isinstance(gaussians, Gaussians)
        around = Around(occupancy, gaussians, placed, ekf.read_pose().pose, dense.landmark)
        found = search(around, self.landmarks.rectangles(ekf), self.choices.search)
        self.searches.append(found)
        for one in found.found:
            self.landmarks.take(one, dense.regions.base[one.region], dense.landmark)


def _view(log: Log) -> View:
    if log.scans is None:
        return View(50.0, -math.pi, math.pi)
    distance = log.scans.range_m[np.isfinite(log.scans.range_m)]
    angle = log.scans.angle_rad + log.scans.mount.pose[2] * 0.0
    return View(float(distance.max(initial=0.0)), float(angle.min()), float(angle.max()))
