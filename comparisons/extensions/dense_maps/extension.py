"""A dense map beside the filter, compared with the same scans placed by the smoother."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull, QhullError, cKDTree

from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.motion import motion_between
from comparisons.adapters.planar_scans import PlanarScans
from comparisons.arrays import Array
from comparisons.checks.finding import Finding
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.check import DenseAgreement, compare_dense, dense_cause
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.source import DenseRun, DenseWatcher
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.pipeline.extension import Extension
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepared import Prepared
from comparisons.report.html.drawing import Drawing
from comparisons.words import Explanation, Row
from ekf_reference.core.landmark_types import POINT
from graphslam.increments import dead_reckoned

MOST_BYTES = 2 * 1024**3
"""Memory that a job with a dense map may take; what may take more is refused before it starts."""
_PROGRAM, _LAYER = 170e6, 30e6
"""Bytes of the program with a log, and of each layer's pictures."""
_CELL, _CELL_WITHOUT_TRUTH, _CELL_BESIDE_POINTS = 280.0, 110.0, 160.0
"""Bytes of a cell at the end of a run: where true surfaces are compared, where there are none, and
what comes on top where layers of points are compared, too."""
_MOVING_CELL = 200.0
_KEPT_CELL = 96.0
_PIXEL, _FIRST_PIXEL, _FIRST_PIXELS = 80.0, 300.0, 1e6
"""Bytes of a picture's pixel, and of those in the first band that is drawn."""
_RETURN = 300.0
_SKEWED, _VIRTUAL = 1.8, 3.5
"""Cells are skewed, and regions with a virtual corner reach beyond the landmarks: so many times the
landmarks' ground in cells, and their window in pixels."""
_SCANS = 200
"""So many of a log's scans, evenly, say what ground is seen."""
_TILE_M = 2.0
"""Side of the squares that ground is counted in."""
_ROUND = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)


class Demand:
    """What a map of a log takes; upper bounds.

    regions_m2: cells' ground in regions. seen_m2: ground that scans see. window_m2: of pictures.
    returns: of all scans. The vehicle is taken to be where dead reckoning has it; with drift the
    same ground counts twice.
    """

    def __init__(self, log: Log, config: DenseMapsConfig, *, points: bool, mapped: bool) -> None:
        """points: regions are anchored to points. mapped: the job draws what it finds."""
        self._config, self._mapped = config.settled(points=points), mapped
        self._truth = log.truth.surfaces is not None
        scans = PlanarScans(log)
        count = len(scans.time_s)
        number = np.linspace(0, count - 1, min(count, _SCANS)).astype(int)
        time_s, pose = _reckoned(log)
        at = pose[np.clip(np.searchsorted(time_s, scans.time_s[number]), 0, len(pose) - 1)]
        tiles, returns = [np.zeros((0, 2))], 0
        for i, vehicle in zip(number.tolist(), at, strict=True):
            scan = scans.scan(i, vehicle)
            returns += len(scan.range_m)
            ahead = np.arange(0.0, scan.range_m.max(initial=0.0) + _TILE_M, _TILE_M)
            share = np.minimum(ahead[:, None] / scan.range_m, 1.0)[..., None]
            place = scan.origin + share * (scan.point - scan.origin)
            tiles.append(np.unique(np.floor(place.reshape(-1, 2) / _TILE_M), axis=0))
        self.seen_m2 = _TILE_M**2 * len(np.unique(np.concatenate(tiles), axis=0))
        self.returns = returns * count / max(len(number), 1)
        self.regions_m2, self.window_m2 = self._regions(log, time_s, pose, points=points)

    def bytes(self, resolution_m: float) -> float:
        """Peak of the whole process."""
        c, square = self._config, resolution_m**2
        of_returns = {"points", "particles", "sog"} & set(c.layers)
        grid = self.regions_m2 / square if "occupancy" in c.layers else 0.0
        moving = self.regions_m2 / square if c.detect_motion else 0.0
        classic = self.seen_m2 / square if self._mapped else 0.0
        pixels = self.window_m2 / square if self._mapped else 0.0
        cell = _CELL if self._truth and self._mapped else _CELL_WITHOUT_TRUTH
        cell += _CELL_BESIDE_POINTS if of_returns else 0.0
        run = cell * (grid + classic) + _MOVING_CELL * moving
        drawn = _PIXEL * pixels + _FIRST_PIXEL * min(pixels, _FIRST_PIXELS)
        kept = _KEPT_CELL * (grid + classic) + _MOVING_CELL * moving
        fixed = _PROGRAM + _LAYER * len(c.layers) + _RETURN * self.returns * len(of_returns)
        return fixed + max(run, kept + drawn)

    def check(self, name: str) -> None:
        """Raise InputError for more than MOST_BYTES, with a resolution that fits."""
        size_m = self._config.resolution_m
        wanted = self.bytes(size_m)
        if wanted <= MOST_BYTES:
            return
        decade = 10.0 ** math.floor(math.log10(size_m))
        coarser = [s * d for d in (decade, 10.0 * decade, 100.0 * decade) for s in _ROUND]
        fits = next((s for s in coarser if s <= 10.0 and self.bytes(s) <= MOST_BYTES), None)
        cells = (self.regions_m2 + self.seen_m2) / size_m**2
        hint = f"expected --resolution {fits:g} or more" if fits else "expected a shorter log"
        raise InputError(
            f"{name}: a dense map with --resolution {size_m:g} may have {cells:.2g} cells and take "
            f"{wanted / 1024**3:.2g} GiB of memory, the limit is {MOST_BYTES / 1024**3:g} GiB; "
            + hint
        )

    def _regions(
        self, log: Log, time_s: Array, pose: Array, *, points: bool
    ) -> tuple[float, float]:
        """Ground [m^2] that regions may have cells on, and the window that holds them."""
        reach_m, corner = self._config.bounds.reach_m, pose[:, :2]
        if points:
            s = log.measurements
            at = pose[np.clip(np.searchsorted(time_s, s.time_s), 0, len(pose) - 1)]
            turn, near = at[:, 2] + s.bearing_rad, s.range_m <= reach_m
            ray = s.range_m[:, None] * np.column_stack((np.cos(turn), np.sin(turn)))
            corner = (at[:, :2] + ray)[near]
        if len(corner) < 1 or not np.isfinite(corner).all():
            return 0.0, 0.0
        margin_m = 0.0 if points else reach_m
        low, high = corner.min(axis=0) - margin_m, corner.max(axis=0) + margin_m
        window_m2 = float(np.prod(high - low))
        side_m = max(_TILE_M, math.sqrt(window_m2 / 1e6))
        east, north = (np.arange(a, b + side_m, side_m) for a, b in np.stack((low, high), axis=1))
        ground = np.stack(np.meshgrid(east, north), axis=-1).reshape(-1, 2)
        inside = cKDTree(pose[:, :2]).query(ground)[0] <= reach_m + side_m
        if not points:
            return side_m**2 * float(inside.sum()), window_m2
        try:
            edges = ConvexHull(corner).equations
        except (QhullError, ValueError):  # all in a line, which has no regions
            return 0.0, window_m2
        inside &= (ground @ edges[:, :2].T + edges[:, 2] <= side_m).all(axis=1)
        return _SKEWED * side_m**2 * float(inside.sum()), _VIRTUAL * window_m2


