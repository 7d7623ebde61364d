"""Nieto 2005, sections 3.10, 4.4, 6.1.1 and 6.5: the car park, and what is claimed of its maps.

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
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure as Canvas
from scipy.spatial import cKDTree

from comparisons.adapters.motion import motion_between
from comparisons.arrays import Array
from comparisons.checks.accuracy import match_by_distance
from comparisons.config import EkfConfig, MapConfig
from comparisons.errors import InputError
from comparisons.estimates.estimate import landmark_blocks
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.figure import draw_cloud, draw_occupied, draw_regions
from comparisons.extensions.dense_maps.job import DenseMapping, map_log
from comparisons.extensions.dense_maps.source import BeforeClosing
from comparisons.extensions.high_level.figure import HIGH_LEVEL_COLOUR
from comparisons.logs.log import Log
from comparisons.report.figures.style import draw_landmarks, draw_reference
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR, ellipses
from ekf_reference.core.geometry import to_world
from ekf_reference.dense.layers.gaussians import Ellipses
from ekf_reference.dense.layers.layer import Samples
from ekf_reference.scan_landmarks.high_level import Search, SearchOptions, search
from ekf_reference.scan_matching.sog import SumOfGaussians
from graphslam.increments import dead_reckoned
from research.documents.claims import Claims, at_least, at_most, elsewhere
from research.documents.drawing import SIGMAS, Place, draw_lines, frame, plan
from research.documents.interface import Experiment, Figure
from research.documents.measures import (
    SHARE_WITHIN_3_SIGMA,
    ellipses_of,
    occupied,
    off_gps,
    rms,
    searched_at_end,
    within_3_sigma,
)

FOLDER = "acfr_car_park"
CELL_M, COARSE_M, PAIR_M = 0.4, 0.5, 7.0
"""Cells of Fig. 4.15; cells, and greatest distance of two corners, in section 6.5."""
HIGH_LEVEL_COUNT = 9
"""High level landmarks in Fig. 6.18."""
ERROR_BEFORE_M = 3.0
"""Of the map before the loop closes, section 4.4."""
LEAST = 20
"""Gaussians of a high level landmark: section 6.5 names no number; with 200 there are none."""
_WHOLE_MAP_M = 1e3
_LAST = elsewhere("returns of the last 15 s are put where the saturated steering leads")
OTHER_PART = "the log is another part of the drives than the thesis'"
OTHER_LOG = " Our log of the car park is another part of the drives than the thesis'."


@dataclass(frozen=True, kw_only=True)
class CarPark:
    """The car park's maps.

    fine, coarse: by the landmarks alone, with cells of CELL_M and COARSE_M. aided_path: (T, 2) of
    the filter that is given GPS. image: (M, 2) all returns from there, the thesis' reference.
    wheels: (K, 2) dead reckoning. gps: (G, 2). path_gps, aided_gps, wheels_gps: (G',) distances to
    GPS at its times. beacon: (L, 2) surveyed, NaN where a landmark has none. searched,
    searched_fine: corners and high level landmarks of the coarse and of the fine map.
    """

    log: str
    fine: DenseMapping
    coarse: DenseMapping
    aided_path: Array
    image: Array
    wheels: Array
    gps: Array
    path_gps: Array
    aided_gps: Array
    wheels_gps: Array
    beacon: Array
    searched: Search
    searched_fine: Search

    def off(self, point: Array) -> Array:
        """(N,) distances of points (N, 2) to the laser image."""
        away: Array = cKDTree(self.image).query(point)[0]
        return away

    @property
    def before(self) -> BeforeClosing:
        """The fine map before the update that moved it the most."""
        if self.fine.dense.before is None:
            raise InputError(f"{self.log}: no update moved the map")
        return self.fine.dense.before

    @property
    def landmark(self) -> Array:
        """(L, 2) by the filter without GPS."""
        place: Array = self.fine.ekf.estimate.landmark
        return place

    @property
    def blocks(self) -> Array:
        """(L, 2, 2) [m^2]."""
        return landmark_blocks(self.fine.ekf.estimate.joint_covariance)

    @property
    def ellipses(self) -> Ellipses:
        """Of the coarse map's Gaussians."""
        return ellipses_of(self.coarse)

    @property
    def surface(self) -> Samples:
        """The sum of Gaussians, each of peak one, on a grid of COARSE_M; height as `occupancy`."""
        held = self.ellipses
        low, high = held.mean.min(axis=0) - COARSE_M, held.mean.max(axis=0) + COARSE_M
        axes = [np.arange(a, b, COARSE_M) for a, b in zip(low, high, strict=True)]
        point = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        g = SumOfGaussians.of_equal_height(held.mean, held.covariance)
        peak = g.weight[0] / (2.0 * np.pi * np.sqrt(np.linalg.det(g.covariance[0])))
        height = np.concatenate([g.value(column) for column in point]) / peak
        return Samples(point.reshape(-1, 2), height, np.zeros(len(height), dtype=np.intp))


def car_park(log: Log) -> CarPark:
    """Drive the log three times: cells of 0.4 m and 0.5 m, and with GPS.

    Raises InputError for a log without scans, GPS or surveyed landmarks.
    """
    positions, known = log.positions, log.truth.landmarks
    if positions is None or known is None:
        raise InputError(f"{log.name}: GPS and surveyed landmarks are needed")
    fine, coarse = (_mapped(log, cell) for cell in (CELL_M, COARSE_M))
    aided = _mapped(log, CELL_M, gps=True)
    run = aided.dense
    image = [run.scans.scan(k, pose).point for k, pose in enumerate(run.scan_pose)]
    time_s = fine.dense.scan_time_s
    wheels = dead_reckoned(log.prior.pose, motion_between(log, time_s).displacement)[1:]
    landmark = fine.ekf.estimate.landmark
    beacon = np.full_like(landmark, np.nan)
    ours, theirs = match_by_distance(landmark, known.position_m)
    beacon[ours] = known.position_m[theirs]
    return CarPark(
        log=f"{log.name}, {log.duration_s:.0f} s, another part of the drives than the thesis'",
        fine=fine,
        coarse=coarse,
        aided_path=run.scan_pose[:, :2],
        image=np.vstack(image),
        wheels=wheels[:, :2],
        gps=positions.position_m,
        path_gps=off_gps(log, time_s, fine.dense.scan_pose),
        aided_gps=off_gps(log, run.scan_time_s, run.scan_pose),
        wheels_gps=off_gps(log, time_s, wheels),
        beacon=beacon,
        searched=_searched(coarse, COARSE_M),
        searched_fine=_searched(fine, CELL_M),
    )


def _mapped(log: Log, cell_m: float, *, gps: bool = False) -> DenseMapping:
    maps = DenseMapsConfig(
        layers=("points", "occupancy", "sog"), resolution_m=cell_m, d_min_m=cell_m
    )
    ekf = EkfConfig(gps="on" if gps else "off")
    return map_log(log, MapConfig(ekf=ekf, extensions={"dense_maps": maps}))


def _searched(mapping: DenseMapping, cell_m: float) -> Search:
    options = SearchOptions(reach_m=_WHOLE_MAP_M, cell_m=cell_m, pair_m=PAIR_M, least=LEAST)
    return search(searched_at_end(mapping), np.empty((0, 4, 2)), options)


def _claims_3_20(found: CarPark) -> Claims:
    known = np.isfinite(found.beacon[:, 0])
    error = (found.landmark - found.beacon)[known]
    sigma = np.sqrt(np.trace(found.blocks, axis1=1, axis2=2))
    far = np.linalg.norm(found.landmark - found.aided_path[0], axis=1)
    farther = far > np.median(far)
    why = elsewhere("the last 15 s, without a reflector in view, are dead reckoning in both")
    text = "SLAM stays closer to GPS than dead reckoning (RMS distance, over that of the wheels)"
    yield at_most(text, rms(found.path_gps) / rms(found.wheels_gps), 0.5, why=why, own=True)
    text = "where landmarks are in view it is close to GPS (median distance)"
    yield at_most(text, np.median(found.path_gps), 0.5, "m", own=True)
    text = "the landmarks' surveyed places are within the 3-sigma ellipses (share)"
    yield at_least(text, np.mean(within_3_sigma(error, found.blocks[known])), SHARE_WITHIN_3_SIGMA)
    text = (
        "landmarks far from the start are the most uncertain (mean sigma of the farther half "
        "over that of the nearer)"
    )
    yield at_least(text, sigma[farther].mean() / sigma[~farther].mean(), 1.0)


def _claims_3_22(found: CarPark) -> Claims:
    regions = found.fine.dense.dense.regions
    away = found.off(found.fine.layers["points"].point)
    text = "the dense map lies on the laser image (median distance of its points)"
    yield at_most(text, np.median(away), CELL_M, "m", own=True)
    text = "all of it does (95 % of the distances)"
    yield at_most(text, np.percentile(away, 95.0), CELL_M, "m", why=_LAST, own=True)
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
    why = elsewhere(f"{OTHER_PART}: from {off[0]:.2f} m to {off[1]:.2f} m")
    yield at_most("by a large part (the same)", off[1] / off[0], 0.5, why=why, own=True)


def _near_image(found: CarPark, what: str, layer: str, *, fine: bool = False) -> Claims:
    """Of a layer of the coarse map, or of the fine one."""
    mapping, cell_m = (found.fine, CELL_M) if fine else (found.coarse, COARSE_M)
    text = f"{what} lie on the laser image (median distance; limit: a cell)"
    away = found.off(occupied(mapping.layers[layer]))
    yield at_most(text, np.median(away), cell_m, "m", own=True)


def _corner_claims(found: CarPark, *, fine: bool = False) -> Claims:
    """Corners of the grid of 0.5 m, or of 0.4 m."""
    mapping, cell_m = (found.fine, CELL_M) if fine else (found.coarse, COARSE_M)
    corner = (found.searched_fine if fine else found.searched).corner
    held = occupied(mapping.layers["occupancy"])
    away = cKDTree(held).query(corner)[0] if len(corner) else np.array([np.nan])
    text = "corners are found in the grid that no single scan shows"
    yield at_least(text, len(corner), 2, own=True)
    text = (
        "they are corners of what stands there (largest distance to an occupied cell; limit: "
        "two cells)"
    )
    yield at_most(text, away.max(), 2.0 * cell_m, "m", own=True)


def _claims_6_11(found: CarPark) -> Claims:
    text = "SLAM combined with GPS follows GPS (median distance)"
    yield at_most(text, np.median(found.aided_gps), 0.1, "m", own=True)


def _claims_6_15(found: CarPark) -> Claims:
    surface = found.surface
    high = surface.point[surface.occupancy > 0.5]
    off = np.percentile(found.off(high), 95.0) if len(high) else np.nan
    text = (
        "the sum of Gaussians is high where the laser image is (95 % of the distances of what "
        "is above half a peak; limit: two cells)"
    )
    yield at_most(text, off, 2.0 * COARSE_M, "m", why=_LAST, own=True)


def _claims_6_16(found: CarPark) -> Claims:
    layers = found.coarse.layers
    grid = cKDTree(occupied(layers["occupancy"]))
    for name, key in (("raw observations", "points"), ("Gaussians", "sog")):
        text = (
            f"{name} and the grid show the same surfaces (median distance to an occupied cell; "
            "limit: two cells)"
        )
        away = grid.query(occupied(layers[key]))[0]
        yield at_most(text, np.median(away), 2.0 * COARSE_M, "m", own=True)


def _claims_6_18(found: CarPark) -> Claims:
    s = found.searched
    yield at_least("pairs of corners up to 7 m apart are found", len(s.candidate) + s.known, 1)
    why = elsewhere(
        f"{OTHER_PART}, and holds {len(found.ellipses.mean)} Gaussians in all; how many a "
        "landmark must have is not stated"
    )
    text = f"nine are accepted as high level landmarks (with at least {LEAST} Gaussians each)"
    yield at_least(text, len(s.found), HIGH_LEVEL_COUNT, why=why)


CAR_PARK = Experiment("the car park, dense maps", lambda given: car_park(given.log(FOLDER)), FOLDER)


_MARGIN_M = 6.0


def _frame(axis: Axes, found: CarPark, title: str, *, legend: Place | None = None) -> None:
    """The same part of the park in all figures: where the vehicle and the landmarks are."""
    plan(axis, title, legend=legend)
    frame(axis, np.vstack((found.aided_path, found.landmark)), _MARGIN_M)


def _draw_3_20(canvas: Canvas, found: CarPark) -> None:
    left, right = canvas.subplots(1, 2, sharex=True, sharey=True)
    for axis in (left, right):
        axis.plot(*found.gps.T, ".", color=TRUTH_COLOUR, markersize=2, label="GPS")
    left.plot(*found.wheels.T, "-", color=EKF_COLOUR, linewidth=1.0, label="dead reckoning")
    path = found.fine.dense.scan_pose[:, :2]
    right.plot(*path.T, "-", color=EKF_COLOUR, linewidth=1.0, label="SLAM")
    draw_reference(right, found.beacon, "*", "surveyed reflectors")
    outline = ellipses(found.landmark, found.blocks, SIGMAS)
    draw_landmarks(right, found.landmark, outline, SMOOTHER_COLOUR, "o", "landmarks, 3 sigma")
    for axis, title in ((left, "(a) dead reckoning"), (right, "(b) feature SLAM")):
        _frame(axis, found, title, legend="lower left")


def _draw_3_22(canvas: Canvas, found: CarPark) -> None:
    axis = canvas.add_subplot()
    _over_image(axis, found, found.fine.layers["points"], found.fine.placed.triangle)
    axis.plot(*found.landmark.T, "o", color=SMOOTHER_COLOUR, markersize=4, markerfacecolor="none")
    _frame(axis, found, "dense map (dark), laser image by SLAM and GPS (light), regions")


def _over_image(axis: Axes, found: CarPark, samples: Samples, triangle: Array) -> None:
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


def _grid(canvas: Canvas, found: CarPark, *, fine: bool = False) -> None:
    """All cells of 0.5 m by their occupancy, or of 0.4 m, in one subplot."""
    mapping, cell_m = (found.fine, CELL_M) if fine else (found.coarse, COARSE_M)
    axis, samples = canvas.add_subplot(), mapping.layers["occupancy"]
    order = np.argsort(samples.occupancy, kind="stable")
    east, north = samples.point[order].T
    drawn = axis.scatter(
        east, north, s=5.0, marker="s", linewidths=0, c=samples.occupancy[order],
        cmap="viridis", vmin=0.0, vmax=1.0, rasterized=True,
    )  # fmt: skip
    canvas.colorbar(drawn, ax=axis, label="occupancy", shrink=0.8)
    _frame(axis, found, f"occupancy, cells of {cell_m:g} m")


def _draw_6_1(canvas: Canvas, found: CarPark) -> None:
    """The grid with corners, and a close-up of the upper part, as in the thesis."""
    left, right = canvas.subplots(1, 2)
    corner = found.searched_fine.corner
    for axis in (left, right):
        draw_occupied(axis, found.fine.layers["occupancy"])
        axis.plot(*corner.T, "+", color=EKF_COLOUR, markersize=7, label="corners")
    _frame(left, found, "(a) what the grid holds occupied, and corners", legend="best")
    _frame(right, found, "(b) the upper part")
    north = corner[:, 1].max()
    right.set_ylim(north - 16.0, north + 3.0)


def _draw_6_11(canvas: Canvas, found: CarPark) -> None:
    axis = canvas.add_subplot()
    draw_cloud(axis, found.image)
    axis.plot(*found.gps.T, "-", color=TRUTH_COLOUR, linewidth=1.2, label="GPS")
    axis.plot(*found.gps[0], "^", color=EKF_COLOUR, label="start")
    _frame(axis, found, "laser image by SLAM and GPS", legend="lower left")


def _draw_6_12(canvas: Canvas, found: CarPark) -> None:
    axis = canvas.add_subplot()
    draw_regions(axis, found.coarse.placed.triangle)
    draw_occupied(axis, found.coarse.layers["points"])
    _frame(axis, found, "raw observations in local regions")


def _draw_6_14(canvas: Canvas, found: CarPark) -> None:
    axis = canvas.add_subplot()
    _gaussians(axis, found)
    _frame(axis, found, "Gaussians, 1 sigma")


def _gaussians(axis: Axes, found: CarPark) -> None:
    held = found.ellipses
    draw_lines(axis, ellipses(held.mean, held.covariance, 1.0, 16), EKF_COLOUR, width=0.6)


def _draw_6_15(canvas: Canvas, found: CarPark) -> None:
    axis, surface = canvas.add_subplot(), found.surface
    east, north = (np.unique(column) for column in surface.point.T)
    height = surface.occupancy.reshape(len(east), len(north)).T
    drawn = axis.pcolormesh(east, north, height, cmap="viridis", vmax=1.5, rasterized=True)
    canvas.colorbar(drawn, ax=axis, label="sum of Gaussians of peak 1", shrink=0.8)
    _frame(axis, found, f"sum of Gaussians on a grid of {COARSE_M:g} m")


def _draw_6_17(canvas: Canvas, found: CarPark) -> None:
    _grid(canvas, found)
    axis = canvas.axes[0]
    axis.plot(*found.searched.corner.T, "+", color=EKF_COLOUR, markersize=7, label="corners")
    axis.legend(fontsize=8)


def _draw_6_16(canvas: Canvas, found: CarPark) -> None:
    axes = canvas.subplots(1, 3, sharex=True, sharey=True)
    draw_occupied(axes[0], found.coarse.layers["points"])
    _gaussians(axes[1], found)
    draw_occupied(axes[2], found.coarse.layers["occupancy"])
    for axis, title in zip(axes, ("raw observations", "Gaussians", "occupied cells"), strict=True):
        draw_regions(axis, found.coarse.placed.triangle)
        _frame(axis, found, title)


def _draw_6_18(canvas: Canvas, found: CarPark) -> None:
    left, right = canvas.subplots(1, 2, sharex=True, sharey=True)
    s = found.searched
    draw_cloud(left, found.image)
    left.plot(*s.corner.T, "+", color=EKF_COLOUR, markersize=7, label="corners")
    for style, name, chosen in (
        ("solid", "high level landmarks", s.gaussians >= LEAST),
        ("dotted", "too few Gaussians", s.gaussians < LEAST),
    ):
        areas = PolyCollection(
            list(s.candidate[chosen]), facecolors="none", edgecolors=HIGH_LEVEL_COLOUR,
            linestyles=style, label=name,
        )  # fmt: skip
        left.add_collection(areas)
    for one in s.found:
        right.plot(*to_world(one.place, one.template.shape.mean).T, ".", markersize=3)
    _frame(left, found, "(a) pairs of corners", legend="lower left")
    _frame(right, found, "(b) templates of the high level landmarks")


_TWO = (12.0, 7.0)

FIGURES = (
    Figure(
        name="N3.20", title="Car park: dead reckoning and feature SLAM beside GPS",
        says="Dead reckoning drifts away from GPS; SLAM stays, with the largest uncertainty far "
        "from the start." + OTHER_LOG,
        experiment=CAR_PARK, draw=_draw_3_20, claims=_claims_3_20, size=_TWO,
    ),
    Figure(
        name="N3.22", title="Car park: final map of DenseSLAM",
        says="The dense map lies on the laser image that SLAM and GPS make together; virtual "
        "landmarks were needed to take in the walls." + OTHER_LOG,
        experiment=CAR_PARK, draw=_draw_3_22, claims=_claims_3_22, size=(7.5, 7.0),
    ),
    Figure(
        name="N3.23", title="Car park: raw returns before and after a loop closes",
        says="The error before the closing is easily observed, and the map is corrected by "
        "it." + OTHER_LOG,
        experiment=CAR_PARK, draw=partial(_closing, layer="points"),
        claims=partial(_closing_claims, layer="points"), size=_TWO,
    ),
    Figure(
        name="N4.14", title="Car park: an occupancy grid before and after a loop closes",
        says="Some 3 m of error before the closing are reduced substantially; the accuracy is that "
        "of the raw observations." + OTHER_LOG,
        experiment=CAR_PARK, draw=partial(_closing, layer="occupancy"),
        claims=_claims_4_14, size=_TWO,
    ),
    Figure(
        name="N4.15", title="Car park: final occupancy grid",
        says="The final grid, with cells of 0.4 m, shows the environment." + OTHER_LOG,
        experiment=CAR_PARK, draw=partial(_grid, fine=True),
        claims=partial(_near_image, what="the grid's occupied cells", layer="occupancy", fine=True),
        size=(7.5, 7.0),
    ),
    Figure(
        name="N6.1", title="Car park: corners of the occupancy grid",
        says="A corner detector finds in the map what cannot be identified from one vantage "
        "point." + OTHER_LOG,
        experiment=CAR_PARK, draw=_draw_6_1, claims=partial(_corner_claims, fine=True), size=_TWO,
    ),
    Figure(
        name="N6.11", title="Car park: trajectory and laser image",
        says="SLAM combined with GPS gives a laser image of the environment." + OTHER_LOG,
        experiment=CAR_PARK, draw=_draw_6_11, claims=_claims_6_11, size=(7.5, 7.0),
    ),
    Figure(
        name="N6.12", title="Car park: raw observations in local regions",
        says="Raw observations fused into the regions are a map of the environment." + OTHER_LOG,
        experiment=CAR_PARK, draw=_draw_6_12,
        claims=partial(_near_image, what="raw observations", layer="points"), size=(7.5, 7.0),
    ),
    Figure(
        name="N6.13", title="Car park: occupancy layer with cells of 0.5 m",
        says="The occupancy layer is another map of the same environment." + OTHER_LOG,
        experiment=CAR_PARK, draw=_grid,
        claims=partial(_near_image, what="the grid's occupied cells", layer="occupancy"),
        size=(7.5, 7.0),
    ),
    Figure(
        name="N6.14", title="Car park: sum of Gaussians with d_min of 0.5 m",
        says="Gaussians, observed ones fused with the map's where nearer than d_min, represent the "
        "same environment." + OTHER_LOG,
        experiment=CAR_PARK, draw=_draw_6_14,
        claims=partial(_near_image, what="the Gaussians' means", layer="sog"), size=(7.5, 7.0),
    ),
    Figure(
        name="N6.15", title="Car park: the sum of Gaussians as a surface",
        says="Evaluated on a grid of 0.5 m, the sum is high where something stands." + OTHER_LOG,
        experiment=CAR_PARK, draw=_draw_6_15, claims=_claims_6_15, size=(7.5, 7.0),
    ),
    Figure(
        name="N6.16", title="Car park: three layers of one run",
        says="Raw observations, Gaussians and a grid of the same data are kept at the same "
        "time." + OTHER_LOG,
        experiment=CAR_PARK, draw=_draw_6_16, claims=_claims_6_16, size=(15.0, 6.4),
    ),
    Figure(
        name="N6.17", title="Car park: corners of the occupancy layer",
        says="The corner detector marks corners of buildings and cars." + OTHER_LOG,
        experiment=CAR_PARK, draw=_draw_6_17, claims=_corner_claims, size=(7.5, 7.0),
    ),
    Figure(
        name="N6.18", title="Car park: high level landmarks",
        says="Pairs of corners up to 7 m apart give rectangles, and the Gaussians in them nine "
        "high level landmarks." + OTHER_LOG,
        experiment=CAR_PARK, draw=_draw_6_18, claims=_claims_6_18, size=_TWO,
    ),
)  # fmt: skip
