"""CSV files of a user: columns in any order under usual names, units by the header's suffix.

A header is a name and, optionally, a unit: `range_m`, `range [m]`, `bearing_deg`, `t_ns`, or the
path of a ROS message's field. Without a unit, there or stated for the column, values are SI and
radians; times say by their size what they are. Separators are `,`, `;` or tabs, whichever the
header holds most of.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from decimal import Decimal
from math import pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError, shorten
from comparisons.logs.from_arrays import COVARIANCE, GAPS, LABELS, TWIST
from comparisons.logs.message_csv import MESSAGES, MessageFields, heading_of, message_of
from comparisons.logs.stamps import (
    Nanoseconds,
    nanoseconds,
    origin,
    resolved_by_floats,
    seconds_after,
)
from comparisons.logs.table import is_number, locate_rows, number_or_fail, read_text

SEE = "see docs/your-own-log.md"
_DEGREE = pi / 180
UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3},
    "rad": {"rad": 1.0, "deg": _DEGREE},
    "mps": {"mps": 1.0, "m/s": 1.0, "kmh": 1 / 3.6, "km/h": 1 / 3.6},
    "radps": {"radps": 1.0, "rad/s": 1.0, "degps": _DEGREE, "deg/s": _DEGREE},
    "m2": {"m2": 1.0},
}
"""By dimension, the units that a header may name, in SI; the first is the default."""
_PER_SECOND = {"s": 1, "sec": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
_SECONDS_END = 1e10

NAMES: dict[str, tuple[str, ...]] = {
    "time_s": ("time", "t", "timestamp", "stamp"),
    "speed_mps": ("speed", "v", "velocity", "forward_velocity", "linear_velocity"),
    "yaw_rate_radps": ("yaw_rate", "yawrate", "w", "omega", "angular_velocity"),
    "steering_rad": ("steering", "steer", "steering_angle"),
    "x_m": ("x",),
    "y_m": ("y",),
    "heading_rad": ("heading", "yaw", "theta"),
    "dx_m": ("dx",),
    "dy_m": ("dy",),
    "dheading_rad": ("dheading", "dyaw", "dtheta"),
    "range_m": ("range", "distance"),
    "bearing_rad": ("bearing",),
    "sigma_range_m": ("sigma_range",),
    "sigma_bearing_rad": ("sigma_bearing",),
    "landmark": ("landmark", "id", "label", "landmark_id", "subject_nb"),
    "id": ("id", "label", "landmark", "landmark_id", "subject_nb"),
    "diameter_m": ("diameter",),
    "intensity": ("intensity",),
    "var_x_m2": ("var_x",),
    "cov_xy_m2": ("cov_xy",),
    "var_y_m2": ("var_y",),
    "sigma_m": ("sigma",),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon", "lng"),
    "altitude": ("altitude", "alt"),
    **{name: (name,) for name in (*TWIST, *COVARIANCE)},
}
"""What a header may be called, by column of a log folder."""
_NEXT = "are not supported in a log: record your filter and slamcheck audit it, see docs/audit.md"
_ALONE = {"bearing_rad": f" (ranges alone {_NEXT})", "range_m": f" (bearings alone {_NEXT})"}
"""What is said where one of two columns is missing."""
_DIGITS = re.compile(r"\d+")
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_SIGNED = (
    "bearing_rad", "yaw_rate_radps", "steering_rad", "heading_rad", "dheading_rad", "x_m", "y_m",
    "dx_m", "dy_m", "speed_mps",
)  # fmt: skip
"""Columns that may count the other way round, as `--unit bearing=-deg`."""
_FOLLOWS = {"sigma_range_m": "range_m", "sigma_bearing_rad": "bearing_rad", "sigma_m": "x_m"}
"""A column of sigmas, and the one whose unit it has where its header names none."""
_ISO = re.compile(r"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d)?)(?:[.,](\d{1,12}))?(Z|[+-]\d\d:?\d\d)?")


@dataclass(frozen=True, kw_only=True)
class PlainTable:
    """columns: by name, numbers (N,) or words. line: (N,) of the file. origin: header of each.

    headers: of the file, in its order. unit: of each column that is not in SI, in words. factor: of
    each column, to SI. used: headers that are read. stated: the names under which units were given
    that a column has. start_s: what times count from. time_ns: the times exactly as written, where
    nothing is subtracted and float64 lacks nanoseconds of them. A column of numbers that is empty
    throughout is not there.
    """

    path: Path
    columns: dict[str, Any]
    line: list[int]
    origin: dict[str, str]
    headers: list[str]
    unit: dict[str, str] = field(default_factory=dict)
    factor: dict[str, float] = field(default_factory=dict)
    used: frozenset[str] = frozenset()
    stated: frozenset[str] = frozenset()
    start_s: int = 0
    time_ns: Nanoseconds | None = None

    def rows(self, kept: NDArray[np.bool_]) -> PlainTable:
        """Those in some of the rows (N,), booleans."""
        columns = {name: np.asarray(column)[kept] for name, column in self.columns.items()}
        line = np.array(self.line, dtype=np.int64)[kept].tolist()
        exact = None if self.time_ns is None else self.time_ns[kept]
        return replace(self, columns=columns, line=line, time_ns=exact)

    def locating(self) -> AbstractContextManager[None]:
        """Turn a RecordError about a row of this table into one that names file and line."""
        return locate_rows(self.path, self.line.__getitem__)


class _Lines(NamedTuple):
    """A file as words: names of columns, and rows of as many with their line numbers."""

    path: Path
    names: list[str]
    rows: list[list[str]]
    line: list[int]
    points: bool

    def words(self, place: int, *, text: bool = False) -> list[str]:
        """One column; points: whether a decimal comma may be none."""
        words = [row[place].strip() for row in self.rows]
        return words if self.points or text else _with_points(words)


class _Source(NamedTuple):
    """Where a column stands.

    unit: None where its header names none. stated: the name that it has in what a user gave.
    """

    places: tuple[int, ...]
    unit: str | None = None
    stated: str = ""


def read_plain(
    path: Path,
    wanted: Sequence[str],
    *,
    units: Mapping[str, str] | None = None,
    start_s: int | None = 0,
) -> PlainTable:
    """Return, in SI, what a CSV file has of the columns of a log folder that are wanted.

    units: by a header or a column's usual name, the unit of its values. start_s: what times count
    from, subtracted from their decimals; None: the origin of the file's own. Raises InputError
    naming file, line, column and expectation.
    """
    lines = _lines(path, wanted)
    sources = _sources(lines, wanted, units or {})
    for name in _empty(sources, lines.rows):
        for place in sources.pop(name).places:
            lines.names[place] += " (empty)"
    columns: dict[str, Any] = {}
    unit: dict[str, str] = {}
    factor: dict[str, float] = {}
    time_ns: Nanoseconds | None = None
    for name, source in sources.items():
        header = "', '".join(lines.names[place] for place in source.places)
        if name in LABELS:
            columns[name] = np.array(lines.words(source.places[0], text=True), dtype=str)
        elif name == "time_s":
            stamps, unit[name] = _times(lines, source, header)
            if start_s is None:
                start_s = origin(float(min(stamps, default=0)))
            columns[name] = seconds_after(stamps, start_s)
            if not resolved_by_floats(columns[name]):
                time_ns = nanoseconds(stamps)
        elif len(source.places) > 1:
            columns[name] = _heading(lines, source)
        else:
            followed = sources.get(_FOLLOWS.get(name, ""), source)
            found = source.unit or (followed.unit and followed.unit.removeprefix("-"))
            factor[name] = _factor(name, found or "")
            words = lines.words(source.places[0])
            columns[name] = factor[name] * _numbers(path, words, lines.line, name, header)
            unit[name] = _unit_words(name, found, source)
    return PlainTable(
        path=path,
        columns=columns,
        line=lines.line,
        origin={n: "', '".join(lines.names[p] for p in s.places) for n, s in sources.items()},
        headers=lines.names,
        unit={name: words for name, words in unit.items() if words},
        factor=factor,
        used=frozenset(lines.names[p] for s in sources.values() for p in s.places),
        stated=frozenset(source.stated for source in sources.values() if source.stated),
        start_s=start_s or 0,
        time_ns=time_ns,
    )


def need(table: PlainTable, names: Sequence[str]) -> None:
    """Raise InputError that names all columns that a file lacks."""
    lacking = [name for name in names if name not in table.columns]
    if not lacking:
        return
    expected = ", and ".join(
        f"no column for {name}, expected one named {' or '.join(NAMES[name])}" for name in lacking
    )
    alone = [one for one in _ALONE if one in names]
    note = _ALONE[lacking[0]] if len(alone) == 2 and lacking[0] in alone and not lacking[1:] else ""
    raise InputError(
        f"{table.path}: {expected}{note}; found {shown(table.headers)}; name its columns so, {SEE}"
    )


def shown(headers: Sequence[str]) -> str:
    """Names of columns in their order, cut; three or more that differ in a number alone as one."""
    alike: dict[str, list[str]] = {}
    for header in headers:
        alike.setdefault(_DIGITS.sub("#", header), []).append(header)
    words = [[shorten(name) for name in names] for names in alike.values()]
    return shorten(
        ", ".join(f"{w[0]} to {w[-1]} ({len(w)})" if w[2:] else ", ".join(w) for w in words), 300
    )


def _lines(path: Path, wanted: Sequence[str]) -> _Lines:
    """Split a file into a header and rows of as many words."""
    lines = [
        (number, line)
        for number, line in enumerate(read_text(path).splitlines(), start=1)
        if line and not line.isspace()
    ]
    comments = [line.lstrip("# \t") for _, line in lines if line.lstrip().startswith("#")]
    records = [(number, line) for number, line in lines if not line.lstrip().startswith("#")]
    if not records:
        raise InputError(f"{path}: holds no records, expected a header and rows below it")
    (first, header), begin = records[0], 1
    delimiter = max(",;\t", key=header.count)
    if _numeric(header, delimiter):  # a header behind #, as numpy writes it
        header, begin = (comments[-1] if comments else ""), 0
    names = [name.strip() for name in _split(path, [(first, header)], delimiter)[0]]
    message = message_of(_split(path, records[:1], delimiter)[0])
    if message is not None and not (begin == 0 and header):
        names, begin = list(MESSAGES[message]), 0
    if not _sources(_Lines(path, names, [], [], True), wanted, {}):
        raise InputError(f"{path}:{first}: {_no_columns(header, names, delimiter, wanted)}")
    rows = _split(path, records[begin:], delimiter)
    number = [one for one, _ in records[begin:]]
    for row, line in zip(rows, number, strict=True):
        while len(row) > len(names) and not row[-1].strip():
            row.pop()
        if len(row) != len(names):
            raise InputError(
                f"{path}:{line}: {len(row)} values, expected {len(names)} as in the header"
            )
    return _Lines(path, names, rows, number, delimiter == ",")


def _no_columns(header: str, names: list[str], delimiter: str, wanted: Sequence[str]) -> str:
    """What is said of a file that has none of the columns wanted."""
    named = [name for name in wanted[:6] if NAMES[name] != (name,)]
    choices = ", ".join(f"{name} ({', '.join(NAMES[name])})" for name in named)
    if header and delimiter not in header and _numeric(",".join(header.split()), ","):
        return (
            "numbers with blanks between them, as a TUM trajectory has, expected a line of names "
            "with commas, semicolons or tabs between them; slamcheck export TRAJECTORY.tum "
            f"POSES.csv writes a trajectory so; {SEE}"
        )
    if not header or _numeric(header, delimiter):
        return (
            "no header, expected a line of names with commas, semicolons or tabs between them, "
            f"among them {choices}; {SEE}"
        )
    return (
        f"none of the columns wanted; found {shown(names)}; wanted are "
        f"{choices}; name its columns so, {SEE}"
    )


def _empty(sources: Mapping[str, _Source], rows: list[list[str]]) -> list[str]:
    """Columns of numbers without any, where that is no value of their own."""
    some = {place for row in rows for place, word in enumerate(row) if word.strip()}
    own = (*LABELS, *GAPS)
    return [
        name
        for name, source in sources.items()
        if rows and name not in own and some.isdisjoint(source.places)
    ]


def _with_points(words: list[str]) -> list[str]:
    """Numbers with decimal commas as ones with points; of a column without any points alone."""
    if any("." in word for word in words):
        return words
    return [word.replace(",", ".") if _DECIMAL_COMMA.fullmatch(word) else word for word in words]


def split_unit(text: str) -> tuple[float | None, str]:
    """Return the number that a text begins with, and what is behind it; None for no number."""
    matched = _NUMBER.match(text.strip())
    if matched is None:
        return None, text
    return float(matched[0]), text.strip()[matched.end() :].strip()


def _sources(lines: _Lines, wanted: Sequence[str], units: Mapping[str, str]) -> dict[str, _Source]:
    """Where the file has each column: under a usual name, else as a field of a message.

    A message's stamp goes before the time at which it was recorded.
    """
    found: dict[str, _Source] = {}
    for place, header in enumerate(lines.names):
        column, unit = _column(lines.path, header, wanted)
        if column is None:
            continue
        if column in found:
            other = lines.names[found[column].places[0]]
            raise InputError(
                f"{lines.path}: columns '{shorten(other)}' and '{shorten(header)}' both "
                f"mean {column}, expected one"
            )
        found[column] = _Source((place,), unit)
    message = MessageFields(lines.path, lines.names)
    for column in wanted:
        places = () if column in found and column != "time_s" else message.places(column)
        if places:
            found[column] = _Source(places)
    return {name: _stated(lines, name, source, units) for name, source in found.items()}


def _stated(lines: _Lines, name: str, source: _Source, units: Mapping[str, str]) -> _Source:
    """The same with the unit that a user gave for it."""
    header = lines.names[source.places[0]]
    called = {header.lower(), _parted(header)[0], name, *NAMES[name]}
    given = next((one for one in units if one.lower() in called), None)
    if given is None:
        return source
    known = UNITS.get(_dimension(name), {})
    unit = units[given].removeprefix("-")
    if unit not in known or (unit != units[given] and name not in _SIGNED):
        raise InputError(
            f"--unit {shorten(given)}={shorten(units[given])}: the unit is unknown, expected "
            f"{', '.join(known) or 'none'}"
        )
    if source.unit is not None and known[source.unit] != known[unit]:
        raise InputError(
            f"--unit {shorten(given)}={shorten(units[given])}: '{shorten(header)}' of "
            f"{lines.path} says {source.unit}, expected the same"
        )
    return source._replace(unit=units[given], stated=given)


def _column(path: Path, header: str, wanted: Sequence[str]) -> tuple[str | None, str | None]:
    """The column that a header under a usual name means, if it is wanted, and its unit."""
    name, unit = _parted(header)
    for column in wanted:
        units = UNITS.get(_dimension(column), {})
        if name in NAMES[column] and (unit is None or unit in units):
            return column, unit
        if (parts := name.rpartition("_"))[0] in NAMES[column] and parts[2] in units:
            return column, parts[2]
        if name in NAMES[column]:
            known = ", ".join(units) or "none"
            raise InputError(
                f"{path}: unit '{shorten(str(unit))}' of column '{shorten(header)}' is "
                f"unknown, expected {known}"
            )
    return None, None


def _factor(name: str, unit: str) -> float:
    """What makes SI of a column's values; a unit behind `-` counts the other way round."""
    factor = UNITS.get(_dimension(name), {}).get(unit.removeprefix("-"), 1.0)
    return -factor if unit.startswith("-") else factor


