"""A log from a user's CSV files: which columns mean what, and what is assumed where none says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from comparisons.errors import InputError, RecordError, quoted, shorten
from comparisons.logs.column_names import ColumnOptions, column_of, known_unit, usual_name
from comparisons.logs.from_arrays import odometry_kinds
from comparisons.logs.log import Log, Positions, Prior
from comparisons.logs.message_csv import is_message
from comparisons.logs.odometry import RelativePoses, wheel_samples
from comparisons.logs.plain_csv import (
    SEE,
    PlainTable,
    need,
    read_plain,
    shown,
    split_unit,
)
from comparisons.logs.readers.gps_start import Reckoned, east_north, lay_fixes
from comparisons.logs.schema import (
    COLUMNS,
    COVARIANCE,
    KINDS,
    LARGEST_SIGMA,
    LEAST_SIGMA,
    OPTIONS,
    POSES,
    POSITIONS,
    STEERED,
    STREAMS,
    TWIST,
    UNITS,
    VARIANCES,
    LogStream,
    dimension,
)
from graphslam.increments import MotionSamples, dead_reckoned

_BY_ARGUMENT = {stream.argument: stream for stream in STREAMS if stream.option}
_MOTION = tuple(dict.fromkeys(name for table in KINDS.values() for name in table.values))
_PLACE = POSITIONS.needed
_DEGREES = ("latitude", "longitude")
_FIX = ("time_s", *_DEGREES)
_STREAM_OF = {
    column.name: stream.spoken
    for stream in _BY_ARGUMENT.values()
    for table in stream.user_tables
    for column in (*table.columns, *table.others)
    if column.stated is not None
}
"""The stream that a stated number is of."""
LEAST_VARIANCE = 1e-6
"""Drivers write smaller ones of positions for what they do not know."""


@dataclass(frozen=True, kw_only=True)
class UserFiles:
    """What a user has, and what he states.

    paths: by argument of `Log.from_arrays`, but for the truth's poses. stated: by column, such as
    `sigma_range_m`, what holds for all rows: numbers in SI, or texts, "1" in SI, or "1deg". truth:
    reads its poses, by what times count from.
    kind: of odometry, None where the columns say. units: by `COLUMN` or `STREAM:COLUMN`, of values
    whose header names no unit. columns: by the same, with a usual name for COLUMN, the header that
    has it. prior_pose: (x, y, heading) at the first odometry. imu: yaw rates in place of the
    odometry's.
    """

    name: str
    paths: Mapping[str, Path]
    stated: Mapping[str, float | str]
    truth: Callable[[int], PlainTable] | None = None
    kind: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    columns: Mapping[str, str] = field(default_factory=dict)
    imu: Path | None = None
    prior_pose: tuple[float, float, float] | None = None


class NewLog(NamedTuple):
    """The log, comments for its `log.toml` by key, and lines on how the files were read."""

    log: Log
    remarks: dict[str, str]
    notes: list[str]


def build(files: UserFiles) -> NewLog:
    """Read the files into a log. Raises InputError naming file, line, value and expectation."""
    reading = _Reading(files)
    streams = reading.all()
    if reading.stated:
        name = next(iter(reading.stated))
        why = f"the {reading.kind} odometry does not use it"
        if COLUMNS[name].names:
            why = f"the file of --{_STREAM_OF[name]} gives its own sigmas, or there is none"
        raise InputError(f"{OPTIONS[name]}: {why}")
    try:
        log = Log.from_arrays(**streams, name=files.name)
    except RecordError as error:
        raise reading.located(error) from None
    if files.prior_pose is not None:
        pose = np.array(files.prior_pose)
        log = replace(log, prior=Prior(log.prior.time_s, pose, log.prior.covariance))
    if reading.geodetic and log.positions is not None:
        log, note = _laid(log, log.positions)
        reading.notes.append(note)
    origins = {f"{stream} file": _origins(t, limits=False) for stream, t in reading.tables.items()}
    if reading.start_s:
        origins["time_origin_s"] = str(reading.start_s)
        reading.notes.append(f"times count from {reading.start_s} s of the files")
    log = replace(log, provenance={**log.provenance, **origins})
    reading.check_instants(log)
    notes = [f"{stream}: {_origins(t, limits=True)}" for stream, t in reading.tables.items()]
    start = _start(files, log)
    return NewLog(log, _remarks(start), [*notes, _start_words(log, start), *reading.notes])


class _Reading:
    """The files of one log as they are read: tables by stream, and sigmas not used so far."""

    def __init__(self, files: UserFiles) -> None:
        self.files, self.stated = files, dict(files.stated)
        self.tables: dict[str, PlainTable] = {}
        self.notes: list[str] = []
        self.kind, self.geodetic = "", False
        self.start_s: int | None = None  # that of the odometry, which is read first
        self.span_s = (-np.inf, np.inf)
        self.kinds = {"odometry": self.odometry, "positions": self.positions}

    def all(self) -> dict[str, Any]:
        """All streams. Raises InputError that names what is unknown or missing in any of them."""
        streams: dict[str, Any] = {}
        faults: list[str] = []
        for argument, stream in _BY_ARGUMENT.items():
            try:
                if argument == "truth":
                    streams[argument] = self.truth()
                elif argument in self.files.paths:
                    read = self.kinds.get(argument, self.stream)
                    streams[argument] = read(stream, self.files.paths[argument])
            except InputError as error:
                faults.append(str(error))
        faults += self._unused_options()
        if faults:
            several = [fault.removesuffix(f", {SEE}").removesuffix(f"; {SEE}") for fault in faults]
            raise InputError(faults[0] if not faults[1:] else f"{'; '.join(several)}; {SEE}")
        return streams

    def odometry(self, stream: LogStream, path: Path) -> dict[str, Any]:
        """Columns of one kind, with what is stated of it."""
        table = self._read("odometry", path, stream.wanted)
        self.start_s = table.start_s
        if self.files.imu is not None:
            table = self._with_imu(table, self.files.imu)
        self.kind = self.files.kind or self._kind(table)
        if self.kind not in KINDS:
            raise InputError(f"--kind is {quoted(self.kind)}, expected one of {', '.join(KINDS)}")
        declared = KINDS[self.kind]
        needed = declared.needed
        need(table, needed)
        moves = [name for name in declared.stated if name in self.stated]
        covariances: tuple[str, ...] = ()
        if self.kind == "relative-poses":
            covariances = COVARIANCE
        elif self.kind == "poses" and not moves:
            covariances = (*COVARIANCE, *TWIST)
        table = self.tables["odometry"] = _only(table, (*needed, *covariances))
        for name in needed:
            self._check_angle(table, name)
        times = table.columns["time_s"]
        if self.kind != "relative-poses":  # a wheel sample holds until the next
            holds = self.kind != "poses" and len(times) > 1
            held_s = np.median(np.abs(np.diff(times))) if holds else 0.0
            self.span_s = (times.min(), times.max() + held_s)
        stated: dict[str, Any] = {}
        if self.kind in ("velocity", "steering"):
            stated = self._take_all(*declared.stated)
        elif self.kind == "poses" or not set(COVARIANCE) <= table.columns.keys():
            stated = {name: self._take(name) for name in moves}
        return {**table.columns, **stated}

    def _with_imu(self, table: PlainTable, path: Path) -> PlainTable:
        """Odometry with the mean yaw rate of an IMU over each of its samples."""
        need(table, ("time_s", "speed_mps"))
        imu = self._read("imu", path, ("time_s", "yaw_rate_radps"))
        need(imu, ("time_s", "yaw_rate_radps"))
        time_s, at_s = table.columns["time_s"], imu.columns["time_s"]
        if len(at_s) < 2 or len(time_s) < 2 or np.diff(at_s).min() <= 0.0:
            raise InputError(f"{path}: expected at least two samples of times that increase")
        slack = 2.0 * float(np.median(np.diff(at_s)))
        ends = np.append(time_s[1:], 2.0 * time_s[-1] - time_s[-2])
        inside = (time_s >= at_s[0] - slack) & (time_s <= at_s[-1] + slack)
        if inside.sum() < max(2, len(inside) / 2):
            raise InputError(
                f"{path}: from {at_s[0]:.3f} to {at_s[-1]:.3f} s, expected yaw rates for the "
                f"odometry's {time_s[0]:.3f} to {time_s[-1]:.3f} s"
            )
        if not inside.all():
            self.notes.append(
                f"left out: {int((~inside).sum())} of {len(inside)} odometry, outside the time of "
                "the yaw rates"
            )
            table, time_s, ends = table.rows(inside), time_s[inside], ends[inside]
        rate = imu.columns["yaw_rate_radps"]
        turned = np.append(0.0, np.cumsum(np.diff(at_s) * (rate[1:] + rate[:-1]) / 2))
        begin, end = (np.clip(one, at_s[0], at_s[-1]) for one in (time_s, ends))
        long = end - begin
        mean = np.where(
            long > 0.0,
            (np.interp(end, at_s, turned) - np.interp(begin, at_s, turned))
            / np.where(long > 0.0, long, 1.0),
            np.interp(begin, at_s, rate),
        )
        columns = {**_only(table, ("time_s", "speed_mps")).columns, "yaw_rate_radps": mean}
        origin = {**table.origin, "yaw_rate_radps": f"{path.name}, mean of each sample"}
        return replace(table, columns=columns, origin=origin)

    def positions(self, stream: LogStream, path: Path) -> dict[str, Any]:
        """Columns, within the odometry's time; of latitudes and longitudes, about the first."""
        table = self._read("positions", path, stream.wanted)
        self.geodetic = set(_FIX) <= table.columns.keys() and "x_m" not in table.columns
        need(table, _FIX if self.geodetic else _PLACE)
        table = self._within("positions", self._once("positions", table))
        columns = dict(table.columns)
        if self.geodetic:
            altitude = np.nan_to_num(columns.pop("altitude", np.zeros(len(table.line))))
            plane = east_north(columns.pop("latitude"), columns.pop("longitude"), altitude)
            columns |= {"x_m": plane[:, 0], "y_m": plane[:, 1]}
        variances = {name: columns.pop(name, None) for name in VARIANCES}
        place = {name: columns[name] for name in _PLACE}
        if all(
            one is not None and (name == "cov_xy_m2" or one.min(initial=np.inf) >= LEAST_VARIANCE)
            for name, one in variances.items()
        ):
            return {**place, **variances}
        if variances["var_x_m2"] is not None:
            self.notes.append("covariances of positions below (1 mm)^2 are none, and not used")
        if "sigma_m" in columns:
            return {**place, "sigma_m": columns["sigma_m"]}
        return {**place, **self._take_all("sigma_m")}

    def truth(self) -> dict[str, Any] | None:
        """Columns of the truth's poses."""
        if self.files.truth is None:
            return None
        table = self.tables["truth"] = self.files.truth(self.start_s or 0)
        need(table, POSES.needed)
        return table.columns

    def stream(self, stream: LogStream, path: Path) -> dict[str, Any]:
        """Columns of a stream of one kind, with what is stated of those that no file must have."""
        (declared,) = stream.tables
        table = self._read(stream.spoken, path, stream.wanted)
        stated = [name for name in declared.needed if COLUMNS[name].stated is not None]
        need(table, [name for name in declared.needed if name not in stated])
        for name in declared.needed:
            self._check_angle(table, name)
        if stream.is_timed:
            table = self._within(stream.spoken, self._once(stream.spoken, table))
        if "landmark" in declared.names and "landmark" not in table.columns:
            names = " or ".join(COLUMNS["landmark"].names)
            self.notes.append(
                "landmarks are unknown and will be associated by the estimators: there is no "
                f"column {names}"
            )
        lacking = [name for name in stated if name not in table.columns]
        return {**table.columns, **self._take_all(*lacking)}

    def located(self, error: RecordError) -> InputError:
        """A record's fault with the file and line that it came from."""
        streams = {"measurements": "measurements", "relative poses": "odometry"}
        stream = streams.get(error.stream, error.stream.split()[-1])
        table = self.tables.get(error.stream) or self.tables.get(stream)
        if table is None:
            return error
        place = table.path if error.row is None else f"{table.path}:{table.line[error.row]}"
        mend = "; sort the file by time" if "expected times to increase" in error.fault else ""
        return InputError(f"{place}: {error.fault}{mend}")

    def check_instants(self, log: Log) -> None:
        """Measurements must be at the times of single motions, for nothing is between."""
        if self.kind != "relative-poses":
            return
        times, seen_s = (log.prior.time_s, *log.odometry.time_s.tolist()), log.measurements.time_s
        stray = np.flatnonzero(~np.isin(seen_s, times))
        if len(stray):
            row = int(stray[0])
            fault = (
                f"time {seen_s[row]} s is not the end of a motion, expected a time at which a "
                f"motion of {self.files.paths['odometry']} ends"
            )
            raise self.located(RecordError("measurements", row, fault))

    def _read(self, stream: str, path: Path, wanted: tuple[str, ...]) -> PlainTable:
        options = column_options(self.files.units, self.files.columns, stream)
        table = read_plain(path, wanted, options=options, start_s=self.start_s)
        self.tables[stream] = table
        if table.columns and not table.line:
            raise InputError(
                f"{path}: holds no records, expected rows below the header (a line that begins "
                "with # is a comment)"
            )
        return table

    def _once(self, stream: str, table: PlainTable) -> PlainTable:
        """Without repeated records, which would count twice as information."""
        columns = [np.asarray(column).tolist() for column in table.columns.values()]
        first: dict[str, int] = {}
        for row, reported in enumerate(zip(*columns, strict=True)):
            first.setdefault(str(reported), row)
        kept = np.isin(np.arange(len(table.line)), list(first.values()))
        if not kept.all():
            lost = int((~kept).sum())
            line = table.line[int(np.argmin(kept))]
            self.notes.append(
                f"left out: {lost} of {len(kept)} {stream}, repeated (first at line {line})"
            )
        return table.rows(kept)

    def _kind(self, table: PlainTable) -> str:
        """The kind of the columns; of several, the one whose sigma is stated, or a message's poses.

        A message of odometry holds poses and velocities; a bag's poses are read.
        """
        names = {name for name in table.columns if name in _MOTION}
        kinds = odometry_kinds(names - table.guessed) or odometry_kinds(names)
        driven = [kind for kind in kinds if kind in ("velocity", "steering")]
        if len(driven) == 1 and "sigma_speed_mps" in self.stated:
            kinds = driven
        elif len(kinds) > 1 and is_message(table.origin.get("x_m", "")):
            kinds = ["poses"]
        if len(kinds) == 1:
            return kinds[0]
        if kinds:
            raise InputError(
                f"{table.path}: odometry: holds {' and '.join(kinds)}, expected one of them: give "
                f"--kind; found {shown(table.headers)}; {SEE}"
            )
        unknown = [header for header in table.headers if header and header not in table.used]
        found = f"unknown columns: {shown(unknown)}" if unknown else "columns are missing"
        read = shown([header for header in table.headers if header in table.used])
        choices = "; ".join(
            f"{kind}: {', '.join(' or '.join(COLUMNS[name].names[:2]) for name in table.values)}"
            for kind, table in KINDS.items()
        )
        raise InputError(
            f"{table.path}: odometry: {found}; expected beside {read or 'time'} one of {choices}; "
            f"{table.mend}, {SEE}"
        )

    def _take_all(self, *names: str) -> dict[str, float]:
        """Stated numbers by name. Raises InputError that names all that are missing."""
        lacking = [name for name in names if name not in self.stated]
        if lacking:
            options = " and ".join(OPTIONS[name] for name in lacking)
            columns = " and ".join(name for name in lacking if COLUMNS[name].names)
            fault = (
                "are missing, expected numbers" if lacking[1:] else "is missing, expected a number"
            )
            column = f" or a column {columns}" if columns else ""
            raise InputError(f"{options} {fault}{column}; {SEE}")
        return {name: self._take(name) for name in names}

    def _take(self, name: str) -> float:
        """A stated number in SI; a text without a unit has that of the column it is a sigma of."""
        value = self.stated.pop(name)
        if isinstance(value, str):
            value = self._in_si(name, value)
        stated = COLUMNS[name].stated
        least = LEAST_SIGMA if stated is None or stated.is_positive else 0.0
        if not least <= value <= LARGEST_SIGMA:
            raise InputError(f"{OPTIONS[name]} is {value:g}, expected between {least:g} and 1e+06")
        return value

    def _in_si(self, name: str, text: str) -> float:
        """A number in SI, or with a unit behind it; of rates, angles too, which are per second."""
        stated, table = COLUMNS[name].stated, self.tables.get(_STREAM_OF[name])
        columns = (name,) if stated is None else stated.of
        column = next((one for one in columns if table and one in table.columns), columns[0])
        units = dict(UNITS[dimension(column)])
        if dimension(column) == "radps":
            units |= UNITS["rad"]
        number, unit = split_unit(text)
        known = known_unit(column, unit)
        if known is None and unit and dimension(column) == "radps":
            known = known_unit("heading_rad", unit)
        if number is None or (unit and known is None):
            raise InputError(
                f"{OPTIONS[name]} is '{shorten(text)}', expected a number, or one with a unit "
                f"behind it: {', '.join(units)}"
            )
        if known:
            return number * units[known]
        if table is not None and abs(table.factor.get(column, 1.0)) != 1.0:
            si = dimension(column)
            self.notes.append(
                f"{OPTIONS[name]} {text} is {text} {si}, though '{table.origin[column]}' is in "
                f"{table.unit[column].partition(' ')[0].removeprefix('-')}: a sigma without a unit "
                "is in SI"
            )
        return number

    def _unused_options(self) -> list[str]:
        """What is wrong with units and headers that are given and that no file has."""
        faults = []
        for given, unit in self.files.units.items():
            if not any(_column(given) in table.stated for table in self._tables_of(given)):
                option = f"--unit {shorten(f'{given}={unit}')}"
                faults.append(f"{option}: no file has such a column that is read")
        for given, header in self.files.columns.items():
            name, option = _column(given), f"--column {shorten(f'{given}={header}')}"
            if column_of(name) is None:
                usual = ", ".join(
                    dict.fromkeys(column.names[0] for column in COLUMNS.values() if column.names)
                )
                faults.append(f"{option}: '{shorten(name)}' is unknown, expected {usual}")
            elif not any(name in table.named for table in self._tables_of(given)):
                faults.append(f"{option}: no file that needs it has a column '{shorten(header)}'")
        return faults

    def _tables_of(self, given: str) -> list[PlainTable]:
        """The files that an option of `COLUMN` or `STREAM:COLUMN` is of."""
        stream = given.rpartition(":")[0]
        return [table for name, table in self.tables.items() if stream in ("", name)]

    def _within(self, stream: str, table: PlainTable) -> PlainTable:
        """The records during the odometry; the others are left out, and counted aloud."""
        times = table.columns["time_s"]
        kept = (times >= self.span_s[0]) & (times <= self.span_s[1])
        if len(times) and not kept.any():
            raise InputError(
                f"{table.path}: from {times.min():.3f} to {times.max():.3f} s, expected times "
                f"within the odometry's {self.span_s[0]:.3f} to {self.span_s[1]:.3f} s"
            )
        if not kept.all():
            self.notes.append(
                f"left out: {int((~kept).sum())} of {len(kept)} {stream}, outside the time of the "
                "odometry"
            )
        self.tables[stream] = table.rows(kept)
        return self.tables[stream]

    def _check_angle(self, table: PlainTable, name: str) -> None:
        """Values that can only be degrees are refused with the word that converts them."""
        largest = COLUMNS[name].degrees_above
        if largest == np.inf or name not in table.columns:
            return
        values = np.abs(table.columns[name])
        if len(values) and values.max() > largest:
            row, header = int(values.argmax()), table.origin[name]
            unit = "degps" if name.endswith("ps") else "deg"
            raise InputError(
                f"{table.path}:{table.line[row]}: '{header}' is {table.columns[name][row]:g} in "
                f"radians, expected {largest:.4g} at most; give --unit {header}={unit}, or name "
                f"the column {usual_name(name)}_{unit}, if these are degrees"
            )


