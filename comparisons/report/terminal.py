"""What a job prints: the outcome in a few short lines, and every figure where it is asked for."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, zip_longest
from typing import NamedTuple

from rich.console import Console
from rich.text import Text

from comparisons.checks.causes import cause_name
from comparisons.errors import printable
from comparisons.extensions.interface import Row
from comparisons.report.ladder import Step
from comparisons.report.models import CauseResult

WIDTH, HEIGHT = 80, 14
"""Columns and lines of what is printed unless more is asked for."""
MARKS = {True: "in", False: "OUT", None: ""}
"""Whether a figure lies in its band, in words."""
STYLES = {
    "agree": "bold green",
    "verified": "bold green",
    "disagree": "bold red",
    "unverified": "bold yellow",
}
_LABEL = 13
"""Columns before the text of a line."""


@dataclass(frozen=True, kw_only=True)
class Summary:
    """What a job has to print.

    headline: the outcome in words, printed first. style: of the headline, as rich names it.
    reasons: why the outcome is what it is, where that is no cause, as an optimum that is not
    verified. lines: label and text, one line each. rows: all figures.
    """

    headline: str
    style: str = ""
    causes: Sequence[CauseResult] = ()
    reasons: Sequence[str] = ()
    remarks: Sequence[str] = ()
    steps: Sequence[Step] = ()
    lines: Sequence[tuple[str, str]] = ()
    rows: Sequence[Row] = ()


class Line(NamedTuple):
    """A line on the terminal, and its style."""

    text: str
    style: str = ""


def print_summary(
    summary: Summary, console: Console, report: str = "", *, verbose: bool = False
) -> None:
    """Print the outcome in a few lines. report: where it is. verbose: then print all figures."""
    lines = brief(summary, report)
    if verbose:
        lines += [Line(""), *every_cause(summary), *table(summary.rows, max(WIDTH, console.width))]
    for line in lines:
        console.print(Text(line.text, style=line.style))


def brief(summary: Summary, report: str = "") -> list[Line]:
    """Return at most HEIGHT lines of WIDTH columns; only a long path makes the last one longer.

    The text of a label takes a second line where two causes and the count of notes leave room.
    """
    head = [Line(text, summary.style) for text in fit(summary.headline, most=2, after="  ")]
    tail = _ladder(summary.steps)
    least = len(head) + len(tail) + len(summary.lines) + bool(report)
    kept = 2 * min(len(summary.causes), 2) + bool(summary.reasons or summary.remarks)
    spare = HEIGHT - least - kept
    for label, text in summary.lines:
        first, after = f"{label + ':':<{_LABEL}}", " " * _LABEL
        found = fit(text, most=2 if spare > 0 else 1, first=first, after=after)
        spare -= len(found) - 1
        tail += [Line(one) for one in found]
    if report:
        tail.append(Line(f"{'report:':<{_LABEL}}{printable(report)}"))
    return [*head, *_reasons(summary, HEIGHT - len(head) - len(tail)), *tail]


def every_cause(summary: Summary) -> Iterator[Line]:
    """Return all causes with their hints, all reasons and remarks, each in full."""
    for cause in summary.causes:
        yield from (Line(one) for one in fit(_named(cause), most=0, after="  "))
        yield from (Line(one, "dim") for one in fit(cause.hint, most=0, first="    ", after="    "))
    for text in (*summary.reasons, *(f"note: {remark}" for remark in summary.remarks)):
        yield from (Line(one) for one in fit(text, most=0, after="  "))


def table(rows: Sequence[Row], width: int = WIDTH) -> Iterator[Line]:
    """Return figures by group: quantity, value, band, and whether the value lies in the band."""
    quantity = _column((row.quantity for row in rows), int(0.46 * width))
    band = _column((row.band for row in rows), int(0.26 * width))
    room = width - quantity - band - 9 - len(MARKS[False])
    value = min(room, _column((row.value for row in rows if row.band), room))
    for group, found in groupby(rows, key=lambda row: row.group):
        yield Line(printable(group), "bold")
        for row in found:
            wide = value if row.band else width - quantity - 4
            cells = (
                _wrapped(row.quantity, quantity),
                _wrapped(row.value, wide),
                _wrapped(row.band, band),
                [MARKS[row.inside]],
            )
            widths = (quantity, wide, band, 0) if row.band else (quantity, wide, 0, 0)
            style = "red" if row.inside is False else ""
            for parts in zip_longest(*cells, fillvalue=""):
                shown = zip(parts, widths, strict=True)
                yield Line("  " + "  ".join(f"{p:<{w}}" for p, w in shown).rstrip(), style)


def fit(
    text: str, width: int = WIDTH, *, most: int = 1, first: str = "", after: str = ""
) -> list[str]:
    """Return a text in lines that break at words; what is beyond the last one is left out.

    Args:
        text: anything; characters that a terminal might obey are replaced.
        width: columns of a line.
        most: lines, 0 for all.
        first: indent of the first line.
        after: indent of the others.
    """
    return textwrap.wrap(
        printable(" ".join(text.split())),
        width,
        initial_indent=first,
        subsequent_indent=after,
        max_lines=most or None,
        placeholder=" ...",
        break_on_hyphens=False,
    ) or [""]


def _named(cause: CauseResult) -> str:
    return f"{cause_name(cause.gap)}: {cause.evidence}"


def _reasons(summary: Summary, room: int) -> list[Line]:
    """Return causes, reasons and remarks, as many as there is room for, the last line the rest."""
    kinds = (
        ("cause", [_named(cause) for cause in summary.causes]),
        ("reason", list(summary.reasons)),
        ("note", [f"note: {remark}" for remark in summary.remarks]),
    )
    texts = [(kind, text) for kind, found in kinds for text in found]
    lines: list[Line] = []
    for i, (_, text) in enumerate(texts):
        left = room - len(lines) - (i + 1 < len(texts))
        if left < 1:
            rest = [kind for kind, _ in texts[i:]]
            counts = [
                f"{n} more {kind}{'s' if n > 1 else ''}"
                for kind, _ in kinds
                if (n := rest.count(kind))
            ]
            return [*lines, Line(f"  {', '.join(counts)} in the report")]
        lines += [Line(one) for one in fit(text, most=min(2, left), first="  ", after="    ")]
    return lines


def _ladder(steps: Sequence[Step]) -> list[Line]:
    """Return a line for each gap, from estimate to estimate, below a heading."""
    if not steps:
        return []
    heading = f"{'gap':<14}{'from ' + steps[0].above:<31}{'means, in sigma':>15}"
    lines = [Line(f"{heading}{'limit':>7}{'cov., rel.':>13}", "bold")]
    for step in steps:
        mean = "infinite" if step.judged else "-"
        if step.sigma is not None:
            mean = f"{step.sigma:.2g}"
        most = "-" if step.limit is None else f"{step.limit:.2g}"
        far = "-" if step.covariance is None else f"{step.covariance:.2g}"
        if step.error_m is not None:
            far = f"{step.error_m:.3g} m"
        below = textwrap.shorten(f"-> {step.below}", 37, placeholder=" ...")
        text = f"{step.gap:<14}{below:<37}{mean:>9}{most:>7}{far:>13}"
        lines.append(Line(text, "red" if step.fails else ""))
    return lines


def _column(texts: Iterator[str], most: int) -> int:
    return min(most, max(map(len, texts), default=0))


def _wrapped(text: str, width: int) -> list[str]:
    return fit(text, max(width, 8), most=0)
