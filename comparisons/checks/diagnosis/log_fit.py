"""Corrections of a log that leave its stated noise, with their numbers.

The smoother solves the log with each correction of `faults.of_logs`. Numbers are fitted by Newton's
method on the optimum's chi-square: the residuals' derivative by a number, less what the state
absorbs of it, gives step and standard deviation. A number that has a name within its interval is
said by that name. `log_doctor` calls this for a log and for a run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import fdtrc

from comparisons.arrays import Array
from comparisons.checks.diagnosis.solved_log import LogSolver, SolvedLog
from comparisons.errors import InputError
from comparisons.faults.of_logs import LogCorrection, NamedNumber
from comparisons.logs.log import Log
from graphslam.goodness_of_fit import far_less
from graphslam.optimum import ChiSquareTest
from graphslam.problem import SlamProblem
from graphslam.sparse_system import column_lengths, normal_factors, scaled_columns, sparse_system

LEVEL = 1e-6
"""Of the F test of all corrections together."""
_ROUNDS = 8
_HALVINGS = 3
_SETTLED = 0.1
"""Chi-square that another step would take off, of a number that is found."""
_LEAST_PROMISE = 8.0
"""Chi-square that a first step takes off where it lies in its band, or a number is not sought."""
_LEAST_GAIN = 0.02
"""Share of the excess that a step takes off, or there is no use in another."""
AS_LIKELY = -2.0 * float(np.log(LEVEL))
"""Chi-square above the least: what leaves no more may be the one."""
_QUANTILE = 3.29
"""Standard deviations to both ends of an interval of 99.9 %."""
_WIDEST = 0.05
"""Standard deviation, relative to the number or to a radian, beyond which a number has no name."""
_SURE = 0.01
"""Half the interval of a factor that has a name, within which it is that and no calibration."""
_CALIBRATIONS = 1.0 / 3.0, 3.0
"""Factors between these may be calibrations as well."""
_LOOSE = 1.25
"""Times the upper end of a short part's band; what leaves more is excluded."""
_FAILURES = (InputError, RuntimeError, ValueError, FloatingPointError)


class LogFit(NamedTuple):
    """A correction with which a log fits.

    Attributes:
        correction: What is corrected.
        numbers: Of it.
        sigmas: Of these; NaN where they are not known.
        solved: With it.
        name: Of its number, if it has one.
    """

    correction: LogCorrection
    numbers: tuple[float, ...]
    sigmas: tuple[float, ...]
    solved: SolvedLog
    name: NamedNumber | None = None

    @property
    def what(self) -> str:
        """What is wrong, in words."""
        return self.correction.what(*self.numbers) if self.name is None else self.name.what

    @property
    def said(self) -> str:
        """The same as the end of `the log fits ...`, with the interval of a single number."""
        if self.name is not None or not self.numbers:
            return f"if {self.what}"
        bounds = ""
        if np.isfinite(self.interval).all():
            low, high = sorted(map(self.correction.shown, self.interval))
            bounds = f" ({low:.4g} to {high:.4g})"
        return f"with {self.what}{bounds}"

    @property
    def interval(self) -> tuple[float, float]:
        """Of a single number, 99.9 %; infinite of several."""
        if len(self.numbers) != 1 or not np.isfinite(self.sigmas[0]):
            return -np.inf, np.inf
        number, wide = self.numbers[0], _QUANTILE * self.sigmas[0]
        if self.correction.sensors:
            spread = float(np.exp(wide / number))
            return number / spread, number * spread
        return number - wide, number + wide

    @property
    def mend(self) -> str:
        """What the user may do."""
        return self.correction.mend if self.name is None else self.name.mend

    @property
    def unit(self) -> bool:
        """Whether it is about a unit."""
        return self.name is not None and self.name.is_unit

    @property
    def chi2(self) -> float:
        """Of the whole with the correction."""
        return self.solved.chi2

    def correct(self, log: Log) -> Log:
        """Return a log as it should be."""
        return self.correction.correct(log, *self.numbers)


