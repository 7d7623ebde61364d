"""A log from a user's CSV files: which columns mean what, and what is assumed where none says."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from comparisons.errors import InputError, RecordError
from comparisons.logs.from_arrays import COVARIANCE, KINDS, odometry_kind
from comparisons.logs.log import Log, Prior
from comparisons.logs.plain_csv import NAMES, SEE, PlainTable, read_plain

_MOTION = tuple(dict.fromkeys(name for needed in KINDS.values() for name in needed))
_MEASUREMENTS = (
    "time_s",
    "range_m",
    "bearing_rad",
    "landmark",
    "sigma_range_m",
    "sigma_bearing_rad",
    "diameter_m",
    "intensity",
)
_VARIANCES = ("var_x_m2", "cov_xy_m2", "var_y_m2")
_PLACE = ("time_s", "x_m", "y_m")
_ALONE = {
    "bearing_rad": " (ranges alone are not supported)",
    "range_m": " (bearings alone are not supported)",
}
"""What is said where one of two columns is missing."""
_LARGEST = {"bearing_rad": 2 * np.pi, "steering_rad": 1.55, "yaw_rate_radps": 20.0}
"""Larger angles and rates than a vehicle has are degrees, or wrong."""
_SHARP = ("sigma_range_m", "sigma_bearing_rad", "sigma_m", "wheelbase_m")
"""What is stated above zero."""
OPTIONS = {
    "sigma_speed_mps": "--sigma-speed",
    "sigma_turn": "--sigma-turn",
    "sigma_move_m": "--sigma-move",
    "sigma_range_m": "--sigma-range",
    "sigma_bearing_rad": "--sigma-bearing",
    "sigma_m": "--sigma-position",
    "wheelbase_m": "--wheelbase",
}
"""The option that states a column's number for all rows."""


@dataclass(frozen=True, kw_only=True)
class UserFiles:
    """What a user has, and what he states.

    stated: numbers by column, such as `sigma_range_m`, that hold for all rows. truth: its poses,
    already read. kind: of odometry, None where the columns say. degrees: of angles whose header
    names no unit. prior_pose: (x, y, heading) at the first odometry.
    """

    name: str
    odometry: Path
    measurements: Path
    stated: dict[str, float]
    positions: Path | None = None
    truth: PlainTable | None = None
    truth_landmarks: Path | None = None
    kind: str | None = None
    degrees: bool = False
    prior_pose: tuple[float, float, float] | None = None


class Found(NamedTuple):
    """The log, comments for its `log.toml` by key, and lines on how the files were read."""

    log: Log
    remarks: dict[str, str]
    notes: list[str]


def build(files: UserFiles) -> Found:
    """Read the files into a log. Raises InputError naming file, line, value and expectation."""
    for name, value in files.stated.items():
        least = 1e-7 if name in _SHARP else 0.0
        if not least <= value <= 1e6:
            raise InputError(f"{OPTIONS[name]} is {value:g}, expected between {least:g} and 1e+06")
    reading = _Reading(files)
    odometry = reading.odometry()
    measurements, positions = reading.measurements(), reading.positions()
    truth, marks = reading.truth(), reading.truth_landmarks()
    if reading.stated:
        name = next(iter(reading.stated))
        why = f"the {reading.kind} odometry does not use it"
        if name == "sigma_m":
            why = "the file of --positions gives its own sigmas, or there is none"
        raise InputError(f"{OPTIONS[name]}: {why}")
    try:
        log = Log.from_arrays(
            odometry,
            measurements,
            positions=positions,
            truth=truth,
            truth_landmarks=marks,
            name=files.name,
        )
    except RecordError as error:
        raise reading.located(error) from None
    if files.prior_pose is not None:
        pose = np.array(files.prior_pose)
        log = replace(log, prior=Prior(log.prior.time_s, pose, log.prior.covariance))
    origins = {f"{stream} file": _origins(t, limits=False) for stream, t in reading.tables.items()}
    log = replace(log, provenance={**log.provenance, **origins})
    reading.check_instants(log)
    notes = [f"{stream}: {_origins(t, limits=True)}" for stream, t in reading.tables.items()]
    return Found(log, _remarks(files, log), notes + reading.notes)


