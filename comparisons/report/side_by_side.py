"""Results of several jobs, or trajectories, side by side: printed, CSV, LaTeX, HTML."""

from __future__ import annotations

import csv
import html
import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError
from rich.console import Console
from rich.table import Table
from rich.text import Text

from comparisons.atomic import Kind, begins, check_file, write_whole
from comparisons.checks.smoother import SmootherFigures
from comparisons.errors import InputError, outdated_format, printable, shorten
from comparisons.figures import kept_fields, numbers
from comparisons.logs.log_meta import first_fault
from comparisons.logs.table import read_text
from comparisons.report.models import SCHEMA, Result, found_numbers

if TYPE_CHECKING:
    from comparisons.checks.path_errors import PathErrors

TITLE = "Results side by side"
Cell = str | float | None
Row = tuple[str, list[Cell]]
Page = Callable[[Sequence[str], Sequence[Row]], str]
"""Makes a text of the columns' titles and rows."""
_SAME = 1e-9
"""Figures closer than this, relative, are one."""
_TEXT = 16
"""Characters after which a word of a cell goes on in the next line; figures never do."""
_NAME = 28
"""Least columns of the names of figures, which are broken to have all results in one block."""
_FILES: dict[str, tuple[str, dict[str, str]]] = {
    "result": ("run", {}),
    "solution": (
        "solve",
        {"accuracy": "accuracy.smoother", "dead_reckoning": "accuracy.dead_reckoning"},
    ),
    "check": ("check", {"accuracy": "accuracy.estimate", "smoother_accuracy": "accuracy.smoother"}),
    "odometry": (
        "odometry",
        {
            "graph": "smoother",
            "accuracy": "accuracy.smoother",
            "scan_odometry": "accuracy.scan_odometry",
            "wheels": "accuracy.wheels",
        },
    ),
    "map": ("map", {"accuracy": "accuracy.ekf"}),
    "montecarlo": ("montecarlo", {}),
}
"""The file of each job, and what its parts are called where a run has the same."""
_ASIDE = (
    "config",
    "settings",
    "log",
    "seconds",
    "cpu_s",
    "versions",
    "level",
    "schema",
    "schema_version",
)
_SMOOTHER = kept_fields(SmootherFigures).items()
_LEFT_OUT = {f"smoother.{name}" for name, one in _SMOOTHER if one.mark.side == "left out"}
"""Figures of any job that say nothing of what it found."""


@dataclass(frozen=True)
class ComparedResult:
    """A result. words: what it is, by name. metrics: its figures, None where it has no such."""

    words: Mapping[str, str]
    metrics: Mapping[str, float | None]


def read_results(folders: Sequence[Path]) -> list[ComparedResult]:
    """Results of any job, from its folder. Raises InputError."""
    return [_read(folder) for folder in folders]


def is_result(folder: Path) -> bool:
    """Whether a folder holds a result of a job."""
    return _kind_of(folder) is not None


def _kind_of(folder: Path) -> str | None:
    """The name of the file of `_FILES` that a folder holds; None where it holds none."""
    return next((name for name in _FILES if (folder / f"{name}.json").is_file()), None)


def result_of_path(errors: PathErrors, reference: str, *, aligned: bool) -> ComparedResult:
    """A trajectory's errors as a result. reference: what it was compared with."""
    words = {
        "compared with": reference,
        "alignment": "turned and moved" if aligned else "none",
        "poses compared": f"{len(errors.time_s):,} of {errors.poses:,}",
    }
    return ComparedResult(words, errors.figures())


def side_by_side(results: Sequence[ComparedResult], only: Sequence[str] = ()) -> list[Row]:
    """Names, and a cell per result: what they are, the verdicts, all figures that differ.

    only: patterns of the figures that are wanted instead, whether they differ or not; one without
    a wildcard is a part of the name. Raises InputError for one that none has.
    """
    names = dict.fromkeys(name for result in results for name in result.words)
    rows: list[Row] = []
    for name in names:
        words = [result.words.get(name, "") for result in results]
        if name != "job" or len(set(words)) > 1:
            rows.append((name, list(words)))
    figures = dict.fromkeys(name for result in results for name in result.metrics)
    wanted = [pattern if "*" in pattern else f"*{pattern}*" for pattern in only]
    for pattern, given in zip(wanted, only, strict=True):
        if not any(fnmatchcase(name, pattern) for name in figures):
            heads = (f"{name.partition('.')[0]}{'.*' if '.' in name else ''}" for name in figures)
            known = ", ".join(dict.fromkeys(heads))
            raise InputError(
                f"--only {shorten(given)}: no figure is called so, expected some of {known}"
            )
    for name in figures:
        values = [result.metrics.get(name) for result in results]
        chosen = any(fnmatchcase(name, pattern) for pattern in wanted)
        if chosen if wanted else not _alike(values):
            rows.append((name, list(values)))
    return [row for row in rows if _reported(row[1])]


