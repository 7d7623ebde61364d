"""Records of a log, as arrays and as columns of text: the schema's table of each says which."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Self, cast

import numpy as np

from comparisons.arrays import Array, Index, Mask, symmetric, upper_triangles
from comparisons.logs.schema import RecordTable
from comparisons.logs.validation import check


class LogRecord:
    """A record of a log, whose arrays a table of the schema declares.

    Attributes:
        table: The table.
        classes: Every class of records, by its table's name.
    """

    table: ClassVar[RecordTable]
    classes: ClassVar[dict[str, type[LogRecord]]] = {}

    def __init_subclass__(cls) -> None:
        """List the class if it has a table."""
        super().__init_subclass__()
        if "table" in vars(cls):
            LogRecord.classes[cls.table.name] = cls

    def __post_init__(self) -> None:
        """Check the arrays. Raises RecordError."""
        check(self, self.table)


class Stream(LogRecord):
    """Records in the order of time, columns of which are arrays of one length."""

    def chosen(self, rows: Mask | Index) -> Self:
        """The same with some of its rows; what is one for all of them stays."""
        names = [part.name for part in self.table.fields if part.shape[0] == "N"]
        columns = {name: getattr(self, name)[rows] for name in names}
        return cast(Self, replace(cast(Any, self), **columns))


def record_of(table: RecordTable, columns: Mapping[str, Any], **settings: Any) -> Any:
    """Return the record of columns (N,) by name.

    Args:
        table: Declares the record's class, its arrays, and the columns of each.
        columns: All of the table, but those that a record may leave empty; or a whole array of it.
        settings: What the record holds beside arrays.

    Raises:
        RecordError: The record refuses a value.
    """
    arrays: dict[str, Any] = {}
    for part in table.fields:
        parts = [columns[column.name] for column in part.columns if column.name in columns]
        if part.name in columns:
            arrays[part.name] = columns[part.name]
        elif part.is_covariance:
            arrays[part.name] = symmetric(np.column_stack(parts))
        elif len(part.shape) > 1:
            arrays[part.name] = np.column_stack(parts)
    return LogRecord.classes[table.name](**arrays, **settings)


def values_in(record: LogRecord, names: Sequence[str]) -> Array:
    """Return the values of some of a record's columns, (N,) of one and (N, m) of several."""
    values = []
    for name in names:
        part, place = record.table.places[name]
        array = getattr(record, part.name)
        values.append(array if array.ndim == 1 else array[:, place])
    return values[0] if len(names) == 1 else np.column_stack(values)


def with_values(record: Any, names: Sequence[str], values: Array) -> Any:
    """Return a record with other values in some of its columns, as `values_in` gives them."""
    changed: dict[str, Array] = {}
    for k, name in enumerate(names):
        part, place = record.table.places[name]
        column = values if len(names) == 1 else values[:, k]
        if len(part.shape) == 1:
            changed[part.name] = column
        else:
            array = changed.setdefault(part.name, getattr(record, part.name).copy())
            array[:, place] = column
    return replace(record, **changed)


def columns_of(record: LogRecord) -> dict[str, list[Any]]:
    """Return a record's columns by name, without those that are there for values alone."""
    columns: dict[str, list[Any]] = {}
    for part in record.table.fields:
        array = getattr(record, part.name)
        if all(column.is_added for column in part.columns) and np.isnan(array).all():
            continue
        flat = upper_triangles(array) if part.is_covariance else array
        values = np.atleast_2d(flat.T).tolist()
        columns |= dict(zip((column.name for column in part.columns), values, strict=True))
    return columns
