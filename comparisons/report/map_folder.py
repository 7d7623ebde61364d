"""The folder that the map job leaves: map.json, a picture, each layer in several formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from comparisons.atomic import fresh_folder
from comparisons.estimates.folder import FILES as ESTIMATE_FILES
from comparisons.estimates.folder import write_estimate
from comparisons.extensions.dense_maps.figure import dense_map_figure, dynamic_figure
from comparisons.extensions.dense_maps.source import LAYERS
from comparisons.pipeline.dense_map import DenseMapping
from comparisons.report.map_export import rasterise, write_image, write_ros_map
from comparisons.report.map_models import MapResult
from comparisons.report.picture import save
from graphslam.scan.clouds import write_cloud

_SUFFIXES = ("png", "pgw", "pgm", "yaml", "pcd", "ply")
MAP_CONTENTS = frozenset(
    {"map.json", "map.png", "regions.csv", "dynamic.png", "dynamic.pgw", "dynamic-map.png"}
    | {f"{layer}.{suffix}" for layer in LAYERS for suffix in _SUFFIXES}
    | {f"ekf/{name}" for name in ESTIMATE_FILES}
)
"""What the folder holds; a folder with nothing else may be replaced by the next."""
_LIKELY = 0.5


def write_map_folder(
    mapping: DenseMapping, result: MapResult, folder: Path, cloud: str | None = None
) -> None:
    """Write everything; the folder appears whole or not at all. Raises InputError.

    cloud: `pcd` or `ply` for the layers as clouds too, which needs Open3D: raises
    Open3dMissingError. Without regions there are no layers to write.
    """
    with fresh_folder(folder, MAP_CONTENTS) as work:
        (work / "ekf").mkdir()
        write_estimate(mapping.ekf.estimate, work / "ekf")
        save(dense_map_figure(mapping), work / "map.png")
        dynamic = mapping.dense.dense.dynamic
        if dynamic is not None:
            save(dynamic_figure(mapping, dynamic), work / "dynamic-map.png")
        if len(mapping.placed.triangle):
            _write_layers(mapping, work, cloud)
            (work / "regions.csv").write_text(regions_csv(mapping), encoding="utf-8")
        (work / "map.json").write_text(result.model_dump_json(indent=2) + "\n", encoding="utf-8")


def _write_layers(mapping: DenseMapping, work: Path, cloud: str | None) -> None:
    cell_m = mapping.dense.options.resolution_m
    for name, layer in mapping.dense.dense.layers.items():
        raster = rasterise(layer, mapping.placed, cell_m)
        write_image(raster, work / f"{name}.png")
        write_ros_map(raster, work / f"{name}.pgm")
        samples = mapping.layers[name]
        point = samples.point[samples.occupancy > _LIKELY]
        if cloud is not None and len(point):
            flat = np.column_stack((point, np.zeros(len(point))))
            write_cloud(work / f"{name}.{cloud}", flat)
    if mapping.dense.dense.dynamic is not None:
        raster = rasterise(mapping.dense.dense.dynamic, mapping.placed, cell_m)
        write_image(raster, work / "dynamic.png")


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
