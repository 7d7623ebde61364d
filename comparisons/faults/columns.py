"""The columns of a log: what a program reads of its streams, under one name for every reader.

A column is one kind of measured value, or several that are read together. What was done to it is
a change (`misreadings`); what corrects it is in `of_logs`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.column_names import usual_name
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.records import values_in, with_values
from comparisons.logs.schema import (
    COLUMNS,
    MEASUREMENTS,
    POSITIONS,
    RELATIVE,
    STEERED,
    VELOCITY,
    spelt_unit,
)

_KEPT: dict[str, Callable[[Array], Array]] = {
    "range_m": lambda values: np.maximum(values, 1e-3),
    "bearing_rad": lambda values: np.angle(np.exp(1j * values)),
}
"""What keeps the values of a column within its limits."""


class LogColumn(NamedTuple):
    """Values (N,) of a stream, or columns (N, m) that belong together.

    Attributes:
        name: As `new-log` calls it.
        stream: What it is of: `odometry`, `measurements` or `positions`.
        the: As a filter's author calls it, `the speed`.
        columns: Of the schema that it holds.
        words: Of the values, as `turn rates`.
        short: Beside another column of the stream, as `yaw_rate`.
        subject: Of a unit, as `yaw_rate is in`.
        step: What noise hides of it.
    """

    name: str
    stream: str
    the: str
    columns: tuple[str, ...]
    words: str = ""
    short: str = ""
    subject: str = ""
    step: float = 0.0

    @property
    def unit(self) -> str:
        """Dimension, of `UNITS`; empty where its columns have several."""
        units = {COLUMNS[column].unit for column in self.columns}
        return units.pop() if len(units) == 1 else ""

    @property
    def entries(self) -> tuple[int, ...]:
        """Which of the stream's values it holds, of `values_of`."""
        return tuple(_ENTRIES[column] for column in self.columns)

    @property
    def is_angle(self) -> bool:
        """Whether it has a sense of rotation."""
        return self.unit.startswith("rad")

    @property
    def spelt_unit(self) -> str:
        """The unit in words."""
        return spelt_unit(self.unit)

    def read(self, log: Log) -> Array:
        """Return its values."""
        return values_in(getattr(log, self.stream), self.columns)

    def write(self, log: Log, values: Array) -> Log:
        """Return the log with these values, kept within their limits."""
        if len(self.columns) == 1:
            values = _kept(self.columns[0], values)
        else:
            columns = zip(self.columns, values.T, strict=True)
            values = np.column_stack([_kept(name, column) for name, column in columns])
        record = with_values(getattr(log, self.stream), self.columns, values)
        changed: dict[str, Any] = {self.stream: record}
        return replace(log, **changed)

    def changed(self, log: Log, change: Callable[[Array], Array]) -> Log:
        """Return the log with other values."""
        return self.write(log, change(self.read(log)))


def _kept(column: str, values: Array) -> Array:
    keep = _KEPT.get(column)
    return values if keep is None else keep(values)


_ENTRIES = {
    column: place
    for table in (VELOCITY, STEERED, RELATIVE, MEASUREMENTS, POSITIONS)
    for place, column in enumerate(table.measured)
}


def columns_of(log: Log) -> list[LogColumn]:
    """Return every column of a log's streams that holds a measured value."""
    columns = []
    if len(log.measurements.time_s):
        columns += measured_columns()
    if len(log.odometry.time_s):
        columns += odometry_columns(log)
    return columns + ([] if log.positions is None else position_columns())


def pair_words(first: LogColumn, second: LogColumn) -> str:
    """Return that two columns of a stream are in each other's place."""
    of = "" if " of " not in first.words else first.words[first.words.index(" of ") :]
    return f"{first.short} and {second.short}{of} are exchanged"


def values_of(log: Log, stream: str) -> Array:
    """Return the values (N, m) of a stream: the controls, range and bearing, or east and north."""
    record = positions_of(log) if stream == "positions" else getattr(log, stream)
    return values_in(record, record.table.measured)


