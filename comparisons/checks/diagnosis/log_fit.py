"""Which single number of the log's sensors, if it were another, makes the smoother fit.

Each is fitted alone by minimising the chi-square of the smoother's optimum over it: scales of
speed, turn, range and bearing (-1 for the opposite sign), offsets of the last three, and the clock
of the measurements. It is named where what is left is the stated noise, everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import fdtrc

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.smoother_input import build_problem
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.diagnosis.solved_log import Solve, SolvedLog
from comparisons.errors import InputError
from comparisons.logs.log import Log, Poses
from comparisons.logs.odometry import RelativePoses, SteeringOdometry, VelocityOdometry
from comparisons.logs.transforms.calibration import Line, delayed, driven, sensed
from graphslam.goodness_of_fit import Goodness
from graphslam.graph_builder import build_graph, to_values
from graphslam.optimisers import levenberg_marquardt
from graphslam.optimum import ChiSquareTest
from graphslam.search import relaxed_values
from graphslam.smoother import SmootherEvidence

LEVEL = 1e-6
"""Of the F test of all numbers together."""
_ROUNDS = 4
_MOST_REFINED = 3
_AS_LIKELY = -2.0 * float(np.log(LEVEL))
"""Chi-square above the least: what leaves no more may be the one."""
_DELAYS_S = (-2.0, -1.0, -0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5, 1.0, 2.0)
_TOLERANCE = 1e-6
"""Of the smoother's error, relative."""

_WORDS: dict[type, tuple[str, str]] = {
    RelativePoses: ("ways between poses", "turns between poses"),
    SteeringOdometry: ("speeds", "steering angles"),
    VelocityOdometry: ("speeds", "turn rates"),
}


class LogFit(NamedTuple):
    """A change with which the log fits.

    what: in words. solved: with it. change: makes the log as it should be. mend: what corrects it.
    unit: it is about a unit.
    """

    what: str
    solved: SolvedLog
    change: Callable[[Log], Log]
    mend: str = "correct the calibration or the clock"
    unit: bool = False

    @property
    def chi2(self) -> float:
        """Of the whole with the change."""
        return self.solved.chi2

    @property
    def fits(self) -> bool:
        """Whether what is left is the stated noise: as a whole, by sensor, landmark and time."""
        return self.solved.goodness.sound


class _Number(NamedTuple):
    """change: makes the log's value right if the number is. step: about what noise hides.

    grid: numbers in order, with that of no fault, between which chi-square is no smooth function,
    as of a delay, that moves measurements from sample to sample.
    """

    words: str
    change: Callable[[Log, float], Log]
    neutral: float
    step: float
    grid: tuple[float, ...] = ()


def _numbers(log: Log) -> Iterator[_Number]:
    """Of what the log has."""
    way, turn = _WORDS[type(log.odometry)]
    yield from _of_sensor(way, "", 0.0, driven)
    yield from _of_sensor(turn, "rad", 1e-3, lambda g, line: driven(g, turn=line))
    if not len(log.measurements.time_s):
        return
    yield from _of_sensor("ranges", "m", 0.01, sensed)
    yield from _of_sensor("bearings", "rad", 1e-3, lambda g, line: sensed(g, bearing=line))
    if not isinstance(log.odometry, RelativePoses):
        yield _Number(
            "measurements {:+.3g} s later than the log says", delayed, 0.0, 0.05, _DELAYS_S
        )


def _of_sensor(
    name: str, unit: str, step: float, change: Callable[[Log, Line], Log]
) -> Iterator[_Number]:
    """A scale, and an offset where it has a unit."""
    yield _Number(f"{name} {{:.3g}} times the log's", lambda g, k: change(g, (k, 0.0)), 1.0, 0.01)
    if unit:
        offset = f"an offset of {{:+.3g}} {unit} on the {name}"
        yield _Number(offset, lambda g, b: change(g, (1.0, b)), 0.0, step)


def solve_by_run(run: EkfRun, result: SmootherEvidence) -> Solve:
    """Return the solution, by a run's association, of a log that is changed."""
    poses = Poses(run.timeline.epoch_time_s, result.poses)

    def solved(changed: Log, afresh: bool) -> SolvedLog:
        timeline = build_timeline(changed, run.positions)
        problem = build_problem(changed, replace(run, timeline=timeline))
        graph = build_graph(problem)
        if afresh:
            values = relaxed_values(problem)
        else:
            seen = problem.seen_landmarks, problem.pose_landmarks
            values = to_values(poses.at(timeline.epoch_time_s), result.landmarks, *seen)
        optimum = levenberg_marquardt(graph, values, _TOLERANCE)[0]
        ids, labels = run.estimate.landmark_id.tolist(), dict(run.estimate.labels)
        return SolvedLog(Goodness(problem, graph, optimum), timeline.epoch_time_s, ids, labels)

    return solved


