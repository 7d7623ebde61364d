"""The map job: one log through the filter, and everything its scanner saw between the landmarks."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from comparisons.adapters.ekf_factory import EkfChoices, fused_positions
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.accuracy import SurfaceError, surface_error
from comparisons.extensions.dense_maps.source import (
    GRID_MODEL,
    DenseOptions,
    DenseRun,
    DenseWatcher,
)
from comparisons.extensions.scan_landmarks.source import (
    LANDMARKS,
    ScanSlamSources,
    check_landmarks,
    usual_options,
)
from comparisons.logs.log import Log
from comparisons.logs.transforms.known_landmarks import join_known_sightings
from ekf_reference.dense.layers.classic_grid import ClassicGrid
from ekf_reference.dense.layers.layer import Samples
from ekf_reference.dense.placed_regions import PlacedRegions
from ekf_reference.scan_landmarks.scan_slam import ScanLandmarks, ScanSlamOptions

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class DenseMapping:
    """What the map job found.

    placed: the regions as the landmarks lie in the end; layers: what each layer holds there.
    classic: the same scans in one grid in the world's frame, as is usual without DenseSLAM.
    errors: by layer, `classic` (where regions are) among them, against true surfaces where the
    log has them. scan_landmarks: what the scans gave as landmarks, None where they were not asked.
    """

    log: Log
    choices: EkfChoices
    ekf: EkfRun
    dense: DenseRun
    placed: PlacedRegions
    layers: Mapping[str, Samples]
    classic: Samples
    errors: Mapping[str, SurfaceError]
    scan_landmarks: ScanLandmarks | None
    seconds: dict[str, float]


def map_log(
    log: Log,
    choices: EkfChoices | None = None,
    options: DenseOptions | None = None,
    progress: Progress = lambda stage, done, total: None,
    landmarks: str = "points",
    slam: ScanSlamOptions | None = None,
) -> DenseMapping:
    """Run the filter with a dense map beside it. Raises InputError.

    Where the map looks for what moves, the filter does not go by that; else it does not notice
    the map. landmarks: of LANDMARKS, which the map hangs on (Nieto 2005, section 6.2). slam: of
    scan landmarks.
    """
    check_landmarks(landmarks)
    chosen = (choices or EkfChoices()).settle(log)
    log = join_known_sightings(log)
    if landmarks != "scans" and not len(log.sightings.time_s):
        raise InputError(
            f"{log.name}: holds no sightings of landmarks, between which the map is kept "
            "(try --features trees or --landmarks scans)"
        )
    if not len(log.odometry.time_s):
        raise InputError(f"{log.name}: holds no odometry, which the filter needs")
    options = options or DenseOptions()
    sources = ScanSlamSources.of(log, landmarks, slam or usual_options(mapped=True))
    log = log if sources is None else sources.log
    classic = ClassicGrid(options.resolution_m, GRID_MODEL)
    watcher = DenseWatcher(log, options, (classic,), kinds=LANDMARKS[landmarks])
    positions = fused_positions(log, chosen)
    source = None if sources is None else sources()
    start = time.perf_counter()
    run = run_ekf(
        log,
        build_timeline(log, positions, None if sources is None else sources.scans.time_s),
        chosen,
        positions,
        lambda k, n: progress("map", k, n),
        watcher=watcher,
        source=source,
        guard=watcher if options.dynamic else None,
    )
    seconds = {"filter and map": time.perf_counter() - start}
    dense = watcher.run()
    placed = dense.dense.regions.placed(dense.landmark)
    layers = {name: layer.samples(placed) for name, layer in dense.dense.layers.items()}
    errors: dict[str, SurfaceError] = {}
    usual = classic.samples()
    if log.truth.surfaces is not None:
        region = placed.locate(usual.point).region
        kept = np.flatnonzero(region >= 0)
        there = Samples(usual.point[kept], usual.occupancy[kept], region[kept])
        held = {**layers, "classic": there}
        errors = {k: surface_error(s, log.truth.surfaces.segment) for k, s in held.items()}
    found = None if source is None else source.found
    return DenseMapping(log, chosen, run, dense, placed, layers, usual, errors, found, seconds)