class TestedLog(NamedTuple):
    """A log, or its first part, with its optimum and what solves it when it is changed."""

    log: Log
    solved: SolvedLog
    solver: LogSolver

    @property
    def test(self) -> ChiSquareTest:
        """Of the log as it is."""
        return self.solved.goodness.test

    def with_correction(
        self, correction: LogCorrection, numbers: Sequence[float], near: SolvedLog | None = None
    ) -> SolvedLog | None:
        """Return the optimum with a correction; None where there is none.

        near: an optimum from where it is sought; None to seek it afresh.
        """
        try:
            solved = self.solver.solved(correction.correct(self.log, *numbers), near)
        except _FAILURES:
            return None
        return solved if np.isfinite(solved.chi2) else None


class LogFits(NamedTuple):
    """Corrections with which a log fits, the likeliest first.

    least: deviance, as `_deviance`, of the likeliest of all that were tried, infinite where none is
        promising. It may not be among the fits, for a part of what it leaves is no noise.
    """

    fits: list[LogFit]
    least: float = np.inf


def fits_of(
    tested: TestedLog, corrections: Sequence[LogCorrection], least: float = np.inf
) -> LogFits:
    """Return the corrections with which a log fits.

    tested: some part of its residuals leaves the stated noise. least: deviance of others, beside
    which these have to be likely.
    """
    fits = []
    for correction in corrections:
        fit = _fitted(tested, correction)
        if fit is None or not promising(
            tested.test, fit.chi2, len(corrections), max(1, len(fit.numbers))
        ):
            continue
        least = min(least, _deviance(tested, fit))
        fits += [one for one in _by_name(tested, fit) if one.solved.goodness.sound]
    return LogFits(_alike(tested, fits, least), least)


def less_noisy(
    tested: TestedLog, corrections: Iterable[LogCorrection], short: TestedLog | None = None
) -> LogFits:
    """Return the corrections that keep the size of all residuals, and with which they are far less.

    tested: its chi-square may lie in its band, for its sigmas may be too large. short: a part of
    it, whose residuals they must not make larger.
    """
    fits: list[LogFit] = []
    for correction in corrections:
        names: list[NamedNumber | None] = [
            number for number in correction.names if number.keeps_size
        ]
        for name in [None] if correction.keeps_size else names:
            fits += _less_noise(tested, correction, name, short)
    return LogFits(_alike(tested, fits))


def _less_noise(
    tested: TestedLog, correction: LogCorrection, name: NamedNumber | None, short: TestedLog | None
) -> Iterator[LogFit]:
    numbers = () if name is None else (name.number,)
    if short is not None:
        part = short.with_correction(correction, numbers)
        if part is None or part.chi2 > short.solved.chi2 + AS_LIKELY:
            return
    solved = tested.with_correction(correction, numbers)
    if solved is None or not far_less(solved.goodness.test, tested.test):
        return
    if solved.goodness.within:
        yield LogFit(correction, numbers, (np.nan,) * len(numbers), solved, name)


def not_excluded(tested: TestedLog, corrections: Sequence[LogCorrection]) -> list[LogCorrection]:
    """Return the corrections that a short part of a log does not exclude, from its numbers on.

    tested: the part; all of them where it fits as it is.
    """
    if tested.test.reading != "too high":
        return list(corrections)
    most = _LOOSE * tested.test.upper
    fits = (_fitted(tested, correction) for correction in corrections)
    return [_from_there(fit) for fit in fits if fit is not None and fit.chi2 <= most]


def _alike(tested: TestedLog, fits: Sequence[LogFit], least: float = np.inf) -> list[LogFit]:
    """Return the likeliest first, and those that are not much less likely.

    least: deviance of others.
    """
    deviances = [_deviance(tested, fit) for fit in fits]
    least = min((least, *deviances))
    order = np.argsort(deviances, kind="stable").tolist()
    return simplest([fits[k] for k in order if deviances[k] <= least + AS_LIKELY])


def _deviance(tested: TestedLog, fit: LogFit) -> float:
    """Chi-square, what the odometry's noise adds, of which a correction makes another, and numbers.

    The noise of a car's turns grows with the speed, so that speeds in mm/s are held by nothing. A
    number costs the logarithm of the degrees of freedom, as in Schwarz's criterion.
    """
    problem, stated = fit.solved.goodness.problem, tested.solved.goodness.problem
    noise = len(problem.steps) * (_log_noise(problem) - _log_noise(stated))
    return fit.chi2 + noise + len(fit.numbers) * float(np.log(max(tested.test.dof, 1)))


