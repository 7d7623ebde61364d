"""Pictures of dense maps. They draw on a given axis and compute nothing."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.figure import Figure

from comparisons.arrays import Array
from comparisons.extensions.dense_maps.accuracy import OCCUPIED
from comparisons.extensions.dense_maps.check import DenseAgreement
from comparisons.extensions.dense_maps.source import DenseRun
from comparisons.logs.log import Log
from comparisons.report.marks import EKF_COLOUR
from comparisons.report.picture import blank
from ekf_reference.dense.layers.layer import LayerSamples

DENSE_COLOUR = "#1b3a4b"
REGION_COLOUR = "#8fb996"
_MOST_DRAWN = 200_000


def draw_regions(axis: Axes, triangle: Array) -> None:
    """Outlines of regions (R, 3, 2)."""
    axis.add_collection(
        PolyCollection(list(triangle), facecolors="none", edgecolors=REGION_COLOUR, linewidths=0.5)
    )


def draw_occupied(axis: Axes, samples: LayerSamples, colour: str = DENSE_COLOUR) -> None:
    """What is occupied, as dots, as the thesis draws it."""
    point = samples.point[samples.occupancy > OCCUPIED]
    size = 1.2 if len(point) < 20_000 else 0.5
    x, y = thinned(point).T
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
        plan(axis)
    figure.colorbar(drawn, ax=list(axes), label="distance [m]", shrink=0.8)
    return figure


def draw_cloud(axis: Axes, point: Array) -> None:
    """Points (N, 2) in the background."""
    x, y = thinned(point).T
    axis.scatter(x, y, s=1.0, linewidths=0, color="#bbbbbb", zorder=2)


def draw_distances(axis: Axes, point: Array, distance_m: Array) -> PathCollection:
    """Points (N, 2) by their distance (N,) to something, yellow from half a metre on."""
    (x, y), by = thinned(point).T, thinned(distance_m)
    return axis.scatter(
        x, y, s=1.5, linewidths=0, c=by, cmap="viridis", vmin=0.0, vmax=0.5, zorder=3
    )


def thinned(rows: Array) -> Array:
    """At most so many rows (N, ...) as a picture shows, evenly."""
    return rows[:: -(-len(rows) // _MOST_DRAWN) or 1]


def plan(axis: Axes) -> None:
    """A map's axes."""
    axis.set_aspect("equal")
    axis.set_xlabel("east [m]")
    axis.set_ylabel("north [m]")