def fitted_numbers(log: Log, solve: Solve, test: ChiSquareTest) -> list[LogFit]:
    """Return the numbers that make a log fit whose chi-square is too high, the best first.

    test: of the log as it is.
    """
    rough = []
    for one in _numbers(log):
        fit = _Fit(log, solve, test.chi2, one)
        rough.append((fit.round(), fit))
    rough.sort(key=lambda pair: pair[0])
    candidates = []
    for _, fit in rough[:_MOST_REFINED]:
        if promising(test, fit.refined(), len(rough)):
            candidates.append(fit.log_fit)
    return alike([one for one in candidates if one.fits])


def alike(fits: Sequence[LogFit]) -> list[LogFit]:
    """Return the likeliest first, and those that are not much less likely."""
    least = min((one.chi2 for one in fits), default=0.0)
    return sorted((one for one in fits if one.chi2 <= least + _AS_LIKELY), key=lambda one: one.chi2)


def promising(test: ChiSquareTest, chi2: float, changes: int) -> bool:
    """Whether a change may explain a chi-square that is too high: no more is left than noise.

    What makes chi-square too low instead, as a scale that shrinks all residuals, explains nothing.
    test: without the change. chi2: with it. changes: how many were tried.
    """
    if not test.lower <= chi2 <= test.upper < test.chi2:
        return False
    f = (test.chi2 - chi2) / (chi2 / max(test.dof - 1, 1))
    return changes * float(fdtrc(1, test.dof - 1, f)) < LEVEL


class _Fit:
    """Newton's method on chi-square by one number."""

    def __init__(self, log: Log, solve: Solve, chi2: float, number: _Number) -> None:
        self._log, self._solve, self._number = log, solve, number
        self._at, self._step = number.neutral, number.step
        self._chi2, self._afresh = chi2, True
        opposite = self._of(-number.neutral) if number.neutral else np.inf
        self._afresh = opposite < chi2
        if self._afresh:
            self._at, self._chi2 = -number.neutral, opposite
        if number.grid:
            self._scan(number.grid)

    @property
    def log_fit(self) -> LogFit:
        """The number as it is."""
        number, at = self._number, self._at
        solved = self._solve(number.change(self._log, at), self._afresh)
        return LogFit(number.words.format(at), solved, lambda log: number.change(log, at))

    def refined(self) -> float:
        """Chi-square at the number that fits best."""
        for _ in range(_ROUNDS - 1):
            before = self._chi2
            self.round()
            if before - self._chi2 < 1e-3 * before:
                break
        return self._chi2

    def round(self) -> float:
        """Take a step of Newton's, halved until chi-square falls; return chi-square then."""
        up, down = (self._of(self._at + sign * self._step) for sign in (1.0, -1.0))
        bend = up - 2.0 * self._chi2 + down
        if not np.isfinite(bend):
            return self._chi2
        slope = 0.5 * (up - down)
        move = -slope / bend * self._step if bend > 0.0 else -np.sign(slope) * 8.0 * self._step
        for _ in range(_ROUNDS):
            chi2 = self._of(self._at + move)
            if chi2 < self._chi2:
                self._at, self._chi2 = self._at + move, chi2
                self._step = min(self._step, 0.25 * abs(move))
                break
            move *= 0.5
        return self._chi2

    def _scan(self, grid: tuple[float, ...]) -> None:
        """Go to the best number around the best of a grid."""
        found = [self._of(number) for number in grid]
        best = int(np.argmin(found))
        beside = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        options = {"maxiter": 12, "xatol": self._step / 10.0}
        fine = minimize_scalar(self._of, bounds=beside, method="bounded", options=options)
        for at, chi2 in ((grid[best], found[best]), (float(fine.x), float(fine.fun))):
            if chi2 < self._chi2:
                self._at, self._chi2 = at, chi2

    def _of(self, number: float) -> float:
        """Chi-square of the smoother with the number; infinite where the log cannot have it."""
        try:
            return self._solve(self._number.change(self._log, number), self._afresh).chi2
        except (InputError, RuntimeError, ValueError):
            return np.inf
