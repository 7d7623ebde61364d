"""Nieto 2005, sections 3.10 and 4.4: the car park, and what is claimed of its maps.

The log at hand (--data) is another part of the drives than the thesis': 125 s and 200 m of way
around the reflectors between buildings, with RTK GPS throughout, where the thesis has 1 km in an
area of 120 by 200 m. In its last 15 s the steering reading saturates with no reflector in view, and
walls are drawn a second time, metres beside the first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from scipy.spatial import cKDTree

from comparisons.arrays import Array
from comparisons.checks.accuracy import match_by_distance
from comparisons.config import EkfConfig, MapConfig
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.figure import draw_cloud, draw_occupied, draw_regions
from comparisons.extensions.dense_maps.job import DenseMapping, map_log
from comparisons.extensions.dense_maps.report import returns_result
from comparisons.extensions.dense_maps.source import BeforeClosing
from comparisons.logs.log import Log
from comparisons.report.marks import SMOOTHER_COLOUR
from ekf_reference.dense.layers.layer import LayerSamples
from research.documents.claims import Claims, at_least, at_most, elsewhere
from research.documents.drawing import frame, plan
from research.documents.interface import DocumentFigure, Experiment
from research.documents.measures import (
    occupied,
    rms,
)

FOLDER = "acfr_car_park"
CELL_M = 0.4
"""Cells of Fig. 4.15."""
ERROR_BEFORE_M = 3.0
"""Of the map before the loop closes, section 4.4."""
_LAST = elsewhere("returns of the last 15 s are put where the saturated steering leads")
OTHER_PART = "the log is another part of the drives than the thesis'"
OTHER_LOG = " Our log of the car park is another part of the drives than the thesis'."


@dataclass(frozen=True, kw_only=True)
class CarPark:
    """The car park's maps.

    fine: by the landmarks alone, with cells of CELL_M. literal: by the thesis' settings.
    aided_path: (T, 2) of the filter that is given GPS. image: (M, 2) all returns from there, the
    thesis' reference. beacon: (L, 2) surveyed, NaN where a landmark has none.
    """

    log: str
    fine: DenseMapping
    literal: DenseMapping
    aided_path: Array
    image: Array
    beacon: Array

    def off(self, point: Array) -> Array:
        """(N,) distances of points (N, 2) to the laser image."""
        away: Array = cKDTree(self.image).query(point)[0]
        return away

    @property
    def before(self) -> BeforeClosing:
        """The map before the update that moved it the most."""
        if self.fine.dense.before is None:
            raise InputError(f"{self.log}: no update moved the map")
        return self.fine.dense.before

    @property
    def landmark(self) -> Array:
        """(L, 2) by the filter without GPS."""
        place: Array = self.fine.ekf.estimate.landmark
        return place


def car_park(log: Log) -> CarPark:
    """Drive the log twice: by the landmarks alone, and with GPS.

    Raises InputError for a log without scans, GPS or surveyed landmarks.
    """
    known = log.truth.landmarks
    if log.positions is None or known is None:
        raise InputError(f"{log.name}: GPS and surveyed landmarks are needed")
    fine, run = _mapped(log), _mapped(log, gps=True).dense
    image = [run.scans.scan(k, pose).point for k, pose in enumerate(run.scan_pose)]
    landmark = fine.ekf.estimate.landmark
    beacon = np.full_like(landmark, np.nan)
    ours, theirs = match_by_distance(landmark, known.position_m)
    beacon[ours] = known.position_m[theirs]
    return CarPark(
        log=f"{log.name}, {log.duration_s:.0f} s, another part of the drives than the thesis'",
        fine=fine,
        literal=_literally_mapped(log),
        aided_path=run.scan_pose[:, :2],
        image=np.vstack(image),
        beacon=beacon,
    )


def _mapped(log: Log, *, gps: bool = False) -> DenseMapping:
    maps = DenseMapsConfig(layers=("points", "occupancy"), resolution_m=CELL_M, d_min_m=CELL_M)
    ekf = EkfConfig(gps="on" if gps else "off")
    return map_log(log, MapConfig(ekf=ekf, extensions={"dense_maps": maps}))


def _literally_mapped(log: Log) -> DenseMapping:
    where = {"source": log.name, "format": log.format}
    config = MapConfig.of(
        preset="nieto-2005", log=where, extensions={"dense_maps": {"layers": ("points",)}}
    )
    return map_log(log, config)


def _claims_3_22(found: CarPark) -> Claims:
    regions = found.fine.dense.dense.regions
    away = found.off(found.fine.layers["points"].point)
    text = "the dense map lies on the laser image (median distance of its points)"
    yield at_most(text, np.median(away), CELL_M, "m", own=True)
    text = "all of it does (95 % of the distances)"
    yield at_most(text, np.percentile(away, 95.0), CELL_M, "m", why=_LAST, own=True)
    shares = [returns_result(one.dense.dense).covered for one in (found.literal, found.fine)]
    why = elsewhere(
        f"{OTHER_PART}: {len(found.literal.placed.triangle)} regions between its reflectors meet "
        f"the thesis' conditions; by the settings of runs {100.0 * shares[1]:.0f} % are in one"
    )
    text = (
        "by the thesis' settings the map holds what was scanned (share of the returns in regions)"
    )
    yield at_least(text, shares[0], 0.5, why=why, own=True)
    text = "virtual landmarks were needed (regions with one)"
    yield at_least(text, int(np.count_nonzero((regions.base < 0).any(axis=1))), 1)


def _claims_4_14(found: CarPark) -> Claims:
    cells, points = (
        float(np.median(found.off(occupied(found.fine.layers[name]))))
        for name in ("occupancy", "points")
    )
    yield from _closing_claims(found, "occupancy")
    text = (
        "the grid is as accurate as the raw observations (median distance to the laser image, "
        "difference; limit: a cell)"
    )
    yield at_most(text, abs(cells - points), CELL_M, "m", own=True)


def _closing_claims(found: CarPark, layer: str) -> Claims:
    """Of the map as it was, against the laser image, and of its landmarks, against the survey."""
    b = found.before
    then = found.off(occupied(b.layers[layer]))
    known = np.flatnonzero(np.isfinite(found.beacon[: len(b.landmark), 0]))
    true = found.beacon[known]
    off = [rms(np.linalg.norm(x[known] - true, axis=1)) for x in (b.landmark, found.landmark)]
    why = elsewhere(
        f"{OTHER_PART}: in a loop of 60 m only {b.shift_m:.2f} m of error come together"
    )
    text = (
        "before the loop closes the map is visibly off (95 % of its distances to the laser image)"
    )
    yield at_least(text, np.percentile(then, 95.0), ERROR_BEFORE_M, "m", why=why)
    text = (
        "closing the loop corrects the map (RMS distance of its landmarks to the surveyed "
        "ones, in the end over before)"
    )
    yield at_most(text, off[1] / off[0], 1.0)


CAR_PARK = Experiment("the car park, dense maps", lambda given: car_park(given.log(FOLDER)), FOLDER)


_MARGIN_M = 6.0


def _frame(axis: Axes, found: CarPark, title: str) -> None:
    """The same part of the park in all figures: where the vehicle and the landmarks are."""
    plan(axis, title)
    frame(axis, np.vstack((found.aided_path, found.landmark)), _MARGIN_M)


def _draw_3_22(canvas: Canvas, found: CarPark) -> None:
    axis = canvas.add_subplot()
    _over_image(axis, found, found.fine.layers["points"], found.fine.placed.triangle)
    axis.plot(*found.landmark.T, "o", color=SMOOTHER_COLOUR, markersize=4, markerfacecolor="none")
    _frame(axis, found, "dense map (dark), laser image by SLAM and GPS (light), regions")


def _over_image(axis: Axes, found: CarPark, samples: LayerSamples, triangle: Array) -> None:
    draw_cloud(axis, found.image)
    draw_regions(axis, triangle)
    draw_occupied(axis, samples)


def _closing(canvas: Canvas, found: CarPark, layer: str) -> None:
    left, right = canvas.subplots(1, 2, sharex=True, sharey=True)
    b = found.before
    _over_image(left, found, b.layers[layer], b.triangle)
    _over_image(right, found, found.fine.layers[layer], found.fine.placed.triangle)
    _frame(left, found, f"(a) before the landmarks move by {b.shift_m:.2f} m, {b.time_s:.0f} s")
    _frame(right, found, "(b) in the end")


_TWO = (12.0, 7.0)

FIGURES = (
    DocumentFigure(
        name="N3.22", title="Car park: final map of DenseSLAM",
        says="The dense map lies on the laser image that SLAM and GPS make together; virtual "
        "landmarks were needed to take in the walls." + OTHER_LOG,
        experiment=CAR_PARK, draw=_draw_3_22, claims=_claims_3_22, size=(7.5, 7.0),
    ),
    DocumentFigure(
        name="N4.14", title="Car park: an occupancy grid before and after a loop closes",
        says="Some 3 m of error before the closing are reduced substantially; the accuracy is that "
        "of the raw observations." + OTHER_LOG,
        experiment=CAR_PARK, draw=partial(_closing, layer="occupancy"),
        claims=_claims_4_14, size=_TWO,
    ),
)  # fmt: skip
