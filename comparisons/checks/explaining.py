"""What explains a disagreement, or an optimum that is not verified, and never makes one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from comparisons.checks.check import Check
from comparisons.checks.consistency.consistency import Consistency
from comparisons.checks.consistency.finding import ConsistencyFinding
from comparisons.checks.diagnosis.solved_log import LogSolver, SolvedLog, solved_run
from comparisons.checks.finding import Finding
from comparisons.checks.verdict import to_explain
from comparisons.errors import InputError
from comparisons.figures import degrees
from comparisons.statistics import WORDS
from comparisons.words import Cause
from graphslam.goodness_of_fit import Goodness
from graphslam.optimum import ChiSquareTest

if TYPE_CHECKING:
    from comparisons.checks.diagnosis.dropouts import Dropouts
    from comparisons.checks.diagnosis.log_fit import LogFit
    from comparisons.pipeline.known import Known

_GREW = 3.0
"""A dropout over which the position's sigma grew so many times is named as a cause."""


class Explaining(Finding):
    """Causes that explain others."""

    def __init__(self, causes: Sequence[Cause]) -> None:
        """causes: none where this explains nothing."""
        self.causes = causes


class CheckMisfit(Check):
    """Which number of the log, or which noise, makes chi-square too high?"""

    name = "misfit"
    needs = "a run whose estimates disagree, or whose optimum is not verified"
    errs = "not at all: it explains another cause"

    def find(self, known: Known) -> Explaining | None:
        """Return what makes all of the log fit, or else where its residuals leave the noise."""
        test = known.result.optimality.chi_square
        if not to_explain(known) or test.reading != "too high":
            return None
        result = known.result
        goodness = Goodness(result.problem, result.graph, result.values)
        solved = solved_run(goodness, known.smoothed)
        return Explaining(
            _wrong_log(known, test, solved)
            or other_noise(known, test)
            or [misfit(test, solved.departure, known.value(ConsistencyFinding))]
        )


class CheckDropouts(Check):
    """Did a stretch without measurements make the filter uncertain?"""

    name = "dropouts"
    needs = CheckMisfit.needs
    errs = CheckMisfit.errs

    def find(self, known: Known) -> Explaining | None:
        """Return the worst stretch."""
        from comparisons.checks.diagnosis.dropouts import find_dropouts

        if not to_explain(known):
            return None
        return Explaining(dropout(find_dropouts(known.ekf, known.smoothed)))


def _wrong_log(known: Known, test: ChiSquareTest, solved: SolvedLog) -> list[Cause]:
    """Return what of the log's own numbers is wrong."""
    from comparisons.checks.diagnosis.log_doctor import Examination, examine_run, solver_of_run

    log, run = known.prepared.log, known.ekf
    known.prepared.progress("the log's own numbers", 0, 0)
    if rows := _exchanged_rows(known, solver_of_run(run, solved), solved):
        return [_log_fault(rows)]
    fits = examine_run(log, run, solved)
    return [_log_fault(Examination(test, fits).words, fits)] if fits else []


def _exchanged_rows(known: Known, solver: LogSolver, near: SolvedLog) -> str:
    """Return which rows of the prior's covariance are exchanged, if the log fits so."""
    from comparisons.checks.diagnosis.first_pose import exchanged_rows
    from comparisons.checks.diagnosis.log_doctor import fused_log
    from comparisons.faults.catalogue import EXCHANGED_ROWS

    run, smoothed = known.ekf, known.smoothed
    log = fused_log(known.prepared.log, run)
    words = exchanged_rows(log.prior, smoothed.pose[0], smoothed.pose_covariance[0])
    for order in EXCHANGED_ROWS.values() if words else ():
        exchanged = replace(log.prior, covariance=log.prior.covariance[np.ix_(order, order)])
        try:
            solved = solver.solved(replace(log, prior=exchanged), near)
        except (InputError, RuntimeError):
            continue
        if solved.goodness.sound:
            return words
    return ""


def _log_fault(words: str, fits: Sequence[LogFit] = ()) -> Cause:
    """What the log looks like, with what mends it. fits: what makes it fit, if it was fitted."""
    advice = "make the log again with this changed (slamcheck new-log)"
    if any(fit.numbers and fit.name is None for fit in fits):
        advice = (
            "check the calibration, units and clock of this sensor; correct the log and run again"
        )
    return Cause("log", words, advice)


def other_noise(known: Known, test: ChiSquareTest) -> list[Cause]:
    """Return the sensors whose noise alone explains all residuals."""
    from comparisons.checks.diagnosis.other_noise import other_noises
    from graphslam.variance_components import variance_components

    result = known.result
    if result.reweighted or result.lagged is not None:
        return []
    causes = []
    for noise in other_noises(result, variance_components(result)):
        low, high = noise.component.interval(WORDS)
        causes.append(
            Cause(
                "noise",
                f"the log fits with a noise of the {noise.sensor} {noise.component.factor:.2g} "
                f"times the stated ({low:.2g} to {high:.2g} in 99.9 %): chi-square falls from "
                f"{test.chi2:.0f} to {noise.test.chi2:.0f} for {test.dof} degrees of freedom",
                f"check the sigma of the {noise.sensor}",
            )
        )
    return causes


def misfit(test: ChiSquareTest, departure: str, consistency: Consistency | None) -> Cause:
    """Nothing that was tried makes the log fit. departure: where its residuals leave the noise."""
    sensors = () if consistency is None else consistency.sensors
    listed = [
        f"{sensor.sensor}' {nis.name} {nis.mean:.3g} (expected {nis.expected_words})"
        for sensor in sensors
        for nis in sensor.nis[1:]
        if consistency and nis.worded(consistency.outside)[0] == "too high"
    ]
    parts = [
        f"none of the changes tried makes the log fit: chi-square {test.chi2:.0f} for {test.dof} "
        "degrees of freedom",
        departure,
        f"these mean NIS are too high as well: {', '.join(listed)}" if listed else "",
    ]
    return Cause(
        "misfit",
        "; ".join(filter(None, parts)),
        "check what was recorded there: its association, its clock, its frame",
    )


def dropout(dropouts: Dropouts) -> list[Cause]:
    """The stretch without observations that made the vehicle uncertain, if one did."""
    worst = dropouts.worst
    if worst is None or worst.growth < _GREW:
        return []
    refused = f", {worst.refused} measurements rejected" if worst.refused else ""
    before, after = worst.sigma_heading_rad
    return [
        Cause(
            "dropout",
            f"the filter used no measurement from {worst.begin_s:.1f} to {worst.end_s:.1f} s "
            f"({worst.way_m:.1f} m driven{refused}): the position's sigma grew from "
            f"{worst.sigma_m[0]:.2g} to {worst.sigma_m[1]:.2g} m, the heading's from "
            f"{degrees(before)} to {degrees(after)}, and at the end of it the filter was "
            f"{worst.error_m:.2f} m from the smoother; such stretches are "
            f"{100.0 * (1.0 - dropouts.coverage):.0f} % of the time, and outside them the RMS "
            f"difference is {dropouts.error_outside_m:.2f} m",
            "check for a silent or blocked sensor, for lost messages, and for a gate that rejects "
            "every measurement",
        )
    ]
