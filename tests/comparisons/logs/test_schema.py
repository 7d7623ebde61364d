"""The schema of a log's streams: complete, without contradictions, and what the pages say."""

import ast
from dataclasses import fields, replace
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import comparisons
from comparisons.errors import RecordError
from comparisons.logs.log import Log, Truth
from comparisons.logs.records import LogRecord, columns_of, record_of
from comparisons.logs.schema import (
    ANY,
    COLUMNS,
    KINDS,
    STREAMS,
    UNITS,
    Column,
    RecordTable,
)
from tests.comparisons.logs.test_log_folder import assert_same, full_log
from tools.formats_page import PAGE, written

TABLES = {table.name: table for stream in STREAMS for table in stream.tables}


def all_columns() -> list[Column]:
    tables = [*TABLES.values(), *KINDS.values()]
    return list(chain.from_iterable((*table.columns, *table.others) for table in tables))


def test_the_page_is_generated_from_the_schema() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert written(page) == page, "docs/formats.md is old: make settings"
    assert written(page.replace("`var_x`", "`variance`")) == page


def test_every_stream_of_a_log_is_declared() -> None:
    """In the order of its fields."""
    others = {"name", "format", "prior", "truth", "provenance", "integration"}
    streams = [field.name for field in fields(Log) if field.name not in others]
    streams += [f"truth.{field.name}" for field in fields(Truth)]
    assert [stream.field for stream in STREAMS] == streams
    assert len({stream.file for stream in STREAMS}) == len(STREAMS)


@pytest.mark.parametrize("table", TABLES.values(), ids=attrgetter("name"))
def test_a_record_has_the_arrays_of_its_table(table: RecordTable) -> None:
    kind: Any = LogRecord.classes[table.name]
    assert kind.table is table
    annotated = {field.name for field in fields(kind) if field.type in ("Array", "Ids", "Index")}
    assert annotated == {part.name for part in table.fields}


def test_a_column_is_declared_once() -> None:
    """Two columns of one name would be read in two ways; one without a unit says why."""
    for column in all_columns():
        assert COLUMNS.get(column.name, column) is column
        is_known = column.unit in UNITS
        assert is_known or column.is_label or not column.name.endswith(tuple(UNITS))
    assert len(COLUMNS) == len({column.name for column in COLUMNS.values()})


def test_a_record_is_its_columns() -> None:
    """To text and back."""
    log, compared = full_log(), list[str]()
    for stream in STREAMS:
        record = attrgetter(stream.field)(log)
        if record is None or stream.is_archived:
            continue
        columns = {name: np.array(values) for name, values in columns_of(record).items()}
        names = [part.name for part in record.table.fields]
        more = {key: value for key, value in vars(record).items() if key not in names}
        assert_same(record_of(record.table, columns, **more), record)
        compared.append(stream.field)
    assert len(compared) == 8


@pytest.mark.parametrize(
    ("field", "name"), [("measurements", "bearing_rad"), ("measurements", "landmark")]
)
def test_limits_are_those_of_the_schema(field: str, name: str) -> None:
    record = getattr(full_log(), field)
    limits = COLUMNS[name].limits
    assert limits != ANY
    values = getattr(record, name).copy()
    values[1] = limits.low - 1
    with pytest.raises(RecordError, match=f"{name} is .*, expected {limits.expected}"):
        replace(record, **{name: values})


def test_columns_of_arrays_are_in_the_docstring() -> None:
    text = str(Log.from_arrays.__doc__)
    tables = [table for stream in STREAMS if stream.option for table in stream.user_tables]
    assert [name for table in tables for name in table.needed if f"`{name}`" not in text] == []


def test_usual_names_are_in_the_guide() -> None:
    """Those of single values; a message's own, and matrices, are described by their ends."""
    guide = (PAGE.parent / "your-own-log.md").read_text(encoding="utf-8")
    singles = [column for column in COLUMNS.values() if column.unit or column.is_label]
    assert [one.name for one in singles if not all(f"`{n}`" in guide for n in one.names)] == []


def column_lists(source: str) -> list[list[str]]:
    """Return what a module writes down of columns: collections with three names and more."""
    known = {column.name for column in all_columns()}
    lists = []
    for node in ast.walk(ast.parse(source)):
        entries: list[Any] = []
        if isinstance(node, ast.Tuple | ast.List | ast.Set):
            entries = node.elts
        elif isinstance(node, ast.Dict):
            entries = node.keys
        names = [entry.value for entry in entries if isinstance(entry, ast.Constant)]
        lists.append([name for name in names if name in known])
    return [names for names in lists if len(names) > 2]


def test_no_other_module_lists_columns() -> None:
    """But fields of messages, which are called so, too."""
    root = Path(comparisons.__file__).parent
    paths = [
        path for path in root.rglob("*.py") if path.name not in ("schema.py", "message_csv.py")
    ]
    assert len(paths) > 100
    lists = {path.name: column_lists(path.read_text()) for path in paths}
    assert {name: names for name, names in lists.items() if names} == {}


def test_a_list_of_columns_is_found() -> None:
    assert column_lists("A = ('time_s', 'x_m', 'y_m', 3)") == [["time_s", "x_m", "y_m"]]
    assert column_lists("A = {'id': 0, 'x_m': 1, 'y_m': 2}") == [["id", "x_m", "y_m"]]
    assert column_lists("A = ('time_s', 'x_m', *rest)") == []