def print_side_by_side(titles: Sequence[str], rows: Sequence[Row], console: Console) -> None:
    """Print a column per result, in as many blocks as the width asks for."""
    widths = [_width(title, [cells[i] for _, cells in rows]) for i, title in enumerate(titles)]
    room = max(_NAME, console.width - 2 - sum(width + 2 for width in widths))
    first = max(len(line) for name, _ in rows for line in _folded(name, room))
    blocks = _blocks(widths, console.width - first - 2)
    console.width = max(console.width, first + 4 + max(widths))  # of one figure, else rich cuts it
    for block in blocks:
        table = Table(box=None, padding=(0, 2, 0, 0))
        table.add_column("", no_wrap=True, width=first)
        for i in block:
            table.add_column(Text(printable(titles[i])), overflow="fold", width=widths[i])
        for name, cells in rows:
            if _reported([cells[i] for i in block]):
                table.add_row(
                    "\n".join(_folded(name, room)),
                    *(Text(printable(_short(cells[i]))) for i in block),
                )
        console.print(table)


def check_table(path: Path) -> None:
    """Raise InputError where a table may not be written, before the work."""
    if path.suffix.lower() not in _TABLES:
        known = ", ".join(_TABLES)
        raise InputError(f"{path}: its suffix names no kind of table, expected {known}")
    check_file(path, _KINDS[path.suffix.lower()])


def write_table(
    titles: Sequence[str], rows: Sequence[Row], path: Path, page: Page | None = None
) -> None:
    """Write CSV with every digit, or LaTeX or HTML as printed, by the suffix.

    Args:
        titles: Of the columns.
        rows: As of `side_by_side`.
        path: Of the file.
        page: What HTML is made of instead of the table alone.

    Raises:
        InputError: The suffix names no table, or another file stands there.
    """
    check_table(path)
    made = _TABLES if page is None else _TABLES | {".html": page}
    text = made[path.suffix.lower()](titles, rows)
    write_whole(
        path,
        lambda part: part.write_text(text, encoding="utf-8"),
        _KINDS[path.suffix.lower()],
    )


def _read(folder: Path) -> ComparedResult:
    name = _kind_of(folder)
    if name is None:
        known = ", ".join(f"{one}.json" for one in _FILES)
        raise InputError(f"{folder}: holds no result of slamcheck, expected one of {known}")
    path, (job, names) = folder / f"{name}.json", _FILES[name]
    text = read_text(path)
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise InputError(f"{path}: not a result of slamcheck {job}")
    earlier = _at(found, "versions", "slamcheck").startswith("0.1.") or "scan_graph" in found
    if earlier or (job == "run" and found.get("schema", 1) in range(1, SCHEMA)):
        what = "a result with earlier names of figures"
        raise outdated_format(path, what, f"write it anew with slamcheck {job}")
    words = _words(found, job)
    if job == "run":
        try:
            run = Result.model_validate_json(text)
        except ValidationError as error:
            raise InputError(f"{path}: not a run's result: {first_fault(error)}") from None
        words["verdict"], every = run.headline, found_numbers(run)
    else:
        every = dict(numbers({names.get(key, key): one for key, one in found.items()}, None))
    figures = {
        name: number.value
        for name, number in every.items()
        if name not in _LEFT_OUT and name.partition(".")[0] not in _ASIDE
    }
    return ComparedResult(words, figures)


def _words(found: Mapping[str, Any], job: str) -> dict[str, str]:
    """What a result is: rows that all have, and those that some jobs have."""
    association = _at(found, "ekf", "association") or _at(found, "association_by")
    gps = _at(found, "ekf", "gps") or _at(found, "gps")
    causes = found.get("causes")
    first = causes[0] if isinstance(causes, list) and causes else {}
    words = {
        "verdict": _at(found, "verdict"),
        "first cause": _at(first, "gap"),
        "grade": _at(found, "grade"),
        "job": job,
        "log": _at(found, "log", "name") or _at(found, "scenario"),
        "filter": _at(found, "ekf", "filter"),
        "association": association,
        "attributes": _at(found, "ekf", "attributes"),
        "gps": gps,
    }
    return {name: word for name, word in words.items() if word or name == "first cause"}


def _at(found: Any, *keys: str) -> str:
    for key in keys:
        found = found.get(key) if isinstance(found, Mapping) else None
    return found if isinstance(found, str) else ""


