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
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError, shorten
from comparisons.logs.column_names import (
    RENAME,
    ColumnOptions,
    Meaning,
    UnknownUnit,
    column_of,
    factor_of,
    known_unit,
    meaning,
    named_header,
    parted,
    usual_name,
)
from comparisons.logs.message_csv import MESSAGES, MessageFields, heading_of, message_of
from comparisons.logs.schema import COLUMNS, UNITS, dimension
from comparisons.logs.stamps import (
    Nanoseconds,
    nanoseconds,
    origin,
    resolved_by_floats,
    seconds_after,
)
from comparisons.logs.table import is_number, locate_rows, number_or_fail, read_text

SEE = "see docs/your-own-log.md"
_PER_SECOND = {"s": 1, "sec": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
_SECONDS_END = 1e10
_DAY_S, _LONGEST_S = 86_400.0, 1e7
"""Of a drive, whose times name no unit: a third of a year, and no log is so long."""
_NEXT = "are not supported in a log: record your filter and slamcheck audit it, see docs/audit.md"
_ALONE = {"bearing_rad": f" (ranges alone {_NEXT})", "range_m": f" (bearings alone {_NEXT})"}
"""What is said where one of two columns is missing."""
_DIGITS = re.compile(r"\d+")
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_SIGMAS = {
    name: column.stated.of[0]
    for name, column in COLUMNS.items()
    if column.stated is not None and column.names
}
"""A column of sigmas, and the one that it is of; its unit is its own."""
_ISO = re.compile(r"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d)?)(?:[.,](\d{1,12}))?(Z|[+-]\d\d:?\d\d)?")


@dataclass(frozen=True, kw_only=True)
class PlainTable:
    """columns: by name, numbers (N,) or words. line: (N,) of the file. origin: header of each.

    headers: of the file, in its order. unit: of each column that is not in SI, in words. factor: of
    each column, to SI. used: headers that are read. stated: the names under which units were given
    that a column has. start_s: what times count from. time_ns: the times exactly as written, where
    nothing is subtracted and float64 lacks nanoseconds of them. named: usual names that a user gave
    a header for. guessed: columns under names that are less usual. mend: what to do about a header
    that is not known. A column of numbers that is empty throughout is not there.
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
    named: frozenset[str] = frozenset()
    guessed: frozenset[str] = frozenset()
    mend: str = RENAME

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

    unit: None where its header names none. stated, named: the name that it has where a user gave
    its unit, and its header. usual: whether its name is.
    """

    places: tuple[int, ...]
    unit: str | None = None
    stated: str = ""
    named: str = ""
    usual: bool = True


def read_plain(
    path: Path,
    wanted: Sequence[str],
    *,
    options: ColumnOptions | None = None,
    start_s: int | None = 0,
) -> PlainTable:
    """Return, in SI, what a CSV file has of the columns of a log folder that are wanted.

    options: what a user says of its columns. start_s: what times count
    from, subtracted from their decimals; None: the origin of the file's own. Raises InputError
    naming file, line, column and expectation.
    """
    options = options or ColumnOptions()
    lines = _lines(path, wanted, options)
    sources = _sources(lines, wanted, options)
    _check_sigma_units(lines, sources)
    for name in _empty(sources, lines.rows):
        for place in sources.pop(name).places:
            lines.names[place] += " (empty)"
    columns: dict[str, Any] = {}
    unit: dict[str, str] = {}
    factor: dict[str, float] = {}
    time_ns: Nanoseconds | None = None
    for name, source in sources.items():
        header = "', '".join(lines.names[place] for place in source.places)
        if COLUMNS[name].is_label:
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
            factor[name] = factor_of(name, source.unit or "")
            words = lines.words(source.places[0])
            columns[name] = factor[name] * _numbers(path, words, lines.line, name, header)
            unit[name] = _unit_words(name, source)
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
        named=frozenset(source.named for source in sources.values() if source.named),
        guessed=frozenset(name for name, source in sources.items() if not source.usual),
        mend=options.mend,
    )


