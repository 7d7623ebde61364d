"""Nieto 2005, Figs. 3.20 to 3.23, 4.14, 4.15, 6.1 and 6.11 to 6.18: how they look."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure as Canvas

from comparisons.arrays import Array
from comparisons.experiments.reproduction import nieto_car_park as claim
from comparisons.experiments.reproduction.drawing import SIGMAS, plan
from comparisons.experiments.reproduction.interface import AnyFigure, Claim, Figure
from comparisons.experiments.reproduction.nieto_car_park import CAR_PARK, COARSE_M, CarPark
from comparisons.extensions.dense_maps.figure import draw_cloud, draw_occupied, draw_regions
from comparisons.extensions.high_level.figure import HIGH_LEVEL_COLOUR
from comparisons.report.figures.style import draw_landmarks, draw_reference
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR, ellipses
from ekf_reference.dense.layers.layer import Samples

_MARGIN_M = 6.0


def _frame(axis: Axes, found: CarPark, title: str) -> None:
    """The same part of the park in all figures: where the vehicle and the landmarks are."""
    shown = np.vstack((found.aided_path, found.landmark))
    low, high = shown.min(axis=0) - _MARGIN_M, shown.max(axis=0) + _MARGIN_M
    plan(axis, title)
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def draw_3_20(canvas: Canvas, found: CarPark) -> None:
    """Dead reckoning and SLAM, both with GPS."""
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
        _frame(axis, found, title)
        axis.legend(fontsize=8, loc="lower left")


def draw_3_22(canvas: Canvas, found: CarPark) -> None:
    """Raw points over the laser image."""
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


def draw_3_23(canvas: Canvas, found: CarPark) -> None:
    """Raw points before and after."""
    _closing(canvas, found, "points")


def draw_4_14(canvas: Canvas, found: CarPark) -> None:
    """Cells before and after."""
    _closing(canvas, found, "occupancy")


def _grid(canvas: Canvas, found: CarPark, samples: Samples, cell_m: float) -> Axes:
    """All cells by their occupancy, in one subplot."""
    axis = canvas.add_subplot()
    order = np.argsort(samples.occupancy, kind="stable")
    east, north = samples.point[order].T
    drawn = axis.scatter(
        east, north, s=5.0, marker="s", linewidths=0, c=samples.occupancy[order],
        cmap="viridis", vmin=0.0, vmax=1.0, rasterized=True,
    )  # fmt: skip
    canvas.colorbar(drawn, ax=axis, label="occupancy", shrink=0.8)
    _frame(axis, found, f"occupancy, cells of {cell_m:g} m")
    return axis


def draw_4_15(canvas: Canvas, found: CarPark) -> None:
    """The grid of 0.4 m."""
    _grid(canvas, found, found.fine.layers["occupancy"], claim.CELL_M)


def draw_6_1(canvas: Canvas, found: CarPark) -> None:
    """The grid with corners, and a close-up of the upper part, as in the thesis."""
    left, right = canvas.subplots(1, 2)
    corner = found.searched_fine.corner
    for axis in (left, right):
        draw_occupied(axis, found.fine.layers["occupancy"])
        axis.plot(*corner.T, "+", color=EKF_COLOUR, markersize=7, label="corners")
    _frame(left, found, "(a) what the grid holds occupied, and corners")
    _frame(right, found, "(b) the upper part")
    north = corner[:, 1].max()
    right.set_ylim(north - 16.0, north + 3.0)
    left.legend(fontsize=8)


def draw_6_11(canvas: Canvas, found: CarPark) -> None:
    """GPS and the laser image."""
    axis = canvas.add_subplot()
    draw_cloud(axis, found.image)
    axis.plot(*found.gps.T, "-", color=TRUTH_COLOUR, linewidth=1.2, label="GPS")
    axis.plot(*found.gps[0], "^", color=EKF_COLOUR, label="start")
    _frame(axis, found, "laser image by SLAM and GPS")
    axis.legend(fontsize=8, loc="lower left")


def draw_6_12(canvas: Canvas, found: CarPark) -> None:
    """Raw observations in regions."""
    axis = canvas.add_subplot()
    draw_regions(axis, found.coarse.placed.triangle)
    draw_occupied(axis, found.coarse.layers["points"])
    _frame(axis, found, "raw observations in local regions")


def draw_6_13(canvas: Canvas, found: CarPark) -> None:
    """The grid of 0.5 m."""
    _grid(canvas, found, found.coarse.layers["occupancy"], COARSE_M)


def draw_6_14(canvas: Canvas, found: CarPark) -> None:
    """Ellipses of one sigma."""
    axis = canvas.add_subplot()
    _gaussians(axis, found)
    _frame(axis, found, "Gaussians, 1 sigma")


def _gaussians(axis: Axes, found: CarPark) -> None:
    held = found.ellipses
    outline = ellipses(held.mean, held.covariance, 1.0, 16)
    axis.add_collection(LineCollection(list(outline), colors=EKF_COLOUR, linewidths=0.6))


def draw_6_15(canvas: Canvas, found: CarPark) -> None:
    """The sum's height."""
    axis, surface = canvas.add_subplot(), found.surface
    east, north = (np.unique(column) for column in surface.point.T)
    height = surface.occupancy.reshape(len(east), len(north)).T
    drawn = axis.pcolormesh(east, north, height, cmap="viridis", vmax=1.5, rasterized=True)
    canvas.colorbar(drawn, ax=axis, label="sum of Gaussians of peak 1", shrink=0.8)
    _frame(axis, found, f"sum of Gaussians on a grid of {COARSE_M:g} m")


