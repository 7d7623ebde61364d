"""A dense map beside the filter: every scan of a log, from where the filter then thought it was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import motion_model
from comparisons.adapters.motion import CLOCK_S
from comparisons.adapters.planar_scans import PlanarScans
from comparisons.arrays import Array
from comparisons.estimates.estimate import Estimate
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.figures import Aside
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.pipeline.clock import Clock
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import POINT, POSE, LandmarkKind
from ekf_reference.dense.conditions import Conditions, ellipse_margin, flip_margin
from ekf_reference.dense.delayed_initialisation import DelayedInitialisation
from ekf_reference.dense.dense_map import DenseMap
from ekf_reference.dense.dynamic import Differencing, DynamicLayer
from ekf_reference.dense.layers.classic_grid import ClassicGrid
from ekf_reference.dense.layers.gaussians import Gaussians
from ekf_reference.dense.layers.layer import Layer, LayerSamples
from ekf_reference.dense.layers.occupancy import OccupancyGrid
from ekf_reference.dense.layers.particles import Particles
from ekf_reference.dense.layers.points import AllReturns
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.sensor_model import InverseSensorModel
from ekf_reference.dense.view import FilterView, by_number

MARGINS = {"joint": flip_margin, "ellipses": ellipse_margin}
_TELLING_M = 0.05
"""Least shift of the regions by one update that is drawn as a picture (root mean square)."""
_MARGIN_M = 0.5
"""So near to a dynamic cell a measurement or a landmark counts as dynamic: both may be off."""
_CLEARLY = 1.2
"""A later update must move the regions, all together, so many times as far to take its place."""


def grid_model(config: DenseMapsConfig) -> InverseSensorModel:
    """Return what one return says of a grid's cells (Nieto 2005, eq. 4.4)."""
    return InverseSensorModel(p_occupied=config.p_occupied, p_free=config.p_free)


def classic_grid(config: DenseMapsConfig) -> ClassicGrid:
    """Return one empty grid in the world, with the cells of the occupancy layer."""
    return ClassicGrid(config.resolution_m, grid_model(config), config.confidence)


def build_map(
    config: DenseMapsConfig, also: Sequence[str] = (), rule: Differencing | None = None
) -> DenseMap:
    """Return an empty map. also: more layers. rule: of what moves."""
    size, bounds = config.resolution_m, config.bounds
    made: Mapping[str, Layer] = {
        "points": AllReturns(size),
        "occupancy": OccupancyGrid(size, grid_model(config), config.confidence, config.coarsening),
        "particles": Particles(
            np.random.default_rng(0),
            model=grid_model(config),
            d_min_m=config.d_min_m,
            confidence=config.confidence,
            least=config.least_weight,
            thinned=config.thinned,
        ),
        "sog": Gaussians(config.d_min_m, thinned=config.thinned),
    }
    conditions = Conditions(  # Nieto 2005, section 3.5
        least_correlation=config.least_correlation,
        known_apart_m=bounds.known_apart_m,
        longest_edge_m=bounds.longest_edge_m,
        margin=MARGINS[config.flip_test],
    )
    waiting = DelayedInitialisation(capacity=bounds.capacity, patience=bounds.patience)
    return DenseMap(
        layers={name: made[name] for name in dict.fromkeys((*config.layers, *also))},
        regions=LocalRegions(conditions=conditions),
        waiting=waiting if config.delayed or config.virtual_landmarks else None,
        delayed=config.delayed,
        virtual=config.virtual_landmarks,
        reach_m=bounds.reach_m,
        dynamic=DynamicLayer(size, rule or Differencing()) if config.detect_motion else None,
        known_m=config.known_m,
    )


