"""What `slamcheck audit` reports: audit.json, what is printed, and its folder with a page."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from comparisons.arrays import Array
from comparisons.audit.audit import Audit, Verdict
from comparisons.audit.spurious import Learnt, LearntDirection
from comparisons.innovations import SensorInnovations
from comparisons.report.folder import JobFolder
from comparisons.report.html.page import PageContent, facts_of, write_page
from comparisons.report.job import Report
from comparisons.report.marks import (
    EKF_COLOUR,
    EVENT,
    SCANS_COLOUR,
    SMOOTHER_COLOUR,
    TIME,
    Curve,
    Panel,
    nis_panel,
)
from comparisons.report.picture import blank, draw_panel
from comparisons.report.terminal import STYLES, Summary
from comparisons.words import Row

if TYPE_CHECKING:
    from comparisons.pipeline.clock import Clock

_STYLES: dict[Verdict, str] = {
    "sound": "agree",
    "faulty": "disagree",
    "nothing checked": "unverified",
}
_LACKING = (
    "no snapshot, gain or correction is recorded after a prediction or an update, so that no "
    "algebra could be checked: record snapshots of the covariance, or the gains of updates"
)
_BY_EVENT = "by the number of the event, for the trace has not all times"
_LEAST = 1e-17
"""What a gap of nothing is drawn as."""


class AuditReport(Report[Audit, Audit]):
    """Report of `slamcheck audit`."""

    @staticmethod
    def build(audit: Audit, read: Clock | None = None) -> Audit:
        """Return the findings, which are stored as they are."""
        return audit

    def summary(self) -> Summary:
        """Return what the command prints."""
        audit = self.found
        wrong = [one.text for one in audit.findings if one.fault]
        # Where precision explains what is wrong, that goes first.
        first = [one.text for one in audit.findings if wrong and one.check == "precision"]
        named = [one.text for one in audit.findings if not one.fault and one.text not in first]
        headline = f"verdict: {audit.verdict}"
        if wrong:
            headline += f" ({len(wrong)} finding{'s' if len(wrong) > 1 else ''})"
        lines = [
            (
                "trace",
                f"{audit.events:,} events, {audit.updates:,} updates, {audit.snapshots:,} "
                f"snapshot{'s' if audit.snapshots != 1 else ''}",
            ),
            ("algebra", _algebra_line(audit)),
            ("gains", _gains_line(audit)),
            *(("sensor", _sensor_line(one)) for one in audit.sensors[:3]),
        ]
        for name, found in (("smoother", audit.smoother), ("NEES", audit.nees)):
            if found is not None:
                low, high = found.band
                text = f"{found.mean:.3g} per degree of freedom ({low:.3g} to {high:.3g} expected)"
                lines.append((name, text))
        if audit.spurious is not None:
            lines.append(("spurious", _spurious_line(audit.spurious)))
        return Summary(
            headline=headline,
            style=STYLES[_STYLES[audit.verdict]],
            reasons=[_LACKING] if audit.verdict == "nothing checked" else [*first, *wrong],
            remarks=[*audit.remarks, *named],
            lines=lines,
            rows=audit_rows(audit),
        )

    def page(self) -> PageContent:
        """Return what stands on the page."""
        audit = self.found
        summary, panels = self.summary(), [one for one in audit_panels(audit) if one.curves]
        return PageContent(
            name=audit.trace.name,
            headline=summary.headline.removeprefix("verdict: "),
            colour=_STYLES[audit.verdict],
            reasons=summary.reasons,
            facts=facts_of(summary.lines),
            remarks=summary.remarks,
            reported=_BY_EVENT if panels and not audit.timed else "",
            panels=panels,
            curves_file="curves.png",
            rows=summary.rows,
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
        return _STYLES[self.found.verdict]


def _spurious_line(found: Sequence[LearntDirection]) -> str:
    some = [
        f"{one.name} to {one.sigma:.3g} {one.unit}".rstrip()
        for one in found
        if one.largest is not None
    ]
    if not some:
        return f"nothing learnt of {', '.join(one.name for one in found)}"
    return f"learnt from measurements that cannot tell it: {', '.join(some)}"


def _algebra_line(audit: Audit) -> str:
    until = "" if audit.unsolved is None else f" before event {audit.unsolved:,}"
    if audit.largest_gap is None:
        return f"not checked: the trace has no snapshot{until}"
    gap = audit.first_open
    if gap is None or audit.sound:  # what only least squares sees is small, and no finding
        worst = audit.largest_gap.worst
        return f"equal to least squares at every snapshot{until}, to {worst:.1g}"
    at = f" ({gap.time_s:.6g} s)" if audit.timed and gap.time_s is not None else ""
    return (
        f"gap opens at event {gap.event:,}{at}: {gap.sigma:.2g} sigma, {gap.covariance:.2g} in "
        "covariance"
    )


def _gains_line(audit: Audit) -> str:
    if not audit.gains_compared:
        return "not recorded"
    unlike = sum(one.check == "gain" for one in audit.findings)
    whose = "some are not Kalman's" if unlike else "all Kalman's"
    return f"{audit.gains_compared:,} compared, {whose}"


def _sensor_line(one: SensorInnovations) -> str:
    if not one.nis:
        return f"{one.sensor}: no innovation"
    nis = one.nis[0]
    text = f"{one.sensor}: NIS {nis.mean:.3g} ({nis.band.low:.3g} to {nis.band.high:.3g} expected)"
    if one.rejected or one.gating.passes is not None:
        text += f", {one.rejected:,} of {one.measured:,} rejected"
    return text


def audit_rows(audit: Audit) -> list[Row]:
    """Return all figures."""
    rows = [
        Row("Trace", "events", f"{audit.events:,}"),
        Row("Trace", "updates", f"{audit.updates:,}"),
        Row("Trace", "snapshots", f"{audit.snapshots:,}"),
        Row("Trace", "blocks, ever", f"{len(audit.blocks):,}"),
    ]
    most = f"at most {audit.tolerance:.0e}"
    if audit.largest_gap is not None:
        gap = audit.largest_gap
        for what, value in (("estimate [sigma]", gap.sigma), ("covariance", gap.covariance)):
            inside = value <= audit.tolerance
            rows.append(Row("Algebra", f"largest gap of the {what}", f"{value:.2g}", most, inside))
        text = f"{audit.oracle_agreement:.1g} sigma^2"
        rows.append(Row("Algebra", "recursion against least squares, until a fault", text))
    for one in audit.sensors:
        rows += _sensor_rows(one)
    blocks = audit.nees_by_block.items()
    for name, found in (
        ("filter minus smoother, per dof (1)", audit.smoother),
        ("NEES per dof (1)", audit.nees),
        *((f"NEES per dof of block {block} (1)", one) for block, one in blocks),
    ):
        if found is not None:
            (low, high), inside = found.band, found.band.holds(found.mean)
            band = f"{low:.3g} to {high:.3g}"
            rows.append(Row("Consistency", name, f"{found.mean:.3g}", band, inside))
    for way in audit.spurious or ():
        sigma = "none" if way.largest is None else f"{way.sigma:.3g} {way.unit}".rstrip()
        rows.append(Row("Spurious information", f"{way.name}, seems known to", sigma))
    if audit.verdict == "faulty":
        return rows
    # One in twenty figures of a sound filter leaves its band: none is marked.
    return [one._replace(inside=one.inside or None) for one in rows]


def _sensor_rows(one: SensorInnovations) -> list[Row]:
    group, gating = f"Sensor {one.sensor}", one.gating
    rows = one.nis_rows(group)
    rows += [
        Row(group, f"{w.component}: p of whiteness by {w.order}", f"{w.p_value:.2g}",
            "at least 0.001", w.p_value >= 0.001)
        for w in one.whiteness
    ]  # fmt: skip
    rejected, limits, inside = f"{one.rejected:,} of {one.measured:,}", "", None
    if gating.band is not None:
        low, high = gating.band
        limits, inside = (
            f"{100.0 * low:.2g} to {100.0 * high:.2g} %",
            low <= one.rejected / one.measured <= high,
        )
    return [*rows, Row(group, "rejected by the gate", rejected, limits, inside)]


def audit_panels(audit: Audit) -> list[Panel]:
    """Return what is drawn over time, or over events: the algebra gap, and NIS by sensor."""
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
    panels += [
        nis_panel(one, EKF_COLOUR, _along(audit, one.windows.event, one.windows.time_s), x_label)
        for one in audit.sensors
        if len(one.windows.event) > 1
    ]
    if audit.learnt is not None and len(audit.learnt.event) > 1:
        at = _along(audit, audit.learnt.event, audit.learnt.time_s)
        panels.append(_spurious_panel(audit.learnt, at, x_label))
    return panels


def _along(audit: Audit, event: ArrayLike, time_s: ArrayLike) -> Array:
    """Return where on the axis events lie. What precedes the first time lies there."""
    if not audit.timed:
        return np.asarray(event, dtype=float)
    at = np.asarray(time_s, dtype=float)
    found: Array = np.where(np.isnan(at), np.nanmin(at), at)
    return found


def _spurious_panel(found: Learnt, at: Array, x_label: str) -> Panel:
    colours = cycle((EKF_COLOUR, SMOOTHER_COLOUR, SCANS_COLOUR))
    curves = (
        Curve(one.name, colour, at, growth)
        for one, colour, growth in zip(found.directions, colours, found.growth.T, strict=False)
        if one.largest is not None
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