def _unit_words(name: str, unit: str | None, source: _Source) -> str:
    if source.stated:
        return f"{unit} by --unit"
    dimension = _dimension(name)
    return "" if unit is None or UNITS[dimension][unit] == 1.0 else unit


def _parted(header: str) -> tuple[str, str | None]:
    """A header's name and the unit in brackets behind it."""
    text = header.strip().lower().lstrip("%_ ")
    at = min(len(text.partition(bracket)[0]) for bracket in "[(")
    if at < len(text) and text[-1] in "])":
        name = text[:at].replace("_", " ").rstrip()
        return name.replace(" ", "_"), text[at + 1 : -1].strip()
    return text.replace(" ", "_"), None


def _dimension(column: str) -> str:
    tail = column.rpartition("_")[2]
    return tail if tail in UNITS else ""


def _numeric(line: str, delimiter: str) -> bool:
    """Every word is a number, so that the line is no header."""
    return all(is_number(word) for word in line.split(delimiter) if word.strip())


def _split(path: Path, records: list[tuple[int, str]], delimiter: str) -> list[list[str]]:
    """The words of each line; a quotation does not go beyond its line."""
    found = []
    for number, line in records:
        if '"' not in line:
            found.append(line.split(delimiter))
            continue
        try:
            found.append(next(csv.reader([line], delimiter=delimiter, skipinitialspace=True)))
        except csv.Error as error:
            raise InputError(f"{path}:{number}: cannot be read ({error})") from None
    return found


