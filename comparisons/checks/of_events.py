"""The checks of an audit: what the recorded events of any Kalman filter say of it.

All of them read the figures of one pass through the events; see comparisons.audit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from comparisons.audit.audit import AlgebraGap, Audit, Progress
from comparisons.audit.audit import audit as go_through
from comparisons.audit.functions import FunctionFigures
from comparisons.audit.least_squares import LARGEST_ANCHORED
from comparisons.audit.spurious import LearntDirection
from comparisons.checks.check import Question
from comparisons.checks.finding import Absent, Finding, Findings
from comparisons.innovations import InnovationFigures, SensorInnovations
from comparisons.shown import Brief
from comparisons.statistics import Averaged
from comparisons.words import Row

_STATISTICAL = "on 1 of 1,000 sound linear traces, together with the other statistical checks"
_MOST_LINES = 3
"""Sensors that are named below the verdict."""


@dataclass(frozen=True, repr=False)
class KnownEvents(Findings, Brief):
    """What an audit knows, and what its checks find. audit: the figures of its pass."""

    audit: Audit
    findings: dict[str, Finding] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)


def audit_trace(path: str | Path, tolerance: float, progress: Progress | None = None) -> Audit:
    """Audit a trace, and say what it lacks for a check; see `comparisons.audit.audit.audit`."""
    audit = go_through(path, tolerance, progress)
    return replace(audit, not_checked=ask_events(audit).absent)


def ask_events(audit: Audit) -> KnownEvents:
    """Return what all checks find in an audit."""
    known = KnownEvents(audit)
    for check in EVENT_CHECKS:
        check.ask(known)
    return known


class EventFinding(Finding):
    """Rows of the table, of which none is marked in a sound trace, and lines.

    One in twenty figures of a sound filter leaves its band.
    """

    def __init__(self, audit: Audit, rows: Sequence[Row], *lines: tuple[str, str]) -> None:
        """audit: what they are of."""
        faulty = audit.verdict == "faulty"
        self._rows = [row if faulty else row._replace(inside=row.inside or None) for row in rows]
        self.lines = lines

    def rows(self) -> Sequence[Row]:
        """Return rows of the table."""
        return self._rows


class EventCheck(Question[KnownEvents]):
    """A check of an audit."""

    of = "a check of an audit"


class CheckSnapshots(EventCheck):
    """Is the covariance at every snapshot that of least squares over all events before it?"""

    name = "algebra"
    needs = "snapshots of the covariance"
    errs = "not at all but by rounding, for which --tolerance allows"
    figures = (("gaps", AlgebraGap),)

    def find(self, known: KnownEvents) -> EventFinding | Absent:
        """Return the largest gap, and where the first one opens."""
        audit = known.audit
        until = "" if audit.unsolved is None else f" before event {audit.unsolved:,}"
        if audit.largest_gap is None:
            return Absent(f"the trace has no snapshot{until}")
        largest, most = audit.largest_gap, f"at most {audit.tolerance:.0e}"
        rows = [
            Row("Algebra", f"largest gap of the {what}", f"{value:.2g}", most,
                value <= audit.tolerance)
            for what, value in (
                ("estimate [sigma]", largest.sigma),
                ("covariance", largest.covariance),
            )
        ]  # fmt: skip
        text = f"{audit.oracle_agreement:.1g} sigma^2"
        rows.append(Row("Algebra", "recursion against least squares, until a fault", text))
        gap = audit.first_open
        if gap is None:
            said = f"equal to least squares at every snapshot{until}, to {largest.worst:.1g}"
        elif audit.sound and not audit.follows_kalman:
            said = (
                "that of the filter's gains at every snapshot; by Kalman's gains it would differ "
            )
            said += f"by up to {largest.sigma:.2g} sigma, {largest.covariance:.2g} in covariance"
        elif audit.sound:  # the recursion goes on from what rounding has made of a snapshot
            said = f"that of the events at every snapshot{until}; least squares over all of them "
            said += f"differ by up to {largest.sigma:.2g} sigma, {largest.covariance:.2g} in "
            said += "covariance, by rounding"
        else:
            at = f" ({gap.time_s:.6g} s)" if audit.timed and gap.time_s is not None else ""
            said = f"gap opens at event {gap.event:,}{at}: {gap.sigma:.2g} sigma, "
            said += f"{gap.covariance:.2g} in covariance"
        return EventFinding(audit, rows, ("algebra", said))


class CheckGains(EventCheck):
    """Are the gains and corrections Kalman's?"""

    name = "gains"
    needs = "gains of updates, or corrections of the estimate"
    errs = "not at all but by rounding, for which --tolerance allows"

    def find(self, known: KnownEvents) -> EventFinding | Absent:
        """Return how many were compared."""
        audit = known.audit
        if not audit.gains_compared:
            return Absent("no gain or correction is recorded")
        unlike, count = audit.gains_unlike, audit.gains_compared
        whose = "all Kalman's"
        if unlike:
            whose = "none of them Kalman's" if unlike == count else f"{unlike:,} not Kalman's"
        return EventFinding(audit, (), ("gains", f"{audit.gains_compared:,} compared, {whose}"))


