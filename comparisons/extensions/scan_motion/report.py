"""What `slamcheck odometry` reports: odometry.json, what is printed, and its folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

from comparisons.arrays import Array
from comparisons.checks.accuracy import Accuracy
from comparisons.checks.optimum import lacking
from comparisons.checks.smoother import SmootherFigures
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.folder import tum_text
from comparisons.extensions.scan_motion.increments import IncrementCheck
from comparisons.extensions.scan_motion.job import FrontEnd
from comparisons.extensions.scan_motion.log_by_scans import measurements_kept
from comparisons.extensions.scan_motion.result import (
    LoopResult,
    ScanOdometryResult,
    increment_remarks,
)
from comparisons.pipeline.clock import Clock
from comparisons.report.figures.style import (
    draw_aside,
    draw_cloud,
    draw_reference,
    draw_trajectory,
    entitle,
    plan,
)
from comparisons.report.html.map import MapContent, Track, estimate_map
from comparisons.report.job_report import JobReport, optimum_entries
from comparisons.report.marks import EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR
from comparisons.report.models import CheckedResult
from graphslam.g2o import G2oContents, holds, write_g2o
from graphslam.scan.clouds import write_cloud


class FrontEndResult(CheckedResult):
    """`odometry.json`: the scan front end alone.

    Attributes:
        odometry: scan odometry.
        loops: loop closure.
        graph: the smoother of the scan pose graph.
        landmarks: landmarks of the map.
        gps: value of `--gps`.
        increments: errors of the increments by truth or GPS.
        accuracy: errors of the scan pose graph.
        scan_odometry: errors of the scan odometry.
        wheels: errors of the wheels' odometry.
        verdict: whether the graph's optimum is verified and no scan was lost that no wheels bridge.
        reasons: why it is not.
    """

    odometry: ScanOdometryResult
    loops: LoopResult
    graph: SmootherFigures
    landmarks: int
    gps: str
    increments: IncrementCheck | None
    accuracy: Accuracy | None = None
    scan_odometry: Accuracy | None = None
    wheels: Accuracy | None = None
    verdict: Literal["verified", "unverified"]
    reasons: list[str]


class FrontEndReport(JobReport[FrontEnd, FrontEndResult]):
    """Report of `slamcheck odometry`."""

    @staticmethod
    def build(front_end: FrontEnd, read: Clock | None = None) -> FrontEndResult:
        """The findings, read being the time that reading the log took."""
        f = front_end
        reasons = [*([f.motion.lacks] if f.motion.lacks else []), *lacking(f.graph.optimality)]
        remarks = [*_remarks(f), *(remark for remark in f.known.remarks if remark not in reasons)]
        return FrontEndResult(
            landmarks=len(f.estimate.landmark),
            gps=f.prepared.config.front_end.gps,
            verdict="unverified" if reasons else "verified",
            reasons=reasons,
            **optimum_entries(f.known, FrontEndResult, remarks, read),
        )

    def drawn(self) -> MapContent:
        """Return what the page's map shows: the graph, and where the odometries lead."""
        f, path = self.found, partial(Track, time_s=self.found.time_s, against_time=False)
        others = [path(name="scan odometry", colour=EKF_COLOUR, dashes="5 3", pose=f.odometry)]
        if f.wheels is not None:
            others.append(path(name="wheels", colour=TRUTH_COLOUR, dashes="2 2", pose=f.wheels))
        cloud = ("scans", f.map_points()[:, :2])
        return estimate_map(f.log, "scan graph", SMOOTHER_COLOUR, f.estimate, *others, cloud=cloud)

    @property
    def estimates(self) -> Mapping[str, Estimate]:
        """The graph's."""
        return {"graph": self.found.estimate}

    def figures(self) -> Mapping[str, Figure]:
        """Return the map."""
        return {"map": front_end_figure(self.found, self.found.map_points())}

    def files(self) -> Mapping[str, Callable[[Path], object]]:
        """Return paths, graph and cloud. Raises MissingLibraryError: a cloud needs Open3D."""
        f, cloud, problem = self.found, self.found.prepared.config.cloud, self.found.graph.problem
        files = {"odometry.tum": _tum(f.time_s, f.odometry)}
        if f.wheels is not None:
            files["wheels.tum"] = _tum(f.time_s, f.wheels)
        if holds(problem):
            contents = G2oContents(
                problem, f.estimate.pose, f.estimate.landmark, landmark_ids=f.estimate.landmark_id
            )
            files["graph.g2o"] = lambda path: write_g2o(path, contents)
        if cloud is not None:
            files[f"map.{cloud}"] = lambda path: write_cloud(path, f.map_points())
        return files


def _tum(time_s: np.ndarray, pose: np.ndarray) -> Callable[[Path], object]:
    return lambda path: path.write_text(tum_text(time_s, pose), encoding="utf-8")


def _remarks(f: FrontEnd) -> list[str]:
    remarks = []
    stream = f.log.clouds if f.log.scans is None else f.log.scans
    beyond = 0 if stream is None else len(stream.time_s) - len(f.motion.source.row)
    if beyond:
        remarks.append(f"{beyond} scans lie outside the time of the odometry and were left out")
    measurements = f.log.measurements
    beyond = (
        int(np.count_nonzero(~measurements_kept(f.log, f.motion))) if measurements.labelled else 0
    )
    if beyond:
        remarks.append(f"{beyond} measurements lie outside the time of the scans and were left out")
    remarks += f.motion.remarks
    return remarks + increment_remarks(f.increments)


def front_end_figure(front_end: FrontEnd, points: Array) -> Figure:
    """The map that the scans make, with the trajectories of wheels, scan odometry and graph."""
    f = front_end
    figure, axis = plan()
    draw_cloud(axis, points)
    if f.log.truth.poses is not None:
        draw_reference(axis, f.log.truth.poses.pose, ".", "truth")
    elif f.log.positions is not None:
        draw_reference(axis, f.log.positions.position_m, ".", "GPS")
    draw_trajectory(axis, f.odometry, EKF_COLOUR, "scan odometry", "--")
    draw_trajectory(axis, f.estimate.pose, SMOOTHER_COLOUR, "scan graph")
    closed = f.graph.problem.loop_closures
    for first, second in zip(closed.first, closed.second, strict=True):
        ends = f.estimate.pose[[first, second]]
        axis.plot(ends[:, 0], ends[:, 1], color=SCANS_COLOUR, linewidth=0.7, zorder=3)
    if f.wheels is not None:
        draw_aside(axis, f.wheels, "wheels")
    scans = len(f.motion.row)
    entitle(axis, f"{f.log.name}: {scans} scans, {len(closed.first)} loops closed (yellow)")
    return figure