@dataclass(frozen=True)
class BeforeClosing:
    """The map just before the update that moved its regions the most, as a rule a loop's closing.

    Attributes:
        time_s: time of the update.
        shift_m: root mean square shift of the landmarks that are corners of regions.
        landmark: (L, 2) as they then lay; no part of a result file, as what follows.
        triangle: (R, 3, 2) likewise.
        layers: what each held.
    """

    time_s: float
    shift_m: float
    landmark: Aside[Array]
    triangle: Aside[Array]
    layers: Aside[Mapping[str, LayerSamples]]


@dataclass(frozen=True, kw_only=True)
class DenseRun:
    """A dense map and how it came about.

    kinds: of landmarks that its regions are anchored to; places in the map are numbers
    (dense.view.numbered). scan_time_s: (N,) of all scans taken in, scan_pose: (N, 3) the vehicle
    then. scans: the log's. landmark: (L, 2) where the filter has them in the end. clock: of
    regions and of scans.
    """

    kinds: tuple[LandmarkKind, ...]
    options: DenseMapsConfig
    dense: DenseMap
    scans: PlanarScans
    scan_time_s: Array
    scan_pose: Array
    landmark: Array
    before: BeforeClosing | None
    clock: Clock

    @property
    def layers(self) -> Mapping[str, Layer]:
        """Those that were asked for; the map may hold more for others."""
        return {name: self.dense.layers[name] for name in self.options.layers}

    def is_dynamic(self, point: Array) -> NDArray[np.bool_]:
        """(N,) which points (N, 2) [m] are where something was seen to move."""
        return _is_dynamic(self.dense, self.landmark, point)

    def landmarks_of(self, estimate: Estimate) -> Array:
        """(L, 2) [m] the map's landmarks as an estimate has them, NaN where it has them not."""
        count = int(estimate.pose_landmark_id.max(initial=-1)) + 1
        pose_landmarks = np.full((count, POSE.width), np.nan)
        pose_landmarks[estimate.pose_landmark_id] = estimate.pose_landmarks
        each = {POINT: estimate.landmark, POSE: pose_landmarks}
        known = by_number([each[kind] for kind in self.kinds])
        place = np.full_like(self.landmark, np.nan)
        place[: len(known)] = known[: len(place)]
        return place

    def name_of(self, number: int, point_id: NDArray[np.int64]) -> str:
        """Name a landmark of the map: a point's id (L,), or s and a scan landmark's index."""
        landmark_index, kind = divmod(int(number), len(self.kinds))
        return str(point_id[landmark_index]) if self.kinds[kind] == POINT else f"s{landmark_index}"