class CheckDerivatives(EventCheck):
    """Are F, H and the Jacobians of new blocks the derivatives of the filter's own functions?"""

    name = "derivatives"
    needs = "functions of predictions, updates or new blocks, recorded with their points"
    errs = "not at all but by rounding, for which --tolerance allows"
    figures = (("functions", FunctionFigures),)

    def find(self, known: KnownEvents) -> EventFinding | Absent:
        """Return how many matrices were compared, and how far they are from derivatives."""
        audit = known.audit
        if not audit.functions:
            return Absent("no function is recorded")
        rows = [
            Row("Derivatives", f"{slot.slot}: largest effect of a difference [sigma]",
                f"{slot.largest_sigma:.2g}", f"at most {audit.tolerance:.0e}",
                slot.differing == 0)
            for slot in audit.functions
        ]  # fmt: skip
        equal = [
            f"{slot.slot} in {slot.events - slot.differing:,} of {slot.events:,}"
            for slot in audit.functions
        ]
        return EventFinding(audit, rows, ("derivatives", f"equal: {', '.join(equal)}"))


class CheckInnovations(EventCheck):
    """Are the innovations of each sensor white, of their covariance, and gated as declared?"""

    name = "innovations"
    needs = "updates"
    errs = _STATISTICAL
    figures = (("sensors", InnovationFigures),)

    def find(self, known: KnownEvents) -> EventFinding | Absent:
        """Return the figures of every sensor."""
        audit = known.audit
        if not audit.sensors:
            return Absent("no update is recorded")
        rows = [row for sensor in audit.sensors for row in _sensor_rows(sensor)]
        lines = (("sensor", _sensor_line(sensor)) for sensor in audit.sensors[:_MOST_LINES])
        return EventFinding(audit, rows, *lines)


class CheckAgainstSmoother(EventCheck):
    """Does the filter differ from the smoother of its events by what P_f - P_s says?"""

    name = "smoother"
    needs = f"snapshots on the way, and at most {LARGEST_ANCHORED} entries of the state"
    errs = _STATISTICAL
    figures = (("smoother", Averaged),)

    def find(self, known: KnownEvents) -> EventFinding | Absent:
        """Return the average over the snapshots."""
        audit = known.audit
        if audit.smoother is None:
            return Absent(f"too few snapshots of at most {LARGEST_ANCHORED} entries")
        row = _averaged_row("filter minus smoother, per dof (1)", audit.smoother)
        return EventFinding(audit, [row], ("smoother", _averaged_words(audit.smoother)))


