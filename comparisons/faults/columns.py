"""The columns of a log: what a program reads of its streams, under one name for every reader.

A column is one kind of measured value, or several that are read together. What was done to it is
a change (`misreadings`); what corrects it is in `of_logs`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import RelativePoses, SteeringOdometry

_SPELT = {"mps": "m/s", "radps": "rad/s"}


class LogColumn(NamedTuple):
    """Values (N,) of a stream, or columns (N, m) that belong together.

    Attributes:
        name: As `new-log` calls it.
        stream: What it is of: `odometry`, `measurements` or `positions`.
        the: As a filter's author calls it, `the speed`.
        unit: Dimension, of `UNITS`; empty where columns of several are read together.
        entries: Which of the stream's values it holds, of `values_of`.
        read: From a log.
        write: Into a log.
        words: Of the values, as `turn rates`.
        short: Beside another column of the stream, as `yaw_rate`.
        subject: Of a unit, as `yaw_rate is in`.
        step: What noise hides of it.
    """

    name: str
    stream: str
    the: str
    unit: str
    entries: tuple[int, ...]
    read: Callable[[Log], Array]
    write: Callable[[Log, Array], Log]
    words: str = ""
    short: str = ""
    subject: str = ""
    step: float = 0.0

    @property
    def is_angle(self) -> bool:
        """Whether it has a sense of rotation."""
        return self.unit.startswith("rad")

    @property
    def spelt_unit(self) -> str:
        """The unit in words."""
        return _SPELT.get(self.unit, self.unit)

    def changed(self, log: Log, change: Callable[[Array], Array]) -> Log:
        """Return the log with other values."""
        return self.write(log, change(self.read(log)))


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
    if stream == "odometry":
        if isinstance(log.odometry, RelativePoses):
            return log.odometry.displacement
        return np.column_stack(log.odometry.controls)
    if stream == "measurements":
        return np.column_stack((log.measurements.range_m, log.measurements.bearing_rad))
    return positions_of(log).position_m


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
    singles, stream = [column for column in columns if len(column.entries) == 1], columns[0].stream

    def write(log: Log, values: Array) -> Log:
        for column in singles:
            log = column.write(log, values[:, column.entries[0]])
        return log

    entries = tuple(range(len(singles)))
    whole = LogColumn("all", stream, the, "", entries, partial(values_of, stream=stream), write)
    return [whole, *columns]


def measured_columns() -> list[LogColumn]:
    """Return range and bearing."""

    def ranges(log: Log, values: Array) -> Log:
        measurements = replace(log.measurements, range_m=np.maximum(values, 1e-3))
        return replace(log, measurements=measurements)

    def bearings(log: Log, values: Array) -> Log:
        wrapped = np.angle(np.exp(1j * values))
        return replace(log, measurements=replace(log.measurements, bearing_rad=wrapped))

    return [
        LogColumn("range", "measurements", "the range", "m", (0,),
                  lambda log: log.measurements.range_m, ranges,
                  "ranges", "ranges", "ranges are", 0.01),
        LogColumn("bearing", "measurements", "the bearing", "rad", (1,),
                  lambda log: log.measurements.bearing_rad, bearings,
                  "bearings", "bearings", "bearings are", 1e-3),
    ]  # fmt: skip


def odometry_columns(log: Log) -> list[LogColumn]:
    """Return speed and turn, or x, y and turn of the motions between poses."""

    def of_field(name: str) -> tuple[Callable[[Log], Array], Callable[[Log, Array], Log]]:
        def write(log: Log, values: Array) -> Log:
            changed: dict[str, Any] = {name: values}
            return replace(log, odometry=replace(log.odometry, **changed))

        return lambda log: getattr(log.odometry, name), write

    def of_moves(*k: int) -> tuple[Callable[[Log], Array], Callable[[Log, Array], Log]]:
        where = k[0] if len(k) == 1 else slice(k[0], k[-1] + 1)

        def write(log: Log, values: Array) -> Log:
            moves = moves_of(log).copy()
            moves[:, where] = values
            return with_moves(log, moves)

        return lambda log: moves_of(log)[:, where], write

    if isinstance(log.odometry, RelativePoses):
        of = " of the displacements"
        return [
            LogColumn("way", "odometry", "the translation of the displacement", "m", (0, 1),
                      *of_moves(0, 1), "ways between poses", "ways", "ways between poses are",
                      0.01),
            LogColumn("x", "odometry", "the forward displacement", "m", (0,), *of_moves(0),
                      f"x{of}", "x", f"x{of} is in", 1e-3),
            LogColumn("y", "odometry", "the leftward displacement", "m", (1,), *of_moves(1),
                      f"y{of}", "y", f"y{of} is in", 1e-3),
            LogColumn("heading", "odometry", "the rotation of the displacement", "rad", (2,),
                      *of_moves(2), "turns between poses", "heading", "heading is in", 1e-3),
        ]  # fmt: skip
    name, the, words, unit = "yaw_rate", "the yaw rate", "turn rates", "radps"
    if isinstance(log.odometry, SteeringOdometry):
        name, the, words, unit = "steering", "the steering angle", "steering angles", "rad"
    return [
        LogColumn("speed", "odometry", "the speed", "mps", (0,), *of_field("speed_mps"),
                  "speeds", "speed", "speeds are", 0.01),
        LogColumn(name, "odometry", the, unit, (1,), *of_field(f"{name}_{unit}"),
                  words, name, f"{name} is in", 1e-3),
    ]  # fmt: skip


def position_columns() -> list[LogColumn]:
    """Return east and north of the positions, both and each."""

    def of_axes(*k: int) -> tuple[Callable[[Log], Array], Callable[[Log, Array], Log]]:
        where = k[0] if len(k) == 1 else slice(k[0], k[-1] + 1)

        def write(log: Log, values: Array) -> Log:
            place = positions_of(log).position_m.copy()
            place[:, where] = values
            return replace(log, positions=replace(positions_of(log), position_m=place))

        return lambda log: positions_of(log).position_m[:, where], write

    of = " of the positions"
    return [
        LogColumn("way", "positions", "the position", "m", (0, 1), *of_axes(0, 1),
                  "positions", "positions", "positions are", 0.01),
        LogColumn("east", "positions", "the position's east", "m", (0,), *of_axes(0),
                  f"east{of}", "east", f"east{of} is in", 0.01),
        LogColumn("north", "positions", "the position's north", "m", (1,), *of_axes(1),
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
