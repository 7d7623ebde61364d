"""What `slamcheck audit` reports: audit.json, what is printed, and its folder with a page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import cycle, islice
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from comparisons.arrays import Array
from comparisons.audit.algebra import AuditFinding
from comparisons.audit.audit import Audit, Verdict
from comparisons.audit.error_curves import BlockErrorCurve
from comparisons.audit.spurious import Learnt
from comparisons.checks.of_events import KnownEvents, ask_events
from comparisons.report.folder import JobFolder
from comparisons.report.html.page import DatedFinding, PageContent, page_of, write_page
from comparisons.report.html.states import states_table
from comparisons.report.job import Report
from comparisons.report.marks import (
    DEPARTURE_COLOUR,
    EKF_COLOUR,
    EVENT,
    SCANS_COLOUR,
    SMOOTHER_COLOUR,
    TIME,
    TRUTH_COLOUR,
    Curve,
    FilledBand,
    Moment,
    Panel,
    nis_panel,
)
from comparisons.report.picture import blank, draw_panel
from comparisons.report.terminal import Summary
from comparisons.words import Row

if TYPE_CHECKING:
    from comparisons.pipeline.clock import Clock

_LOOKS: dict[Verdict, str] = {
    "sound": "agree",
    "faulty": "disagree",
    "nothing checked": "unverified",
}
_LACKING = (
    "no snapshot, gain or correction is recorded after a prediction or an update, so that no "
    "algebra could be checked: record snapshots of the covariance, or the gains of updates"
)
_BY_EVENT = "The curves run over the numbers of events, for the trace has not all times."
_MARKED = "Dotted lines: where a finding is first seen."
_MOST_MARKED = 12
"""Findings that are marked across the curves."""
_MOST_ERRORS = 15
"""Components of which the errors are drawn: a vehicle's, without landmarks."""
_LEAST = 1e-17
"""What a gap of nothing is drawn as."""


class AuditReport(Report[Audit, Audit]):
    """Report of `slamcheck audit`."""

    @staticmethod
    def build(audit: Audit, read: Clock | None = None) -> Audit:
        """Return the findings, which are stored as they are."""
        return audit

    @cached_property
    def known(self) -> KnownEvents:
        """What the checks find."""
        return ask_events(self.found)

    def summary(self) -> Summary:
        """Return what the command prints."""
        audit = self.found
        wrong = [finding.text for finding in audit.findings if finding.fault]
        # Where precision explains what is wrong, that goes first.
        first = [
            finding.text for finding in audit.findings if wrong and finding.check == "precision"
        ]
        named = [
            finding.text
            for finding in audit.findings
            if not finding.fault and finding.text not in first
        ]
        headline = f"verdict: {audit.verdict}"
        if wrong:
            headline += f" ({len(wrong)} finding{'s' if len(wrong) > 1 else ''})"
        lines = [
            (
                "trace",
                f"{audit.events:,} events, {audit.updates:,} updates, {audit.snapshots:,} "
                f"snapshot{'s' if audit.snapshots != 1 else ''}",
            ),
            *self.known.lines,
        ]
        if lacking := self.known.absent:
            lines.append(("not checked", "; ".join(f"{n}: {why}" for n, why in lacking.items())))
        return Summary(
            headline=headline,
            look=_LOOKS[audit.verdict],
            reasons=[_LACKING] if audit.verdict == "nothing checked" else [*first, *wrong],
            remarks=[*audit.remarks, *named],
            lines=lines,
            rows=audit_rows(self.known),
        )

    def page(self) -> PageContent:
        """Return what stands on the page."""
        audit = self.found
        summary, panels = self.summary(), [panel for panel in audit_panels(audit) if panel.curves]
        return replace(
            page_of(summary, audit.trace.name),
            reasons=summary.reasons[:1] if audit.verdict == "nothing checked" else (),
            dated=_dated(audit),
            remarks=audit.remarks,
            reported=" ".join(_reported(audit, panels)),
            panels=panels,
            curves_file="curves.png",
            sections=[states_table(audit.states)],
        )

    def folder(self) -> JobFolder:
        """Return what is to be written: the result, the page, and a picture of the curves."""
        panels = audit_panels(self.found)
        return JobFolder(
            name="audit",
            result=self.result,
            figures={"curves": audit_figure(panels)} if panels else {},
            files={"report.html": partial(write_page, self.page())},
        )

    @property
    def outcome(self) -> str:
        """Return the word that decides the command's exit code."""
        return _LOOKS[self.found.verdict]


def audit_rows(known: KnownEvents) -> list[Row]:
    """Return all figures."""
    audit = known.audit
    return [
        Row("Trace", "events", f"{audit.events:,}"),
        Row("Trace", "updates", f"{audit.updates:,}"),
        Row("Trace", "snapshots", f"{audit.snapshots:,}"),
        Row("Trace", "blocks, ever", f"{len(audit.blocks):,}"),
        *known.rows(),
    ]


