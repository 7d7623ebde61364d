"""Dense maps, and where something moves in them."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from comparisons.arrays import Array
from comparisons.extensions.dense_maps.figure import (
    draw_error_layer,
    draw_occupied,
    draw_regions,
    draw_surfaces,
    plan,
    thinned,
)
from comparisons.pipeline.dense_map import DenseMapping
from comparisons.report.marks import TRUTH_COLOUR
from comparisons.report.picture import blank
from ekf_reference.dense.dynamic import DynamicLayer
from ekf_reference.dense.layers.layer import Samples

DYNAMIC_COLOUR = "#e08a1e"
_BESIDE_M = 1.0


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
        plan(axis)
    axis = axes[len(panels)]
    sigma_m = dense.dense.neglected.sigma_m(np.arange(len(mapping.placed.triangle)))
    drawn = draw_error_layer(axis, mapping.placed.triangle, sigma_m)
    figure.colorbar(drawn, ax=axis, label="standard deviation [m]", shrink=0.8)
    axis.set_title("how far left-out correlations may still move the data")
    plan(axis)
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
    x, y = thinned(dynamic.points(mapping.placed)).T
    axis.scatter(x, y, s=3.0, marker="s", linewidths=0, color=DYNAMIC_COLOUR, zorder=4)
    axis.plot(*mapping.dense.landmark.T, "+", color=TRUTH_COLOUR, markersize=6, zorder=5)
    axis.set_title("where occupancy changed (orange), and what is occupied in the end")
    plan(axis)
    seen = dynamic.grid.samples(mapping.placed).point
    if len(seen):  # regions may reach far beyond
        low, high = seen.min(axis=0) - _BESIDE_M, seen.max(axis=0) + _BESIDE_M
        axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    return figure