def read_columns(log: Log, stream: str) -> list[LogColumn]:
    """Return the columns of a stream, the first all that are read at once.

    stream: `odometry`, `measurements` or `positions`, which the log has.
    """
    if stream == "positions":
        return position_columns()
    if stream == "measurements":
        return read_measurements()
    return _with_all(odometry_columns(log), "the odometry")


def read_measurements() -> list[LogColumn]:
    """Return range and bearing, before them both at once."""
    return _with_all(measured_columns(), "the measurement")


def _with_all(columns: list[LogColumn], the: str) -> list[LogColumn]:
    singles = tuple(column.columns[0] for column in columns if len(column.columns) == 1)
    return [LogColumn("all", columns[0].stream, the, singles), *columns]


def measured_columns() -> list[LogColumn]:
    """Return range and bearing."""
    return [
        LogColumn("range", "measurements", "the range", ("range_m",),
                  "ranges", "ranges", "ranges are", 0.01),
        LogColumn("bearing", "measurements", "the bearing", ("bearing_rad",),
                  "bearings", "bearings", "bearings are", 1e-3),
    ]  # fmt: skip


def odometry_columns(log: Log) -> list[LogColumn]:
    """Return speed and turn, or x, y and turn of the motions between poses."""
    if isinstance(log.odometry, RelativePoses):
        of = " of the displacements"
        return [
            LogColumn("way", "odometry", "the translation of the displacement", ("dx_m", "dy_m"),
                      "ways between poses", "ways", "ways between poses are", 0.01),
            LogColumn("x", "odometry", "the forward displacement", ("dx_m",),
                      f"x{of}", "x", f"x{of} is in", 1e-3),
            LogColumn("y", "odometry", "the leftward displacement", ("dy_m",),
                      f"y{of}", "y", f"y{of} is in", 1e-3),
            LogColumn("heading", "odometry", "the rotation of the displacement",
                      ("dheading_rad",), "turns between poses", "heading", "heading is in", 1e-3),
        ]  # fmt: skip
    speed, turn = log.odometry.table.measured
    name, (the, words) = usual_name(turn), _TURNS[turn]
    return [
        LogColumn("speed", "odometry", "the speed", (speed,),
                  "speeds", "speed", "speeds are", 0.01),
        LogColumn(name, "odometry", the, (turn,), words, name, f"{name} is in", 1e-3),
    ]  # fmt: skip


_TURNS = {
    "yaw_rate_radps": ("the yaw rate", "turn rates"),
    "steering_rad": ("the steering angle", "steering angles"),
}


def position_columns() -> list[LogColumn]:
    """Return east and north of the positions, both and each."""
    of = " of the positions"
    return [
        LogColumn("way", "positions", "the position", ("x_m", "y_m"),
                  "positions", "positions", "positions are", 0.01),
        LogColumn("east", "positions", "the position's east", ("x_m",),
                  f"east{of}", "east", f"east{of} is in", 0.01),
        LogColumn("north", "positions", "the position's north", ("y_m",),
                  f"north{of}", "north", f"north{of} is in", 0.01),
    ]  # fmt: skip


def positions_of(log: Log) -> Positions:
    """Return the positions of a log. Raises InputError where it has none."""
    if log.positions is None:
        raise InputError(f"{log.name}: no positions, expected some")
    return log.positions


def moves_of(log: Log) -> Array:
    """Return (N, 3) motions between poses. Raises InputError where the log is of wheels."""
    if not isinstance(log.odometry, RelativePoses):
        raise InputError(f"{log.name}: wheel odometry, expected relative poses")
    return log.odometry.displacement


def with_moves(log: Log, displacement: Array) -> Log:
    """Return a log with other motions between poses (N, 3)."""
    changed: dict[str, Any] = {"displacement": displacement}
    return replace(log, odometry=replace(log.odometry, **changed))