def column_options(
    units: Mapping[str, str], columns: Mapping[str, str], stream: str
) -> ColumnOptions:
    """Return what is said of a file's columns: by `COLUMN` for each, by `STREAM:COLUMN` for one."""

    def of_stream(options: Mapping[str, str]) -> dict[str, str]:
        return {
            column: value
            for given, value in options.items()
            for named, _, column in [given.rpartition(":")]
            if named in ("", stream)
        }

    return ColumnOptions(units=of_stream(units), headers=of_stream(columns))


def _column(given: str) -> str:
    """The column of an option of `COLUMN` or `STREAM:COLUMN`."""
    return given.rpartition(":")[2]


def _laid(log: Log, plane: Positions) -> tuple[Log, str]:
    """The log with fixes of a plane in the frame of its start, whose heading the first show."""
    laid = lay_fixes(_reckoned(log), plane)
    if laid is None:
        raise InputError(
            f"positions: {len(plane.time_s)} fixes do not show the heading at the start along the "
            "odometry, expected more, or positions x, y in its frame"
        )
    pose = log.prior.pose
    turn = np.array(
        ((np.cos(pose[2]), -np.sin(pose[2]), 0.0), (np.sin(pose[2]), np.cos(pose[2]), 0.0),
         (0.0, 0.0, 1.0))
    )  # fmt: skip
    covariance = log.prior.covariance + turn @ laid.covariance @ turn.T
    positions = replace(
        laid.positions,
        position_m=laid.positions.position_m @ turn[:2, :2].T + pose[:2],
        covariance=turn[:2, :2] @ laid.positions.covariance @ turn[:2, :2].T,
    )
    note = (
        f"positions: WGS 84 about the first fix; the first {laid.spent + 1} of "
        f"{len(plane.time_s)} show the heading at the start, and are spent on that"
    )
    log = replace(log, prior=Prior(log.prior.time_s, pose, covariance), positions=positions)
    return log, note


