"""What `slamcheck solve` reports: solution.json, rows for a terminal, and its folder."""

from __future__ import annotations

import numpy as np
from rich.console import Console

from comparisons.checks.verdict import misfit_remarks
from comparisons.extensions.interface import Row
from comparisons.pipeline.prepare import Clock
from comparisons.pipeline.solve import Solution
from comparisons.report.figures.solution import solution_figure
from comparisons.report.folder import JobFolder
from comparisons.report.models import PoseGraphResult, SolutionResult
from comparisons.report.rows import (
    accuracy_rows,
    association_check_rows,
    association_rows,
    log_rows,
    print_rows,
    print_verdict,
    seconds_rows,
    smoother_rows,
)
from comparisons.report.sections import (
    accuracy_result,
    association_check_result,
    association_result,
    log_result,
    package_versions,
    smoother_result,
)
from comparisons.report.settings import settings_result, settings_rows
from graphslam.g2o import G2oContents, holds, write_g2o

LARGEST_DRAWN = 150
"""Variables of the largest graph that is drawn as dot."""


def build_solution_result(solution: Solution, read: Clock | None = None) -> SolutionResult:
    """Return the findings, read being the time that reading the log took."""
    s, optimality = solution, solution.result.optimality
    remarks = misfit_remarks(optimality)
    if optimality.lacks and not remarks:
        remarks.append(optimality.lacks)
    if s.association_check is not None:
        remarks += s.association_check.remarks
    return SolutionResult(
        config=s.prepared.config.model_dump(mode="json"),
        settings=settings_result(s.prepared.config, s.log.format),
        log=log_result(s.log),
        association_by=s.association_by,
        landmarks=len(s.estimate.landmark),
        measurements_used=int(np.count_nonzero(s.landmark_index >= 0)),
        gps=s.prepared.ekf.gps,
        smoother=smoother_result(s.result, s.estimate),
        accuracy=accuracy_result(s.accuracy),
        dead_reckoning=accuracy_result(s.accuracy_dead_reckoned),
        association=association_result(s.association),
        association_check=association_check_result(s.association_check),
        pose_graph=_pose_graph(s),
        verdict="verified" if s.verified else "unverified",
        remarks=remarks,
        **s.prepared.clock.after(read),
        versions=package_versions(),
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


def print_solution(result: SolutionResult, console: Console) -> None:
    """Print log, evidence, accuracy and verdict."""
    total = result.log.records["measurements"]
    rows = [
        *log_rows(result.log),
        *settings_rows(result.settings),
        Row(
            "map",
            f"{result.landmarks} landmarks from {result.measurements_used:,} of {total:,} "
            "measurements "
            f"({result.association_by})",
        ),
        *_pose_graph_rows(result),
        *smoother_rows(result.smoother),
        *accuracy_rows("accuracy", result.accuracy),
        *accuracy_rows("dead reckoning", result.dead_reckoning),
        *association_rows(result.association),
        *association_check_rows(result.association_check),
        *seconds_rows(result.seconds, result.cpu_s),
    ]
    print_rows(rows, console)
    print_verdict(result.verdict, console, remarks=result.remarks)


def _pose_graph_rows(result: SolutionResult) -> list[Row]:
    graph = result.pose_graph
    if graph is None:
        return []
    gaps = f", {graph.unmeasured:,} steps without odometry" if graph.unmeasured else ""
    return [
        Row(
            "pose graph",
            f"{result.smoother.poses:,} poses, {graph.loop_closures:,} closures{gaps}; chi2 "
            f"{graph.initial_chi2:.6g} dead reckoned, {result.smoother.chi2:.6g} at the optimum",
        )
    ]


def solution_folder(solution: Solution, result: SolutionResult) -> JobFolder:
    """Return what is to be written."""
    estimate, smoothed = solution.estimate, solution.result
    contents = G2oContents(smoothed.problem, estimate.pose, estimate.landmark)
    files = {}
    if holds(smoothed.problem):
        files["graph.g2o"] = lambda path: write_g2o(path, contents)
    if smoothed.values.size() <= LARGEST_DRAWN:
        files["graph.dot"] = lambda path: smoothed.graph.saveGraph(str(path), smoothed.values)
    return JobFolder(
        name="solution",
        result=result,
        config=solution.prepared.config,
        estimates={"smoother": estimate},
        figures={"map": solution_figure(solution)},
        files=files,
    )