def _log_noise(problem: SlamProblem) -> float:
    """Mean logarithm of the determinants of the increments' covariances."""
    covariances = problem.increment_covariance[problem.steps]
    return float(np.linalg.slogdet(covariances)[1].mean()) if len(covariances) else 0.0


def simplest(fits: Sequence[LogFit]) -> list[LogFit]:
    """Return fits without what contains another one of them, and none said twice."""
    keys = {(fit.correction.slot, fit.correction.change) for fit in fits}
    said: dict[str, LogFit] = {}
    for fit in fits:
        if not keys.intersection(fit.correction.contains):
            said.setdefault(fit.what, fit)
    return list(said.values())


def promising(test: ChiSquareTest, chi2: float, changes: int, numbers: int = 1) -> bool:
    """Whether a correction may explain what leaves the noise: no more is left than noise.

    What makes chi-square too low instead, as a scale that shrinks all residuals, explains nothing.
    test: without it. chi2: with it. changes: how many were tried. numbers: that it has.
    """
    if not test.lower <= chi2 <= min(test.upper, test.chi2):
        return False
    left = max(test.dof - numbers, 1)
    f = (test.chi2 - chi2) / numbers / (chi2 / left)
    return changes * float(fdtrc(numbers, left, f)) < LEVEL


def _from_there(fit: LogFit) -> LogCorrection:
    """The correction, whose numbers are sought next to those of a fit."""
    correction = fit.correction
    if len(fit.numbers) != 1:
        return correction
    (number,) = fit.numbers
    nearest = [
        name for name in correction.names if abs(name.number - number) <= 0.5 * abs(name.number)
    ]
    if correction.grid:
        place = int(np.clip(np.searchsorted(correction.grid, number), 1, len(correction.grid) - 1))
        return correction._replace(grid=correction.grid[max(place - 2, 0) : place + 2])
    return correction._replace(names=tuple(nearest))


def _fitted(tested: TestedLog, correction: LogCorrection) -> LogFit | None:
    """A correction with the numbers that leave least; None where it leaves no less."""
    if not correction.neutral:
        solved = tested.with_correction(correction, ())
        return None if solved is None else LogFit(correction, (), (), solved)
    neutral, plausible = np.array(correction.neutral), tested.test.reading == "plausible"
    if plausible:
        linear = _step(tested, correction, neutral, tested.solved)
        if linear is not None and linear[2] < _LEAST_PROMISE:
            return None
    if correction.grid:
        return _scanned(tested, correction)
    fit = _by_newton(tested, correction, neutral, tested.solved)
    if plausible or (fit is not None and fit.chi2 <= tested.test.upper):
        return fit
    starts = [
        (solved.chi2, name.number, solved)
        for name in correction.names
        if (solved := tested.with_correction(correction, (name.number,))) is not None
    ]
    if not starts:
        return fit
    _, number, solved = min(starts, key=lambda start: start[0])
    other = _by_newton(tested, correction, np.array((number,)), solved)
    fits = [one for one in (fit, other) if one is not None]
    return min(fits, key=lambda fit: fit.chi2, default=None)


def _by_newton(
    tested: TestedLog, correction: LogCorrection, numbers: Array, solved: SolvedLog
) -> LogFit | None:
    """Newton's method from numbers whose optimum is known."""
    sigmas = np.full(len(numbers), np.nan)
    for _ in range(_ROUNDS):
        linear = _step(tested, correction, numbers, solved)
        if linear is None:
            return None
        step, sigmas, promised = linear
        before = solved.chi2
        for halving in range(_HALVINGS):
            trial = numbers + 0.5**halving * step
            nearer = tested.with_correction(correction, trial.tolist(), solved)
            if nearer is not None and nearer.chi2 < before:
                numbers, solved = trial, nearer
                break
        gain, excess = before - solved.chi2, before - tested.test.dof
        if promised < _SETTLED or gain < _SETTLED or gain < _LEAST_GAIN * excess:
            break
    return LogFit(correction, tuple(numbers.tolist()), tuple(sigmas.tolist()), solved)


