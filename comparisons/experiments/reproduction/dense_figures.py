"""Pictures of what local regions do. Functions draw on a given axis and compute nothing."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from comparisons.arrays import Array
from comparisons.experiments.reproduction.decorrelation_example import DecorrelationExample
from comparisons.experiments.reproduction.drawing import chart, frame, plan
from comparisons.report.figures.style import draw_reference
from comparisons.report.marks import EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR

WORLD_COLOUR, LOCAL_COLOUR = EKF_COLOUR, SMOOTHER_COLOUR
_CORNER_COLOURS = (SMOOTHER_COLOUR, SCANS_COLOUR, TRUTH_COLOUR)
_AROUND_M = 12.0


def draw_region(axis: Axes, example: DecorrelationExample) -> None:
    """The region's axes, the point in it and the distant landmark (Nieto 2005, Fig. 3.5 a)."""
    first, second, third = example.triangle[0]
    point, distant = example.point[0], example.distant[0]
    axis.plot(*example.landmark.T, "*", color=TRUTH_COLOUR, markersize=5, label="landmarks")
    for end in (second, third):
        axis.plot(*np.stack((first, end)).T, color=LOCAL_COLOUR, linewidth=1.6)
    axis.plot(*np.stack((first, point)).T, ":", color=WORLD_COLOUR, label="point $i$ in its region")
    axis.plot(*np.stack((point, distant)).T, "--", color=SCANS_COLOUR, label="to landmark $j$")
    axis.plot(*point, "o", color=WORLD_COLOUR, markersize=5)
    shown = np.concatenate((example.triangle[0], point[None], distant[None]))
    frame(axis, shown, _AROUND_M)
    plan(axis, "", legend="best")


def draw_base_correlation(axis: Axes, time_s: Array, coefficients: Array) -> None:
    """Of the point with its base landmarks, (T, 3, 2) in east and north (Fig. 3.5 b)."""
    for corner, colour in enumerate(_CORNER_COLOURS):
        axis.plot(time_s, coefficients[:, corner, 0], "-", color=colour, label=f"L{corner + 1}")
        axis.plot(time_s, coefficients[:, corner, 1], "--", color=colour)
    chart(axis, "", "time [s]", "correlation, base and point")


def draw_decorrelation(axis: Axes, time_s: Array, world: Array, local: Array) -> None:
    """Coefficients (T, 2, 2) of a distant landmark with the point (Fig. 3.5 c)."""
    ours = (np.diagonal(of, axis1=1, axis2=2) for of in (world, local))
    _draw_both(axis, time_s, *ours)
    axis.set_ylim(-0.02, 1.02)
    chart(axis, "", "time [s]", "correlation, $j$ and point")


def draw_sigma(axis: Axes, time_s: Array, world_m: Array, local_m: Array) -> None:
    """Standard deviations (T, 2) of the point (Fig. 3.5 d)."""
    _draw_both(axis, time_s, world_m, local_m)
    axis.set_ylim(bottom=0.0)
    chart(axis, "", "time [s]", "standard deviation [m]")


def _draw_both(axis: Axes, time_s: Array, world: Array, local: Array) -> None:
    """(T, 2) each: solid in east or along axis a, dashed in north or along axis b."""
    for value, colour, name in (
        (world, WORLD_COLOUR, "in the world"),
        (local, LOCAL_COLOUR, "in its region"),
    ):
        axis.plot(time_s, value[:, 0], "-", color=colour, label=name)
        axis.plot(time_s, value[:, 1], "--", color=colour)


def draw_displacement(axis: Axes, time_s: Array, world_m: Array, local_m: Array) -> None:
    """How far the point has moved, (T,) each (Nieto 2005, Fig. 3.12 a)."""
    axis.plot(time_s, world_m, "-", color=WORLD_COLOUR, label="in the world")
    axis.plot(time_s, local_m, "--", color=LOCAL_COLOUR, label="in its region")
    chart(axis, "", "time [s]", "change of place [m]")


def draw_wandering(axis: Axes, point: Array, true_point: Array | None) -> None:
    """The point (T, 2) in the world as time goes on, and where it is (Fig. 3.12 b)."""
    axis.plot(*point.T, ".", color=WORLD_COLOUR, markersize=4, label="estimates")
    axis.plot(*point[0], "o", color=WORLD_COLOUR, markerfacecolor="none", label="the first")
    if true_point is not None:
        draw_reference(axis, true_point[None], "*", "truth")
    axis.set_aspect("equal", adjustable="datalim")
    chart(axis, "", "east [m]", "north [m]")


def draw_example_3_1(figure: Figure, example: DecorrelationExample) -> None:
    """Nieto 2005, Fig. 3.5: solid in east or along axis a, dashed in north or along axis b."""
    axes, found, time = figure.subplots(2, 2).ravel(), example.correlations, example.time_s
    draw_region(axes[0], example)
    draw_base_correlation(axes[1], time, example.with_base)
    draw_decorrelation(axes[2], time, found.world, found.local)
    draw_sigma(axes[3], time, found.sigma_world_m, found.sigma_local_m)


def draw_example_3_2(figure: Figure, example: DecorrelationExample) -> None:
    """Nieto 2005, Fig. 3.12."""
    left, right = figure.subplots(1, 2)
    draw_displacement(left, example.time_s, example.moved.world_m, example.moved.local_m)
    draw_wandering(right, example.point, example.true_point)
