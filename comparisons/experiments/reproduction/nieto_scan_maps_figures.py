"""Nieto 2005, Figs. 6.7 and 6.8: how they look, and what is claimed by them."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Polygon

from comparisons.arrays import Array
from comparisons.experiments.reproduction.drawing import SIGMAS, TRUE_PATH_COLOUR, chart, plan
from comparisons.experiments.reproduction.interface import (
    AnyFigure,
    Claim,
    Figure,
    at_least,
    at_most,
)
from comparisons.experiments.reproduction.nieto_scan_maps import (
    LAYERS,
    SCAN_MAPS,
    ScanMap,
    ScanMaps,
    Surrounded,
)
from comparisons.extensions.dense_maps.accuracy import OCCUPIED
from comparisons.extensions.dense_maps.figure import (
    DENSE_COLOUR,
    draw_occupied,
    draw_regions,
    draw_surfaces,
)
from comparisons.extensions.scan_landmarks.figure import axes_of, place_covariances
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, ellipses
from ekf_reference.dense.layers.layer import Samples

_AXIS_COLOUR = "#17a2b8"
_KINDS = ((EKF_COLOUR, "template"), (SMOOTHER_COLOUR, "with map"))


def claims_6_7(found: ScanMaps) -> list[Claim]:
    """A dense map without a point landmark."""
    each, layers = found.each, LAYERS
    after = [one.mapping.errors[name].median_m for one in each for name in layers]
    before = [one.error_before(name).median_m for one in each for name in layers]
    more = [
        one.covered(_held(one.mapping.layers[name])) / one.covered(one.template_point)
        for one in each
        for name in layers
    ]
    return [
        at_most(
            "after the loop both layers lie near the true surfaces (median distance of what is "
            "occupied, the worst of the layers and drives)",
            max(after),
            0.4,
            "m",
        ),
        at_most(
            "closing the loop brings them there (median distance over the one before, the worst "
            "of the layers and drives)",
            max(a / b for a, b in zip(after, before, strict=True)),
            1.0,
        ),
        at_least(
            "the maps hold much more than the landmarks' templates by themselves (surface that "
            "lies within 0.5 m of the one over that of the other, the least of the layers and "
            "drives)",
            min(more),
            2.0,
            why="scan landmarks stand on the surfaces and 20 m apart, so that regions end at them: "
            "a quarter of the returns lie where no region can be",
        ),
    ]


def claims_6_8(found: ScanMaps) -> list[Claim]:
    """Where an alignment may begin."""
    basin = found.basin
    far = basin.error_m >= 1.0
    failed = 1.0 - basin.converged[far].mean(axis=0)
    wrong = basin.wrong[far].mean(axis=0)
    return [
        at_most(
            "with the dense map around it a template is less often laid into a local maximum "
            f"(failures over those of the template alone, one start 1 m to {basin.error_m[-1]:g} m "
            f"off, {basin.cases} pairs of a landmark and a scan)",
            float(failed[1] / failed[0]),
            1.0,
        ),
        at_most(
            "nor is it when a prior of that sigma is searched (wrong results over those of the "
            "template alone)",
            float(wrong[1] / wrong[0]),
            1.0,
        ),
    ]


def draw_6_7(canvas: Canvas, found: ScanMaps) -> None:
    """Environment and paths, scan landmarks, and both layers."""
    one = found.each[0]
    axes = canvas.subplots(2, 2, sharex=True, sharey=True)
    _paths(axes[0, 0], one)
    _landmarks(axes[0, 1], one)
    for axis, name, title in (
        (axes[1, 0], "occupancy", "(c) occupancy grid, cells above 0.8"),
        (axes[1, 1], "sog", "(d) sum of Gaussians, means"),
    ):
        draw_surfaces(axis, one.segment)
        draw_regions(axis, one.mapping.placed.triangle)
        draw_occupied(axis, one.mapping.layers[name])
        plan(axis, title)
    corner = one.segment.reshape(-1, 2)
    low, high = corner.min(axis=0) - 3.0, corner.max(axis=0) + 3.0
    axes[0, 0].set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def _paths(axis: Axes, one: ScanMap) -> None:
    draw_surfaces(axis, one.segment)
    truth, estimate = one.mapping.log.truth.poses, one.mapping.ekf.estimate
    if truth is not None:
        axis.plot(*truth.pose[:, :2].T, "-", color=TRUE_PATH_COLOUR, label="true path")
    path = estimate.pose[:, :2]
    axis.plot(*path.T, "--", color=EKF_COLOUR, linewidth=0.9, label="estimated path")
    axis.legend(fontsize=8, loc="best")
    plan(axis, "(a) objects alone, no point landmark")


def _landmarks(axis: Axes, one: ScanMap) -> None:
    estimate = one.mapping.ekf.estimate
    axis.plot(*one.template_point.T, ".", color=DENSE_COLOUR, markersize=2)
    for ends in axes_of(estimate):
        axis.plot(*ends.T, "-", color=_AXIS_COLOUR, linewidth=1.2)
    for outline in ellipses(estimate.pose_landmarks[:, :2], place_covariances(estimate), SIGMAS):
        axis.plot(*outline.T, "-", color=EKF_COLOUR, linewidth=0.7)
    plan(axis, "(b) scan landmarks, axes and 3 sigma")


def draw_6_8(canvas: Canvas, found: ScanMaps) -> None:
    """One landmark alone and with the map around it; how far off alignments may begin."""
    left, middle, right = canvas.subplots(1, 3)
    _template(left, found.shown, with_map=False)
    _template(middle, found.shown, with_map=True)
    basin = found.basin
    for column, (colour, name) in enumerate(_KINDS):
        home, wrong = 100.0 * basin.converged[:, column], 100.0 * basin.wrong[:, column]
        right.plot(basin.error_m, home, "o-", color=colour, label=f"{name}: found from one start")
        right.plot(basin.error_m, wrong, "x:", color=colour, label=f"{name}: searched, wrong")
    right.set_ylim(0.0, 105.0)
    title = f"(c) {basin.cases} pairs of a landmark and a scan"
    chart(right, title, "initial error [m], and 10 degrees a metre", "alignments [%]")


def _template(axis: Axes, one: Surrounded, *, with_map: bool) -> None:
    """In the landmark's axis."""
    draw_surfaces(axis, one.segment)
    if with_map:
        axis.plot(*one.around.T, ".", color="#2b6cb0", markersize=2.5, label="dense map")
        axis.add_patch(Polygon(one.rectangle, fill=False, edgecolor="#777777", linewidth=0.8))
    axis.plot(*one.template.T, ".", color=EKF_COLOUR, markersize=3, label="template")
    axis.plot((3.0, 0.0, 0.0), (0.0, 0.0, 3.0), "-", color=_AXIS_COLOUR, linewidth=1.5)
    low, high = one.rectangle.min(axis=0) - 3.0, one.rectangle.max(axis=0) + 3.0
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axis.set_aspect("equal")
    title = "(b) with the dense map around it" if with_map else "(a) a landmark's template"
    chart(axis, title, "ahead [m]", "left [m]")


def _held(samples: Samples) -> Array:
    return np.asarray(samples.point[samples.occupancy > OCCUPIED])


FIGURES: tuple[AnyFigure, ...] = (
    Figure(
        name="N6.7",
        title="DenseSLAM between the landmarks of Scan-SLAM",
        source="Nieto 2005, Fig. 6.7",
        says="Without a point landmark the local regions are anchored to scan landmarks, and the "
        "dense "
        "maps "
        "between them hold much more than the templates by themselves.",
        experiment=SCAN_MAPS,
        draw=draw_6_7,
        claims=claims_6_7,
        size=(11.0, 9.6),
    ),
    Figure(
        name="N6.8",
        title="A scan landmark with the dense map around it",
        source="Nieto 2005, Fig. 6.8",
        says="A template augmented with the dense map around it makes convergence to a local "
        "maximum "
        "less probable.",
        experiment=SCAN_MAPS,
        draw=draw_6_8,
        claims=claims_6_8,
        size=(14.0, 4.8),
    ),
)