def _step(
    tested: TestedLog, correction: LogCorrection, numbers: Array, solved: SolvedLog
) -> tuple[Array, Array, float] | None:
    """Newton's step, the numbers' standard deviations, and what it promises to take off."""
    goodness = solved.goodness
    jacobian, right = sparse_system(goodness.graph, goodness.values, goodness.rows)
    slopes = []
    for k, size in enumerate(correction.steps):
        ends = []
        for sign in (1.0, -1.0):
            moved = numbers.copy()
            moved[k] += sign * size
            try:
                ends.append(
                    tested.solver.right_hand_side(
                        correction.correct(tested.log, *moved.tolist()), goodness.values
                    )
                )
            except _FAILURES:
                return None
        if len(ends[0]) != len(right) or len(ends[1]) != len(right):
            return None
        slopes.append((ends[0] - ends[1]) / (2.0 * size))
    slope = np.column_stack(slopes)
    jacobian = scaled_columns(jacobian, column_lengths(jacobian))
    try:
        solver = normal_factors(jacobian)
    except RuntimeError:
        return None
    slope = slope - jacobian @ solver.solve(jacobian.T @ slope)
    information = slope.T @ slope
    if not np.isfinite(information).all() or np.linalg.cond(information) > 1e14:
        return None
    step = -np.linalg.solve(information, slope.T @ right)
    sigmas = np.sqrt(np.diagonal(np.linalg.inv(information)))
    return step, sigmas, float(step @ information @ step)


def _scanned(tested: TestedLog, correction: LogCorrection) -> LogFit | None:
    """The best number around the best of a grid; its interval is where chi-square has risen."""

    def chi2_at(number: float) -> float:
        solved = tested.with_correction(correction, (number,))
        return np.inf if solved is None else solved.chi2

    grid = correction.grid
    coarse = [chi2_at(number) for number in grid]
    best = int(np.argmin(coarse))
    number, least, step = grid[best], coarse[best], correction.steps[0]
    neighbours = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    if correction.change == "lag":
        samples = np.arange(neighbours[0], neighbours[1] + 1.0).tolist()
        least, number = min((chi2_at(sample), sample) for sample in samples)
    else:
        options = {"maxiter": 14, "xatol": step / 20.0}
        fine = minimize_scalar(chi2_at, bounds=neighbours, method="bounded", options=options)
        if float(fine.fun) < least:
            number, least = float(fine.x), float(fine.fun)
    solved = tested.with_correction(correction, (number,))
    if solved is None:
        return None
    bend = min(chi2_at(number + step), chi2_at(number - step)) - least
    sigma = step / np.sqrt(bend) if bend > 0.0 else np.nan
    return LogFit(correction, (number,), (float(sigma),), solved)


def _by_name(tested: TestedLog, fit: LogFit) -> list[LogFit]:
    """The fit by the name of its number, where one lies within its interval and fits as well.

    Also where one is near a number that does not fit, for far from the log as it is the numbers are
    not found exactly. A name that may be a calibration is said beside its number.
    """
    if len(fit.numbers) != 1 or not fit.correction.names:
        return [fit]
    number, wide = fit.numbers[0], _QUANTILE * fit.sigmas[0]
    name = min(fit.correction.names, key=lambda name: abs(name.number - number))
    is_factor = fit.correction.change == "times"
    scale = abs(name.number) if is_factor else 1.0
    distance = abs(name.number - number)
    inside = distance <= wide <= _QUANTILE * _WIDEST * scale
    near = distance <= _WIDEST * scale and not fit.solved.goodness.sound
    if not (inside or near):
        return [fit]
    solved = tested.with_correction(fit.correction, (name.number,))
    if solved is None or not solved.goodness.sound:
        return [fit]
    named = LogFit(fit.correction, (name.number,), fit.sigmas, solved, name)
    low, high = _CALIBRATIONS
    certain = not (is_factor and low < name.number < high) or wide <= _SURE * scale
    return [named] if certain else [named, fit]
