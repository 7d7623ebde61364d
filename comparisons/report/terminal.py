"""What a job prints: the outcome and why, in full, and every figure where it is asked for."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, zip_longest
from typing import TYPE_CHECKING, NamedTuple

from rich.console import Console
from rich.text import Text

from comparisons.errors import printable
from comparisons.words import Row, cause_name

if TYPE_CHECKING:
    from comparisons.report.ladder import Step
    from comparisons.words import Cause

WIDTH, MOST = 80, 5
"""Columns of what is printed, and how many causes, reasons and notes; the report has all."""
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

    headline: the outcome in words, printed first. look: the outcome whose style it is printed in.
    reasons: why the outcome is what it is, where that is no cause, as an optimum that is not
    verified. lines: label and text. rows: all figures.
    """

    headline: str
    look: str = ""
    causes: Sequence[Cause] = ()
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
    """Print the outcome and why. report: where it is. verbose: then print all figures."""
    lines = brief(summary, report)
    if verbose:
        lines += [Line(""), *table(summary.rows, max(WIDTH, console.width))]
    for line in lines:
        console.print(Text(line.text, style=line.style))


def brief(summary: Summary, report: str = "") -> list[Line]:
    """Return the outcome, its causes with their hints, reasons, notes, gaps and few figures.

    In lines of WIDTH columns; only a long path makes the last one longer.
    """
    style = STYLES.get(summary.look, "bold")
    lines = [Line(text, style) for text in fit(summary.headline, after="  ")]
    for cause in summary.causes[:MOST]:
        lines += _indented(f"{cause_name(cause.gap)}: {cause.evidence}")
        hint = fit(cause.hint, first="    hint: ", after="      ")
        lines += [Line(one, "dim") for one in hint if cause.hint]
    notes = [f"note: {remark}" for remark in summary.remarks]
    for text in (*summary.reasons[:MOST], *notes[:MOST]):
        lines += _indented(text)
    lines += _rest(cause=summary.causes, reason=summary.reasons, note=notes)
    lines += _ladder(summary.steps)
    for label, text in summary.lines:
        first, after = f"{label + ':':<{_LABEL}}", " " * _LABEL
        lines += [Line(one) for one in fit(text, first=first, after=after)]
    if report:
        lines.append(Line(f"{'report:':<{_LABEL}}{printable(report)}"))
    return lines


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


def fit(text: str, width: int = WIDTH, *, first: str = "", after: str = "") -> list[str]:
    """Return a text in lines that break at words.

    Args:
        text: anything; characters that a terminal might obey are replaced.
        width: columns of a line.
        first: indent of the first line.
        after: indent of the others.
    """
    return textwrap.wrap(
        printable(" ".join(text.split())),
        width,
        initial_indent=first,
        subsequent_indent=after,
        break_on_hyphens=False,
    ) or [""]


def _indented(text: str) -> list[Line]:
    return [Line(one) for one in fit(text, first="  ", after="    ")]


def _rest(**texts: Sequence[object]) -> list[Line]:
    """Return a line that counts what is left out, by kind."""
    more = {kind: len(found) - MOST for kind, found in texts.items() if len(found) > MOST}
    counts = [f"{count} more {kind}{'s' if count > 1 else ''}" for kind, count in more.items()]
    return _indented(f"{', '.join(counts)} in the report") if counts else []


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
        text = f"{step.gap:<14}{below:<37}{mean:>9} {most:>6}{far:>13}"
        lines.append(Line(text, "red" if step.fails else ""))
    return lines


def _column(texts: Iterator[str], most: int) -> int:
    return min(most, max(map(len, texts), default=0))


def _wrapped(text: str, width: int) -> list[str]:
    return fit(text, max(width, 8))
