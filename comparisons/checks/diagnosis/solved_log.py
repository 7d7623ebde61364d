"""The smoother's optimum of a log, as it is or changed, and where its residuals leave the noise.

`log_fit` and `log_doctor` solve logs so; a change is named where nothing is left outside.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from comparisons.arrays import Array
from comparisons.estimates.estimate import Estimate
from comparisons.figures import rounded
from comparisons.logs.log import Log
from comparisons.logs.transforms.known_landmarks import SURVEYED
from graphslam.goodness_of_fit import Goodness, ResidualGroup

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


Solve = Callable[[Log, bool], SolvedLog]
"""Of a changed log, and whether its optimum may lie elsewhere than that of the log as it is.

Raises InputError or RuntimeError where there is none.
"""


def solved_run(goodness: Goodness, estimate: Estimate) -> SolvedLog:
    """Return an optimum with the names of an estimate, whose poses and landmarks it has."""
    return SolvedLog(
        goodness, estimate.time_s, estimate.landmark_id.tolist(), dict(estimate.labels)
    )
