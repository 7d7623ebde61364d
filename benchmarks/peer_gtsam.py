"""gtsam as its users call it, and our smoother, on gtsam's Victoria Park.

The functions that call gtsam plainly are those of `benchmarks/smoother.py`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gtsam

from benchmarks.peer_pairs import Pair, here
from benchmarks.smoother import bare_graph, bare_isam2, bare_marginals, bare_solution, own_solution
from comparisons.logs.bundled import open_log
from comparisons.pipeline.solve import solve
from graphslam.graph_builder import build_graph
from graphslam.initialisation import track
from graphslam.search import relaxed_values


def rows(*, quick: bool) -> list[Pair]:
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
        Pair(
            name="gtsam: our smoother from the same start",
            work=f"{size}: graph, optimum, covariance of each pose, last pose and map jointly",
            ours=here(ours),
            theirs=here(bare),
            goal=1.15,
            notes=errors("ours", "gtsam"),
        ),
        Pair(
            name="gtsam's iSAM2: our way to the optimum",
            work=f"{size}: graph and solution from odometry and measurements alone",
            ours=here(from_nothing),
            theirs=here(isam2),
            goal=0.1,
            notes=errors("ours, from nothing", "iSAM2"),
        ),
    ]