def _reckoned(log: Log) -> tuple[Array, Array]:
    """Times (K,) and poses (K, 3) by the odometry alone, from the prior on."""
    odometry, start_s = log.odometry, log.prior.time_s
    if isinstance(odometry, RelativePoses):
        moves, time_s = odometry.displacement, odometry.time_s
    else:
        end_s = max(float(odometry.time_s[-1]), start_s)
        time_s = start_s + np.linspace(0.0, end_s - start_s, 2 + int(_SCANS * 10))[1:]
        time_s = time_s[np.diff(time_s, prepend=start_s) > 1e-3]
        moves = motion_between(log, time_s).displacement
    return np.concatenate(([start_s], time_s)), dead_reckoned(log.prior.pose, moves)


class DenseMaps(Extension):
    """Do both estimates put what the scanner saw at the same places?

    Puts a watcher beside the filter, which others may use.
    """

    name = "dense_maps"
    needs = "scans"
    errs = "not measured"
    explains: ClassVar = {
        "dense": Explanation(
            "The dense maps differ",
            "The dense map of the EKF differs from the map that the smoother's poses give for "
            "the same scans. The sparse landmarks may agree all the same.",
            "Check the landmarks at the corners of the named region. A region deforms if these "
            "were uncertain relative to each other when its scans were added.",
        )
    }
    figures = (("dense", DenseAgreement),)
    settings: DenseMapsConfig

    def attach(self, setup: FilterSetup, prepared: Prepared[Any]) -> None:
        """Start an empty map, anchored to the landmarks that the filter will have.

        Raises InputError where it may need more memory than is allowed.
        """
        mapped = prepared.config.job == "map"
        demand = Demand(prepared.log, self.settings, points=POINT in setup.kinds, mapped=mapped)
        demand.check(prepared.log.name)
        watcher = DenseWatcher(prepared.log, self.settings, setup.kinds)
        setup.observers.append(watcher)
        setup.offers.append(watcher)

    def find(self, known: Known) -> DenseMapsFinding | None:
        """Compare the layers that were asked for with the smoother's."""
        watcher = known.setup.find(DenseWatcher)
        if watcher is None or not self.settings.layers:
            return None
        prepared = known.prepared
        with prepared.clock.stage("dense check"):
            prepared.progress("dense check", 0, 0)
            dense = watcher.run()
            agreement = compare_dense(prepared.log, dense, known.gaps.smoothed)
        return DenseMapsFinding(prepared.log, dense, agreement)


class DenseMapsFinding(Finding):
    """dense: the filter's map. agreement: with the smoother's, None with nothing in a region."""

    def __init__(self, log: Log, dense: DenseRun, agreement: DenseAgreement | None) -> None:
        """Maps that are apart are a reason to disagree."""
        self.dense, self.agreement, self._log = dense, agreement, log
        if agreement is None:
            count, rule = len(dense.dense.regions.base), dense.options.first_condition
            self.remarks = [
                f"no return fell into one of {count} regions ({rule}), so no dense maps could be "
                "compared"
            ]
            return
        self.entries = {"dense": agreement}
        if not agreement.agrees:
            self.causes = [dense_cause(agreement)]

    def rows(self) -> Sequence[Row]:
        """Return how far the maps are apart."""
        return [] if self.agreement is None else self.agreement.rows()

    def figures(self) -> Mapping[str, Figure]:
        """Return every layer over the smoother's returns."""
        from comparisons.extensions.dense_maps.figure import dense_check_figure

        if self.agreement is None:
            return {}
        return {"dense": dense_check_figure(self.dense, self.agreement, self._log)}

    def layers(self, drawing: Drawing) -> None:
        """Add what every layer holds occupied."""
        if self.agreement is not None:
            for name, layer in self.agreement.layers.items():
                drawing.dots(f"dense {name}", "#5b7c8d", layer.point)
