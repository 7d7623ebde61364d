"""What `slamcheck solve` reports: solution.json, what is printed, and its folder."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from comparisons.checks.optimum import overstated
from comparisons.figures import rounded, rows_of
from comparisons.pipeline.clock import Clock
from comparisons.pipeline.solve import Solution
from comparisons.report.figures.run import map_figure
from comparisons.report.folder import JobFolder
from comparisons.report.html.map import Track, estimate_map
from comparisons.report.html.page import PageContent, write_page
from comparisons.report.job import Report
from comparisons.report.marks import SMOOTHER_COLOUR, TRUTH_COLOUR
from comparisons.report.models import PoseGraphResult, SolutionResult
from comparisons.report.rows import log_rows, seconds_rows, smoother_rows
from comparisons.report.sections import about_job, known_page, optimum_findings, smoother_result
from comparisons.report.settings import settings_rows
from comparisons.report.terminal import Summary
from comparisons.words import Row
from graphslam.g2o import G2oContents, holds, write_g2o
from graphslam.optimum import ChiSquareTest

FRAME = "only the absolute positions fix the frame of the graph, so they are used"
LARGEST_DRAWN = 150
"""Variables of the largest graph that is drawn as dot."""


class SolutionReport(Report[Solution, SolutionResult]):
    """Report of `slamcheck solve`."""

    @staticmethod
    def build(solution: Solution, read: Clock | None = None) -> SolutionResult:
        """Return the findings, read being the time that reading the log took."""
        s = solution
        remarks = [*([FRAME] if s.log.prior.open else []), *s.notes, *s.open_loops]
        if not s.is_misread:
            remarks += [remark for remark in s.known.remarks if remark not in s.lacks]
        return SolutionResult(
            association_by=s.association_by,
            landmarks=len(s.estimate.landmark),
            measurements_used=int(np.count_nonzero(s.landmark_index >= 0)),
            gps=s.prepared.ekf.gps,
            smoother=smoother_result(s.result, s.estimate),
            association_check=s.association_check,
            pose_graph=_pose_graph(s),
            verdict="verified" if s.verified else "unverified",
            reasons=s.lacks,
            **optimum_findings(s.known, SolutionResult, remarks),
            **about_job(s.prepared, s.prepared.clock.after(read)),
        )

    def summary(self) -> Summary:
        """Return what the command prints: outcome, map, evidence and accuracy."""
        result = self.result
        measurements, smoother = result.log.records["measurements"], result.smoother
        tested = f"chi-square {rounded(smoother.chi2)}"
        if smoother.dof:
            low, high = smoother.chi2_band
            tested += f" (expected {smoother.dof}, band {rounded(low)} to {rounded(high)})"
        used = "measurements used for the map"
        test = ChiSquareTest(smoother.chi2, smoother.dof, *smoother.chi2_band)
        is_large = overstated(test) and not self.found.is_misread
        too_large = ", sigmas too large" if is_large else ""
        return Summary(
            headline=f"verdict: {result.headline}{too_large}",
            look=result.look,
            reasons=result.reasons,
            remarks=result.remarks,
            lines=[
                (
                    "map",
                    f"{result.landmarks:,} landmarks from {result.measurements_used:,} of "
                    f"{measurements:,} measurements (association: {result.association_by})",
                ),
                ("optimum", f"{tested}, {smoother.poses:,} poses"),
                *self.found.known.lines,
            ],
            rows=[
                *log_rows(result.log),
                *settings_rows(result.settings),
                Row("Map", "landmarks", f"{result.landmarks:,}"),
                Row("Map", used, f"{result.measurements_used:,} of {measurements:,}"),
                Row("Map", "association", result.association_by),
                *_pose_graph_rows(result),
                *smoother_rows(smoother),
                *self.found.known.rows,
                *(result.association_check.rows() if result.association_check else ()),
                *seconds_rows(result.seconds, result.cpu_s),
            ],
        )

    def page(self) -> PageContent:
        """Return what stands on the page."""
        s = self.found
        reckoned = Track(
            name="dead reckoning",
            colour=TRUTH_COLOUR,
            dashes="2 2",
            time_s=s.estimate.time_s,
            pose=s.dead_reckoned,
            against_time=False,
        )
        drawn = estimate_map(s.log, "smoother", SMOOTHER_COLOUR, s.estimate, reckoned)
        config = s.prepared.config
        return known_page(self.result, self.summary(), "solve", drawn, config, s.known)

    def folder(self) -> JobFolder:
        """Return what is to be written."""
        estimate, smoothed = self.found.estimate, self.found.result
        contents = G2oContents(
            smoothed.problem, estimate.pose, estimate.landmark, landmark_ids=estimate.landmark_id
        )
        files: dict[str, Callable[[Path], object]] = {
            "report.html": partial(write_page, self.page())
        }
        if holds(smoothed.problem):
            files["graph.g2o"] = lambda path: write_g2o(path, contents)
        if smoothed.values.size() <= LARGEST_DRAWN:
            files["graph.dot"] = lambda path: smoothed.graph.saveGraph(str(path), smoothed.values)
        return JobFolder(
            name="solution",
            result=self.result,
            config=self.found.prepared.config,
            estimates={"smoother": estimate},
            figures={"map": map_figure(self.found)},
            files=files,
        )


def _pose_graph(solution: Solution) -> PoseGraphResult | None:
    problem = solution.result.problem
    if solution.log.loop_closures is None:
        return None
    return PoseGraphResult(
        loop_closures=len(problem.loop_closures.first),
        unmeasured=problem.pose_count - 1 - len(problem.steps),
        initial_chi2=2.0 * solution.result.initial_error(),
    )


def _pose_graph_rows(result: SolutionResult) -> list[Row]:
    graph = result.pose_graph
    if graph is None:
        return []
    optimum = Row("Pose graph", "chi-square at the optimum", f"{result.smoother.chi2:.6g}")
    return [*rows_of("Pose graph", graph), optimum]
