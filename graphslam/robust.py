"""Measurements and positions with outliers: robust kernels, and graduated non-convexity.

A kernel stays in the graph and lowers the weight of what fits badly, so that marginals, too, are
those of the weighted problem. Graduated non-convexity decides which observations are outliers; they
are left out, and what remains is an ordinary problem.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from graphslam.arrays import Index
from graphslam.problem import SlamProblem

INLIER_PROBABILITY = 0.999
"""Observations beyond this quantile of chi-square are outliers."""


@dataclass(frozen=True)
class Rejected:
    """What was left out: rows of the problem's measurements and of its positions."""

    measurements: Index
    positions: Index


NOTHING_REJECTED = Rejected(np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp))


def reject_outliers(
    problem: SlamProblem, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> tuple[SlamProblem, Rejected]:
    """The problem without outliers (Yang et al. 2020, by gtsam).

    graph: build_graph(problem). values: a start. The prior, the increments and what was surveyed
    are taken to be sound; every landmark keeps at least its best measurement.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(20)
    parameters.setRelativeErrorTol(1e-4)
    settings = gtsam.GncLMParams(parameters)
    first, count = 1 + len(problem.steps), len(problem.z) + len(problem.position)
    sound = [*range(first), *range(first + count, graph.size())]
    settings.setKnownInliers(sound)
    optimiser = gtsam.GncLMOptimizer(graph, values, settings)
    optimiser.setInlierCostThresholdsAtProbability(INLIER_PROBABILITY)
    end = optimiser.optimize()
    weight = np.asarray(optimiser.getWeights())[first : first + count]
    kept = weight[: len(problem.z)] > 0.5
    error = np.array([graph.at(first + row).error(end) for row in range(len(problem.z))])
    for landmark_index in np.setdiff1d(
        problem.measurement_landmark, problem.measurement_landmark[kept]
    ):
        rows = np.flatnonzero(problem.measurement_landmark == landmark_index)
        kept[rows[np.argmin(error[rows])]] = True
    fixed = weight[len(problem.z) :] > 0.5
    rejected = Rejected(np.flatnonzero(~kept), np.flatnonzero(~fixed))
    return problem.keep(kept, fixed), rejected
