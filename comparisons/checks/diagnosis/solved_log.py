"""The smoother's optimum of a log, as it is or changed, and where its residuals leave the noise.

`log_fit` and `log_doctor` solve logs so; a change is named where nothing is left outside.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import gtsam
import numpy as np

from comparisons.arrays import Array
from comparisons.estimates.estimate import Estimate
from comparisons.figures import rounded
from comparisons.logs.log import Log, Poses
from comparisons.logs.transforms.known_landmarks import SURVEYED
from graphslam.goodness_of_fit import Goodness, ResidualGroup
from graphslam.graph_builder import build_graph, from_values, row_components, to_values
from graphslam.optimisers import levenberg_marquardt
from graphslam.problem import SlamProblem
from graphslam.restricted_likelihood import restricted_deviance
from graphslam.search import relaxed_values
from graphslam.sparse_system import sparse_system

_TOLERANCE = 1e-6
"""Of the smoother's error, relative."""
_MOST_ITERATIONS = 30

_SENSORS = {
    "odometry": "the odometry",
    "range": "ranges",
    "bearing": "bearings",
    "position": "positions",
    "pose landmark": "measurements of pose landmarks",
    "loop closure": "loop closures",
    "": "measurements",
}
"""What sentences call the components of a problem."""


class SolvedLog(NamedTuple):
    """An optimum with its residuals.

    time_s: (K,) of the poses. landmarks: ids by landmark index. labels: names by id.
    """

    goodness: Goodness
    time_s: Array
    landmarks: list[int]
    labels: dict[int, str]

    @property
    def chi2(self) -> float:
        """Of the whole."""
        return self.goodness.test.chi2

    @property
    def deviance(self) -> float:
        """Of its noise, as `restricted_deviance`; infinite where the state is not determined."""
        goodness = self.goodness
        try:
            return restricted_deviance(goodness.problem, goodness.graph, goodness.values)
        except RuntimeError:
            return np.inf

    @property
    def departure(self) -> str:
        """Where the residuals leave the stated noise first, in words; empty where nowhere."""
        part = self.goodness.departure
        return "" if part is None else f"the residuals depart {self._words(part)}"

    def _words(self, part: ResidualGroup) -> str:
        first_s, last_s = (f"{self.time_s[pose]:.9g} s" for pose in (part.first, part.last))
        where, size = self._sensor(part), f"{part.value:.3g} sigma"
        span = f"from {first_s} to {last_s}"
        if part.how == "single":
            return f"at {last_s}, in {where} ({size})"
        if part.how == "mean":
            return f"in the mean of {where} ({size})"
        if part.how == "order":
            return f"in {where}: each and the next are correlated ({size})"
        of = f"chi-square {rounded(part.value)} for {rounded(part.expected)} degrees of freedom"
        if part.how == "first":
            return f"at {first_s}, in {where} ({of} to {last_s})"
        return f"in {where} {span} ({of})"

    def _sensor(self, part: ResidualGroup) -> str:
        sensor = _SENSORS[part.component]
        if part.landmark < 0:
            return sensor
        number = self.landmarks[part.landmark]
        name = self.labels.get(number, str(number % SURVEYED))
        return f"{sensor} of landmark {name}"


class LogSolver(NamedTuple):
    """Solves a log that is changed.

    Attributes:
        problem: Makes of a log the smoother's input and the times (K,) of its poses. Raises
            InputError.
        landmarks: Ids by landmark index.
        labels: Names by id.
    """

    problem: Callable[[Log], tuple[SlamProblem, Array]]
    landmarks: list[int]
    labels: dict[int, str]

    def solved(self, log: Log, near: SolvedLog | None = None) -> SolvedLog:
        """Return the optimum of a log.

        Args:
            log: Changed or not.
            near: An optimum of a similar log, from where it is sought; None to seek it afresh.

        Raises:
            InputError: The log has no problem.
            RuntimeError: It has no optimum.
        """
        problem, time_s = self.problem(log)
        graph = build_graph(problem)
        start = relaxed_values(problem) if near is None else _values_near(problem, time_s, near)
        values = levenberg_marquardt(graph, start, _TOLERANCE, _MOST_ITERATIONS)[0]
        return SolvedLog(Goodness(problem, graph, values), time_s, self.landmarks, self.labels)

    def right_hand_side(self, log: Log, values: gtsam.Values) -> Array:
        """Return the whitened right-hand side (m,) of a log's graph at a point.

        Raises:
            InputError: The log has no problem.
            RuntimeError: It has other unknowns than the point.
        """
        problem, _ = self.problem(log)
        return sparse_system(build_graph(problem), values, len(row_components(problem)))[1]


def _values_near(problem: SlamProblem, time_s: Array, near: SolvedLog) -> gtsam.Values:
    """An optimum's values, at other times where the problem's poses have others."""
    if np.array_equal(time_s, near.time_s):
        return near.goodness.values
    poses, landmarks = from_values(near.goodness.values, near.goodness.problem)
    seen = problem.seen_landmarks, problem.pose_landmarks
    return to_values(Poses(near.time_s, poses).at(time_s), landmarks, *seen)


def solved_run(goodness: Goodness, estimate: Estimate) -> SolvedLog:
    """Return an optimum with the names of an estimate, whose poses and landmarks it has."""
    return SolvedLog(
        goodness, estimate.time_s, estimate.landmark_id.tolist(), dict(estimate.labels)
    )
