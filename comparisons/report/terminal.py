"""What a job prints: outcome, first cause and what decides it, or all of it where that is asked."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, zip_longest
from typing import TYPE_CHECKING, NamedTuple

from rich.console import Console
from rich.text import Text

from comparisons.checks.causes import decides
from comparisons.errors import printable
from comparisons.words import Row, cause_name, facts

if TYPE_CHECKING:
    from comparisons.report.ladder import LadderStep
    from comparisons.words import Cause

WIDTH, MOST = 80, 5
"""Columns of what is printed, and how many notes, unless all is asked for."""
DECIDING = 6
"""Lines of what decides an outcome, below the line in which its cause begins."""
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
_RESERVED = 3
"""Lines that a cause leaves to the first reason beside it."""


@dataclass(frozen=True, kw_only=True)
class Summary:
    """What a job has to print.

    headline: the outcome in words, printed first. look: the outcome whose style it is printed in.
    explained: names of what follows from the first cause, as was computed. reasons: why the
    outcome is what it is, where that is no cause, as an optimum that is not verified. lines: label
    and text. rows: all figures.
    """

    headline: str
    look: str = ""
    causes: Sequence[Cause] = ()
    explained: Sequence[str] = ()
    reasons: Sequence[str] = ()
    remarks: Sequence[str] = ()
    steps: Sequence[LadderStep] = ()
    lines: Sequence[tuple[str, str]] = ()
    rows: Sequence[Row] = ()


class Line(NamedTuple):
    """A line on the terminal, and its style."""

    text: str
    style: str = ""


def print_summary(
    summary: Summary, console: Console, report: str = "", *, verbose: bool = False
) -> None:
    """Print the outcome and why. report: where it is. verbose: all of it, then all figures."""
    lines = brief(summary, report, whole=verbose)
    if verbose:
        lines += [Line(""), *table(summary.rows, max(WIDTH, console.width))]
    for line in lines:
        console.print(Text(line.text, style=line.style))


def brief(summary: Summary, report: str = "", *, whole: bool = False) -> list[Line]:
    """Return the outcome, its first cause, or notes where there is none, gaps and few figures.

    In lines of WIDTH columns; only a long path makes the last one longer. whole: with all causes,
    hints and notes, uncut.
    """
    lines = _outcome(summary, whole=whole)
    lines += _ladder(summary.steps)
    for label, text in summary.lines:
        first, after = f"{label + ':':<{_LABEL}}", " " * _LABEL
        lines += [Line(one) for one in fit(text, first=first, after=after)]
    if report:
        lines.append(Line(f"{'report:':<{_LABEL}}{printable(report)}"))
    return lines


def deciding(
    causes: Sequence[Cause],
    reasons: Sequence[str] = (),
    *,
    explained: Sequence[str] = (),
    also: Sequence[str] = (),
    listed: str = "-v lists them",
) -> list[Line]:
    """Return what decides an outcome, in few lines, and by name what else there is.

    Args:
        causes: the first one is printed, with its hint, and those that only explain another.
        reasons: those that have room are printed.
        explained: names of what follows from the first cause.
        also: names of what does not, or may not.
        listed: where all of it stands, in words.
    """
    lines, room, cut = list[Line](), 1 + DECIDING, False
    if causes:
        reserved = min(len(_indented(reasons[0])), _RESERVED) if reasons else 0
        lines, cut = _cut(_words(causes[0]), room - reserved)
    printed = 0
    for reason in reasons:
        block, short = _cut(reason, room - len(lines))
        if lines and short:
            break
        lines, cut, printed = lines + block, cut or short, printed + 1
    room -= len(lines)
    others = list[str]()
    for i, cause in enumerate(causes):
        block = _indented(_words(cause)) if i else []
        if len(block) > room or (i and decides(cause.gap) != "never"):
            others.append(cause_name(cause.gap))
            continue
        lines, room = [*lines, *block, *_hint(cause)], room - len(block)
    left = len(reasons) - printed
    names = [
        *(["the rest of the evidence"] if cut else []),
        *dict.fromkeys(others),
        *([_count(left, "more finding")] if left else []),
        *also,
    ]
    more = [f"explained by it: {', '.join(explained)}"] if explained else []
    more += [f"also: {', '.join(names)}"] if names else []
    return lines + (_indented(f"{'; '.join(more)}; {listed}") if more else [])


def in_short(cause: Cause, lines: int = 3) -> str:
    """Return a cause in one line, with the facts that would fit into so many of a terminal."""
    return " ".join(line.text.strip() for line in _cut(_words(cause), lines)[0])


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


def _outcome(summary: Summary, *, whole: bool) -> list[Line]:
    """Return the headline and why. whole: with everything that is known of it."""
    style = STYLES.get(summary.look, "bold")
    lines = [Line(text, style) for text in fit(summary.headline, after="  ")]
    notes = [f"note: {remark}" for remark in summary.remarks]
    if whole:
        for cause in summary.causes:
            lines += [*_indented(_words(cause)), *_hint(cause)]
        return lines + [line for text in (*summary.reasons, *notes) for line in _indented(text)]
    if not summary.causes and not summary.reasons:
        lines += [line for text in notes[:MOST] for line in _indented(text)]
        more = len(notes) - MOST
        return lines + (
            _indented(f"{_count(more, 'more note')}; -v lists them") if more > 0 else []
        )
    headline = textwrap.shorten(printable(summary.headline), WIDTH, placeholder=" ...")
    outside = sum(row.inside is False for row in summary.rows)
    also = [_count(len(notes), "note")] if notes else []
    also += [_count(outside, "figure") + " outside the band"] if outside else []
    why = deciding(summary.causes, summary.reasons, explained=summary.explained, also=also)
    return [Line(headline, style), *why]


def _words(cause: Cause) -> str:
    return f"{cause_name(cause.gap)}: {cause.evidence}"


def _hint(cause: Cause) -> list[Line]:
    hint = fit(cause.hint, first="    hint: ", after="      ")
    return [Line(line, "bold") for line in hint if cause.hint]


def _cut(text: str, room: int) -> tuple[list[Line], bool]:
    """Return a text in at most so many lines, whole facts if one fits; and whether it is cut."""
    lines = _indented(text)
    if len(lines) <= room:
        return lines, False
    every = facts(text)
    for count in range(len(every) - 1, 0, -1):
        lines = _indented(f"{'; '.join(every[:count])}; ...")
        if len(lines) <= room:
            return lines, True
    *before, last = lines[: max(room, 1)]
    whole = last.text if len(last.text) <= WIDTH - 4 else last.text[: WIDTH - 4].rpartition(" ")[0]
    return [*before, Line(f"{whole} ...")], True


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def _ladder(steps: Sequence[LadderStep]) -> list[Line]:
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
