"""What a program makes of a stream that it reads: a column and a change of it, words of both."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.faults.columns import LogColumn, pair_words
from comparisons.faults.grammar import times

LAGS = (1, -1, 2, -2)
"""Rows by which values may come late, or early where negative, where no more are sought."""
_ROWS = {"odometry": "sample", "measurements": "measurement", "positions": "position"}
"""What the rows of a stream are called."""
_OF_ROW = ("all", "way")
"""Columns that are all of a row."""


class ValueChange(NamedTuple):
    """A change of a column, with one number or none.

    Attributes:
        words: With a place for the number.
        values: Makes of values (N, m), and of the number, those that are used instead.
        start: The number that a fit begins with; empty where there is none.
        is_neutral: Whether that of `start` changes nothing.
        is_line: Whether it is a factor or an offset, of which two go together.
        is_factor: Whether it is a factor; then it has words of its own.
    """

    words: str
    values: Callable[..., Array]
    start: tuple[float, ...] = ()
    is_neutral: bool = True
    is_line: bool = False
    is_factor: bool = False


class Misreading(NamedTuple):
    """Columns of one stream that a program changes, one after the other."""

    parts: tuple[tuple[LogColumn, ValueChange], ...]

    @property
    def column(self) -> LogColumn:
        """The first."""
        return self.parts[0][0]

    @property
    def change(self) -> ValueChange:
        """That of the first."""
        return self.parts[0][1]

    @property
    def start(self) -> tuple[float, ...]:
        """Numbers that a fit begins with."""
        return tuple(number for _, change in self.parts for number in change.start)

    @property
    def words(self) -> str:
        """With a place for each number."""
        return ", and ".join(change.words for _, change in self.parts)

    def said(self, *numbers: float) -> str:
        """Return it in words, with numbers."""
        said, rest = list[str](), list(numbers)
        for column, change in self.parts:
            some = [rest.pop(0) for _ in change.start]
            text = times(column.the, "the log's") if change.is_factor else change.words.format
            said.append(text(*some))
        return ", and ".join(said)

    def values(self, values: Array, *numbers: float) -> Array:
        """Return the values (N, m) of the stream that are used in place of those that it has."""
        used, rest = values.copy(), list(numbers)
        for column, change in self.parts:
            some = [rest.pop(0) for _ in change.start]
            used[:, column.entries] = change.values(used[:, column.entries], *some)
        return used


def misreadings(columns: Sequence[LogColumn], lags: Sequence[int]) -> list[Misreading]:
    """Return every change of every column, those without a number first.

    All columns at once come first where rows are others, and last where values are.

    Args:
        columns: Of one stream, as `read_columns` gives them.
        lags: Numbers of rows by which values may come late, or early where negative.
    """
    changes = [(column, change) for column in columns for change in _of_rows(column, lags)]
    changes += [
        (column, change) for column in (*columns[1:], columns[0]) for change in _of_values(column)
    ]
    changes += [(columns[0], change) for change in _exchanges(columns)]
    return sorted(
        (Misreading((misreading,)) for misreading in changes), key=lambda change: len(change.start)
    )


def joined_misreadings(columns: Sequence[LogColumn]) -> list[Misreading]:
    """Return two of the factors and offsets of a stream's columns at once."""
    lines = [
        (column, change) for column in columns for change in _of_values(column) if change.is_line
    ]
    return [Misreading(pair) for pair in combinations(lines, 2)]


def late(column: LogColumn, lag: int) -> Misreading:
    """Return that a column of the odometry is so many samples late, and zero before the first."""
    change = ValueChange(_column_lag_words(column, lag), partial(_shifted, lag=lag, held=False))
    return Misreading(((column, change),))


