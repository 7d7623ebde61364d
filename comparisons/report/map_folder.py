"""The folder that the map job leaves: map.json, a picture, each layer in several formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from comparisons.atomic import fresh_folder
from comparisons.mapping import DenseMapping
from comparisons.report.map_export import rasterise, write_image, write_ros_map
from comparisons.report.map_figure import dense_map_figure
from comparisons.report.map_models import MapResult
from comparisons.report.plots import save
from comparisons.runs.dense_run import LAYERS
from comparisons.runs.estimate_folder import FILES as ESTIMATE_FILES
from comparisons.runs.estimate_folder import write_estimate
from graphslam.scan.clouds import write_cloud

_SUFFIXES = ("png", "pgw", "pgm", "yaml", "pcd", "ply")
MAP_CONTENTS = frozenset(
    {"map.json", "map.png"}
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
        if len(mapping.placed.triangle):
            _write_layers(mapping, work, cloud)
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
