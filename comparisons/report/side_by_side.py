"""Several runs side by side, from the folders they left."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from comparisons.errors import InputError
from comparisons.logs.log_meta import first_fault
from comparisons.logs.table import read_text
from comparisons.report.models import Result
from comparisons.report.result import metrics

_SAME = 1e-9
"""Figures closer than this, relative, are one."""


def read_results(folders: Sequence[Path]) -> list[Result]:
    """`result.json` of run folders. Raises InputError."""
    results = []
    for folder in folders:
        path = folder / "result.json"
        try:
            results.append(Result.model_validate_json(read_text(path)))
        except ValidationError as error:
            raise InputError(f"{path}: not a run's result: {first_fault(error)}") from None
    return results


def side_by_side(results: Sequence[Result]) -> list[tuple[str, list[str]]]:
    """Names, and a cell per run: what they are, the verdicts, all figures that differ."""
    rows: list[tuple[str, list[str]]] = [
        ("log", [r.log.name for r in results]),
        ("filter", [r.ekf.filter for r in results]),
        ("association", [r.ekf.association for r in results]),
        ("attributes", [r.ekf.attributes for r in results]),
        ("gps", [r.ekf.gps for r in results]),
        ("verdict", [r.headline for r in results]),
        ("first cause", [r.causes[0].gap if r.causes else "" for r in results]),
    ]
    every = [metrics(r) for r in results]
    names = dict.fromkeys(name for found in every for name in found)
    for name in names:
        values = [found.get(name) for found in every]
        if not _alike(values):
            rows.append((name, ["" if v is None else f"{v:.5g}" for v in values]))
    return rows


def print_side_by_side(
    titles: Sequence[str], rows: Sequence[tuple[str, list[str]]], console: Console
) -> None:
    """A table with a column per run."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    table.add_column("", no_wrap=True)
    for title in titles:
        table.add_column(escape(title), overflow="fold")
    for name, cells in rows:
        table.add_row(name, *(escape(cell) for cell in cells))
    console.print(table)


def _alike(values: Sequence[float | None]) -> bool:
    first = values[0]
    if first is None:
        return all(value is None for value in values)
    return all(
        value is not None and abs(value - first) <= _SAME * max(abs(first), 1e-3)
        for value in values
    )
