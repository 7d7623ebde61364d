"""What is wrong with a log before any filter sees it, by composing slots and changes.

The smoother solves a part of the log with the log's labels as it is and with each correction of
`faults.of_logs`, fitted where it has numbers (`log_fit`); one is named where what is left is the
stated noise, as a whole and by sensor, landmark and time. Where no value of the log explains it,
two exchanged labels may, or another noise of a sensor (`sigma_fit`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.smoother_input import assemble, build_problem, position_rows
from comparisons.adapters.time_window import cut_log
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.checks.diagnosis.exchanged_labels import label_corrections
from comparisons.checks.diagnosis.log_fit import (
    LogFit,
    LogFits,
    TestedLog,
    fits_of,
    less_noisy,
    not_excluded,
)
from comparisons.checks.diagnosis.sigma_fit import sigma_fits
from comparisons.checks.diagnosis.solved_log import LogSolver, SolvedLog
from comparisons.errors import InputError
from comparisons.faults.of_logs import corrections, sigma_corrections
from comparisons.logs.log import Log
from comparisons.logs.transforms.known_landmarks import indices_by_label, join_known_measurements
from graphslam.optimum import ChiSquareTest
from graphslam.problem import SlamProblem

_MOST_MEASUREMENTS = 600
"""Of the part that is solved first."""
_FEW_MEASUREMENTS = 150
"""Of the part by which corrections are sorted out."""
_FEWEST_MEASUREMENTS = 60
"""Of the part by which those are sorted out that would make the residuals of a sound log larger."""
_FEWEST = 20
"""Degrees of freedom; fewer tell nothing."""


class Examination(NamedTuple):
    """What is wrong with a log.

    test: of the log as it is, or of its first part. findings: corrections with which all of it
    fits, the likeliest first. lacks: why none is tried. departure: where its residuals leave the
    stated noise, if no correction makes it fit. part: what is tested, where that is not the whole.
    """

    test: ChiSquareTest
    findings: list[LogFit]
    lacks: str = ""
    departure: str = ""
    part: str = ""

    @property
    def words(self) -> str:
        """A sentence with the figures and what mends it, or where the log leaves its noise.

        Empty where nothing is wrong.
        """
        test = self.test
        if self.findings:
            what = ", or ".join(f"{finding.said} ({finding.mend})" for finding in self.findings)
            return (
                f"the log fits {what}: the smoother's chi-square falls from {test.chi2:.4g} to "
                f"{self.findings[0].chi2:.4g} with this changed, for {test.dof} degrees of freedom"
            )
        if test.reading != "too high":
            return ""
        where = f"; {self.departure}" if self.departure else ""
        return (
            f"chi-square{self.part} is too high, {test.chi2:.4g} for {test.dof} degrees of "
            f"freedom, and none of the changes tried fits{where}"
        )


def examine(log: Log) -> Examination:
    """Return what is wrong with columns, clocks, places, frames or sigmas of a log with labels.

    Nothing for a log that fits. Of a long log a part is solved first; what makes that fit has to
    make all of it fit.
    """
    log = join_known_measurements(log)
    part = _part(log)
    tested, lacks = _tested(part)
    if tested is None:
        return Examination(ChiSquareTest(0.0, 0, 0.0, 0.0), [], lacks)
    scope = "" if part is log else f" of its first {len(part.measurements.time_s)} measurements"
    whole: TestedLog | None = tested if part is log else None
    least = np.inf
    for search in (_of_values, _of_labels, _of_sigmas):
        fits, least = search(tested, least)
        if fits and part is not log:
            whole = whole or _tested(log)[0]
            fits = [] if whole is None else _of_whole(whole, fits, search)
        if fits and whole is not None:
            return Examination(whole.test, fits)
    high = tested.test.reading == "too high"
    departure = tested.solved.departure if high else ""
    return Examination(tested.test, [], departure=departure, part=scope)


def examine_run(log: Log, run: EkfRun, solved: SolvedLog) -> list[LogFit]:
    """Return what makes a log fit as a run used it, the likeliest first.

    Nothing where another noise alone does, which `other_noise` says of a run.

    log: as the estimators read it. solved: the smoother's optimum, whose chi-square is too high.
    """
    log = fused_log(log, run)
    whole = TestedLog(log, solved, solver_of_run(run, solved))
    named = _labelled(log, run)
    part = _part(named)
    tested: TestedLog | None = whole
    if len(part.measurements.time_s) < len(named.measurements.time_s):
        tested = _tested(part)[0]
    least = np.inf
    for search in (_of_values, _of_sigmas):
        fits, least = LogFits([]) if tested is None else search(tested, least)
        if fits and tested is not whole:
            fits = _of_whole(whole, fits, search)
        if any(fit.name is not None or not fit.correction.sensors for fit in fits):
            return fits
    return []


Search = Callable[[TestedLog, float], LogFits]
"""Of a log, beside a chi-square that other corrections leave; infinite where there are none."""


def _of_whole(whole: TestedLog, fits: list[LogFit], search: Search) -> list[LogFit]:
    """What makes a part fit has to make all of the log fit."""
    if search is _of_labels:
        return search(whole, np.inf).fits
    tried = list(dict.fromkeys(fit.correction for fit in fits))
    if search is _of_sigmas:
        near = {fit.correction.slot: fit.correction._replace(neutral=fit.numbers) for fit in fits}
        return sigma_fits(whole, near.values()) if _is_suspect(whole) else []
    if _is_suspect(whole) and (found := fits_of(whole, tried).fits):
        return found
    return less_noisy(whole, tried).fits


def _is_suspect(tested: TestedLog) -> bool:
    """Whether something leaves the stated noise, and less may be left of it."""
    return tested.test.reading != "too low" and not tested.solved.goodness.sound


def _of_values(tested: TestedLog, least: float) -> LogFits:
    """Values, clocks, places and frames."""
    tried = list(corrections(tested.log))
    if _is_suspect(tested):
        short = _tested(_part(tested.log, _FEW_MEASUREMENTS))[0]
        left = tried if short is None else not_excluded(short, tried)
        fits = fits_of(tested, left, least)
        if fits.fits or np.isfinite(fits.least):
            return fits
    return less_noisy(tested, tried, _tested(_part(tested.log, _FEWEST_MEASUREMENTS))[0])


def _of_labels(tested: TestedLog, least: float) -> LogFits:
    if tested.test.reading != "too high":
        return LogFits([], least)
    return fits_of(tested, list(label_corrections(tested)), least)


def _of_sigmas(tested: TestedLog, least: float) -> LogFits:
    """Nothing beside a promising correction of another kind, for a larger noise explains all."""
    if not _is_suspect(tested) or np.isfinite(least):
        return LogFits([], least)
    return LogFits(sigma_fits(tested, sigma_corrections(tested.log)))


def _tested(log: Log) -> tuple[TestedLog | None, str]:
    """Return a log with its optimum, or why there is none."""
    if not log.measurements.labelled or not len(log.odometry.time_s):
        return None, "the log has no labelled measurements of landmarks"
    solver = solver_by_labels(log)
    try:
        solved = solver.solved(log)
    except (InputError, RuntimeError, ValueError):
        return None, "the smoother cannot solve a part of it"
    if not np.isfinite(solved.chi2) or solved.goodness.test.dof < _FEWEST:
        return None, "the smoother cannot solve a part of it"
    return TestedLog(log, solved, solver), ""


def _part(log: Log, most: int = 0) -> Log:
    """The first measurements, _MOST_MEASUREMENTS or so many, and what goes with them."""
    most = most or _MOST_MEASUREMENTS
    time_s = np.sort(log.measurements.time_s)
    if len(time_s) <= most:
        return log
    return cut_log(log, None, float(time_s[most]) - log.prior.time_s)


def solver_by_labels(log: Log) -> LogSolver:
    """Return what solves a log, and changes of it, by the labels of its measurements."""
    _, ids = indices_by_label(log)
    order = np.argsort(ids)

    def problem(changed: Log) -> tuple[SlamProblem, Array]:
        timeline = build_timeline(changed, changed.positions)
        index = order[np.searchsorted(ids[order], changed.measurements.landmark)]
        fixes = position_rows(timeline, changed.positions)
        return assemble(changed, timeline, index, len(ids), fixes), timeline.epoch_time_s

    return LogSolver(problem, ids.tolist(), log.labels)


def fused_log(log: Log, run: EkfRun) -> Log:
    """Return a log with those of its positions that a run fused."""
    fused = run.positions and run.positions.chosen(run.fix_number)
    return replace(log, positions=fused)


def solver_of_run(run: EkfRun, solved: SolvedLog) -> LogSolver:
    """Return what solves a log with its fused positions, and changes of it, as a run did."""

    def problem(changed: Log) -> tuple[SlamProblem, Array]:
        timeline = build_timeline(changed, changed.positions)
        count = len(timeline.position_epoch)
        used = replace(
            run, timeline=timeline, positions=changed.positions, fix_number=np.arange(count)
        )
        return build_problem(changed, used), timeline.epoch_time_s

    return LogSolver(problem, solved.landmarks, solved.labels)


def _labelled(log: Log, run: EkfRun) -> Log:
    """The log with the run's association for labels where it has none, unused rows left out."""
    if log.measurements.labelled:
        return log
    index = run.landmark_index
    rows = np.flatnonzero(index >= 0)
    labels = run.estimate.landmark_id[index[rows]]
    return replace(log, measurements=replace(log.measurements.chosen(rows), landmark=labels))
