"""Nieto 2005, Figs. 6.4, 6.5 and 6.6: how they look."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure as Canvas

from comparisons.arrays import Array
from comparisons.experiments.reproduction import nieto_high_level as claim
from comparisons.experiments.reproduction.drawing import TRUE_PATH_COLOUR, plan
from comparisons.experiments.reproduction.interface import AnyFigure, Figure
from comparisons.experiments.reproduction.nieto_high_level import (
    CORNER_PAIRS,
    HIGH_LEVEL,
    HighLevelDrive,
    HighLevelDrives,
    Pairs,
    Searched,
)
from comparisons.extensions.dense_maps.figure import DENSE_COLOUR, draw_surfaces
from comparisons.extensions.high_level.figure import HIGH_LEVEL_COLOUR, draw_high_level
from comparisons.report.figures.style import draw_trajectory
from comparisons.report.marks import EKF_COLOUR, TRUTH_COLOUR, ellipses

_BESIDE_M = 3.0


def draw_6_4(canvas: Canvas, found: Pairs) -> None:
    """Both pairs of the first drive."""
    axis, one = canvas.add_subplot(), found.each[0]
    draw_surfaces(axis, found.segment)
    _draw_search(axis, one)
    both = one.search.candidate.reshape(-1, 2)
    low, high = both.min(axis=0) - _BESIDE_M, both.max(axis=0) + _BESIDE_M
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    plan(axis, "corners, rectangles around pairs, and the Gaussians in them")
    axis.legend(fontsize=8, loc="lower center", ncols=2)


def draw_6_5(canvas: Canvas, found: HighLevelDrives) -> None:
    """The first search, and the end."""
    left, right = canvas.subplots(1, 2, sharex=True, sharey=True)
    d = found.each[0]
    first = d.searches[0]
    draw_surfaces(left, d.segment)
    _draw_search(left, first)
    left.plot(*first.landmark.T, "+", color=TRUTH_COLOUR, markersize=5, label="point landmarks")
    left.plot(*first.pose[:2], ">", color=EKF_COLOUR, markersize=7, label="vehicle")
    plan(left, f"(a) the first search, {first.time_s:.0f} s")
    left.legend(fontsize=8, loc="lower right")
    _draw_end(right, d)
    right.plot(*d.landmark.T, "+", color=TRUTH_COLOUR, markersize=5, label="point landmarks")
    places = d.run.place[d.run.landmark_index >= 0][
        np.argsort(d.run.landmark_index[d.run.landmark_index >= 0]), :2
    ]
    outline = LineCollection(list(ellipses(places, d.sigma, 1.0)), colors=EKF_COLOUR)
    outline.set_label("1 sigma")
    right.add_collection(outline)
    plan(right, "(b) after the loop, in the end")
    right.legend(fontsize=8, loc="lower right")


def draw_6_6(canvas: Canvas, found: HighLevelDrives) -> None:
    """Templates and axes."""
    axis, d = canvas.add_subplot(), found.each[0]
    _draw_end(axis, d)
    for points in d.placed:
        label = "templates" if points is d.placed[0] else None
        axis.plot(*points.T, ".", color=DENSE_COLOUR, markersize=2.5, label=label, zorder=4)
    axis.plot(*d.landmark.T, "+", color=TRUTH_COLOUR, markersize=5, label="point landmarks")
    plan(axis, "templates of high level landmarks, their axes and rectangles")
    axis.legend(fontsize=8, loc="lower right")


def _draw_search(axis: Axes, one: Searched) -> None:
    """Gaussians, corners, and rectangles, solid where accepted, with the number of Gaussians."""
    axis.plot(*one.point.T, ".", color=DENSE_COLOUR, markersize=1.5, label="Gaussians", zorder=3)
    corner = one.search.corner
    axis.plot(
        *corner.T, "o", color=EKF_COLOUR, markersize=8, markerfacecolor="none", label="corners",
        zorder=4,
    )  # fmt: skip
    closed = _closed(one.search.candidate)
    for style, name, chosen in (
        ("solid", "accepted", one.accepted),
        ("dashed", "rejected", ~one.accepted),
    ):
        if chosen.any():
            lines = LineCollection(list(closed[chosen]), linestyles=style, linewidths=1.2)
            lines.set(color=HIGH_LEVEL_COLOUR, label=name)
            axis.add_collection(lines)
    for area, count in zip(one.search.candidate, one.search.gaussians.tolist(), strict=True):
        top = area[area[:, 1].argmax()]
        axis.annotate(f"{count}", top, xytext=(0, 3), textcoords="offset points", fontsize=9,
                      ha="center", color=HIGH_LEVEL_COLOUR)  # fmt: skip


def _draw_end(axis: Axes, d: HighLevelDrive) -> None:
    draw_surfaces(axis, d.segment)
    draw_trajectory(axis, d.true_path, TRUE_PATH_COLOUR, "true path")
    draw_trajectory(axis, d.path, EKF_COLOUR, "estimated path", "--")
    draw_high_level(axis, d.run)


def _closed(area: Array) -> Array:
    return np.concatenate((area, area[:, :1]), axis=1)


FIGURES: tuple[AnyFigure, ...] = (
    Figure(
        name="N6.4",
        title="Two pairs of corners, one with too few Gaussians",
        source="Nieto 2005, Fig. 6.4",
        says="Four corners make two candidates; the first has enough Gaussians under its "
        "rectangle, the "
        "second has not and is no landmark.",
        experiment=CORNER_PAIRS,
        draw=draw_6_4,
        claims=claim.claims_6_4,
        size=(9.0, 6.0),
    ),
    Figure(
        name="N6.5",
        title="The first search for high level landmarks, and the map after the loop",
        source="Nieto 2005, Fig. 6.5",
        says="Of three candidates that the first search finds one is accepted; once the loop is "
        "closed "
        "four more have been found and are in the state.",
        experiment=HIGH_LEVEL,
        draw=draw_6_5,
        claims=claim.claims_6_5,
        size=(13.0, 6.2),
    ),
    Figure(
        name="N6.6",
        title="The final map of high level landmarks",
        source="Nieto 2005, Fig. 6.6",
        says="The templates' dense information is used for navigation beside the point landmarks, "
        "which makes localisation much more robust.",
        experiment=HIGH_LEVEL,
        draw=draw_6_6,
        claims=claim.claims_6_6,
        size=(8.0, 7.0),
    ),
)