def need(table: PlainTable, names: Sequence[str]) -> None:
    """Raise InputError that names all columns that a file lacks."""
    lacking = [name for name in names if name not in table.columns]
    if not lacking:
        return
    expected = ", and ".join(
        f"no column for {name}, expected one named {' or '.join(COLUMNS[name].names)}"
        for name in lacking
    )
    alone = [one for one in _ALONE if one in names]
    note = _ALONE[lacking[0]] if len(alone) == 2 and lacking[0] in alone and not lacking[1:] else ""
    raise InputError(
        f"{table.path}: {expected}{note}; found {shown(table.headers)}; {table.mend}, {SEE}"
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


def _lines(path: Path, wanted: Sequence[str], options: ColumnOptions) -> _Lines:
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
    if not _sources(_Lines(path, names, [], [], True), wanted, options):
        fault = _no_columns(header, names, delimiter, wanted)
        mend = f"; {options.mend}" if fault.startswith("unknown columns") else ""
        raise InputError(f"{path}:{first}: {fault}{mend}, {SEE}")
    rows = _split(path, records[begin:], delimiter)
    number = [record for record, _ in records[begin:]]
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
    columns = [COLUMNS[name] for name in wanted[:6] if COLUMNS[name].names != (name,)]
    choices = ", ".join(f"{column.name} ({', '.join(column.names)})" for column in columns)
    if header and delimiter not in header and _numeric(",".join(header.split()), ","):
        return (
            "numbers with blanks between them, as a TUM trajectory has, expected a line of names "
            "with commas, semicolons or tabs between them; slamcheck export TRAJECTORY.tum "
            "POSES.csv writes a trajectory so"
        )
    if not header or _numeric(header, delimiter):
        return (
            "no header, expected a line of names with commas, semicolons or tabs between them, "
            f"among them {choices}"
        )
    return f"unknown columns: {shown(names)}; expected {choices}"


def _empty(sources: Mapping[str, _Source], rows: list[list[str]]) -> list[str]:
    """Columns of numbers without any, where that is no value of their own."""
    some = {place for row in rows for place, word in enumerate(row) if word.strip()}
    return [
        name
        for name, source in sources.items()
        if rows and not _may_be_empty(name) and some.isdisjoint(source.places)
    ]


def _may_be_empty(name: str) -> bool:
    return COLUMNS[name].is_label or COLUMNS[name].has_gaps


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


def _sources(lines: _Lines, wanted: Sequence[str], options: ColumnOptions) -> dict[str, _Source]:
    """Where the file has each column.

    As a user says, else under a usual name, as a field of a message, or under a less usual name. A
    message's stamp goes before the time at which it was recorded. Raises InputError that names all
    units and pairs of columns that are not clear.
    """
    found = _named(lines, wanted, options)
    taken = {source.places[0] for source in found.values()}
    faults: list[str] = []
    by_name: dict[bool, dict[str, list[tuple[int, Meaning]]]] = {True: {}, False: {}}
    for place, header in enumerate(lines.names):
        if place in taken:
            continue
        try:
            meant = meaning(header, wanted)
        except UnknownUnit as error:
            faults.append(str(error))
            continue
        if meant is not None and meant.column not in found:
            by_name[meant.usual].setdefault(meant.column, []).append((place, meant))
    message = MessageFields(lines.path, lines.names)
    known = {column: headers[0][0] for column, headers in by_name[True].items()}
    known |= {column: source.places[0] for column, source in found.items()}
    for column in wanted:
        places = () if column in found else message.places(column)
        usual, others = (by_name[rank].get(column, []) for rank in (True, False))
        if places and (column == "time_s" or not usual):
            found[column] = _Source(places)
        elif usual or (others and column not in found):
            headers = usual or others
            if headers[1:]:
                faults.append(_both(lines, headers, options))
            place, meant = headers[0]
            found[column] = _Source((place,), meant.unit, usual=meant.usual)
    if faults:
        raise InputError(f"{lines.path}: {'; '.join(faults)}")
    order = sorted(found, key=lambda one: known.get(one, len(lines.names)))
    return {name: _stated(lines, name, found[name], options.units) for name in order}


def _both(lines: _Lines, headers: list[tuple[int, Meaning]], options: ColumnOptions) -> str:
    """What is said of two headers with the same meaning."""
    (first, meant), (second, _) = headers[:2]
    name, other = (shorten(lines.names[place]) for place in (first, second))
    text = f"columns '{name}' and '{other}' both mean {meant.column}, expected one"
    if options.headers is None:
        return text
    return f"{text}: give --column {usual_name(meant.column)}={name}, or ={other}"


def _named(lines: _Lines, wanted: Sequence[str], options: ColumnOptions) -> dict[str, _Source]:
    """Columns whose header a user says."""
    places = {header.strip().lower(): place for place, header in enumerate(lines.names)}
    found: dict[str, _Source] = {}
    for name, header in (options.headers or {}).items():
        column = next((one for one in wanted if column_of(name, (one,)) is not None), None)
        place = places.get(header.strip().lower())
        if column is None or place is None:
            continue
        unit = named_header(lines.names[place], column).unit
        found[column] = _Source((place,), unit, named=name)
    return found


def _check_sigma_units(lines: _Lines, sources: Mapping[str, _Source]) -> None:
    """Raise InputError for a column of sigmas without a unit, beside values that have another."""
    for name, of in _SIGMAS.items():
        sigma, values = sources.get(name), sources.get(of)
        if sigma is None or values is None or sigma.unit is not None:
            continue
        unit = (values.unit or "").removeprefix("-")
        if values.unit is None or factor_of(of, unit) == 1.0:
            continue
        header, other = (shorten(lines.names[source.places[0]]) for source in (sigma, values))
        raise InputError(
            f"{lines.path}: '{header}' names no unit beside '{other}' in {unit}, expected one: "
            f"name it {usual_name(name)}_{unit}, or give --unit {header}={unit} (or "
            f"{dimension(name)})"
        )


def _stated(lines: _Lines, name: str, source: _Source, units: Mapping[str, str]) -> _Source:
    """The same with the unit that a user gave for it."""
    header = lines.names[source.places[0]]
    names = {header.lower(), parted(header)[0], name, source.named.lower(), *COLUMNS[name].names}
    given = next((one for one in units if one.lower() in names), None)
    if given is None:
        return source
    known = UNITS.get(dimension(name), {})
    sign = "-" if units[given].startswith("-") else ""
    unit = known_unit(name, units[given].removeprefix("-"))
    if unit is None or (sign and not COLUMNS[name].is_signed):
        raise InputError(
            f"--unit {given}={units[given]}: the unit is unknown, expected "
            f"{', '.join(known) or 'none'}"
        )
    if source.unit is not None and known[source.unit] != known[unit]:
        raise InputError(
            f"--unit {given}={units[given]}: '{shorten(header)}' of {lines.path} says "
            f"{source.unit}, expected the same"
        )
    return source._replace(unit=sign + unit, stated=given)


def _unit_words(name: str, source: _Source) -> str:
    if source.stated:
        return f"{source.unit} by --unit"
    return "" if source.unit is None or factor_of(name, source.unit) == 1.0 else source.unit


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
        if COLUMNS[name].has_gaps and word.lower() in ("", "nan"):
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
    span = float(max(values, default=0) - min(values, default=0))
    if not source.unit and span / _PER_SECOND[unit] > _LONGEST_S:
        raise InputError(
            f"{lines.path}: '{shorten(header)}' spans {span / _PER_SECOND[unit] / _DAY_S:.0f} days "
            f"as {unit}, expected the time of a drive; name its unit: {_spans(span, header)}"
        )
    text = "" if unit == "s" and not how else f"{unit}{how}"
    return [decimal / _PER_SECOND[unit] for decimal in values], text


def _spans(span: float, header: str) -> str:
    """The options that make a drive of a span of times, with its length."""
    lengths = {unit: span / n for unit, n in _PER_SECOND.items() if span / n <= _DAY_S}
    return " or ".join(
        f"--unit {shorten(header)}={unit} ({length:.3g} s)" for unit, length in lengths.items()
    )


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
