"""Nieto 2005, Figs. 5.10 to 5.12: how they look."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure as Canvas

from comparisons.experiments.reproduction import nieto_car_park_scans as claim
from comparisons.experiments.reproduction.drawing import plan
from comparisons.experiments.reproduction.interface import AnyFigure, Claim, Figure
from comparisons.experiments.reproduction.nieto_car_park_scans import (
    EXPERIMENT,
    CarParkRun,
    CarParkScans,
)
from comparisons.experiments.reproduction.nieto_scan_slam_figures import axes_at
from comparisons.extensions.dense_maps.figure import draw_cloud
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR, ellipses

_MARGIN_M = 15.0
_SIGMA = 1.0
_FORMS = ("the thesis' form", "joined segments (ours)")


def _both(canvas: Canvas, found: CarParkScans) -> tuple[tuple[Axes, CarParkRun, str], ...]:
    """Two plans of the same part of the park."""
    left, right = canvas.subplots(1, 2, sharex=True, sharey=True)
    low, high = found.reference.min(axis=0) - _MARGIN_M, found.reference.max(axis=0) + _MARGIN_M
    left.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    runs = (found.published, found.joined)
    return tuple(zip((left, right), runs, _FORMS, strict=True))


def draw_5_10(canvas: Canvas, found: CarParkScans) -> None:
    """Paths, templates and ellipses over the laser image."""
    for axis, run, form in _both(canvas, found):
        draw_cloud(axis, found.image)
        axis.plot(*found.gps.T, "-", color=TRUTH_COLOUR, linewidth=1.0, label="GPS")
        axis.plot(*run.path.T, "-", color=EKF_COLOUR, linewidth=1.0, label="Scan-SLAM")
        _templates(axis, run)
        outline = LineCollection(
            list(ellipses(run.held.place[:, :2], run.held.covariance, _SIGMA)),
            colors=SMOOTHER_COLOUR, linewidths=1.0, label="landmarks, 1 sigma", zorder=4,
        )  # fmt: skip
        axis.add_collection(outline)
        off = np.median(run.path_gps)
        plan(
            axis, f"{form}: {len(run.held.landmark_index)} landmarks, {off:.2f} m from GPS (median)"
        )
    canvas.axes[0].legend(fontsize=8, loc="lower left")


def _templates(axis: Axes, run: CarParkRun) -> None:
    axis.plot(*run.held.placed.T, ".", color="#111111", markersize=1.5, label="templates", zorder=3)


def draw_5_11(canvas: Canvas, found: CarParkScans) -> None:
    """Templates and their axes."""
    for axis, run, form in _both(canvas, found):
        _templates(axis, run)
        frames = LineCollection(list(axes_at(run.held.place, 3.0)), colors=EKF_COLOUR)
        frames.set(label="axes", linewidths=1.0, zorder=4)
        axis.add_collection(frames)
        plan(axis, f"{form}: {len(run.held.landmark_index)} landmarks")
    canvas.axes[0].legend(fontsize=8, loc="lower left")


def draw_5_12(canvas: Canvas, found: CarParkScans) -> None:
    """A template on a scan, half of the others being laid better."""
    left, right = canvas.subplots(1, 2)
    for axis, run, form in zip((left, right), (found.published, found.joined), _FORMS, strict=True):
        one = run.shown
        axis.plot(*one.scan.T, ".", color=SMOOTHER_COLOUR, markersize=4, label="scan")
        axis.plot(*one.template.T, "o", color=EKF_COLOUR, markersize=4, markerfacecolor="none",
                  markeredgewidth=0.7, label="template")  # fmt: skip
        plan(axis, f"{form}: {one.off_m:.2f} m from the nearest returns (median)")
        axis.set(xlabel="ahead [m]", ylabel="left [m]")
        axis.legend(fontsize=8, loc="best")


def _row(
    number: str,
    title: str,
    says: str,
    draw: Callable[[Canvas, CarParkScans], None],
    claims: Callable[[CarParkScans], list[Claim]],
) -> AnyFigure:
    return Figure(
        name=f"N{number}",
        title=f"Car park, Scan-SLAM: {title}",
        source=f"Nieto 2005, Fig. {number}",
        says=f"{says} Our log of the car park is another part of the drives than the thesis'.",
        experiment=EXPERIMENT,
        draw=draw,
        claims=claims,
        size=(13.0, 7.0),
    )


FIGURES: tuple[AnyFigure, ...] = (
    _row(
        "5.10", "path, templates and laser image",
        "Six landmarks were incorporated. The results are not as accurate as those of feature "
        "SLAM, since segments sometimes tell too little; templates with more information would "
        "improve them.",
        draw_5_10, claim.claims_5_10,
    ),
    _row(
        "5.11", "map of the landmarks",
        "The landmark covariances are consistent with the errors, so uncertainty remains.",
        draw_5_11, claim.claims_5_11,
    ),
    _row(
        "5.12", "alignment of a template with a scan",
        "Scan matching lays the landmark's template on the whole new scan.",
        draw_5_12, claim.claims_5_12,
    ),
)  # fmt: skip