class _Reading:
    """The files of one log as they are read: tables by stream, and sigmas not used so far."""

    def __init__(self, files: UserFiles) -> None:
        self.files, self.stated = files, dict(files.stated)
        self.tables: dict[str, PlainTable] = {}
        self.notes: list[str] = []
        self.kind = ""
        self.span_s = (-np.inf, np.inf)

    def odometry(self) -> dict[str, Any]:
        """Columns of one kind, with what is stated of it."""
        table = self._read("odometry", self.files.odometry, ("time_s", *_MOTION, *COVARIANCE))
        self.kind = self.files.kind or self._kind(table)
        if self.kind not in KINDS:
            raise InputError(f"--kind is {self.kind!r}, expected one of {', '.join(KINDS)}")
        needed = ("time_s", *KINDS[self.kind])
        _need(table, needed)
        covariances = COVARIANCE if self.kind == "relative-poses" else ()
        table = self.tables["odometry"] = _only(table, (*needed, *covariances))
        for name in ("yaw_rate_radps", "steering_rad"):
            self._check_angle(table, name)
        times = table.columns["time_s"]
        if self.kind != "relative-poses":  # a wheel sample holds until the next
            held = (
                0.0 if self.kind == "poses" or len(times) < 2 else np.median(np.abs(np.diff(times)))
            )
            self.span_s = (times.min(), times.max() + held)
        stated: dict[str, Any] = {}
        if self.kind in ("velocity", "steering"):
            wheelbase = ("wheelbase_m",) if self.kind == "steering" else ()
            stated = {n: self._take(n) for n in ("sigma_speed_mps", "sigma_turn", *wheelbase)}
        elif not set(COVARIANCE) <= table.columns.keys():
            moves = [name for name in ("sigma_move_m", "sigma_turn") if name in self.stated]
            stated = {name: self.stated.pop(name) for name in moves}
        return {**table.columns, **stated}

    def measurements(self) -> dict[str, Any]:
        """Columns, within the odometry's time."""
        table = self._read("measurements", self.files.measurements, _MEASUREMENTS)
        _need(table, ("time_s", "range_m", "bearing_rad"))
        self._check_angle(table, "bearing_rad")
        table = self._within("measurements", self._once("measurements", table))
        if "landmark" not in table.columns:
            names = " or ".join(NAMES["landmark"])
            self.notes.append(
                "landmarks are unknown and will be associated by the estimators: there is no "
                f"column {names}"
            )
        sigmas = {}
        for name in ("sigma_range_m", "sigma_bearing_rad"):
            if name not in table.columns:
                sigmas[name] = self._take(name)
        return {**table.columns, **sigmas}

    def positions(self) -> dict[str, Any] | None:
        """Columns, within the odometry's time."""
        if self.files.positions is None:
            return None
        table = self._read("positions", self.files.positions, (*_PLACE, *_VARIANCES))
        _need(table, _PLACE)
        table = self._within("positions", self._once("positions", table))
        if set(_VARIANCES) <= table.columns.keys():
            return table.columns
        self.tables["positions"] = table = _only(table, _PLACE)
        return {**table.columns, "sigma_m": self._take("sigma_m")}

    def truth(self) -> dict[str, Any] | None:
        """Columns of the truth's poses."""
        if self.files.truth is None:
            return None
        _need(self.files.truth, ("time_s", *KINDS["poses"]))
        self.tables["truth"] = self.files.truth
        return self.files.truth.columns

    def truth_landmarks(self) -> dict[str, Any] | None:
        """Columns of the true map."""
        if self.files.truth_landmarks is None:
            return None
        wanted = ("id", "x_m", "y_m")
        table = self._read("truth landmarks", self.files.truth_landmarks, wanted)
        _need(table, wanted)
        return table.columns

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
        if self.kind == "relative-poses":
            times = (log.prior.time_s, *log.odometry.time_s.tolist())
            stray = np.flatnonzero(~np.isin(log.measurements.time_s, times))
            if len(stray):
                row = int(stray[0])
                raise self.located(
                    RecordError(
                        "measurements",
                        row,
                        f"time {log.measurements.time_s[row]} s is not the end of a motion, "
                        f"expected a time at which a motion of {self.files.odometry} ends",
                    )
                )

    def _read(self, stream: str, path: Path, wanted: tuple[str, ...]) -> PlainTable:
        table = self.tables[stream] = read_plain(path, wanted, degrees=self.files.degrees)
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
        try:
            return odometry_kind([name for name in table.columns if name != "time_s"])
        except InputError as error:
            text = str(error).replace("one of these kinds", "one of them: give --kind")
            found = ", ".join(table.headers)
            raise InputError(f"{table.path}: {text}; found {found}; {SEE}") from None

    def _take(self, name: str) -> float:
        if name not in self.stated:
            column = f" or a column {name}" if name in NAMES else ""
            raise InputError(f"{OPTIONS[name]} is missing, expected a number{column}; {SEE}")
        return self.stated.pop(name)

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
        values, largest = np.abs(table.columns.get(name, np.zeros(0))), _LARGEST.get(name, np.inf)
        if len(values) and values.max() > largest:
            row, header = int(values.argmax()), table.origin[name]
            raise InputError(
                f"{table.path}:{table.line[row]}: '{header}' is {table.columns[name][row]:g} in "
                f"radians, expected {largest:.4g} at most; give --degrees, or name the column "
                f"{NAMES[name][0]}_deg{'ps' if name.endswith('ps') else ''}, if these are degrees"
            )


def _need(table: PlainTable, names: tuple[str, ...]) -> None:
    for name in names:
        if name not in table.columns:
            raise InputError(
                f"{table.path}: no column for {name}, expected one named "
                f"{' or '.join(NAMES[name])}{_ALONE.get(name, '')}; found "
                f"{', '.join(table.headers)}; {SEE}"
            )


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
        if limits and len(column) and column.dtype.kind == "f" and not np.isnan(column).all():
            digits = ".3f" if name == "time_s" else ".4g"
            text += f" ({np.nanmin(column):{digits}} to {np.nanmax(column):{digits}})"
        reported.append(text)
    used = {table.origin.get(name) for name in table.columns}
    unused = [header for header in table.headers if header and header not in used]
    text = f"{table.path.name}, {len(table.line)} rows: {', '.join(reported)}"
    return text + (f"; not used: {', '.join(unused)}" if unused else "")


def _remarks(files: UserFiles, log: Log) -> dict[str, str]:
    """Comments on what was stated and what is a default."""
    if files.prior_pose is not None:
        pose = "--prior-pose"
    elif log.prior.pose.any():
        pose = "default: the true pose at that time; --prior-pose gives another"
    else:
        pose = "default: the origin; --prior-pose gives another"
    stated = {"sigma_speed_mps": "--sigma-speed", "wheelbase_m": "--wheelbase"}
    return {
        **stated,
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
