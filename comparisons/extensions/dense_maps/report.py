"""What `slamcheck map` reports: map.json, what is printed, and its folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from comparisons.arrays import Array
from comparisons.checks.accuracy import Accuracy
from comparisons.checks.filter import EkfFigures
from comparisons.extensions.dense_maps.accuracy import OCCUPIED, SurfaceError, surface_error_rows
from comparisons.extensions.dense_maps.check import FirstCondition
from comparisons.extensions.dense_maps.figure import (
    draw_error_layer,
    draw_occupied,
    draw_regions,
    draw_surfaces,
    plan,
    thinned,
)
from comparisons.extensions.dense_maps.job import DenseMapping
from comparisons.extensions.dense_maps.source import BeforeClosing
from comparisons.figures import Model, Named, rows_of
from comparisons.pipeline.clock import Clock
from comparisons.report.html.map import MapContent, estimate_map
from comparisons.report.job_report import JobReport, job_entries
from comparisons.report.map_export import rasterise, write_image, write_ros_map
from comparisons.report.marks import EKF_COLOUR, TRUTH_COLOUR
from comparisons.report.models import JobResult
from comparisons.report.picture import blank
from comparisons.report.terminal import Summary
from comparisons.words import Row
from ekf_reference.dense.dense_map import DenseMap, ReturnTally
from ekf_reference.dense.dynamic import DynamicLayer, places
from ekf_reference.dense.layers.layer import LayerSamples
from graphslam.scan.clouds import write_cloud

_LIKELY = 0.5
LEAST_COVERED = 0.1
"""Share of the returns in regions, below which a map says little of what was scanned."""


class LayerResult(Model):
    """A layer of the dense map.

    Attributes:
        samples: cells, points or Gaussians that it holds.
        occupied: those with a probability above 0.8.
    """

    samples: Annotated[int, Named("samples")]
    occupied: Annotated[int, Named("occupied samples")]


@dataclass(kw_only=True)
class ReturnsResult(ReturnTally):
    """What became of the scanner's returns.

    Attributes:
        waiting: returns that still wait at the end.
        lost: returns that a full buffer dropped, or that were lost with a landmark.
    """

    waiting: int
    lost: int

    @property
    def covered(self) -> float:
        """Share of the returns that the map has; all of none."""
        return (self.fused + self.late) / self.returns if self.returns else 1.0

    def parts(self) -> dict[str, int]:
        """Return all returns by what became of them, each of which is counted once."""
        return {
            "fused at once": self.fused,
            "fused after a delay": self.late,
            "outside all regions": self.outside,
            "waiting at the end": self.waiting,
            "lost while waiting": self.lost,
        }


class DynamicResult(Model):
    """Places where something moves.

    Attributes:
        places: connected places.
        cells: cells of these places.
        area_m2: area of these places.
        fast: cells that a fast change showed first.
        slow: cells that a slow change showed first.
        compared: pairs of maps that were compared.
        deformed: pairs that could not be, since the region's landmarks had moved against each
            other.
        landmarks: ids of landmarks of the map that stand in such a place.
    """

    places: Annotated[int, Named("places", "{}")]
    cells: int
    area_m2: Annotated[float, Named("area", "{:.1f} m2")]
    fast: int
    slow: int
    compared: int
    deformed: int
    landmarks: Annotated[list[int], Named("landmarks in these places", lambda ids: f"{len(ids)}")]


class MapResult(JobResult):
    """`map.json`: a dense map between the filter's landmarks.

    Attributes:
        ekf: the filter.
        accuracy: errors of the filter against truth or GPS.
        scan_landmarks: landmarks that are templates of scans.
        regions: local regions of the map.
        first_condition: how the regions met the first condition.
        resolution_m: size of a cell.
        returns: what became of the returns.
        lacks: why the map says little of what was scanned; empty where it has enough.
        layers: each layer, by name.
        surface_errors: distance from true surfaces, by layer.
        closing: the update that moved the regions the most.
        dynamic: places where something moves.
    """

    ekf: EkfFigures
    accuracy: Accuracy | None = None
    scan_landmarks: int
    regions: int
    first_condition: FirstCondition
    resolution_m: float
    returns: ReturnsResult
    lacks: str
    layers: dict[str, LayerResult]
    surface_errors: dict[str, SurfaceError]
    closing: BeforeClosing | None
    dynamic: DynamicResult | None


class MapReport(JobReport[DenseMapping, MapResult]):
    """Report of `slamcheck map`."""

    @staticmethod
    def build(mapping: DenseMapping, read: Clock | None = None) -> MapResult:
        """The findings, read being the time that reading the log took."""
        m = mapping
        returns = returns_result(m.dense.dense)
        return MapResult(
            scan_landmarks=len(m.ekf.estimate.pose_landmarks),
            regions=len(m.placed.triangle),
            first_condition=FirstCondition.of(m.dense),
            resolution_m=m.dense.options.resolution_m,
            returns=returns,
            lacks=_lacks(m, returns),
            layers={
                name: LayerResult(
                    samples=len(s.point), occupied=int(np.count_nonzero(s.occupancy > OCCUPIED))
                )
                for name, s in m.layers.items()
            },
            surface_errors=dict(m.errors),
            closing=m.dense.before,
            dynamic=_dynamic(m),
            remarks=[*_remarks(m), *m.known.remarks],
            **job_entries(m.known, MapResult, read, m.dense.clock),
        )

    @property
    def outcome(self) -> str:
        """A map of almost nothing decides nothing."""
        return "unverified" if self.result.lacks else "agree"

    @property
    def headline(self) -> str:
        """How much of what was scanned the map holds."""
        returns = self.result.returns
        fused = f"{returns.fused + returns.late:,} of {returns.returns:,}"
        return f"map: {fused} scan returns in {self.result.regions:,} regions"

    @property
    def lines(self) -> Sequence[tuple[str, str]]:
        """What the map holds, and how good it is."""
        result, returns = self.result, self.result.returns
        errors = [
            f"{name} {error.median_m:.3f} m"
            for name, error in result.surface_errors.items()
            if math.isfinite(error.median_m)
        ]
        layers = [f"{name} {layer.occupied:,}" for name, layer in result.layers.items()]
        parts = [f"{count:,} {what}" for what, count in returns.parts().items() if count]
        lines = [
            ("returns", f"{returns.returns:,}: {', '.join(parts)}"),
            ("occupied", f"{', '.join(layers)} samples"),
        ]
        if errors:
            lines.append(("surfaces", f"median distance to true ones: {', '.join(errors)}"))
        return lines

    @property
    def job_rows(self) -> Sequence[Row]:
        """Rows of the map."""
        return _map_rows(self.result)

    def summary(self) -> Summary:
        """Return what the command prints; what the map lacks is why it decides nothing."""
        lacks = self.result.lacks
        return replace(super().summary(), look=self.outcome, reasons=[lacks] if lacks else [])

    def drawn(self) -> MapContent:
        """Return what the page's map shows: the filter, and the first layer's occupied cells."""
        m = self.found
        name, samples = next(iter(m.layers.items()))
        cloud = (f"{name}: occupied", samples.point[samples.occupancy > OCCUPIED])
        return estimate_map(m.log, "EKF", EKF_COLOUR, m.ekf.estimate, cloud=cloud)

    def figures(self) -> Mapping[str, Figure]:
        """Return the map, and where something moves."""
        mapping = self.found
        figures = {"map": dense_map_figure(mapping)}
        if (dynamic := mapping.dense.dense.dynamic) is not None:
            figures["dynamic-map"] = dynamic_figure(mapping, dynamic)
        return figures

    def files(self) -> Mapping[str, Callable[[Path], object]]:
        """Return regions, and each layer in several formats; without regions there are none.

        Layers as clouds need Open3D: raises MissingLibraryError.
        """
        mapping = self.found
        if not len(mapping.placed.triangle):
            return {}

        def write_regions(path: Path) -> None:
            path.write_text(regions_csv(mapping), encoding="utf-8")

        return {"regions.csv": write_regions, **_layer_files(mapping)}


def _map_rows(result: MapResult) -> list[Row]:
    returns = result.returns
    counts = {
        "scans": returns.scans,
        "returns": returns.returns,
        **{f"returns {what}": count for what, count in returns.parts().items()},
    }
    rows = list[Row]()
    if result.scan_landmarks:
        rows.append(Row("EKF", "scan landmarks", f"{result.scan_landmarks:,}"))
    rows += result.first_condition.rows()
    rows += [Row("Scanner", name, f"{count:,}") for name, count in counts.items()]
    for name, layer in result.layers.items():
        rows += rows_of("Layers", layer, before=f"{name}: ")
    rows += surface_error_rows(result.surface_errors)
    if result.dynamic is not None:
        rows += rows_of("Moving objects", result.dynamic)
    return rows


def _layer_files(mapping: DenseMapping) -> dict[str, Callable[[Path], object]]:
    cloud = mapping.prepared.config.cloud
    files: dict[str, Callable[[Path], object]] = {}
    cell_m = mapping.dense.options.resolution_m
    for name, layer in mapping.dense.dense.layers.items():
        raster = rasterise(layer, mapping.placed, cell_m)
        files[f"{name}.png"] = partial(write_image, raster)
        files[f"{name}.pgm"] = partial(write_ros_map, raster)
        samples = mapping.layers[name]
        point = samples.point[samples.occupancy > _LIKELY]
        if cloud is not None and len(point):
            flat = np.column_stack((point, np.zeros(len(point))))
            files[f"{name}.{cloud}"] = partial(write_cloud, points=flat)
    if mapping.dense.dense.dynamic is not None:
        raster = rasterise(mapping.dense.dense.dynamic, mapping.placed, cell_m)
        files["dynamic.png"] = partial(write_image, raster)
    return files


def regions_csv(mapping: DenseMapping) -> str:
    """One row per region: corners, where they are, returns noted, and the error layer.

    A corner is a landmark's id, s and the number of a scan landmark, or `a+b` for a virtual one
    behind landmarks a and b.
    """
    dense, ids = mapping.dense.dense, mapping.ekf.estimate.landmark_id
    pair = dense.regions.virtual.pair
    neglected = dense.neglected
    numbers = np.arange(len(dense.regions.base))
    mean_m = neglected.sigma_m(numbers)
    lines = [
        "region,corner1,corner2,corner3,x1,y1,x2,y2,x3,y3,fused_at_once,sigma_m,sigma_largest_m"
    ]
    for region, base in enumerate(dense.regions.base.tolist()):
        names = [
            "+".join(mapping.dense.name_of(n, ids) for n in ([c] if c >= 0 else pair[-1 - c]))
            for c in base
        ]
        places = [f"{v:.4f}" for v in mapping.placed.triangle[region].ravel()]
        sigma = [f"{v:.4f}" for v in (mean_m[region], neglected.largest_m[region])]
        count = f"{neglected.count[region]:.0f}"
        lines.append(",".join([str(region), *names, *places, count, *sigma]))
    return "\n".join(lines) + "\n"


def returns_result(dense: DenseMap) -> ReturnsResult:
    """Return what has become of a scanner's returns in a map."""
    waiting = lost = 0
    if dense.waiting is not None:
        waiting = len(dense.waiting.points.scan)
        lost = dense.waiting.counts.dropped + dense.waiting.counts.vanished
    return ReturnsResult(**vars(dense.tally), waiting=waiting, lost=lost)


