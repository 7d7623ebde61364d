"""The folder that the scan front end leaves: odometry.json, map, trajectories, graph, cloud."""

from __future__ import annotations

from pathlib import Path

from comparisons.atomic import fresh_folder
from comparisons.estimates.folder import FILES as ESTIMATE_FILES
from comparisons.estimates.folder import tum_text, write_estimate
from comparisons.pipeline.odometry import FrontEnd
from comparisons.report.models import FrontEndResult
from comparisons.report.picture import save
from comparisons.report.plots import front_end_figure
from graphslam.g2o import G2oContents, holds, write_g2o
from graphslam.scan.clouds import write_cloud

CLOUDS = ("map.pcd", "map.ply")
FRONT_END_CONTENTS = frozenset(
    {"odometry.json", "map.png", "graph.g2o", "odometry.tum", "wheels.tum", *CLOUDS}
    | {f"graph/{name}" for name in ESTIMATE_FILES}
)
"""What the folder holds; a folder with nothing else may be replaced by the next."""


def write_front_end_folder(
    front_end: FrontEnd, result: FrontEndResult, folder: Path, cloud: str | None = None
) -> None:
    """Write everything; the folder appears whole or not at all. Raises InputError.

    cloud: `pcd` or `ply` for the map as a cloud, which needs Open3D: raises Open3dMissingError.
    """
    f = front_end
    with fresh_folder(folder, FRONT_END_CONTENTS) as work:
        (work / "graph").mkdir()
        write_estimate(f.estimate, work / "graph")
        (work / "odometry.tum").write_text(tum_text(f.time_s, f.odometry), encoding="utf-8")
        if f.wheels is not None:
            (work / "wheels.tum").write_text(tum_text(f.time_s, f.wheels), encoding="utf-8")
        points = f.map_points()
        save(front_end_figure(f, points), work / "map.png")
        problem = f.graph.problem
        if holds(problem):
            write_g2o(
                work / "graph.g2o", G2oContents(problem, f.estimate.pose, f.estimate.landmark)
            )
        if cloud is not None:
            write_cloud(work / f"map.{cloud}", points)
        (work / "odometry.json").write_text(
            result.model_dump_json(indent=2) + "\n", encoding="utf-8"
        )
