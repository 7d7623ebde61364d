"""Stated sigmas with which a log fits: by a factor, with its interval, and by what it may be.

A larger noise leaves less chi-square whatever is wrong, so factors are compared by the restricted
likelihood. Those that have a name, as a variance has, are said if they lie in the factor's
interval; beside them the factor itself, unless it is known well. `log_doctor` calls this.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from comparisons.checks.diagnosis.log_fit import AS_LIKELY, LogFit, TestedLog, simplest
from comparisons.checks.diagnosis.solved_log import SolvedLog
from comparisons.faults.of_logs import LogCorrection
from comparisons.plane import in_own_axes
from graphslam.graph_builder import from_values

_MOST_RATIO = 4.0
"""Largest upper end over lower end of the interval of a factor: what is known worse takes up any
misfit."""
_SURE_RATIO = 1.25
"""The same, within which a factor that has a name is no chance."""
_QUANTILE = 3.29
"""Standard deviations to both ends of an interval of 99.9 %."""
_LARGEST = 5.0
"""Natural logarithm of the largest factor."""
_NEAR = 0.7
"""Natural logarithm, around a factor of a part of the log."""
_MOST_ALONG, _ALL = 5.0, 1.0 - 1e-12
"""Standard deviations of a chance correlation, beyond which residuals are no noise (by Fisher's
transformation); and a correlation that is one.
"""
_FIRST_STEP = 0.05
_CURVATURE_STEP = 0.1
_RESOLUTION = 0.005
_BEYOND = 1e3
"""Deviance above the stated of what has no optimum."""


class SigmaFit(NamedTuple):
    """A fit of sigmas with its deviance."""

    fit: LogFit
    deviance: float


def sigma_fits(tested: TestedLog, corrections: Iterable[LogCorrection]) -> list[LogFit]:
    """Return the sigmas with which a log fits, the likeliest first.

    Args:
        tested: Some part of its residuals leaves the stated noise.
        corrections: Of its sigmas; a factor's first number is where it is sought, from 1 on
            everywhere.

    Returns:
        Those that are about as likely as the likeliest, and that leave the stated noise.
    """
    stated = tested.solved.deviance
    fits: list[SigmaFit] = []
    for correction in corrections:
        fits += _factor(tested, correction) if correction.neutral else _fixed(tested, correction)
    fits = [fit for fit in fits if fit.deviance <= stated - AS_LIKELY]
    least = min((fit.deviance for fit in fits), default=0.0)
    likely = [fit for fit in fits if fit.deviance <= least + AS_LIKELY]
    return simplest([fit.fit for fit in sorted(likely, key=lambda one: one.deviance)])


def _fixed(tested: TestedLog, correction: LogCorrection) -> Iterator[SigmaFit]:
    solved = tested.with_correction(correction, (), tested.solved)
    if solved is not None and solved.goodness.sound:
        yield SigmaFit(LogFit(correction, (), (), solved), solved.deviance)


def _factor(tested: TestedLog, correction: LogCorrection) -> Iterator[SigmaFit]:
    """The factor and its names, as far as they fit."""
    peak = _likeliest(tested, correction)
    if peak is None:
        return
    logarithm, sigma = peak
    factor = float(np.exp(logarithm))
    low, high = (float(np.exp(logarithm + sign * _QUANTILE * sigma)) for sign in (-1.0, 1.0))
    if low <= 1.0 or high > _MOST_RATIO * low:
        return
    for name in correction.names:
        if low <= name.number <= high and (solved := _sound(tested, correction, name.number)):
            yield SigmaFit(
                LogFit(correction, (name.number,), (sigma * name.number,), solved, name),
                solved.deviance,
            )
    named = any(low <= name.number <= high for name in correction.names)
    if named and high <= _SURE_RATIO * low:
        return
    if solved := _sound(tested, correction, factor):
        fit = LogFit(correction, (factor,), (sigma * factor,), solved)
        yield SigmaFit(fit, solved.deviance)


def _sound(tested: TestedLog, correction: LogCorrection, factor: float) -> SolvedLog | None:
    """The optimum with a factor, if it has the noise that is stated then, and that is noise."""
    solved = tested.with_correction(correction, (factor,), tested.solved)
    if solved is None or not solved.goodness.sound:
        return None
    return None if "odometry" in correction.sensors and _goes_with_motion(solved) else solved


def _goes_with_motion(solved: SolvedLog) -> bool:
    """Whether the odometry's residuals go with the smoothed motions, as no noise of theirs does.

    Residuals and estimates of least squares are uncorrelated where all is as stated.
    """
    problem, values = solved.goodness.problem, solved.goodness.values
    poses, steps = from_values(values, problem)[0], problem.steps
    moved = in_own_axes(poses[steps], poses[steps + 1])
    off = problem.increment[steps] - moved
    size = np.linalg.norm(moved, axis=0) * np.linalg.norm(off, axis=0)
    share = (moved * off).sum(axis=0) / np.maximum(size, 1e-300)
    deviations = np.arctanh(np.clip(share, -_ALL, _ALL)) * np.sqrt(max(len(steps) - 3, 0))
    return bool((np.abs(deviations) > _MOST_ALONG).any())


def _likeliest(tested: TestedLog, correction: LogCorrection) -> tuple[float, float] | None:
    """Natural logarithm of the likeliest factor above 1, and its standard deviation."""
    stated = tested.solved.deviance

    def deviance(logarithm: float) -> float:
        solved = tested.with_correction(correction, (float(np.exp(logarithm)),), tested.solved)
        return stated + _BEYOND if solved is None else solved.deviance

    start = float(np.log(correction.neutral[0]))
    if start == 0.0 and not deviance(_FIRST_STEP) < stated:
        return None
    bounds = (start - _NEAR, start + _NEAR) if start > 0.0 else (0.0, _LARGEST)
    found = minimize_scalar(
        deviance, bounds=bounds, method="bounded", options={"xatol": _RESOLUTION}
    )
    logarithm, least = float(found.x), float(found.fun)
    bend = deviance(logarithm + _CURVATURE_STEP) + deviance(logarithm - _CURVATURE_STEP)
    curvature = (bend - 2.0 * least) / _CURVATURE_STEP**2
    return (logarithm, float(np.sqrt(2.0 / curvature))) if curvature > 0.0 else None
