"""Nieto 2005, Figs. 5.8 and 5.9: how they look."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure as Canvas

from comparisons.arrays import Array
from comparisons.experiments.reproduction import nieto_scan_slam as claim
from comparisons.experiments.reproduction.drawing import SIGMAS, plan
from comparisons.experiments.reproduction.interface import AnyFigure, Figure
from comparisons.experiments.reproduction.nieto_scan_slam import (
    CORNER_M,
    EXPERIMENT,
    ScanDrive,
    ScanDrives,
    ScanMap,
)
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR, ellipses
from ekf_reference.core.geometry import rotation

_OBJECT_COLOUR = "#aaaaaa"
_BESIDE_M = 4.0


def draw_5_8(canvas: Canvas, found: ScanDrives) -> None:
    """Before the loop closes, and at the end; the end by the thesis' settings."""
    left, right, thesis = canvas.subplots(1, 3, sharex=True, sharey=True)
    d, other = found.shown, found.shown_published
    _draw(left, d, d.before, d.path_before)
    _draw(right, d, d.after, d.path)
    then, now = d.errors_m
    plan(left, f"(a) before the loop closes, {d.closing_s:.0f} s; landmarks off by {then:.1f} m")
    plan(right, f"(b) after; the same landmarks off by {now:.1f} m (RMS)")
    _draw(thesis, other, other.after, other.path)
    ends = "closed" if other.closed else "missed"
    plan(
        thesis,
        f"(c) by the thesis' settings, {len(other.after.landmark_index)} landmarks, loop {ends}; "
        f"off by {other.after.rms_m:.1f} m",
    )
    canvas.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=6,
                  fontsize=9)  # fmt: skip


def draw_5_9(canvas: Canvas, found: ScanDrives) -> None:
    """The left top, at the end."""
    axis, d = canvas.add_subplot(), found.shown
    _draw(axis, d, d.after, d.path, axis_m=2.0, dot=4.0)
    there = d.segment.reshape(-1, 2)
    there = there[(there[:, 0] < CORNER_M[0]) & (there[:, 1] > CORNER_M[1])]
    low, high = there.min(axis=0) - _BESIDE_M, there.max(axis=0) + _BESIDE_M
    plan(axis, "the left top, with 3-sigma ellipses of the axes")
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axis.legend(fontsize=8, loc="lower right")


def _draw(
    axis: Axes, d: ScanDrive, held: ScanMap, path: Array, axis_m: float = 4.0, dot: float = 1.0
) -> None:
    objects = LineCollection(list(d.segment.reshape(-1, 2, 2)), colors=_OBJECT_COLOUR)
    objects.set(label="objects", linewidths=1.2, zorder=1)
    axis.add_collection(objects)
    axis.plot(*d.true_path.T, "-", color=TRUTH_COLOUR, linewidth=1.0, label="true path")
    axis.plot(*path.T, "--", color=EKF_COLOUR, linewidth=1.0, label="estimated path")
    axis.plot(*held.placed.T, ".", color="#111111", markersize=dot, label="templates", zorder=3)
    frames = LineCollection(list(axes_at(held.place, axis_m)), colors=SMOOTHER_COLOUR)
    frames.set(label="axes", linewidths=1.2, zorder=4)
    axis.add_collection(frames)
    outline = LineCollection(list(ellipses(held.place[:, :2], held.covariance, SIGMAS)))
    outline.set(color=SMOOTHER_COLOUR, label="3 sigma", linewidths=0.8, zorder=4)
    axis.add_collection(outline)


def axes_at(place: Array, length_m: float) -> Array:
    """(Q, 3, 2) ahead's end, origin, left's end of axes at places (Q, 3)."""
    ends = length_m * np.array(((1.0, 0.0), (0.0, 0.0), (0.0, 1.0)))
    drawn = [ends @ rotation(float(at[2])).T + at[:2] for at in place]
    return np.array(drawn).reshape(-1, 3, 2)


FIGURES: tuple[AnyFigure, ...] = (
    Figure(
        name="N5.8",
        title="Scan-SLAM among objects, before and after the loop closes",
        source="Nieto 2005, Fig. 5.8",
        says="Pieces of scans serve as landmarks of an EKF; the estimated path follows the true "
        "one, "
        "and once the loop is closed the error between true and estimated objects is smaller.",
        experiment=EXPERIMENT,
        draw=draw_5_8,
        claims=claim.claims_5_8,
        size=(21.0, 7.6),
    ),
    Figure(
        name="N5.9",
        title="Zoom of the left top: objects, templates and their axes",
        source="Nieto 2005, Fig. 5.9",
        says="The templates add the sensor's information in detail; the ellipses bound their axes.",
        experiment=EXPERIMENT,
        draw=draw_5_9,
        claims=claim.claims_5_9,
        size=(8.0, 7.0),
    ),
)