def _alike(values: Sequence[float | None]) -> bool:
    first = values[0]
    if first is None:
        return all(value is None for value in values)
    return all(
        value is not None and abs(value - first) <= _SAME * max(abs(first), 1e-3)
        for value in values
    )


def _reported(cells: Sequence[Cell]) -> bool:
    return any(cell not in (None, "") for cell in cells)


def _short(cell: Cell) -> str:
    if cell is None:
        return ""
    return cell if isinstance(cell, str) else f"{cell:.5g}"


def _width(title: str, cells: Sequence[Cell]) -> int:
    """Of a column: its widest figure whole, titles and words up to a limit."""
    words = [title, *(cell for cell in cells if isinstance(cell, str))]
    figures = (len(_short(cell)) for cell in cells if not isinstance(cell, str))
    return max(min(_TEXT, max(map(len, words))), *figures, 1)


def _folded(name: str, width: int) -> list[str]:
    """Return a dotted name in lines, broken behind dots where it is too long for one."""
    first, *parts = name.split(".")
    lines = [first]
    for part in parts:
        if len(lines[-1]) + len(part) + 2 <= width:
            lines[-1] += f".{part}"
        else:
            lines[-1] += "."
            lines.append(f"  {part}")
    return lines


def _blocks(widths: Sequence[int], most: int) -> list[list[int]]:
    """Columns that stand beside each other: as many as fit, at least one."""
    blocks: list[list[int]] = [[]]
    used = 0
    for i, width in enumerate(widths):
        if blocks[-1] and used + width + 2 > most:
            blocks.append([])
            used = 0
        blocks[-1].append(i)
        used += width + 2
    return blocks


def _csv(titles: Sequence[str], rows: Sequence[Row]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["name", *titles])
    writer.writerows([name, *("" if c is None else c for c in cells)] for name, cells in rows)
    return text.getvalue()


def _latex(titles: Sequence[str], rows: Sequence[Row]) -> str:
    lines = [" & ".join(map(_latex_text, ("", *titles))) + r" \\ \hline"]
    for name, cells in rows:
        reported = (
            _latex_text(c) if isinstance(c, str) else _latex_figure(_short(c)) for c in cells
        )
        lines.append(" & ".join((_latex_text(name), *reported)) + r" \\")
    columns = "l" + "r" * len(titles)
    return "\n".join((rf"\begin{{tabular}}{{{columns}}}", *lines, r"\end{tabular}", ""))


_LATEX = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
_LATEX |= {one: f"\\{one}" for one in "&%$#_{}"}


def _latex_text(text: str) -> str:
    return "".join(_LATEX.get(one, one) for one in printable(text))


def _latex_figure(figure: str) -> str:
    digits, e, power = figure.partition("e")
    return rf"${digits} \times 10^{{{int(power)}}}$" if e else f"${figure}$" if figure else ""


def html_table(titles: Sequence[str], rows: Sequence[Row]) -> str:
    """Return a column per result, for a page."""

    def row(kind: str, name: str, cells: Sequence[str]) -> str:
        columns = (f"<{kind}>{html.escape(cell)}</{kind}>" for cell in cells)
        broken = re.sub(r"[._](?=.)", r"\g<0><wbr>", html.escape(name))
        return f'<tr><th scope="row">{broken}</th>{"".join(columns)}</tr>'

    body = "".join(row("td", name, [_short(cell) for cell in cells]) for name, cells in rows)
    return (
        f'<div class="held"><table class="beside"><thead>{row("th", "", titles)}</thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _html(titles: Sequence[str], rows: Sequence[Row]) -> str:
    from comparisons.report.html.shell import document

    return document(TITLE, (f"<header><h1>{TITLE}</h1></header>", html_table(titles, rows)))


_TABLES: dict[str, Page] = {
    ".csv": _csv,
    ".tex": _latex,
    ".html": _html,
}
_FIRST = rb"(compared with|verdict|first cause|grade|job|log|filter|association|attributes|gps)"
"""Name of a table's first row."""
_KINDS = {
    suffix: Kind("an earlier table of compare", begins(pattern))
    for suffix, pattern in {
        ".csv": rb"name,[^\n]*\n" + _FIRST + rb",",
        ".tex": rb"\\begin\{tabular\}\{lr+\}\n & [^\n]* \\hline\n" + _FIRST + rb" & ",
        ".html": rb"(?s)<!doctype html>\n<html.{,1000}<title>"
        + TITLE.encode()
        + rb"(: [^<]*)?</title>",
    }.items()
}
