"""Nieto 2005, Figs. 3.17, 3.18, 4.2 to 4.6, 4.10, 4.12 and 4.16: how they look."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure as Canvas

from comparisons.arrays import Array
from comparisons.estimates.estimate import landmark_blocks
from comparisons.experiments.reproduction import nieto_dense_claims as claim
from comparisons.experiments.reproduction.drawing import draw_slam, plan
from comparisons.experiments.reproduction.interface import AnyFigure, Claim, Experiment, Figure
from comparisons.experiments.reproduction.nieto_dense import (
    COARSENED,
    LAYERED,
    RAW,
    ROUNDED,
    ClosedMap,
    Coarsened,
    Maps,
    Rounds,
)
from comparisons.experiments.reproduction.watched_run import truth_in_order
from comparisons.extensions.dense_maps.figure import (
    draw_error_layer,
    draw_occupied,
    draw_regions,
    draw_surfaces,
)
from comparisons.report.marks import SMOOTHER_COLOUR, TRUTH_COLOUR, ellipses
from ekf_reference.dense.layers.layer import Samples


def _map(
    axis: Axes, m: ClosedMap, samples: Samples, triangle: Array, landmark: Array, title: str
) -> None:
    draw_regions(axis, triangle)
    draw_surfaces(axis, m.segment)
    draw_occupied(axis, samples)
    axis.plot(*landmark.T, "o", color=SMOOTHER_COLOUR, markersize=4, markerfacecolor="none")
    axis.plot(*m.true.T, "*", color=TRUTH_COLOUR, markersize=4)
    plan(axis, title)


def _before_and_after(canvas: Canvas, m: ClosedMap, layer: str) -> None:
    left, right = canvas.subplots(1, 2, sharex=True, sharey=True)
    b, now = m.before, m.mapping
    title = f"before the loop closes, {b.time_s:.0f} s"
    _map(left, m, b.layers[layer], b.triangle, b.landmark, title)
    _map(right, m, now.layers[layer], now.placed.triangle, now.dense.landmark, "after")


def draw_3_17(canvas: Canvas, maps: Maps) -> None:
    """Raw returns before and after."""
    _before_and_after(canvas, maps.closed[0], "points")


def draw_3_18(canvas: Canvas, maps: Maps) -> None:
    """The left top before."""
    m = maps.closed[0]
    axis = canvas.add_subplot()
    b = m.before
    _map(axis, m, b.layers["points"], b.triangle, b.landmark, "left top, before the loop closes")
    west, north = m.true[:, 0].min(), m.true[:, 1].max()
    axis.set(xlim=(west - 10.0, west + 40.0), ylim=(north - 45.0, north + 8.0))


def draw_4_2(canvas: Canvas, maps: Maps) -> None:
    """The feature map among the objects."""
    mapping = maps.closed[0].mapping
    axis, e = canvas.add_subplot(), mapping.ekf.estimate
    poses, true = truth_in_order(mapping.log)
    draw_surfaces(axis, maps.closed[0].segment)
    blocks = landmark_blocks(e.joint_covariance)
    draw_slam(axis, poses.pose[:, :2], e.pose[:, :2], true, e.landmark, blocks)
    plan(axis, "after the loop")
    axis.legend(fontsize=8)


def draw_4_3(canvas: Canvas, maps: Maps) -> None:
    """One grid left, DenseSLAM's right."""
    m, (left, right) = maps.closed[0], canvas.subplots(1, 2, sharex=True, sharey=True)
    now = m.mapping
    none = np.empty((0, 3, 2))
    _map(left, m, now.classic, none, now.dense.landmark, "(a) one grid in the world")
    held = now.layers["occupancy"]
    _map(right, m, held, now.placed.triangle, now.dense.landmark, "(b) DenseSLAM")


def draw_4_4(canvas: Canvas, found: Rounds) -> None:
    """All cells by their occupancy."""
    last = found.each[-1]
    axes = canvas.subplots(1, 2, sharex=True, sharey=True)
    for axis, held, title in (
        (axes[0], last.classic, "(a) one grid in the world"),
        (axes[1], last.dense, "(b) DenseSLAM"),
    ):
        order = np.argsort(held.occupancy, kind="stable")
        drawn = axis.scatter(
            *held.point[order].T, s=0.6, linewidths=0, c=held.occupancy[order], cmap="viridis",
            vmin=0.0, vmax=1.0, rasterized=True,
        )  # fmt: skip
        plan(axis, f"{title}, after {last.number} rounds")
    canvas.colorbar(drawn, ax=list(axes), label="occupancy", shrink=0.8)


def draw_4_5(canvas: Canvas, found: Rounds) -> None:
    """One grid after every round."""
    axes = canvas.subplots(2, 3, sharex=True, sharey=True).ravel()
    for axis, r in zip(axes, found.each, strict=True):
        draw_surfaces(axis, found.segment)
        draw_occupied(axis, r.classic)
        plan(axis, f"round {r.number}: 95 % within {r.classic_error.p95_m:.2f} m")