def _numbers(path: Path, words: list[str], lines: list[int], name: str, header: str) -> Array:
    try:
        values = np.array(words, dtype=float) if words else np.zeros(0)
    except ValueError:
        values = np.full(len(words), np.nan)
    if np.isfinite(values).all():
        return values
    found = []
    for word, line in zip(words, lines, strict=True):
        if name in GAPS and word.lower() in ("", "nan"):
            found.append(float("nan"))
        else:
            found.append(number_or_fail(word, path, line, f"'{shorten(header)}'"))
    return np.array(found)


def _heading(lines: _Lines, source: _Source) -> Array:
    parts = [
        _numbers(lines.path, lines.words(place), lines.line, "heading_rad", lines.names[place])
        for place in source.places
    ]
    return heading_of(np.column_stack(parts), lines.path, lines.line)


def _times(lines: _Lines, source: _Source, header: str) -> tuple[list[Decimal], str]:
    """Seconds exactly as they are written, and what their unit was taken for."""
    if len(source.places) > 1:
        parts = [_decimals(lines, place) for place in source.places]
        return [s + ns.scaleb(-9) for s, ns in zip(*parts, strict=True)], "s and ns"
    words = lines.words(source.places[0])
    if words and all(_ISO.fullmatch(word) for word in words):
        return [_iso_s(lines, row, word) for row, word in enumerate(words)], "ISO 8601"
    values = _decimals(lines, source.places[0])
    unit, how = source.unit, "" if not source.stated else " by --unit"
    largest = max(range(len(values)), key=lambda row: abs(values[row]), default=None)
    most = 0.0 if largest is None else float(abs(values[largest]))
    if unit is None:
        unit = _by_size(most)
        how = ", by their size" if unit != "s" else ""
    elif largest is not None and most / _PER_SECOND[unit] > _SECONDS_END:
        raise InputError(
            f"{lines.path}:{lines.line[largest]}: '{shorten(header)}' is "
            f"{most:.0f} {unit}, expected at most {_SECONDS_END:g} s; name the column "
            f"'time_{_by_size(most)}' if that is its unit"
        )
    text = "" if unit == "s" and not how else f"{unit}{how}"
    return [one / _PER_SECOND[unit] for one in values], text


