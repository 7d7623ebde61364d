"""gtsam as its users call it, and our smoother, on gtsam's Victoria Park.

Bare gtsam gets the values that our tracked start ends with, as it has no start of its own. From
nothing to the optimum it has iSAM2; we take the relaxed start, the first of our smoother's.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gtsam
import numpy as np

from comparisons.logs.bundled import open_log
from comparisons.pipeline.solve import solve
from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY, build_graph
from graphslam.initialisation import track
from graphslam.optimisers import optimise, polish
from graphslam.problem import SlamProblem
from graphslam.search import relaxed_values
from research.timing import TimedPair, here


def rows(*, quick: bool) -> list[TimedPair]:
    """Return the pairs; quick: of a small log."""
    result = solve(open_log("simulated-loop" if quick else "victoria-park")).result
    problem = result.problem
    start, _ = track(problem, build_graph(problem))
    found: dict[str, tuple[gtsam.NonlinearFactorGraph, gtsam.Values]] = {}

    def ours() -> None:
        graph = build_graph(problem)
        values = own_solution(graph, start)
        mine = replace(result, graph=graph, values=values)
        mine.pose_covariances()
        mine.marginal()
        found["ours"] = graph, values

    def bare() -> None:
        graph = bare_graph(problem)
        values = bare_solution(graph, start)
        bare_marginals(graph, values)
        found["gtsam"] = graph, values

    def from_nothing() -> None:
        graph = build_graph(problem)
        found["ours, from nothing"] = graph, own_solution(graph, relaxed_values(problem))

    def isam2() -> None:
        graph = bare_graph(problem)
        found["iSAM2"] = graph, bare_isam2(problem, graph)

    def errors(*names: str) -> Any:
        return lambda: [
            "errors: "
            + ", ".join(f"{one} {found[one][0].error(found[one][1]):.5f}" for one in names)
        ]

    size = f"{problem.pose_count} poses, {len(problem.z)} measurements"
    return [
        TimedPair(
            name="gtsam: our smoother from the same start",
            work=f"{size}: graph, optimum, covariance of each pose, last pose and map jointly",
            ours=here(ours),
            theirs=here(bare),
            goal=1.15,
            notes=errors("ours", "gtsam"),
        ),
        TimedPair(
            name="gtsam's iSAM2: our way to the optimum",
            work=f"{size}: graph and solution from odometry and measurements alone",
            ours=here(from_nothing),
            theirs=here(isam2),
            goal=0.1,
            notes=errors("ours, from nothing", "iSAM2"),
        ),
    ]


def bare_graph(problem: SlamProblem) -> gtsam.NonlinearFactorGraph:
    """As a user of gtsam would write it."""
    graph = gtsam.NonlinearFactorGraph()
    first = gtsam.noiseModel.Gaussian.Covariance(problem.prior_covariance)
    graph.add(gtsam.PriorFactorPose2(POSE_KEY, gtsam.Pose2(*problem.prior_pose), first))
    for k in range(len(problem.increment)):
        noise = gtsam.noiseModel.Gaussian.Covariance(problem.increment_covariance[k])
        move = gtsam.Pose2(*problem.increment[k])
        graph.add(gtsam.BetweenFactorPose2(POSE_KEY + k, POSE_KEY + k + 1, move, noise))
    for i in range(len(problem.z)):
        r, bearing = problem.z[i]
        noise = gtsam.noiseModel.Diagonal.Sigmas(problem.sigma[i, ::-1].copy())
        pose = POSE_KEY + int(problem.measurement_pose[i])
        landmark = LANDMARK_KEY + int(problem.measurement_landmark[i])
        graph.add(gtsam.BearingRangeFactor2D(pose, landmark, gtsam.Rot2(bearing), r, noise))
    return graph


def bare_isam2(problem: SlamProblem, graph: gtsam.NonlinearFactorGraph) -> gtsam.Values:
    """One update per pose with gtsam's defaults."""
    isam = gtsam.ISAM2(gtsam.ISAM2Params())
    order = np.argsort(problem.measurement_pose, kind="stable") + problem.pose_count
    begin = np.searchsorted(np.sort(problem.measurement_pose), np.arange(problem.pose_count + 1))
    values = gtsam.Values()
    for k in range(problem.pose_count):
        piece, new = gtsam.NonlinearFactorGraph(), gtsam.Values()
        piece.add(graph.at(k))
        if k:
            before = isam.calculateEstimatePose2(POSE_KEY + k - 1)
            pose = before.compose(gtsam.Pose2(*problem.increment[k - 1]))
        else:
            pose = gtsam.Pose2(*problem.prior_pose)
        new.insert(POSE_KEY + k, pose)
        for row in order[begin[k] : begin[k + 1]].tolist():
            piece.add(graph.at(row))
            key = LANDMARK_KEY + int(problem.measurement_landmark[row - problem.pose_count])
            if not values.exists(key):
                r, bearing = problem.z[row - problem.pose_count]
                place = np.array([r * np.cos(bearing), r * np.sin(bearing)])
                new.insert(key, pose.transformFrom(place))
                values.insert(key, place)
        isam.update(piece, new)
    return isam.calculateEstimate()


def bare_marginals(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
    """Of every variable, and of the last pose and all landmarks jointly."""
    marginals = gtsam.Marginals(graph, values)
    keys = list(values.keys())
    for key in keys:
        marginals.marginalCovariance(key)
    marginals.jointMarginalCovariance([max(keys), *(key for key in keys if key < POSE_KEY)])


def own_solution(graph: gtsam.NonlinearFactorGraph, start: gtsam.Values) -> gtsam.Values:
    """Our way from a start to the optimum."""
    return polish(graph, optimise(graph, start)[0])[0]


def bare_solution(graph: gtsam.NonlinearFactorGraph, start: gtsam.Values) -> gtsam.Values:
    """Levenberg-Marquardt with gtsam's defaults, but for the tolerances: to the same optimum."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-10)  # with its own, 1e-5, it ends before the optimum
    parameters.setAbsoluteErrorTol(0.0)
    return gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()