def _dynamic(m: DenseMapping) -> DynamicResult | None:
    layer = m.dense.dense.dynamic
    if layer is None:
        return None
    number = places(layer.points(m.placed))
    under = m.dense.is_dynamic(m.ekf.estimate.landmark)
    return DynamicResult(
        places=int(number.max(initial=-1)) + 1,
        cells=len(number),
        area_m2=layer.area_m2(m.placed),
        **vars(layer.counters),
        landmarks=m.ekf.estimate.landmark_id[under].tolist(),
    )


def _lacks(m: DenseMapping, returns: ReturnsResult) -> str:
    if not len(m.placed.triangle):
        return (
            "no three landmarks meet the conditions of a region "
            f"({m.dense.options.first_condition}), so the map is empty"
        )
    if returns.covered >= LEAST_COVERED:
        return ""
    share = f"only {100.0 * returns.covered:.2g} % of the returns are in the map"
    if returns.outside >= returns.lost + returns.waiting:
        why = (
            f"{returns.outside:,} lie outside all regions, which are triangles of landmarks: some "
            "have to stand among and behind what is scanned (Nieto 2005, sections 3.4 and 3.5)"
        )
    else:
        why = f"{returns.lost + returns.waiting:,} waited for a region that never came about"
    return f"{share}: {why}"


def _remarks(m: DenseMapping) -> list[str]:
    remarks = [m.ekf.breakdown] if m.ekf.breakdown else []
    if m.dense.before is not None:
        remarks.append(
            f"the update at {m.dense.before.time_s:.1f} s moved the regions by "
            f"{m.dense.before.shift_m:.2f} m (rms), and the map with them"
        )
    return remarks


DYNAMIC_COLOUR = "#e08a1e"
_BESIDE_M = 1.0


def dense_map_figure(mapping: DenseMapping) -> Figure:
    """One panel per layer, before and after the largest correction where there was one."""
    dense, before = mapping.dense, mapping.dense.before
    panels: list[tuple[str, LayerSamples, Array, Array]] = []
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
