"""The smoother on gtsam's Victoria Park: our calls against bare gtsam, in one process.

    python benchmarks/smoother.py [--repeat 5] [--quick]

Bare gtsam gets the values that our tracked start ends with, as it has no start of its own, and goes
on to the same optimum: with the relative tolerance 1e-10 and no absolute one, as gtsam's own, 1e-5,
ends before. What a start from nothing costs is a line by itself, beside iSAM2, which is gtsam's
way: the relaxed start, the first that `smooth` takes, with its optimiser; and all of `smooth`, with
the tracked start, too, and the search for other minima. Processor time of one thread, by turns.
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
from graphslam.search import relaxed_values
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
    graph: gtsam.NonlinearFactorGraph,
    start: gtsam.Values,
    relative: float = 1e-10,
    absolute: float = 0.0,
) -> gtsam.Values:
    """Levenberg-Marquardt with gtsam's defaults, but for the tolerances: to the same optimum."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(relative)
    parameters.setAbsoluteErrorTol(absolute)
    return gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()


def timed(repeat: int, *calls: Callable[[], Any]) -> list[tuple[float, Any]]:
    """Median processor time of each call, taken in turns, and its last result."""
    times, results = np.zeros((repeat, len(calls))), [None] * len(calls)
    for row in times:
        for k, call in enumerate(calls):
            start = time.process_time()
            results[k] = call()
            row[k] = time.process_time() - start
    return list(zip(np.median(times, axis=0).tolist(), results, strict=True))


def main() -> None:
    """Print one line per step: ours, bare, ratio."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="a small log, once")
    choices = parser.parse_args()
    repeat = 1 if choices.quick else choices.repeat
    log = open_log("simulated-loop" if choices.quick else "victoria-park")
    problem = solve(log).result.problem
    (build, graph), (bare_build, plain) = timed(
        repeat, lambda: build_graph(problem), lambda: bare_graph(problem)
    )
    start, _ = track(problem, graph)
    result = smooth(problem, {})
    (solve_s, end), (default_s, default_end), (bare_solve, bare_end) = timed(
        repeat,
        lambda: own_solution(graph, start),
        lambda: bare_solution(plain, start, 1e-5, 1e-5),
        lambda: bare_solution(plain, start),
    )
    (marginals, _), (bare_s, _) = timed(
        repeat,
        lambda: (result.pose_covariances(), result.marginal()),
        lambda: bare_marginals(plain, bare_end),
    )
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
    (isam, found), (own, followed), (nothing_s, optimum), (whole_s, _) = timed(
        1,
        lambda: bare_isam2(problem, plain),
        lambda: run_isam2(problem, graph),
        lambda: own_solution(graph, relaxed_values(problem)),
        lambda: smooth(problem, {}),
    )
    print(f"{'iSAM2, each pose with sights':28} {own:9.3f} {isam:9.3f} {own / isam:6.2f}")
    for name, mine in (
        ("from nothing to the optimum", nothing_s),
        ("with the evidence for it", whole_s),
    ):
        print(f"{name:28} {mine:9.3f} {isam:9.3f} {mine / isam:6.2f} (iSAM2)")
    reckoned = gtsam.LevenbergMarquardtOptimizer(
        plain, extension(problem, gtsam.Values(), 0, problem.pose_count)
    )
    errors = {
        "ours": graph.error(end),
        "from nothing": graph.error(optimum),
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