def draw_4_6(canvas: Canvas, found: Coarsened) -> None:
    """Regions by the size of their cells."""
    axis = canvas.add_subplot()
    drawn = draw_error_layer(axis, found.triangle, found.cell_m)
    drawn.set_clim(0.2, 0.5)
    draw_occupied(axis, found.coarse)
    draw_surfaces(axis, found.segment)
    canvas.colorbar(drawn, ax=axis, label="cell [m]", shrink=0.8)
    plan(axis, "size of cells")


def draw_4_10(canvas: Canvas, maps: Maps) -> None:
    """Particles, and their weights."""
    m, (left, right) = maps.closed[0], canvas.subplots(1, 2, width_ratios=(1.3, 1.0))
    held = m.mapping.layers["particles"]
    none = np.empty((0, 3, 2))
    _map(left, m, held, none, m.mapping.dense.landmark, "particles that weigh more than 0.8")
    right.hist(held.occupancy, bins=50, range=(0.0, 1.0), color=SMOOTHER_COLOUR)
    right.set(xlabel="weight", ylabel="particles")
    right.set_title("weights of all", fontsize=10)


def draw_4_12(canvas: Canvas, maps: Maps) -> None:
    """One-sigma ellipses of all Gaussians."""
    m, axis = maps.closed[0], canvas.add_subplot()
    held = m.ellipses
    outline = ellipses(held.mean, held.covariance, 1.0, 12)
    axis.add_collection(LineCollection(list(outline), colors=SMOOTHER_COLOUR, linewidths=0.3))
    draw_surfaces(axis, m.segment)
    axis.autoscale_view()
    plan(axis, "Gaussians, 1 sigma")


def draw_4_16(canvas: Canvas, maps: Maps) -> None:
    """The layers side by side."""
    m, axes = maps.closed[0], canvas.subplots(1, 3, sharex=True, sharey=True)
    for axis, name in zip(axes, ("occupancy", "particles", "sog"), strict=True):
        draw_regions(axis, m.mapping.placed.triangle)
        draw_occupied(axis, m.mapping.layers[name])
        plan(axis, name)


def _row(
    number: str, title: str, says: str, experiment: Experiment[Any], draw: Callable[..., None],
    claims: Callable[..., list[Claim]], size: tuple[float, float] = (12.0, 6.0),
) -> AnyFigure:  # fmt: skip
    source = f"Nieto 2005, Fig. {number}"
    return Figure(
        name=f"N{number}",
        title=title,
        source=source,
        says=says,
        experiment=experiment,
        draw=draw,
        claims=claims,
        size=size,
    )


FIGURES: tuple[AnyFigure, ...] = (
    _row(
        "3.17", "Raw returns in local regions, before and after a loop closes",
        "The dense map errs most at the left, and is corrected together with the landmarks when "
        "the loop closes.",
        RAW, draw_3_17, claim.claims_3_17,
    ),
    _row(
        "3.18", "Close-up: objects and landmarks err alike",
        "Before the closing the objects carry the same rotation and shift as the landmarks around "
        "them: their errors are highly correlated.",
        RAW, draw_3_18, claim.claims_3_18, (7.0, 7.0),
    ),
    _row(
        "4.2", "Feature SLAM under large noise",
        "Although noise was set high, the landmark map is close to the truth once the loop is "
        "closed, and as good as its ellipses say.",
        LAYERED, draw_4_2, claim.claims_4_2, (8.0, 7.0),
    ),
    _row(
        "4.3", "One occupancy grid, and DenseSLAM's",
        "After the first loop objects are misshapen in one grid in the world's frame, while "
        "DenseSLAM's grids are corrected along with the landmarks.",
        LAYERED, draw_4_3, claim.claims_4_3,
    ),
    _row(
        "4.4", "All cells of both, after ten rounds",
        "One grid has wider walls and misshapen objects; DenseSLAM's keep their shape.",
        ROUNDED, draw_4_4, claim.claims_4_4,
    ),
    _row(
        "4.5", "One occupancy grid, round after round",
        "One grid is never corrected: later rounds draw the same objects in other places.",
        ROUNDED, draw_4_5, claim.claims_4_5, (13.0, 8.5),
    ),
    _row(
        "4.6", "Larger cells in almost empty regions",
        "Regions that hold hardly anything can be kept at a lower resolution.",
        COARSENED, draw_4_6, claim.claims_4_6, (8.5, 7.0),
    ),
    _row(
        "4.10", "Particles and their weights",
        "Most particles are likely occupied: 87 % weigh more than 0.8, 2 % less than 0.5; the map "
        "is much like that of raw returns.",
        LAYERED, draw_4_10, claim.claims_4_10, (12.0, 5.5),
    ),
    _row(
        "4.12", "A sum of Gaussians",
        "Gaussians, fused with the nearest return, represent the objects' surfaces.",
        LAYERED, draw_4_12, claim.claims_4_12, (8.0, 7.0),
    ),
    _row(
        "4.16", "Three layers of one run",
        "Different layers of the same data are kept at the same time, each in its own way (there "
        "the car park, here the simulation).",
        LAYERED, draw_4_16, claim.claims_4_16, (15.0, 5.4),
    ),
)  # fmt: skip