class DenseWatcher:
    """Feeds a dense map while the filter runs. Reads the filter only.

    It is a DynamicGuard, too, for a filter that is to know what the map finds to be moving.
    options: what it was asked to keep.
    """

    def __init__(
        self, log: Log, options: DenseMapsConfig, kinds: tuple[LandmarkKind, ...] = (POINT,)
    ) -> None:
        """kinds: of landmarks that regions are anchored to (Nieto 2005, section 6.2).

        Raises InputError.
        """
        self._scans = PlanarScans(log)
        self._next = 0
        self.options, self._kinds = options.settled(points=POINT in kinds), kinds
        self._also: tuple[str, ...] = ()
        self._rule = Differencing()
        self._dense = self._empty()
        self._beside: list[ClassicGrid] = []
        self._motion, self._relative = motion_model(log), isinstance(log.odometry, RelativePoses)
        self._pose: list[Array] = []
        self._before: BeforeClosing | None = None
        self._moved_most = 0.0
        self._clock = Clock()
        self._epoch_s = log.prior.time_s

    def keep_also(self, layers: Sequence[str]) -> None:
        """Keep more layers, for whoever needs them. Raises ValueError once the map is not empty."""
        self._also = (*self._also, *layers)
        self._dense = self._empty()

    def difference_by(self, rule: Differencing) -> None:
        """Find what moves by another rule. Raises ValueError once the map is not empty."""
        self._rule = rule
        self._dense = self._empty()

    def _empty(self) -> DenseMap:
        if self._next:
            raise ValueError("the map has taken in scans")
        return build_map(self.options, self._also, self._rule)

    def feed(self, other: ClassicGrid) -> None:
        """Give the same scans from the same poses to a map in the world's frame as well."""
        self._beside.append(other)

    @property
    def dense(self) -> DenseMap:
        """The map as it is now."""
        return self._dense

    def before_predict(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """Take in the scans of the interval that is about to be predicted."""
        while self._due(time_s + duration_s - CLOCK_S):
            view = FilterView.of(ekf, self._kinds)
            part = max(float(self._scans.time_s[self._next]) - time_s, 0.0)
            if part > CLOCK_S:
                share = part / duration_s if self._relative else 1.0
                step = self._motion.step(view.pose, share * control, part)
                view = replace(view, pose=step.pose)
            self._insert(view)
        self._epoch_s = time_s + duration_s

    def on_predict(self, ekf: Ekf) -> None:
        """What waits follows the vehicle."""
        with self._clock.stage("regions"):
            self._dense.predicted(FilterView.of(ekf, self._kinds))

    def on_update(self, ekf: Ekf) -> None:
        """Make the regions that are now possible; keep the map as it was if it moved a lot."""
        with self._clock.stage("regions"):
            view = FilterView.of(ekf, self._kinds)
            old = self._dense.landmark
            self._dense.place(view)
            if len(old):
                self._note_shift(old, self._dense.landmark[: len(old)])
            self._dense.updated(view)

    def on_end(self, ekf: Ekf, time_s: float) -> None:
        """Take in what was scanned at the very end."""
        while self._due(time_s + CLOCK_S):
            self._insert(FilterView.of(ekf, self._kinds))
        landmark = by_number([ekf.state.places(kind) for kind in self._kinds])
        self._dense.place(replace(FilterView.of(ekf, self._kinds), landmark=landmark))

    def is_dynamic(self, point: Array) -> NDArray[np.bool_]:
        """(N,) which points (N, 2) [m] are where something was seen to move."""
        return _is_dynamic(self._dense, self._dense.landmark, point)

    def run(self) -> DenseRun:
        """The map, once the filter has finished."""
        done = len(self._pose)
        return DenseRun(
            kinds=self._kinds,
            options=self.options,
            dense=self._dense,
            scans=self._scans,
            scan_time_s=self._scans.time_s[:done],
            scan_pose=np.array(self._pose).reshape(-1, 3),
            landmark=self._dense.landmark,
            before=self._before,
            clock=self._clock,
        )

    def _due(self, until_s: float) -> bool:
        times = self._scans.time_s
        return self._next < len(times) and float(times[self._next]) < until_s

    def _insert(self, view: FilterView) -> None:
        scan = self._scans.scan(self._next, view.pose)
        with self._clock.stage("scans"):
            self._dense.insert(view, scan, float(self._scans.time_s[self._next]))
        for other in self._beside:
            other.fuse(scan)
        self._pose.append(view.pose)
        self._next += 1

    def _note_shift(self, old: Array, new: Array) -> None:
        corner = np.unique(self._dense.regions.base)
        corner = corner[corner >= 0]  # virtual ones are anchored to these
        if not len(corner):
            return
        squared = np.square(new[corner] - old[corner]).sum(axis=1)
        shift, moved = float(np.sqrt(squared.mean())), float(np.sqrt(squared.sum()))
        if shift < _TELLING_M or moved < _CLEARLY * self._moved_most:
            return
        self._moved_most = moved
        placed = self._dense.regions.placed(old)
        layers = {name: layer.samples(placed) for name, layer in self._dense.layers.items()}
        self._before = BeforeClosing(self._epoch_s, shift, old, placed.triangle, layers)


def _is_dynamic(dense: DenseMap, landmark: Array, point: Array) -> NDArray[np.bool_]:
    if dense.dynamic is None:
        return np.zeros(len(point), dtype=bool)
    return dense.dynamic.covers(point, dense.regions.placed(landmark), _MARGIN_M)
