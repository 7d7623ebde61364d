"""The smoother on gtsam's Victoria Park: our calls against bare gtsam, in one process.

    python benchmarks/smoother.py [--repeat 3] [--quick]

Bare gtsam gets the values that our tracked start ends with, as it has no start of its own; what
that start costs is a line by itself, beside iSAM2, which is gtsam's way without one. One thread.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable
from typing import Any

import gtsam
import numpy as np

from comparisons.logs.bundled import open_log
from comparisons.pipeline.solve import solve
from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY, build_graph
from graphslam.incremental import run_isam2
from graphslam.initialisation import extension, track
from graphslam.optimisers import optimise, polish
from graphslam.problem import SlamProblem
from graphslam.smoother import smooth


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


def bare_solution(
    graph: gtsam.NonlinearFactorGraph, start: gtsam.Values, tolerance: float
) -> gtsam.Values:
    """Levenberg-Marquardt with gtsam's defaults, but for the relative tolerance."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(tolerance)
    return gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()


def timed(call: Callable[[], Any], repeat: int) -> tuple[float, Any]:
    """Least wall time of some calls, and the last result."""
    least, result = np.inf, None
    for _ in range(repeat):
        start = time.perf_counter()
        result = call()
        least = min(least, time.perf_counter() - start)
    return least, result


def main() -> None:
    """Print one line per step: ours, bare, ratio."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="a small log, once")
    choices = parser.parse_args()
    repeat = 1 if choices.quick else choices.repeat
    log = open_log("simulated-loop" if choices.quick else "victoria-park")
    problem = solve(log).result.problem
    build, graph = timed(lambda: build_graph(problem), repeat)
    bare_build, plain = timed(lambda: bare_graph(problem), repeat)
    start_s, (start, _) = timed(lambda: track(problem, graph), repeat)
    solve_s, end = timed(lambda: own_solution(graph, start), repeat)
    default_s, default_end = timed(lambda: bare_solution(plain, start, 1e-5), repeat)
    bare_solve, bare_end = timed(lambda: bare_solution(plain, start, 1e-10), repeat)
    result = smooth(problem, {})
    marginals, _ = timed(lambda: (result.pose_covariances(), result.marginal()), repeat)
    bare_s, _ = timed(lambda: bare_marginals(plain, bare_end), repeat)
    print(f"{'':28} {'ours, s':>9} {'gtsam, s':>9} {'ratio':>6}")
    rows = (
        ("graph", build, bare_build),
        ("solution", solve_s, bare_solve),
        ("all marginals and the joint", marginals, bare_s),
    )
    together = ("together", sum(row[1] for row in rows), sum(row[2] for row in rows))
    for name, mine, theirs in (*rows, together):
        print(f"{name:28} {mine:9.3f} {theirs:9.3f} {mine / theirs:6.2f}")
    print(
        f"{'with its default tolerance':28} {together[1]:9.3f} "
        f"{together[2] - bare_solve + default_s:9.3f} "
        f"{together[1] / (together[2] - bare_solve + default_s):6.2f}"
    )
    isam, found = timed(lambda: bare_isam2(problem, plain), 1)
    own, followed = timed(lambda: run_isam2(problem, graph), 1)
    print(f"{'iSAM2, each pose with sights':28} {own:9.3f} {isam:9.3f} {own / isam:6.2f}")
    print(f"{'from nothing to the optimum':28} {start_s + solve_s:9.3f} {isam:9.3f} (iSAM2)")
    reckoned = gtsam.LevenbergMarquardtOptimizer(
        plain, extension(problem, gtsam.Values(), 0, problem.pose_count)
    )
    errors = {
        "ours": graph.error(end),
        "gtsam from our start": plain.error(bare_end),
        "at its default tolerance": plain.error(default_end),
        "our iSAM2": graph.error(followed.values),
        "gtsam's iSAM2": plain.error(found),
    }
    if not choices.quick:
        errors["gtsam from dead reckoning"] = plain.error(reckoned.optimize())
    print("errors: " + ", ".join(f"{name} {error:.5f}" for name, error in errors.items()))


if __name__ == "__main__":
    main()
