"""What every map is drawn with."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from comparisons.arrays import Array
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Log
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
}


def draw_trajectory(axis: Axes, position: Array, colour: str, label: str, style: str = "-") -> None:
    """A path (K, 2)."""
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
    """An estimate's trajectory and landmarks. name: `smoother`, `EKF` or `smoother on scans`."""
    colour, marker, style = _LOOK[name]
    draw_trajectory(axis, estimate.pose[:, :2], colour, f"{name} trajectory", style)
    outline = ellipses(estimate.landmark, estimate.landmark_covariances(), 3.0)
    if len(estimate.landmark) or not len(estimate.pose_landmarks):
        label = f"{name} landmarks, 3 sigma"
        draw_landmarks(axis, estimate.landmark, outline, colour, marker, label)


def estimates_figure(
    log: Log, dead_reckoned: Array, estimates: dict[str, Estimate], title: str
) -> Figure:
    """Estimates by name, on top of what the log knows."""
    figure, axis = plan()
    if log.truth.poses is not None:
        pose = log.truth.poses.pose
        axis.plot(pose[:, 0], pose[:, 1], color="#bbbbbb", linewidth=2.5, label="truth", zorder=0)
    if log.positions is not None:
        draw_reference(axis, log.positions.position_m, ".", "GPS")
    if log.truth.landmarks is not None:
        draw_reference(axis, log.truth.landmarks.position_m, "*", "true landmarks")
    for name, estimate in estimates.items():
        draw_estimate(axis, name, estimate)
    axis.set_aspect("equal", adjustable="datalim")
    if log.truth.poses is not None:
        draw_aside(axis, dead_reckoned, "dead reckoning")
    entitle(axis, title)
    return figure


def plan() -> tuple[Figure, Axes]:
    """An empty map."""
    figure = blank(9.0, 7.5, fitted=False)
    axis = figure.add_subplot()
    figure.subplots_adjust(**_MARGINS)
    axis.set_xlabel("east [m]")
    axis.set_ylabel("north [m]")
    axis.grid(visible=True, color="#eeeeee")
    return figure, axis


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
