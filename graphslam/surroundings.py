"""A landmark's surroundings in a large graph: where does it go from another place?

The poses that saw it may move with it; what they touch besides is pinned where it is, so that the
answer takes the time of those poses, not of the whole graph.
"""

from __future__ import annotations

import gtsam
import numpy as np

from graphslam.arrays import Array
from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY, graph_of
from graphslam.optimisers import levenberg_marquardt
from graphslam.problem import SlamProblem

PINNED = 1e-5
"""Standard deviation of what is pinned [m, rad]."""
_TOLERANCE, _LIMIT = 1e-6, 30


class Surroundings:
    """The factors of the poses that saw a landmark, at given values of the whole graph.

    share: of the whole graph's factors.
    """

    def __init__(
        self,
        problem: SlamProblem,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        landmark: int,
    ) -> None:
        """graph: from build_graph: prior, increments, measurements and positions come first."""
        count, measured = problem.pose_count, problem.measurement_pose
        own = np.zeros(count, dtype=bool)
        own[measured[problem.measurement_landmark == landmark]] = True
        steps = np.flatnonzero(own[:-1] | own[1:])
        rows = np.flatnonzero(own[measured])
        poses = np.union1d(np.flatnonzero(own), np.concatenate((steps, steps + 1)))
        others = np.setdiff1d(problem.measurement_landmark[rows], landmark)
        self._key = LANDMARK_KEY + landmark
        fixes = np.flatnonzero(own[problem.position_pose])
        prior = np.flatnonzero(own[:1])
        own_factors = (prior, 1 + steps, count + rows, count + len(measured) + fixes)
        self._graph = graph_of(map(graph.at, np.concatenate(own_factors).tolist()))
        self._values = gtsam.Values()
        pinned = gtsam.noiseModel.Isotropic.Sigma(3, PINNED)
        for k in poses.tolist():
            pose = values.atPose2(POSE_KEY + k)
            self._values.insert(POSE_KEY + k, pose)
            if not own[k]:
                self._graph.push_back(gtsam.PriorFactorPose2(POSE_KEY + k, pose, pinned))
        pinned = gtsam.noiseModel.Isotropic.Sigma(2, PINNED)
        for j in others.tolist():
            place = values.atPoint2(LANDMARK_KEY + j)
            self._values.insert(LANDMARK_KEY + j, place)
            self._graph.push_back(gtsam.PriorFactorPoint2(LANDMARK_KEY + j, place, pinned))
        self._values.insert(self._key, values.atPoint2(self._key))
        self.share = self._graph.size() / graph.size()

    def settle(self, place: Array) -> tuple[float, int]:
        """Let it settle from a place (2,); return the error that the end adds, and the iterations.

        The error added is next to zero where it comes back, and infinite where nothing is found.
        """
        start = gtsam.Values(self._values)
        start.update(self._key, place)
        try:
            end, spent, _ = levenberg_marquardt(self._graph, start, _TOLERANCE, _LIMIT)
        except RuntimeError:
            return float("inf"), _LIMIT
        return self._graph.error(end) - self._graph.error(self._values), spent
