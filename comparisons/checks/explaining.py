"""What explains a disagreement, or an optimum that is not verified, and never makes one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from comparisons.checks.check import Check
from comparisons.checks.consistency.consistency import Consistency
from comparisons.checks.consistency.finding import ConsistencyFinding
from comparisons.checks.finding import Finding
from comparisons.checks.verdict import to_explain
from comparisons.figures import degrees
from comparisons.words import Cause
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
    """Which number of the log, or which sigma, makes chi-square too high?"""

    name = "misfit"
    needs = "a run whose estimates disagree, or whose optimum is not verified"
    errs = "not at all: it explains another cause"

    def find(self, known: Known) -> Explaining | None:
        """Return what is wrong with the log, or else which sensor's innovations are too large."""
        test = known.result.optimality.chi_square
        if not to_explain(known) or test.reading != "too high":
            return None
        wrong = _wrong_log(known, test)
        return Explaining(wrong or noise(test, known.value(ConsistencyFinding)))


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


def _wrong_log(known: Known, test: ChiSquareTest) -> list[Cause]:
    """Return what of the log's own numbers is wrong."""
    from comparisons.checks.diagnosis.first_pose import exchanged_rows
    from comparisons.checks.diagnosis.log_doctor import examine_run
    from comparisons.checks.diagnosis.log_fit import log_fits

    log, run, result, smoothed = known.prepared.log, known.ekf, known.result, known.smoothed
    known.prepared.progress("the log's own numbers", 0, 0)
    if rows := exchanged_rows(log.prior, smoothed.pose[0], smoothed.pose_covariance[0]):
        return [_log_fault(rows)]
    if fits := log_fits(log, run, result):
        return [_log_number(fits, test)]
    found = examine_run(log, run, result)
    return [_log_fault(found.words)] if found.findings else []


def _log_number(fits: Sequence[LogFit], test: ChiSquareTest) -> Cause:
    """Numbers that would make the log fit, of which there is one at least."""
    named = ", or ".join(f"to {one.chi2:.0f} with {one.what}" for one in fits)
    return Cause(
        "log",
        f"the smoother's chi-square falls from {test.chi2:.0f} (for {test.dof} degrees of "
        f"freedom) {named}",
        "check the calibration, units and clock of this sensor; correct the log and run again",
    )


def _log_fault(words: str) -> Cause:
    """What the log looks like, with what mends it."""
    return Cause("log", words, "make the log again with this changed (slamcheck new-log)")


def noise(test: ChiSquareTest, consistency: Consistency | None) -> list[Cause]:
    """The sensors whose innovations are too large, where the smoother's residuals are, too."""
    if consistency is None:
        return []
    off = [
        (nis, sensor.sensor)
        for sensor in consistency.sensors
        for nis in sensor.nis[1:]
        if nis.worded(consistency.outside)[0] == "too high"
    ]
    if not off:
        return []
    worst, of = max(off, key=lambda pair: pair[0].mean)
    listed = ", ".join(f"{name}' {n.name} {n.mean:.3g} (expected {n.dof})" for n, name in off)
    return [
        Cause(
            "noise",
            f"the smoother's chi-square is too high, {test.chi2:.0f} for {test.dof} degrees of "
            f"freedom; these mean NIS are too high as well: {listed}",
            f"check the sigma of the {of}' {worst.name}: if nothing else is wrong, it is about "
            f"{worst.mean**0.5:.2g} times too small; also check the association",
        )
    ]


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