class CheckErrors(EventCheck):
    """Do the covariances explain the errors by the truth (NEES)?"""

    name = "NEES"
    needs = "errors by the truth, recorded with snapshots"
    errs = _STATISTICAL
    figures = (("nees", Averaged),)

    def find(self, known: KnownEvents) -> EventFinding | Absent:
        """Return the averages of the state and of its blocks."""
        audit = known.audit
        rows = [
            _averaged_row(f"NEES per dof of block {block} (1)", average)
            for block, average in audit.nees_by_block.items()
        ]
        if audit.nees is None:
            return EventFinding(audit, rows) if rows else Absent("no error is recorded")
        rows = [_averaged_row("NEES per dof (1)", audit.nees), *rows]
        return EventFinding(audit, rows, ("NEES", _averaged_words(audit.nees)))


class CheckDirections(EventCheck):
    """What has the filter learnt of directions that its sensors cannot tell?"""

    name = "spurious"
    needs = "directions, with the sensors that do not observe them"
    errs = "not at all: what it finds changes no verdict"
    figures = (("spurious", LearntDirection),)

    def find(self, known: KnownEvents) -> EventFinding | Absent:
        """Return how well each direction seems to be known."""
        audit = known.audit
        if audit.spurious is None:
            return Absent("no directions are recorded")
        sigma = {
            direction.name: f"{direction.sigma:.3g} {direction.unit}".rstrip()
            for direction in audit.spurious
            if direction.largest is not None
        }
        rows = [
            Row(
                "Spurious information",
                f"{direction.name}, claimed to",
                sigma.get(direction.name, "none"),
            )
            for direction in audit.spurious
        ]
        said = f"no information on {', '.join(direction.name for direction in audit.spurious)}"
        if sigma:
            learnt = ", ".join(f"{name} to {word}" for name, word in sigma.items())
            said = f"claimed, though no measurement observes it: {learnt}"
        return EventFinding(audit, rows, ("spurious", said))


def _averaged_row(name: str, average: Averaged) -> Row:
    return Row(
        "Consistency",
        name,
        f"{average.mean:.3g}",
        _limits(average),
        average.band.holds(average.mean),
    )


def _averaged_words(average: Averaged) -> str:
    return f"{average.mean:.3g} per degree of freedom ({_limits(average)} expected)"


def _limits(average: Averaged) -> str:
    low, high = average.band
    return f"{low:.3g} to {high:.3g}"


def _sensor_line(sensor: SensorInnovations) -> str:
    if not sensor.nis:
        return f"{sensor.sensor}: no innovation"
    nis = sensor.nis[0]
    text = (
        f"{sensor.sensor}: NIS {nis.mean:.3g} ({nis.band.low:.3g} to {nis.band.high:.3g} expected)"
    )
    if sensor.rejected or sensor.gating.passes is not None:
        text += f", {sensor.rejected:,} of {sensor.measured:,} rejected"
    return text


def _sensor_rows(sensor: SensorInnovations) -> list[Row]:
    group, gating = f"Sensor {sensor.sensor}", sensor.gating
    rows = sensor.nis_rows(group)
    rows += [
        Row(group, f"{w.component}: p of whiteness by {w.order}", f"{w.p_value:.2g}",
            "at least 0.001", w.p_value >= 0.001)
        for w in sensor.whiteness
    ]  # fmt: skip
    rejected, limits, inside = f"{sensor.rejected:,} of {sensor.measured:,}", "", None
    if gating.band is not None:
        low, high = gating.band
        limits, inside = (
            f"{100.0 * low:.2g} to {100.0 * high:.2g} %",
            gating.band.holds(sensor.rejected / sensor.measured),
        )
    return [*rows, Row(group, "rejected by the gate", rejected, limits, inside)]


EVENT_CHECKS: tuple[EventCheck, ...] = (
    CheckSnapshots(),
    CheckGains(),
    CheckDerivatives(),
    CheckInnovations(),
    CheckAgainstSmoother(),
    CheckErrors(),
    CheckDirections(),
)
"""In the order of what is printed."""