def _decimals(lines: _Lines, place: int) -> list[Decimal]:
    """The numbers of a column exactly as they are written."""
    words = lines.words(place)
    _numbers(lines.path, words, lines.line, "time_s", lines.names[place])
    return [Decimal(word) for word in words]


def _by_size(most: float) -> str:
    """The unit in which the largest of times is a number of seconds that may be."""
    return next((u for u, n in _PER_SECOND.items() if most / n <= _SECONDS_END), "ns")


def _iso_s(lines: _Lines, row: int, word: str) -> Decimal:
    """Seconds since 1970 of a date and a time of day, in UTC where it names no zone."""
    matched = _ISO.fullmatch(word)
    if matched is None:
        raise InputError(f"{lines.path}:{lines.line[row]}: '{shorten(word)}' is no ISO 8601 time")
    date, fraction, zone = matched.groups()
    try:
        moment = datetime.fromisoformat(date + (zone or ""))
    except ValueError:
        raise InputError(
            f"{lines.path}:{lines.line[row]}: '{shorten(word)}' is no date, expected one as "
            "2024-05-31T12:00:00.5Z"
        ) from None
    moment = moment if zone else moment.replace(tzinfo=UTC)
    return round(moment.timestamp()) + Decimal(f"0.{fraction or 0}")
