"""The tables of a log folder in `docs/formats.md`, written anew: `python -m tools.formats_page`.

Files, their columns, and what a column holds come from the schema of a log's streams.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

from comparisons.logs.schema import (
    ANY,
    STREAMS,
    ArrayField,
    Column,
    LogStream,
    RecordTable,
    spelt_unit,
)

PAGE = Path(__file__).resolve().parents[1] / "docs" / "formats.md"
_FILES = re.compile(r"\| file \| columns \|\n.*?\n\n", re.DOTALL)
_COLUMNS = re.compile(r"\| column \| unit \| values .*?\n\n", re.DOTALL)


def written(page: str) -> str:
    """Return the page with what the schema says."""
    page = _FILES.sub(lambda _: _table(("file", "columns"), _files()), page, count=1)
    head = ("column", "unit", "values", "names in CSV files of your own")
    return _COLUMNS.sub(lambda _: _table(head, _columns()), page, count=1)


def _table(head: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> str:
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    return "\n".join((lines[0], "|---" * len(head) + "|", *lines[1:], "", ""))


def _files() -> Iterator[tuple[str, ...]]:
    files: dict[RecordTable, str] = {}
    for stream in STREAMS:
        for table in stream.tables:
            name = f"`{stream.file}`" + (f", {table.kind}" if table.kind else "")
            known = files.setdefault(table, stream.file)
            rows = f"as `{known}`" if known != stream.file else _rows(stream, table)
            yield name, "; ".join(filter(None, (rows, stream.words)))


def _rows(stream: LogStream, table: RecordTable) -> str:
    if stream.is_archived:
        return "arrays " + ", ".join(map(_array, table.fields))
    names = ",".join(column.name for column in table.columns if not column.is_added)
    added = "".join(f",{column.name}" for column in table.columns if column.is_added)
    more = f" and, if there are any, `{added}`" if added else ""
    return f"`{names}`{more}" + (f"; {table.words}" if table.words else "")


def _array(part: ArrayField) -> str:
    text = "; ".join(filter(None, (", ".join(map(str, part.shape)), part.words)))
    return f"`{part.name}` ({text})"


def _columns() -> Iterator[tuple[str, ...]]:
    """Columns in the order in which files have them; those in a row that are alike together."""
    tables = [table for stream in STREAMS for table in stream.tables]
    columns = {column.name: column for table in tables for column in table.columns}
    for (unit, values), alike in groupby(columns.values(), lambda one: (one.unit, _values(one))):
        group = list(alike)
        names = ", ".join(f"`{column.name}`" for column in group)
        yield names, spelt_unit(unit), values, "; ".join(filter(None, map(_names, group)))


def _values(column: Column) -> str:
    limits = column.limits.expected if column.limits != ANY else ""
    whole = "a whole number below 2^53" if column.is_label else ""
    once = "each once" if column.is_distinct else ""
    gaps = "`nan` for unknown" if column.has_gaps else ""
    return "; ".join(filter(None, (whole, limits, once, gaps, column.words)))


def _names(column: Column) -> str:
    usual, others = (
        ", ".join(f"`{name}`" for name in names) for names in (column.names, column.less_usual)
    )
    return f"{usual}, else {others}" if others else usual


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
