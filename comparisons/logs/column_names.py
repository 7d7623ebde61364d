"""What the header of a user's column means: one of a log folder's columns, and a unit.

A header is a name and, optionally, a unit: `range_m`, `range [m]`, `bearing_deg`, `t_ns`, `v_m_s`.
Neither case nor `_` makes a name another. `plain_csv` asks here for each header of a file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from comparisons.errors import InputError, shorten
from comparisons.logs.schema import COLUMNS, UNITS, dimension

RENAME = "rename the columns"
_SPELT = {
    **dict.fromkeys(("second", "seconds", "secs"), "s"),
    **dict.fromkeys(("msec", "msecs", "millis", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "usecs", "micros", "microsecond", "microseconds", "µs", "μs"), "us"),
    **dict.fromkeys(
        ("nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds"), "ns"
    ),
    **dict.fromkeys(("meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("radian", "radians", "rads"), "rad"),
    **dict.fromkeys(("degree", "degrees", "degs", "°"), "deg"),
    **dict.fromkeys(("ms-1", "m/sec"), "m/s"),
    **dict.fromkeys(("kph", "kmph"), "km/h"),
    **dict.fromkeys(("rads-1", "rad/sec", "rads/s", "radians/s"), "rad/s"),
    **dict.fromkeys(("degs-1", "deg/sec", "degs/s", "degrees/s", "degree/s", "°/s"), "deg/s"),
}
"""Other spellings of units, without blanks, points and ^."""


@dataclass(frozen=True, kw_only=True)
class ColumnOptions:
    """What a user says of the columns of a file.

    units: by header or usual name, of its values. headers: by usual name, which header has it; None
    where the command has no option for it.
    """

    units: Mapping[str, str] = field(default_factory=dict)
    headers: Mapping[str, str] | None = None

    @property
    def mend(self) -> str:
        """What to do about headers that are not known."""
        return RENAME if self.headers is None else f"{RENAME} or give --column"


class Meaning(NamedTuple):
    """A column of a log folder, the unit that the header names, and whether its name is usual."""

    column: str
    unit: str | None
    usual: bool


class UnknownUnit(InputError):  # noqa: N818  # named for what it is
    """A header of a known name names a unit that its column cannot have."""


def known_unit(column: str, text: str) -> str | None:
    """Return how a unit of a column is spelt in `UNITS`; None for one that it cannot have."""
    units = UNITS.get(dimension(column), {})
    word = text.lower().replace(" ", "").replace(".", "").replace("^", "")
    word = _SPELT.get(word, word)
    if word in units:
        return word
    return next((unit for unit in units if unit.replace("/", "") == word), None)


def meaning(header: str, wanted: Sequence[str]) -> Meaning | None:
    """Return what a header means of the columns that are wanted; None for nothing.

    Raises UnknownUnit.
    """
    for usual in (True, False):
        for name in wanted:
            column = COLUMNS[name]
            keys = {_key(word) for word in (column.names if usual else column.less_usual)}
            unit = _unit_behind(header, keys, name)
            if unit is not None:
                return Meaning(name, unit or None, usual)
    return None


def named_header(header: str, column: str) -> Meaning:
    """Return a header that a user gave for a column, with the unit that ends it."""
    name, unit = parted(header)
    if unit is not None:
        return Meaning(column, _checked_unit(header, column, unit), usual=True)
    ends = (known_unit(column, end) for _, end in _endings(name))
    return Meaning(column, next((end for end in ends if end), None), usual=True)


def column_of(name: str, among: Sequence[str] = tuple(COLUMNS)) -> str | None:
    """Return the column that a name is of, as `time_s` for `time`; None for none of some."""
    key = _key(name)
    columns = [column for column in (COLUMNS[one] for one in among) if column.names]
    for usual in (True, False):
        for column in columns:
            names = column.names if usual else column.less_usual
            if key in {_key(word) for word in (column.name, *names)}:
                return column.name
    return None


def usual_name(column: str) -> str:
    """Return what a header of a column is called in texts."""
    return COLUMNS[column].names[0]


def factor_of(column: str, unit: str) -> float:
    """Return what makes SI of values; a unit behind `-` counts the other way round."""
    factor = UNITS.get(dimension(column), {}).get(unit.removeprefix("-"), 1.0)
    return -factor if unit.startswith("-") else factor


def parted(header: str) -> tuple[str, str | None]:
    """Return a header's name and the unit in brackets behind it."""
    text = header.strip().lower().lstrip("%_ ")
    at = min(len(text.partition(bracket)[0]) for bracket in "[(")
    if at < len(text) and text[-1] in "])":
        name = text[:at].replace("_", " ").rstrip()
        return name.replace(" ", "_"), text[at + 1 : -1].strip()
    return text.replace(" ", "_"), None


def _key(name: str) -> str:
    """What makes a name another; in one with digits, as those of matrices, `_` does as well."""
    lower = name.lower()
    return lower if any(map(str.isdigit, lower)) else lower.replace("_", "")


def _endings(name: str) -> list[tuple[str, str]]:
    """Names with the unit that may end them: of one part, or of two as in `m_s`."""
    words = name.split("_")
    return [
        ("_".join(words[:-count]), "/".join(words[-count:])) for count in (1, 2) if words[count:]
    ]


def _unit_behind(header: str, keys: set[str], column: str) -> str | None:
    """The unit of a header that has one of the names; empty for no unit, None for another name."""
    name, unit = parted(header)
    if _key(name) in keys:
        return "" if unit is None else _checked_unit(header, column, unit)
    for first, end in _endings(name):
        known = known_unit(column, end)
        if known is not None and _key(first) in keys:
            return known
    return None


def _checked_unit(header: str, column: str, unit: str) -> str:
    known = known_unit(column, unit)
    if known is None:
        raise UnknownUnit(
            f"unit '{shorten(unit)}' of column '{shorten(header)}' is unknown, expected "
            f"{', '.join(UNITS.get(dimension(column), ())) or 'none'}"
        )
    return known
