"""What the reproduced figures have in common to look at. Computes nothing."""

from __future__ import annotations

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from comparisons.arrays import Array
from comparisons.report.marks import TRUTH_COLOUR

TRUE_PATH_COLOUR = "#bbbbbb"
SIGMAS = 3.0
Place = Literal["best", "center", "lower left", "lower right", "lower center"]
"""Of a legend."""


def plan(axis: Axes, title: str, *, legend: Place | None = None, columns: int = 1) -> None:
    """A map's labels, with a title. legend: where, if there is one."""
    axis.set_aspect("equal")
    chart(axis, title, "east [m]", "north [m]", legend=legend, columns=columns)


def chart(
    axis: Axes, title: str, x: str, y: str, *, legend: Place | None = "best", columns: int = 1
) -> None:
    """A curve's labels. legend: where, in so many columns, if there is one."""
    axis.set_title(title, fontsize=10)
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    axis.grid(visible=True, color="#eeeeee")
    if legend is not None:
        axis.legend(fontsize=8, loc=legend, ncols=columns)


def frame(axis: Axes, point: Array, margin_m: float) -> None:
    """Show what lies around points (N, 2)."""
    low, high = point.min(axis=0) - margin_m, point.max(axis=0) + margin_m
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def draw_lines(
    axis: Axes,
    line: Array,
    colour: str,
    label: str = "",
    width: float | None = None,
    order: int = 2,
    style: str = "solid",
) -> None:
    """Lines through points (L, P, 2) each, such as outlines of ellipses; width: as usual."""
    lines = LineCollection(
        list(line), colors=colour, linewidths=width, zorder=order, linestyles=style
    )
    if label:
        lines.set_label(label)
    axis.add_collection(lines)


def closed(outline: Array) -> Array:
    """(N, P + 1, 2) polygons (N, P, 2), each with its first corner once more."""
    return np.concatenate((outline, outline[:, :1]), axis=1)


def mark(axis: Axes, time_s: float, label: str) -> None:
    """An instant."""
    axis.axvline(time_s, color=TRUTH_COLOUR, linestyle=":", linewidth=0.9, label=label)