def draw_6_17(canvas: Canvas, found: CarPark) -> None:
    """Corners over the grid of 0.5 m."""
    axis = _grid(canvas, found, found.coarse.layers["occupancy"], COARSE_M)
    axis.plot(*found.searched.corner.T, "+", color=EKF_COLOUR, markersize=7, label="corners")
    axis.legend(fontsize=8)


def draw_6_16(canvas: Canvas, found: CarPark) -> None:
    """Raw, Gaussians, grid."""
    axes = canvas.subplots(1, 3, sharex=True, sharey=True)
    draw_occupied(axes[0], found.coarse.layers["points"])
    _gaussians(axes[1], found)
    draw_occupied(axes[2], found.coarse.layers["occupancy"])
    for axis, title in zip(axes, ("raw observations", "Gaussians", "occupied cells"), strict=True):
        draw_regions(axis, found.coarse.placed.triangle)
        _frame(axis, found, title)


def draw_6_18(canvas: Canvas, found: CarPark) -> None:
    """Rectangles around pairs, and the templates of those accepted."""
    left, right = canvas.subplots(1, 2, sharex=True, sharey=True)
    s = found.searched
    draw_cloud(left, found.image)
    left.plot(*s.corner.T, "+", color=EKF_COLOUR, markersize=7, label="corners")
    for style, name, chosen in (
        ("solid", "high level landmarks", s.gaussians >= claim.LEAST),
        ("dotted", "too few Gaussians", s.gaussians < claim.LEAST),
    ):
        areas = PolyCollection(
            list(s.candidate[chosen]), facecolors="none", edgecolors=HIGH_LEVEL_COLOUR,
            linestyles=style, label=name,
        )  # fmt: skip
        left.add_collection(areas)
    for one in s.found:
        x, y = claim.placed_template(one).T
        right.plot(x, y, ".", markersize=3)
    _frame(left, found, "(a) pairs of corners")
    _frame(right, found, "(b) templates of the high level landmarks")
    left.legend(fontsize=8, loc="lower left")


def _row(
    number: str,
    title: str,
    says: str,
    draw: Callable[[Canvas, CarPark], None],
    claims: Callable[[CarPark], list[Claim]],
    size: tuple[float, float] = (7.5, 7.0),
) -> AnyFigure:
    return Figure(
        name=f"N{number}",
        title=f"Car park: {title}",
        source=f"Nieto 2005, Fig. {number}",
        says=f"{says} Our log of the car park is another part of the drives than the thesis'.",
        experiment=CAR_PARK,
        draw=draw,
        claims=claims,
        size=size,
    )


_TWO = (12.0, 7.0)

FIGURES: tuple[AnyFigure, ...] = (
    _row(
        "3.20", "dead reckoning and feature SLAM beside GPS",
        "Dead reckoning drifts away from GPS; SLAM stays, with the largest uncertainty far from "
        "the start.",
        draw_3_20, claim.claims_3_20, _TWO,
    ),
    _row(
        "3.22", "final map of DenseSLAM",
        "The dense map lies on the laser image that SLAM and GPS make together; virtual landmarks "
        "were needed to take in the walls.",
        draw_3_22, claim.claims_3_22,
    ),
    _row(
        "3.23", "raw returns before and after a loop closes",
        "The error before the closing is easily observed, and the map is corrected by it.",
        draw_3_23, claim.claims_3_23, _TWO,
    ),
    _row(
        "4.14", "an occupancy grid before and after a loop closes",
        "Some 3 m of error before the closing are reduced substantially; the accuracy is that of "
        "the raw observations.",
        draw_4_14, claim.claims_4_14, _TWO,
    ),
    _row(
        "4.15", "final occupancy grid",
        "The final grid, with cells of 0.4 m, shows the environment.",
        draw_4_15, claim.claims_4_15,
    ),
    _row(
        "6.1", "corners of the occupancy grid",
        "A corner detector finds in the map what cannot be identified from one vantage point.",
        draw_6_1, claim.claims_6_1, _TWO,
    ),
    _row(
        "6.11", "trajectory and laser image",
        "SLAM combined with GPS gives a laser image of the environment.",
        draw_6_11, claim.claims_6_11,
    ),
    _row(
        "6.12", "raw observations in local regions",
        "Raw observations fused into the regions are a map of the environment.",
        draw_6_12, claim.claims_6_12,
    ),
    _row(
        "6.13", "occupancy layer with cells of 0.5 m",
        "The occupancy layer is another map of the same environment.",
        draw_6_13, claim.claims_6_13,
    ),
    _row(
        "6.14", "sum of Gaussians with d_min of 0.5 m",
        "Gaussians, observed ones fused with the map's where nearer than d_min, represent the same "
        "environment.",
        draw_6_14, claim.claims_6_14,
    ),
    _row(
        "6.15", "the sum of Gaussians as a surface",
        "Evaluated on a grid of 0.5 m, the sum is high where something stands.",
        draw_6_15, claim.claims_6_15,
    ),
    _row(
        "6.16", "three layers of one run",
        "Raw observations, Gaussians and a grid of the same data are kept at the same time.",
        draw_6_16, claim.claims_6_16, (15.0, 6.4),
    ),
    _row(
        "6.17", "corners of the occupancy layer",
        "The corner detector marks corners of buildings and cars.",
        draw_6_17, claim.claims_6_17,
    ),
    _row(
        "6.18", "high level landmarks",
        "Pairs of corners up to 7 m apart give rectangles, and the Gaussians in them nine high "
        "level landmarks.",
        draw_6_18, claim.claims_6_18, _TWO,
    ),
)  # fmt: skip