def _dated(audit: Audit) -> list[DatedFinding]:
    """Return the findings with their place on the axis of the curves, faults first."""
    return [
        DatedFinding(
            finding.check.capitalize(), finding.text, _place(audit, finding), finding.fault
        )
        for finding in audit.findings
    ]


def _reported(audit: Audit, panels: Sequence[Panel]) -> Iterator[str]:
    """Yield what is said of the curves."""
    if panels and not audit.timed:
        yield _BY_EVENT
    if any(panel.moments for panel in panels):
        yield _MARKED


def _place(audit: Audit, finding: AuditFinding) -> float | None:
    return finding.time_s if audit.timed else finding.event


def audit_panels(audit: Audit) -> list[Panel]:
    """Return what is drawn over time, or over events, with the first places of the findings."""
    moments = tuple(
        Moment(f"{finding.check}, event {finding.event:,}", colour, place)
        for finding in audit.findings[:_MOST_MARKED]
        for colour in (DEPARTURE_COLOUR if finding.fault else TRUTH_COLOUR,)
        if (place := _place(audit, finding)) is not None and finding.event is not None
    )
    return [replace(panel, moments=moments) for panel in _panels(audit)]


def _panels(audit: Audit) -> list[Panel]:
    """Return the algebra gap, errors, NIS by sensor, and what was learnt of directions."""
    panels, x_label = [], TIME if audit.timed else EVENT
    if audit.gaps:
        times = [np.nan if gap.time_s is None else gap.time_s for gap in audit.gaps]
        at = _along(audit, [gap.event for gap in audit.gaps], times)
        sigma, covariance = (
            np.log10(np.maximum(np.array(values, dtype=float), _LEAST))
            for values in zip(*((gap.sigma, gap.covariance) for gap in audit.gaps), strict=True)
        )
        curves = (
            Curve("estimate [sigma]", EKF_COLOUR, at, sigma),
            Curve("covariance", SMOOTHER_COLOUR, at, covariance),
        )
        panels.append(
            Panel(
                title="log10 of the gap from least squares",
                x_label=x_label,
                curves=curves,
                bands=(),
                level=float(np.log10(max(audit.tolerance, _LEAST))),
            )
        )
    errors = (panel for curve in audit.error_curves for panel in _error_panels(audit, curve))
    panels += islice(errors, _MOST_ERRORS)
    panels += [
        nis_panel(
            sensor, EKF_COLOUR, _along(audit, sensor.windows.event, sensor.windows.time_s), x_label
        )
        for sensor in audit.sensors
        if len(sensor.windows.event) > 1
    ]
    if audit.learnt is not None and len(audit.learnt.event) > 1:
        at = _along(audit, audit.learnt.event, audit.learnt.time_s)
        panels.append(_spurious_panel(audit.learnt, at, x_label))
    return panels


def _error_panels(audit: Audit, curve: BlockErrorCurve) -> Iterator[Panel]:
    """Yield the error of each component, within 3 sigma of its covariance."""
    if len(curve.event) < 2:
        return
    at, several = _along(audit, curve.event, curve.time_s), curve.error.shape[1] > 1
    for k, (error, sigma) in enumerate(zip(curve.error.T, curve.sigma.T, strict=True)):
        band = FilledBand(
            name="3 sigma",
            colour=EKF_COLOUR,
            x=at,
            low=-3.0 * sigma,
            high=3.0 * sigma,
            lack="a variance is negative",
        )
        yield Panel(
            title=f"error of {curve.block}{f', component {k}' if several else ''}",
            x_label=TIME if audit.timed else EVENT,
            curves=(Curve("error", EKF_COLOUR, at, error),),
            bands=(band,),
            level=0.0,
        )


def _along(audit: Audit, event: ArrayLike, time_s: ArrayLike) -> Array:
    """Return where on the axis events lie. What precedes the first time lies there."""
    if not audit.timed:
        return np.asarray(event, dtype=float)
    at = np.asarray(time_s, dtype=float)
    found: Array = np.where(np.isnan(at), np.nanmin(at), at)
    return found


def _spurious_panel(information: Learnt, at: Array, x_label: str) -> Panel:
    colours = cycle((EKF_COLOUR, SMOOTHER_COLOUR, SCANS_COLOUR))
    curves = (
        Curve(direction.name, colour, at, growth)
        for direction, colour, growth in zip(
            information.directions, colours, information.growth.T, strict=False
        )
        if direction.largest is not None
    )
    return Panel(
        title="spurious information", x_label=x_label, curves=tuple(curves), bands=(), level=0.0
    )


def audit_figure(panels: Sequence[Panel]) -> Figure:
    """Draw all panels, one below the other."""
    figure = blank(8.0, 0.6 + 2.0 * len(panels))
    axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    for axis, panel in zip(axes, panels, strict=True):
        draw_panel(axis, panel)
        axis.set_xlabel(panel.x_label)
        axis.legend(fontsize=7, loc="best")
    return figure