def _of_values(column: LogColumn) -> Iterator[ValueChange]:
    """A sign, a constant, a factor, an offset."""
    the, unit, is_single = column.the, column.spelt_unit, len(column.entries) == 1
    is_scaled = bool(unit) or column.stream == "odometry"  # not range and bearing by one factor
    if is_scaled and column.name != "range":
        if is_single:
            yield ValueChange(f"{the} is used without its sign", np.abs)
        yield ValueChange(f"{the} has the opposite sign", np.negative)
        yield ValueChange(f"{the} is zero", np.zeros_like)
    if is_single:
        yield ValueChange(f"{the} is always {{:.4g}} {unit}", np.full_like, (0.0,),
                          is_neutral=False)  # fmt: skip
    if is_scaled:
        yield ValueChange(f"{the} is {{}} times the log's", np.multiply, (1.0,),
                          is_line=bool(unit), is_factor=True)  # fmt: skip
    if is_single:
        yield ValueChange(f"{the} has a bias of {{:+.4g}} {unit}", np.add, (0.0,), is_line=True)
    if column.name == "range":
        yield ValueChange(
            f"the square of {the} differs from the log's by {{:+.4g}} m^2, as from a height offset",
            lambda v, h: np.sqrt(np.maximum(v**2 + h, 1e-12)), (0.0,),
        )  # fmt: skip


def _exchanges(columns: Sequence[LogColumn]) -> Iterator[ValueChange]:
    """Which two may be in each other's place, of all values of the stream."""
    singles = [column for column in columns if len(column.entries) == 1]
    for first, second in combinations(singles, 2):
        order = np.arange(len(singles))
        pair = [*first.entries, *second.entries]
        order[pair] = pair[::-1]
        yield ValueChange(pair_words(first, second), lambda v, order=order: v[:, order])


def _of_rows(column: LogColumn, lags: Sequence[int]) -> Iterator[ValueChange]:
    """Other rows, or what lies between them."""
    yield from _of_other_rows(column, lags)
    yield from _of_neighbours(column)


def _of_other_rows(column: LogColumn, lags: Sequence[int]) -> Iterator[ValueChange]:
    """Before the first sample of the odometry the vehicle does as it does then, or stands."""
    for lag in lags:
        words, is_late = _column_lag_words(column, lag), column.stream == "odometry" and lag > 0
        twice = ", the first twice" * is_late
        yield ValueChange(f"{words}{twice}", partial(_shifted, lag=lag))
        if is_late:
            yield late(column, lag).change


def lag_words(lag: int, what: str) -> str:
    """Return that something comes so many samples late, or early where negative."""
    many = f"{abs(lag)} {what}{'s' * (abs(lag) > 1)}"
    return f"{many} {'late' if lag > 0 else 'early'}"


def _column_lag_words(column: LogColumn, lag: int) -> str:
    the, row, count = column.the, _ROWS[column.stream], abs(lag)
    if column.stream == "odometry":
        return f"{the} is used {lag_words(lag, row)}"
    side = "before" if lag > 0 else "after"
    which = ("previous" if lag > 0 else "next") if count == 1 else ""
    if column.name in _OF_ROW:
        return f"{the} is the {which} one" if which else f"{the} is the one {count} {side}"
    return f"{the} is that of " + (f"the {which} {row}" if which else f"{count} {row}s {side}")


def _shifted(values: Array, lag: int, *, held: bool = True) -> Array:
    """Values so many rows before. held: the first comes before it, too; else zero does."""
    row = np.arange(len(values)) - lag
    moved: Array = values[np.clip(row, 0, len(values) - 1)]
    if not held:
        moved[row < 0] = 0.0
    return moved


def _of_neighbours(column: LogColumn) -> Iterator[ValueChange]:
    """Between a row and the one before or after; of measurements these are of another landmark."""
    if column.stream == "measurements":
        return
    the, row = column.the, _ROWS[column.stream]

    def between(values: Array, share: float, lag: int) -> Array:
        return values + share * (_shifted(values, lag, held=False) - values)

    for lag, which in ((1, "previous"), (-1, "next")):
        pair = f"a {row} and the {which} one"
        yield ValueChange(f"{the} is the mean of {pair}", partial(between, share=0.5, lag=lag))
        yield ValueChange(f"{the} is interpolated {{:.4g}} of the way between {pair}",
                          partial(between, lag=lag), (0.0,))  # fmt: skip
