"""The map job: one log through the filter, and everything its scanner saw between the landmarks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.checks.check import Answers
from comparisons.checks.filter import AboutFilter
from comparisons.checks.registry import BASIS, CHECKS
from comparisons.config import MapConfig
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.accuracy import SurfaceError, surface_error
from comparisons.extensions.dense_maps.source import DenseRun, DenseWatcher, classic_grid
from comparisons.logs.log import Log
from comparisons.pipeline.clock import Progress, no_progress
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepare import Required, prepare
from comparisons.pipeline.prepared import Prepared
from comparisons.shown import Shown
from ekf_reference.dense.layers.layer import LayerSamples
from ekf_reference.dense.regions_at_map import RegionsAtMap

REQUIRED = Required(
    measurements="between which the map is kept: try --features trees or --landmarks scans",
    odometry="the filter needs it",
)


@dataclass(frozen=True, kw_only=True)
class DenseMapping(Shown):
    """Hold a dense map that is anchored to the filter's landmarks.

    Attributes:
        prepared: The log as the filter read it, and the configuration.
        setup: What ran beside the filter.
        ekf: The filter's estimate and trace.
        dense: The map, and how it came about.
        placed: The regions as the landmarks lie in the end.
        layers: What each layer holds there, by its name.
        classic: The same scans in one grid in the world's frame, as is usual without regions.
        errors: Distances from true surfaces by layer, `classic` among them; empty without truth.
        answers: Of the checks on the filter, when they are asked for.
    """

    prepared: Prepared[MapConfig]
    setup: FilterSetup
    ekf: EkfRun
    dense: DenseRun
    placed: RegionsAtMap
    layers: Mapping[str, LayerSamples]
    classic: LayerSamples
    errors: Mapping[str, SurfaceError]
    answers: Answers

    def __repr__(self) -> str:
        """Return log and layers in one line."""
        return f"<DenseMapping of {self.log.name}: {', '.join(self.layers)}>"

    @property
    def log(self) -> Log:
        """The log as the filter read it."""
        return self.prepared.log

    @property
    def known(self) -> Known:
        """What is known of the filter, with what the checks find that need no smoother."""
        return self.answers.known


def map_log(
    log: Log, config: MapConfig | None = None, progress: Progress = no_progress
) -> DenseMapping:
    """Run the filter with a dense map beside it. Raises InputError.

    Where the map looks for what moves, the filter ignores that; else it does not notice the map.
    The map is anchored to the filter's landmarks (Nieto 2005, section 6.2).
    """
    default = {"dense_maps": {"layers": ["points", "occupancy"]}}
    config = config or MapConfig.of(extensions=default)
    prepared = prepare(log, config, progress=progress, required=REQUIRED)
    setup = prepared.beside_filter()
    watcher = setup.find(DenseWatcher)
    if watcher is None:
        raise InputError(
            "the configuration has no section extensions.dense_maps, expected one; add it, or "
            "--layer occupancy"
        )
    classic = classic_grid(watcher.options)
    watcher.feed(classic)
    with prepared.clock.stage("filter and map"):
        run = run_ekf(
            prepared.log,
            prepared.timeline,
            prepared.ekf,
            prepared.positions,
            setup,
            prepared.stage_progress("map"),
        )
    dense = watcher.run()
    placed = dense.dense.regions.placed(dense.landmark)
    layers = {name: layer.samples(placed) for name, layer in dense.dense.layers.items()}
    usual = classic.samples()
    known = Known(
        prepared=prepared,
        landmark_index=run.landmark_index,
        timeline=run.timeline,
        positions=run.positions,
        without="the job solves for no optimum",
        run=run,
    )
    return DenseMapping(
        prepared=prepared,
        setup=setup,
        ekf=run,
        dense=dense,
        placed=placed,
        layers=layers,
        classic=usual,
        errors=_errors(prepared.log, placed, layers, usual),
        answers=Answers(known, (*BASIS, AboutFilter(), *CHECKS)),
    )


def _errors(
    log: Log, placed: RegionsAtMap, layers: Mapping[str, LayerSamples], usual: LayerSamples
) -> dict[str, SurfaceError]:
    if log.truth.surfaces is None:
        return {}
    region = placed.locate(usual.point).region
    kept = np.flatnonzero(region >= 0)
    there = LayerSamples(usual.point[kept], usual.occupancy[kept], region[kept])
    held = {**layers, "classic": there}
    return {k: surface_error(s, log.truth.surfaces.segment) for k, s in held.items()}
