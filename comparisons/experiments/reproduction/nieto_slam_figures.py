"""Nieto 2005, Figs. 2.8 to 2.12 and 3.4: how they look."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from comparisons.experiments.reproduction import nieto_slam_claims as claim
from comparisons.experiments.reproduction.drawing import chart, draw_error, draw_slam, mark, plan
from comparisons.experiments.reproduction.interface import AnyFigure, Claim, Figure
from comparisons.experiments.reproduction.nieto_slam import (
    FIXED_EXPERIMENT,
    LOOP_EXPERIMENT,
    Fixed,
    LoopDrive,
    Loops,
    Moment,
)
from comparisons.report.figures.style import draw_correlation
from comparisons.report.marks import SMOOTHER_COLOUR

_LONGER = 10.0


def _moment(axis: Axes, d: LoopDrive, m: Moment, title: str) -> None:
    until = d.poses.time_s <= m.time_s
    draw_slam(axis, d.true_path[until], d.pose[until, :2], m.true, m.landmark, m.blocks)
    plan(axis, title)


def draw_2_8(canvas: Canvas, loops: Loops) -> None:
    """Before and after the closing."""
    d, axes = loops.drives[0], canvas.subplots(1, 2, sharex=True, sharey=True)
    _moment(axes[0], d, d.before, f"before the loop closes, {d.before.time_s:.1f} s")
    _moment(axes[1], d, d.after, f"after, {d.after.time_s:.1f} s")
    axes[0].legend(fontsize=8, loc="center")


def draw_2_9(canvas: Canvas, loops: Loops) -> None:
    """The same, where the map is farthest from the start."""
    draw_2_8(canvas, loops)
    d = loops.drives[0]
    canvas.axes[0].legend(fontsize=8, loc="lower right")
    west, north = d.true_path[:, 0].min(), d.true_path[:, 1].max()
    for axis in canvas.axes:
        axis.set(xlim=(west - 10.0, west + 35.0), ylim=(north - 35.0, north + 10.0))


def draw_2_10(canvas: Canvas, loops: Loops) -> None:
    """Errors of the pose between their bounds, and one landmark's deviations."""
    d = loops.drives[0]
    axes = canvas.subplots(2, 2).ravel()
    names = (("east", "m", 1.0), ("north", "m", 1.0), ("heading", "deg", 180.0 / np.pi))
    for i, (name, unit, scale) in enumerate(names):
        error, sigma = scale * d.poses.error[:, i], scale * d.poses.sigma[:, i]
        draw_error(axes[i], d.poses.time_s, error, sigma)
        chart(axes[i], f"error in {name}", "time [s]", f"[{unit}]")
    for column, style, name in ((0, "-", "east"), (1, "--", "north")):
        axes[3].plot(
            d.poses.time_s, d.first_landmark_m[:, column], style, color=SMOOTHER_COLOUR, label=name
        )
    chart(axes[3], "deviation of the first landmark", "time [s]", "sigma [m]")


def draw_2_11(canvas: Canvas, loops: Loops) -> None:
    """Four normalised covariance matrices."""
    d = loops.drives[0]
    titles = ("a quarter of the loop", "before the closing", "after it", "after three loops")
    moments = (d.quarter, d.before, d.after, d.end)
    for axis, m, title in zip(canvas.subplots(2, 2).ravel(), moments, titles, strict=True):
        draw_correlation(axis, m.coefficients)
        axis.set_title(f"{title}: mean {m.mean_correlation:.2f}", fontsize=10)


def draw_2_12(canvas: Canvas, found: Fixed) -> None:
    """The matrix without and with positions, and how it went."""
    axes = canvas.subplots(1, 3)
    for axis, m, title in zip(axes, (found.before, found.after), ("before", "after"), strict=False):
        draw_correlation(axis, m.coefficients)
        axis.set_title(f"{title} {len(found.fix_s)} positions", fontsize=10)
    axes[2].plot(found.time_s, found.mean_correlation, color=SMOOTHER_COLOUR)
    for time in found.fix_s.tolist():
        mark(axes[2], time, "")
    chart(axes[2], "positions (dotted)", "time [s]", "mean coefficient", legend=False)


def draw_3_4(canvas: Canvas, loops: Loops) -> None:
    """Ellipses before the closing, and where it takes the landmarks."""
    d, axes = loops.drives[0], canvas.subplots(1, 2, sharex=True, sharey=True)
    _moment(axes[0], d, d.before, "neighbours are alike in their uncertainty")
    _moment(axes[1], d, d.after, f"and in how the closing moves them ({_LONGER:g} times)")
    for start, end in zip(d.before.landmark, d.after.landmark, strict=False):
        shown = start + _LONGER * (end - start)
        axes[1].plot(*np.stack((start, shown)).T, "-", color=SMOOTHER_COLOUR, linewidth=1.2)
    axes[0].legend(fontsize=8, loc="center")


def _row(
    number: str, title: str, says: str, draw: Callable[[Canvas, Loops], None],
    claims: Callable[[Loops], list[Claim]], size: tuple[float, float] = (11.0, 5.0),
) -> AnyFigure:  # fmt: skip
    source = f"Nieto 2005, Fig. {number}"
    return Figure(
        name=f"N{number}",
        title=title,
        source=source,
        says=says,
        experiment=LOOP_EXPERIMENT,
        draw=draw,
        claims=claims,
        size=size,
    )


FIGURES: tuple[AnyFigure, ...] = (
    _row(
        "2.8",
        "Feature SLAM before and after a loop closes",
        "On a loop of 255 m the estimate drifts, most at the far side, and closing the loop "
        "corrects the map.",
        draw_2_8,
        claim.claims_2_8,
    ),
    _row(
        "2.9",
        "The far corner of the same map",
        "The landmarks' errors lie within their 3-sigma ellipses, and errors and ellipses shrink "
        "when the loop closes.",
        draw_2_9,
        claim.claims_2_9,
    ),
    _row(
        "2.10",
        "Errors and stated deviations along the drive",
        "The filter's stated deviations fit its actual errors, and a landmark's uncertainty falls "
        "with every observation of the map.",
        draw_2_10,
        claim.claims_2_10,
        (11.0, 7.0),
    ),
    _row(
        "2.11",
        "Correlation of the map as it is explored and closed",
        "The map becomes more correlated when the loop closes, and more still on further loops.",
        draw_2_11,
        claim.claims_2_11,
        (8.0, 8.0),
    ),
    Figure(
        name="N2.12",
        title="Correlation after a few absolute observations",
        source="Nieto 2005, Fig. 2.12",
        says="A few absolute observations of the vehicle take the correlation out of the map "
        "rapidly.",
        experiment=FIXED_EXPERIMENT,
        draw=draw_2_12,
        claims=claim.claims_2_12,
        size=(12.0, 4.2),
    ),
    _row(
        "3.4",
        "Close landmarks have close errors",
        "Landmarks that are close to each other are highly correlated, about equally uncertain, "
        "and moved alike when the loop closes.",
        draw_3_4,
        claim.claims_3_4,
    ),
)
