"""Nieto 2005, sections 3.9 and 4.1.3 to 4.3: dense maps in simulation.

Every experiment is run twice on the same logs: by the settings that runs use, and by the thesis'
(`literal`, `--preset as-published`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.adapters.filter_loop import Beside, run_filter_loop
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.config import MapConfig, Preset
from comparisons.errors import InputError
from comparisons.experiments.reproduction.interface import Experiment, Sources
from comparisons.experiments.reproduction.watched_run import truth_in_order
from comparisons.extensions.dense_maps.accuracy import SurfaceError, surface_error
from comparisons.extensions.dense_maps.config import DenseMapsConfig, Layer
from comparisons.extensions.dense_maps.source import (
    BeforeClosing,
    DenseWatcher,
    grid_model,
)
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.logs.simulate.scan_drive import occupancy
from comparisons.pipeline.dense_map import DenseMapping, map_log
from ekf_reference.core.trace import Trace
from ekf_reference.dense.layers.classic_grid import ClassicGrid
from ekf_reference.dense.layers.gaussians import Ellipses, Gaussians
from ekf_reference.dense.layers.layer import Samples
from ekf_reference.dense.layers.occupancy import Coarsening, OccupancyGrid
from ekf_reference.dense.sensor_model import log_odds

SURFACES: tuple[Layer, ...] = ("points", "occupancy", "particles", "sog")
"""Layers of where surfaces are."""
ROUNDS = (1, 2, 3, 4, 5, 10)
"""Of Fig. 4.5."""
_COARSE_ROUNDS = 2
_MORE = 20
"""Drives that are added at the most until the loop of one is closed by a shift."""
_CLOSING_M = 0.3
"""Least shift of the landmarks (RMS) by the update that closes a loop."""


@dataclass(frozen=True)
class ClosedMap:
    """A dense map whose loop was closed by one strong update. true: (L, 2) as the filter's."""

    mapping: DenseMapping
    before: BeforeClosing
    true: Array

    @property
    def segment(self) -> Array:
        """(S, 4) true surfaces [m]."""
        surfaces = self.mapping.log.truth.surfaces
        return np.empty((0, 4)) if surfaces is None else surfaces.segment

    def error_before(self, layer: str) -> SurfaceError:
        """Of a layer, before the closing."""
        return surface_error(self.before.layers[layer], self.segment)

    @property
    def ellipses(self) -> Ellipses:
        """Of the sum of Gaussians."""
        layer = self.mapping.dense.dense.layers["sog"]
        if not isinstance(layer, Gaussians):
            raise TypeError(f"{type(layer).__name__} is no sum of Gaussians")
        return layer.ellipses(self.mapping.placed)

    def thirds(self, east: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which of (N,) lie in the left and in the right third of the true path."""
        low, high = np.quantile(truth_in_order(self.mapping.log)[0].pose[:, 0], (1 / 3, 2 / 3))
        return east <= low, east >= high


@dataclass(frozen=True)
class Maps:
    """Of several drives. all_drives: also those whose loop closed gently; the first is drawn.

    literal: the same drives by the thesis' settings.
    """

    log: str
    closed: tuple[ClosedMap, ...]
    all_drives: tuple[DenseMapping, ...]
    literal: Maps | None = None


@dataclass(frozen=True, kw_only=True)
class Round:
    """The map after some rounds. classic: one grid in the world. dense: the occupancy layer.

    landmark, true: (L, 2).
    """

    number: int
    classic: Samples
    dense: Samples
    landmark: Array
    true: Array
    classic_error: SurfaceError
    dense_error: SurfaceError


@dataclass(frozen=True)
class Rounds:
    """One long drive. segment: (S, 4) true surfaces. literal: by the thesis' settings."""

    log: str
    each: tuple[Round, ...]
    segment: Array
    literal: Rounds | None = None


@dataclass(frozen=True, kw_only=True)
class Coarsened:
    """Occupancy grids with larger cells in almost empty regions, and with one size of cells.

    triangle: (R, 3, 2). cell_m: (R,) of each region, NaN where nothing was seen. cells, cells_even:
    how many. emptiest: largest share of a region's cells that is empty, by the rule's measure.
    literal: by the thesis' settings.
    """

    log: str
    triangle: Array
    cell_m: Array
    coarse: Samples
    cells: int
    cells_even: int
    emptiest: float
    error: SurfaceError
    error_even: SurfaceError
    segment: Array
    literal: Coarsened | None = None


def _maps(name: str, layers: tuple[Layer, ...], sources: Sources) -> Maps:
    logs, ours = list[Log](), list[DenseMapping]()
    while len(ours) < sources.drives or not _closed(ours):
        if len(ours) == sources.drives + _MORE:
            raise InputError(f"{name}: no drive's loop is closed by a shift of {_CLOSING_M} m")
        logs.append(open_log(name, choices=SimulationChoices(len(logs))))
        ours.append(map_log(logs[-1], _config(name, "recommended", layers=layers)))
    literal = [map_log(log, _config(name, "as-published", layers=layers)) for log in logs]
    reported = f"{name}, {len(ours)} drives from seed 0, {{}} of them corrected at once"
    found = [_of_drives(reported, drives) for drives in (ours, literal)]
    return replace(found[0], literal=found[1])


def _of_drives(reported: str, drives: list[DenseMapping]) -> Maps:
    closed = _closed(drives)
    return Maps(reported.format(len(closed)), closed, tuple(drives))


def _closed(drives: list[DenseMapping]) -> tuple[ClosedMap, ...]:
    return tuple(
        ClosedMap(mapping, before, truth_in_order(mapping.log)[1])
        for mapping in drives
        if (before := mapping.dense.before) is not None and before.shift_m > _CLOSING_M
    )


def _config(name: str, preset: Preset, **fields: Any) -> MapConfig:
    """Settings of a named log by a preset, and of the dense map."""
    return MapConfig.of(preset=preset, log={"source": name}, extensions={"dense_maps": fields})


def raw_maps(sources: Sources) -> Maps:
    """Section 3.9: raw returns."""
    return _maps("scan-loop", ("points",), sources)


def layered_maps(sources: Sources) -> Maps:
    """Chapter 4: all layers."""
    return _maps("occupancy-loop", SURFACES, sources)


def rounds(sources: Sources) -> Rounds:
    """Section 4.1.3: ten rounds, one grid beside the dense map."""
    log = open_log("occupancy-loop", choices=SimulationChoices(0, ROUNDS[-1]))
    return replace(_rounds(log, "recommended"), literal=_rounds(log, "as-published"))


def _rounds(log: Log, preset: Preset) -> Rounds:
    segment, true = _segment(log), truth_in_order(log)[1]
    settings = _config(log.name, preset, layers=("occupancy",))
    config = settings.extensions["dense_maps"]
    if not isinstance(config, DenseMapsConfig):
        raise TypeError(f"{type(config).__name__} is no DenseMapsConfig")
    classic = ClassicGrid(config.resolution_m, grid_model(config))
    watcher = DenseWatcher(log, config)
    watcher.feed(classic)
    ekf = build_ekf(log, settle(settings.ekf, log), Trace())
    loop_s, due, each = occupancy().drive.loop_s, list(ROUNDS), list[Round]()
    for state in run_filter_loop(ekf, log, build_timeline(log), beside=Beside(watching=watcher)):
        if due and state.time_s >= due[0] * loop_s:
            each.append(_round(due.pop(0), watcher, classic, segment, true))
    return Rounds(f"occupancy-loop --loops {ROUNDS[-1]}, seed 0", tuple(each), segment)


def _round(
    number: int, watcher: DenseWatcher, classic: ClassicGrid, segment: Array, true: Array
) -> Round:
    run = watcher.run()
    placed = run.dense.regions.placed(run.landmark)
    dense, usual = run.dense.layers["occupancy"].samples(placed), classic.samples()
    inside = np.flatnonzero(placed.locate(usual.point).region >= 0)
    there = Samples(usual.point[inside], usual.occupancy[inside], usual.region[inside])
    return Round(
        number=number,
        classic=there,
        dense=dense,
        landmark=run.landmark,
        true=true[: len(run.landmark)],
        classic_error=surface_error(there, segment),
        dense_error=surface_error(dense, segment),
    )


def coarsened(sources: Sources) -> Coarsened:
    """Section 4.1.3, Fig. 4.6: 0.2 m, and 0.5 m where a region is almost empty."""
    log = open_log("occupancy-loop", choices=SimulationChoices(0, _COARSE_ROUNDS))
    return replace(_coarsened(log, "recommended"), literal=_coarsened(log, "as-published"))


def _coarsened(log: Log, preset: Preset) -> Coarsened:
    segment = _segment(log)
    maps = [
        map_log(log, _config(log.name, preset, layers=("occupancy",), coarsening=rule))
        for rule in (Coarsening(), None)
    ]
    coarse, even = (_grid(m) for m in maps)
    cells, cells_even = (sum(len(g.odds) for g in layer.grids.values()) for layer in (coarse, even))
    triangle = maps[0].placed.triangle
    edge = np.linalg.norm(triangle[:, 1:] - triangle[:, :1], axis=2)
    cell_m = np.full(len(triangle), np.nan)
    for region, grid in coarse.grids.items():
        cell_m[region] = float(np.max(edge[region] / grid.cells))
    samples = [m.layers["occupancy"] for m in maps]
    return Coarsened(
        log=f"occupancy-loop --loops {_COARSE_ROUNDS}, seed 0",
        triangle=triangle,
        cell_m=cell_m,
        coarse=samples[0],
        cells=cells,
        cells_even=cells_even,
        emptiest=max(
            (float(np.mean(g.odds < log_odds(Coarsening().least))) for g in even.grids.values()),
            default=np.nan,
        ),
        error=surface_error(samples[0], segment),
        error_even=surface_error(samples[1], segment),
        segment=segment,
    )


def _grid(mapping: DenseMapping) -> OccupancyGrid:
    layer = mapping.dense.dense.layers["occupancy"]
    if not isinstance(layer, OccupancyGrid):
        raise TypeError(f"{type(layer).__name__} is no OccupancyGrid")
    return layer


def _segment(log: Log) -> Array:
    surfaces = log.truth.surfaces
    if surfaces is None:
        raise InputError(f"{log.name}: true surfaces are needed")
    return surfaces.segment


RAW = Experiment("section 3.9", raw_maps)
LAYERED = Experiment("chapter 4", layered_maps)
ROUNDED = Experiment("section 4.1.3, ten rounds", rounds)
COARSENED = Experiment("section 4.1.3, two sizes of cells", coarsened)