def _reckoned(log: Log) -> Reckoned:
    """The odometry from the origin."""
    odometry, time_s = log.odometry, log.odometry.time_s
    moved: RelativePoses | MotionSamples
    if isinstance(odometry, RelativePoses):
        moved, time_s = odometry, np.append(log.prior.time_s, time_s)
    else:
        controls = (control[:-1] for control in odometry.controls)
        moved = wheel_samples(odometry, controls, np.diff(time_s))
    pose = dead_reckoned(np.zeros(3), moved.displacement)
    return Reckoned(time_s, pose, pose[:, 0] + 1j * pose[:, 1], moved.covariance)


def _only(table: PlainTable, names: tuple[str, ...]) -> PlainTable:
    """The same with some of its columns."""
    columns = {name: table.columns[name] for name in names if name in table.columns}
    return replace(table, columns=columns)


def _origins(table: PlainTable, *, limits: bool) -> str:
    """How a file was read: each column's header and, if asked for, the limits of its numbers."""
    reported = []
    for name, column in table.columns.items():
        header = table.origin.get(name, name)
        text = name if header == name else f"{name} from '{header}'"
        text += f" in {table.unit[name]}" if name in table.unit else ""
        if limits and len(column) and column.dtype.kind == "f" and not np.isnan(column).all():
            digits = ".3f" if name == "time_s" else ".4g"
            text += f" ({np.nanmin(column):{digits}} to {np.nanmax(column):{digits}})"
        reported.append(text)
    unused = shown([header for header in table.headers if header and header not in table.used])
    text = f"{table.path.name}, {len(table.line)} rows: {', '.join(reported)}"
    return text + (f"; not used: {unused}" if unused else "")


