"""What every map is drawn with."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from comparisons.arrays import Array
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import ExternalEstimate
from comparisons.report.marks import (
    EKF_COLOUR,
    SCANS_COLOUR,
    SMOOTHER_COLOUR,
    TRUTH_COLOUR,
    ellipses,
)
from comparisons.report.picture import blank

_MOST_DRAWN = 100_000
_MARGINS = {"left": 0.085, "right": 0.985, "bottom": 0.07, "top": 0.93}
"""Of a map; fixed, for finding them takes half as long as drawing."""
_LOOK = {
    "smoother": (SMOOTHER_COLOUR, "s", "-"),
    "EKF": (EKF_COLOUR, "o", "--"),
    "smoother on scans": (SCANS_COLOUR, "^", "-."),
    "FastSLAM": (SCANS_COLOUR, "^", "-."),
}
_ELLIPSES = 20
"""So many poses of a trajectory have one."""


def given_or_new(axis: Axes | None) -> Axes:
    """Return given axes, or those of a new figure, which a notebook shows."""
    if axis is not None:
        return axis
    from matplotlib import pyplot  # takes long to load, and a report's figures need no window

    return pyplot.figure(layout="constrained").add_subplot()


def plot_trajectory(
    estimate: Estimate | ExternalEstimate,
    axis: Axes | None = None,
    *,
    name: str = "estimate",
    colour: str = EKF_COLOUR,
    style: str = "-",
) -> Axes:
    """Draw where an estimate went, with 3-sigma ellipses of some of its poses.

    Args:
        estimate: Of this project's estimators, of `read_estimate`, or built from arrays.
        axis: Axes to draw on; None for those of a new figure.
        name: What the legend calls it.
        colour: Of the line and of the ellipses, as matplotlib takes it.
        style: Of the line, as matplotlib takes it.

    Returns:
        The axes. Ellipses are of 20 poses at even steps, the first and the last among them, and
        only where the estimate has pose covariances.
    """
    axis = given_or_new(axis)
    label_plan(axis)
    pose = np.asarray(estimate.pose)
    draw_trajectory(axis, pose, colour, f"{name} trajectory", style)
    if estimate.pose_covariance is not None:
        rows = np.unique(np.linspace(0.0, len(pose) - 1.0, _ELLIPSES).round().astype(int))
        spread = np.asarray(estimate.pose_covariance)[rows, :2, :2]
        outline = ellipses(pose[rows, :2], spread, 3.0)
        axis.add_collection(LineCollection(list(outline), colors=colour, linewidths=0.5, alpha=0.5))
    return axis


def draw_trajectory(axis: Axes, position: Array, colour: str, label: str, style: str = "-") -> None:
    """A path (K, 2 or more columns)."""
    axis.plot(position[:, 0], position[:, 1], style, color=colour, linewidth=0.9, label=label)


def draw_aside(axis: Axes, position: Array, label: str) -> None:
    """A path (K, 2 or more columns) that is cut off where it leaves what else is drawn."""
    x, y = position[:, 0], position[:, 1]
    line = Line2D(x, y, color="#999999", linestyle=":", linewidth=0.9, label=label)
    axis.add_artist(line)  # unlike plot, this leaves the limits alone


def draw_landmarks(
    axis: Axes, position: Array, outline: Array, colour: str, marker: str, label: str
) -> None:
    """Landmarks (L, 2) with their ellipses' outlines (L, P, 2)."""
    axis.add_collection(LineCollection(list(outline), colors=colour, linewidths=0.7, alpha=0.8))
    axis.plot(
        position[:, 0],
        position[:, 1],
        marker,
        color=colour,
        markersize=4,
        markerfacecolor="none",
        label=label,
    )


def draw_reference(axis: Axes, position: Array, marker: str, label: str) -> None:
    """True or surveyed places (N, 2), without uncertainty."""
    axis.plot(
        position[:, 0],
        position[:, 1],
        marker,
        color=TRUTH_COLOUR,
        markersize=5 if marker == "*" else 1.5,
        linestyle="none",
        label=label,
        zorder=1,
    )


def draw_estimate(axis: Axes, name: str, estimate: Estimate) -> None:
    """An estimate's trajectory and landmarks. name: one of those that have a look."""
    colour, marker, style = _LOOK[name]
    plot_trajectory(estimate, axis, name=name, colour=colour, style=style)
    outline = ellipses(estimate.landmark, estimate.landmark_covariances(), 3.0)
    if len(estimate.landmark) or not len(estimate.pose_landmarks):
        label = f"{name} landmarks, 3 sigma"
        draw_landmarks(axis, estimate.landmark, outline, colour, marker, label)


def plan() -> tuple[Figure, Axes]:
    """An empty map."""
    figure = blank(9.0, 7.5, fitted=False)
    axis = figure.add_subplot()
    figure.subplots_adjust(**_MARGINS)
    label_plan(axis)
    return figure, axis


def label_plan(axis: Axes) -> None:
    """Name the axes of a map, and draw a metre equally long on both."""
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_xlabel("east [m]")
    axis.set_ylabel("north [m]")
    axis.grid(visible=True, color="#eeeeee")


def entitle(axis: Axes, title: str) -> None:
    """A map's title, and its legend, once everything is drawn."""
    axis.set_title(title, fontsize=10, parse_math=False)
    axis.legend(fontsize=8, loc="best")


def draw_cloud(axis: Axes, points: Array) -> None:
    """What scans saw, (P, 2 or more) from above, at most so many points that a picture shows."""
    shown = points[:: max(1, len(points) // _MOST_DRAWN)]
    axis.plot(
        shown[:, 0], shown[:, 1], ".", color="#999999", markersize=0.6, label="scans", zorder=0
    )


def draw_correlation(axis: Axes, coefficients: Array) -> None:
    """Correlation coefficients (n, n) as grey levels, black for 1 (Nieto 2005, Fig. 2.11)."""
    axis.imshow(coefficients, cmap="Greys", vmin=0.0, vmax=1.0, interpolation="nearest")
    axis.set_xlabel("state entry: pose, then landmarks in order of arrival")
