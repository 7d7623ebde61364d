"""The schema of a log's streams: complete, without contradictions, and what the pages say."""

from dataclasses import fields, replace
from itertools import chain
from operator import attrgetter
from typing import Any

import numpy as np
import pytest

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

TABLES = {table.name: table for stream in STREAMS for table in stream.tables.values()}


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