def _start(files: UserFiles, log: Log) -> str:
    """Where the pose of the start comes from."""
    if files.prior_pose is not None:
        return "given"
    poses, start_s = log.truth.poses, log.prior.time_s
    if poses is None:
        return "origin"
    if poses.time_s[0] <= start_s <= poses.time_s[-1]:
        return "from truth"
    late_s = float(poses.time_s[0] - start_s)
    if late_s > 0.0:
        return f"origin, although truth begins {late_s:.3g} s later; --prior-pose gives another"
    return f"origin, although truth ends {start_s - float(poses.time_s[-1]):.3g} s earlier"


def _start_words(log: Log, start: str) -> str:
    """The pose of the start, and where it comes from."""
    x, y, heading = log.prior.pose.tolist()
    return f"start: {x:.4g} m, {y:.4g} m, {heading:.4g} rad ({start})"


_POSE = {
    "given": "--prior-pose",
    "from truth": "default: the true pose at that time; --prior-pose gives another",
}


def _remarks(start: str) -> dict[str, str]:
    """Comments on what was stated and what is a default."""
    pose = _POSE.get(start, "default: the origin; --prior-pose gives another")
    return {
        **{name: OPTIONS[name] for name in STEERED.stated},
        "sigma_turn": "--sigma-turn: of the steering angle [rad] or the yaw rate [rad/s]",
        "pose": pose,
        "covariance": "default: 1 mm and 1 mrad",
        "variance_rate_position": "default, stabilisation noise [m^2/s]",
        "variance_rate_heading": "default, stabilisation noise [rad^2/s]",
        "encoder_offset_m": "default: a plain bicycle, encoder and sensor at its rear axle",
        "label_gate": "default: labels are used without a gate",
        "needs_confirmation": "default: the first measurement initialises a landmark",
        "antenna_m": "default: at the pose",
    }
