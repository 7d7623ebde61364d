"""High level landmarks beside the filter: found in a dense map of its own, seen in the scans."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, cast

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.filter_loop import FilterObservers
from comparisons.adapters.planar_scans import PlanarScans, view_to
from comparisons.adapters.pose_landmark_measurements import PoseLandmarkRecorder
from comparisons.arrays import Array
from comparisons.extensions.dense_maps.config import BARE, DenseMapsConfig, Layer
from comparisons.extensions.dense_maps.source import DenseWatcher
from comparisons.extensions.high_level.config import HighLevelConfig
from comparisons.figures import Aside, Named
from comparisons.logs.log import Log
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import to_world
from ekf_reference.core.measurements import DynamicGuard
from ekf_reference.dense.layers.gaussians import Gaussians
from ekf_reference.scan_landmarks.high_level import Around, Search, SearchOptions, search
from ekf_reference.scan_landmarks.high_level_lifecycle import Glimpse, HighLevelLandmarks
from ekf_reference.scan_landmarks.templates import SensorView
from ekf_reference.scan_matching.scan_shape import of_scan

SEARCHED: tuple[Layer, ...] = ("occupancy", "sog")
"""Layers that are searched."""
_AXIS_M = 3.0
"""Length at which axes are drawn."""
_APART_S = 0.05
"""A scan farther than that from an epoch was not taken from its pose."""


@dataclass(frozen=True, kw_only=True)
class HighLevelOptions:
    """every_s: between two searches. resolution_m: of the occupancy layer, and d_min of the sum's.

    dense: settings of the map but for its layers and cells. only_in_view, variance_factor: of a
    measurement; see HighLevelLandmarks.
    """

    every_s: float = 20.0
    search: SearchOptions = field(default_factory=SearchOptions)
    resolution_m: float = 0.2
    dense: DenseMapsConfig = field(default_factory=DenseMapsConfig)
    only_in_view: bool = HighLevelLandmarks.only_in_view
    variance_factor: float = HighLevelLandmarks.variance_factor

    @classmethod
    def of(cls, config: HighLevelConfig, dense: DenseMapsConfig | None = None) -> HighLevelOptions:
        """Return what was chosen; d_min follows the cells, as in Nieto 2005, section 6.5."""
        cell_m = max(SearchOptions.cell_m, config.cell_m)
        return cls(
            every_s=config.every_s,
            search=SearchOptions(cell_m=cell_m, pair_m=config.pair_m, least=config.least),
            resolution_m=config.cell_m,
            dense=dense or DenseMapsConfig(),
            only_in_view=config.only_in_view,
            variance_factor=config.variance_factor,
        )

    @property
    def kept(self) -> DenseMapsConfig:
        """The dense map that is searched."""
        cells = dict.fromkeys(("resolution_m", "d_min_m"), self.resolution_m)
        return self.dense.settled().model_copy(update={**BARE, "layers": SEARCHED, **cells})

    def served_by(self, options: DenseMapsConfig) -> bool:
        """Whether a map with these options has the cells that are searched."""
        layers = {"layers": SEARCHED, "detect_motion": False}
        return options.settled().model_copy(update=layers) == self.kept


@dataclass(frozen=True, kw_only=True)
class HighLevelRun:
    """Entry `high_level`: what became of the search in a drive.

    Attributes:
        searches: searches of the dense map.
        corners: corners of all searches.
        pairs: pairs of corners of all searches.
        candidates: candidates for a landmark, which overlap nothing known.
        poor: candidates with too few Gaussians.
        found: candidates that a search accepted.
        kept: landmarks that were seen again, and since then are in the state.
        deactivated: landmarks that are no longer used, since their template is where something
            moves.
        looks: attempts to measure a landmark within reach, by outcome, `seen` among them.
        landmark_index: (K,) of all that were found, among the filter's pose landmarks; negative
            where one was never seen again.
        place: (K, 3) at the end, NaN where what it hung on has left the map.
        rectangle: (K, 4, 2) as place.
    """

    searches: Annotated[int, Named("searches of the dense map")]
    corners: Annotated[int, Named("corners found")]
    pairs: Annotated[int, Named("pairs of corners tried")]
    candidates: int
    poor: Annotated[int, Named("candidates with too few Gaussians")]
    found: Annotated[int, Named("landmarks found")]
    kept: Annotated[int, Named("landmarks measured again and kept")]
    deactivated: Annotated[int, Named("landmarks deactivated where something moves")]
    looks: dict[str, int]
    landmark_index: Aside[NDArray[np.intp]]
    place: Aside[Array]
    rectangle: Aside[Array]

    @property
    def axes(self) -> tuple[Array, Array]:
        """Lines (2 K, 2) and (2 K, 2) [m] that show where all axes are and how they are turned."""
        tip = [to_world(place, _AXIS_M * np.eye(2)) for place in self.place]
        return np.repeat(self.place[:, :2], 2, axis=0), np.reshape(tip, (-1, 2))


class HighLevelSource(FilterObservers):
    """Watches the filter, with a dense map, and sees the landmarks that are found in it.

    The map at an epoch holds the scans of earlier ones: a scan never meets itself.
    """

    def __init__(
        self,
        log: Log,
        options: HighLevelOptions | None = None,
        shared: DenseWatcher | None = None,
        searched: Callable[[float, Around, Search], None] = lambda time_s, around, search: None,
    ) -> None:
        """shared: observer that keeps such a map already, called before this one; or None.

        searched: shown every search. Raises InputError for a log without scans.
        """
        self._searched = searched
        self.options = options or HighLevelOptions()
        self.landmarks = HighLevelLandmarks(
            only_in_view=self.options.only_in_view, variance_factor=self.options.variance_factor
        )
        self._map = shared or DenseWatcher(log, self.options.kept)
        super().__init__([] if shared else [self._map])
        self._scans = PlanarScans(log)
        self._view = _view(log)
        self._searches: list[Search] = []
        self._next_s = log.prior.time_s + self.options.every_s
        self._place, self._rectangle = np.empty((0, 3)), np.empty((0, 4, 2))

    def on_end(self, ekf: Ekf, time_s: float) -> None:
        """Note where all are in the end."""
        super().on_end(ekf, time_s)
        self._place, self._rectangle = self.landmarks.places(ekf), self.landmarks.rectangles(ekf)

    def look(self, ekf: Ekf, epoch: int, time_s: float, recorder: PoseLandmarkRecorder) -> None:
        """Match the scan of the epoch, if there is one; search before that when it is time to."""
        if time_s >= self._next_s:
            self._next_s = time_s + self.options.every_s
            self._search(ekf, time_s)
        if not self.landmarks.landmark:
            return
        number = int(np.abs(self._scans.time_s - time_s).argmin())
        if abs(float(self._scans.time_s[number]) - time_s) > _APART_S:
            return
        scan = self._scans.scan(number, np.zeros(3))
        shape = of_scan(scan.bearing_rad, scan.range_m, scan.sensor)
        measurements = self.landmarks.look(ekf, Glimpse(shape, scan.pose, self._view))
        if measurements:
            known = self.landmarks.landmark
            which = np.array(
                [known[measurement.number].landmark_index for measurement in measurements],
                dtype=np.intp,
            )
            z, noise = (
                np.array([measurement.z for measurement in measurements]),
                np.array([s.covariance for s in measurements]),
            )
            self.landmarks.initialised(measurements, recorder.observe(ekf, epoch, z, noise, which))

    def keep_from(self, guard: DynamicGuard) -> None:
        """Landmarks whose template lies where something moves are used no more."""
        self.landmarks.guard = guard

    def run(self) -> HighLevelRun:
        """What came of it, once the filter has finished."""
        index = [landmark.landmark_index for landmark in self.landmarks.landmark]
        return HighLevelRun(
            searches=len(self._searches),
            corners=sum(len(one.corner) for one in self._searches),
            pairs=sum(len(one.candidate) + one.known for one in self._searches),
            candidates=sum(len(one.candidate) for one in self._searches),
            poor=sum(one.poor for one in self._searches),
            found=len(index),
            kept=sum(one >= 0 for one in index),
            deactivated=len(self.landmarks.moving),
            looks=dict(sorted(self.landmarks.counts.items())),
            landmark_index=np.array(index, dtype=np.intp),
            place=self._place,
            rectangle=self._rectangle,
        )

    def _search(self, ekf: Ekf, time_s: float) -> None:
        dense = self._map.dense
        around = Around(
            dense.layers["occupancy"],
            cast(Gaussians, dense.layers["sog"]),
            dense.regions.placed(dense.landmark),
            ekf.read_pose().pose,
            dense.landmark,
        )
        found = search(around, self.landmarks.rectangles(ekf), self.options.search)
        self._searches.append(found)
        self._searched(time_s, around, found)
        for template in found.found:
            self.landmarks.take(template, dense.regions.base[template.region], dense.landmark)


def _view(log: Log) -> SensorView:
    """What the log's scanner can see: its beams, as far as anything returned."""
    if log.scans is None:
        return SensorView(50.0, -math.pi, math.pi)
    way = log.scans.range_m
    return view_to(log.scans, float(way[np.isfinite(way)].max(initial=0.0)))
