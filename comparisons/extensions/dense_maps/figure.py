"""Pictures of dense maps. They draw on a given axis and compute nothing."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.figure import Figure

from comparisons.estimates.estimate import Array
from comparisons.extensions.dense_maps.accuracy import OCCUPIED
from comparisons.extensions.dense_maps.check import DenseAgreement
from comparisons.extensions.dense_maps.source import DenseRun
from comparisons.logs.log import Log
from comparisons.pipeline.dense_map import DenseMapping
from comparisons.report.picture import blank
from comparisons.report.plots import EKF_COLOUR, TRUTH_COLOUR
from ekf_reference.dense.dynamic import DynamicLayer
from ekf_reference.dense.layers.layer import Samples

DENSE_COLOUR = "#1b3a4b"
DYNAMIC_COLOUR = "#e08a1e"
REGION_COLOUR = "#8fb996"
_MOST_DRAWN = 200_000
_BESIDE_M = 1.0


def draw_regions(axis: Axes, triangle: Array) -> None:
    """Outlines of regions (R, 3, 2)."""
    axis.add_collection(
        PolyCollection(list(triangle), facecolors="none", edgecolors=REGION_COLOUR, linewidths=0.5)
    )


def draw_occupied(axis: Axes, samples: Samples, colour: str = DENSE_COLOUR) -> None:
    """What is occupied, as dots, as the thesis draws it."""
    point = samples.point[samples.occupancy > OCCUPIED]
    size = 1.2 if len(point) < 20_000 else 0.5
    x, y = _thinned(point).T
    axis.scatter(x, y, s=size, marker="s", linewidths=0, color=colour, zorder=3)


def draw_error_layer(axis: Axes, triangle: Array, sigma_m: Array) -> PolyCollection:
    """Regions (R, 3, 2) by a standard deviation (R,); white where there is none."""
    shown = np.flatnonzero(np.isfinite(sigma_m))
    regions = PolyCollection(
        list(triangle[shown]), array=sigma_m[shown], cmap="viridis", edgecolors="white"
    )
    axis.add_collection(regions)
    axis.autoscale_view()
    return regions


def draw_surfaces(axis: Axes, segment: Array) -> None:
    """True surfaces (S, 4)."""
    lines = LineCollection(list(segment.reshape(-1, 2, 2)), colors=EKF_COLOUR, linewidths=0.5)
    axis.add_collection(lines)


def dense_check_figure(dense: DenseRun, check: DenseAgreement, log: Log) -> Figure:
    """Every layer of the filter's map over the smoother's, coloured by their distance."""
    count = len(check.layers)
    figure = blank(7.4 * count, 6.4)
    axes = np.atleast_1d(figure.subplots(1, count, sharex=True, sharey=True))
    placed = dense.dense.regions.placed(dense.landmark)
    for axis, (name, layer) in zip(axes, check.layers.items(), strict=True):
        draw_regions(axis, placed.triangle)
        if log.truth.surfaces is not None:
            draw_surfaces(axis, log.truth.surfaces.segment)
        draw_cloud(axis, check.smoother_point)
        drawn = draw_distances(axis, layer.point, layer.distance_m)
        axis.set_title(f"{name}: median {layer.median_m:.3f} m from the smoother's returns (grey)")
        _plan(axis)
    figure.colorbar(drawn, ax=list(axes), label="distance [m]", shrink=0.8)
    return figure


def draw_cloud(axis: Axes, point: Array) -> None:
    """Points (N, 2) in the background."""
    x, y = _thinned(point).T
    axis.scatter(x, y, s=1.0, linewidths=0, color="#bbbbbb", zorder=2)


def draw_distances(axis: Axes, point: Array, distance_m: Array) -> PathCollection:
    """Points (N, 2) by their distance (N,) to something, yellow from half a metre on."""
    x, y = _thinned(point).T
    return axis.scatter(
        x,
        y,
        s=1.5,
        linewidths=0,
        c=_thinned(distance_m),
        cmap="viridis",
        vmin=0.0,
        vmax=0.5,
        zorder=3,
    )


def _thinned(rows: Array) -> Array:
    """At most so many rows (N, ...) as a picture shows, evenly."""
    return rows[:: -(-len(rows) // _MOST_DRAWN) or 1]


def _plan(axis: Axes) -> None:
    axis.set_aspect("equal")
    axis.set_xlabel("east [m]")
    axis.set_ylabel("north [m]")


def dense_map_figure(mapping: DenseMapping) -> Figure:
    """One panel per layer, before and after the largest correction where there was one."""
    dense, before = mapping.dense, mapping.dense.before
    panels: list[tuple[str, Samples, Array, Array]] = []
    for name, samples in mapping.layers.items():
        if before is not None:
            title = f"{name}, before {before.time_s:.1f} s"
            panels.append((title, before.layers[name], before.triangle, before.landmark))
        panels.append((name, samples, mapping.placed.triangle, dense.landmark))
    title, none = "one grid in the world's frame", np.empty((0, 3, 2))
    panels.append((title, mapping.classic, none, dense.landmark))
    rows = -(-(len(panels) + 1) // 2)
    figure = blank(13.0, 5.4 * rows)
    axes: list[Axes] = list(figure.subplots(rows, 2).ravel())
    for axis, (title, samples, triangle, landmark) in zip(axes, panels, strict=False):
        draw_regions(axis, triangle)
        if mapping.log.truth.surfaces is not None:
            draw_surfaces(axis, mapping.log.truth.surfaces.segment)
        draw_occupied(axis, samples)
        axis.plot(*landmark.T, "+", color=TRUTH_COLOUR, markersize=4)
        axis.set_title(title)
        _plan(axis)
    axis = axes[len(panels)]
    sigma_m = dense.dense.neglected.sigma_m(np.arange(len(mapping.placed.triangle)))
    drawn = draw_error_layer(axis, mapping.placed.triangle, sigma_m)
    figure.colorbar(drawn, ax=axis, label="standard deviation [m]", shrink=0.8)
    axis.set_title("how far left-out correlations may still move the data")
    _plan(axis)
    for spare in axes[len(panels) + 1 :]:
        spare.set_axis_off()
    return figure


def dynamic_figure(mapping: DenseMapping, dynamic: DynamicLayer) -> Figure:
    """Where something moves, over what is occupied."""
    figure = blank(8.6, 6.4)
    axis = figure.subplots()
    draw_regions(axis, mapping.placed.triangle)
    if mapping.log.truth.surfaces is not None:
        draw_surfaces(axis, mapping.log.truth.surfaces.segment)
    for samples in mapping.layers.values():
        draw_occupied(axis, samples)
    x, y = _thinned(dynamic.points(mapping.placed)).T
    axis.scatter(x, y, s=3.0, marker="s", linewidths=0, color=DYNAMIC_COLOUR, zorder=4)
    axis.plot(*mapping.dense.landmark.T, "+", color=TRUTH_COLOUR, markersize=6, zorder=5)
    axis.set_title("where occupancy changed (orange), and what is occupied in the end")
    _plan(axis)
    seen = dynamic.grid.samples(mapping.placed).point
    if len(seen):  # regions may reach far beyond
        low, high = seen.min(axis=0) - _BESIDE_M, seen.max(axis=0) + _BESIDE_M
        axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    return figure
