"""CSV files of a user: columns in any order under usual names, units by the header's suffix.

A header is a name and, optionally, a unit: `range_m`, `range [m]`, `bearing_deg`, `t_ns`. Without
one values are SI and radians. Separators are `,`, `;` or tabs, whichever the header holds most of.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.table import number_or_fail, read_text, shorten

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
_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
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
    **{f"cov_{i}{j}": (f"cov_{i}{j}",) for i in range(3) for j in range(i, 3)},
}
"""What a header may be called, by column of a log folder."""
_GAPS = ("diameter_m", "intensity")
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_WORDS = ("landmark", "id")


@dataclass(frozen=True, kw_only=True)
class PlainTable:
    """columns: by name, numbers (N,) or words. line: (N,) of the file. origin: header of each.

    headers: of the file, in its order. A column of numbers that is empty throughout is not there.
    """

    path: Path
    columns: dict[str, Any]
    line: list[int]
    origin: dict[str, str]
    headers: list[str]

    def rows(self, kept: NDArray[np.bool_]) -> PlainTable:
        """Those in some of the rows (N,), booleans."""
        columns = {name: np.asarray(column)[kept] for name, column in self.columns.items()}
        line = np.array(self.line, dtype=np.int64)[kept].tolist()
        return replace(self, columns=columns, line=line)


def read_plain(path: Path, wanted: tuple[str, ...], *, degrees: bool = False) -> PlainTable:
    """Read the columns of a CSV file that are among those wanted.

    degrees: angles whose header names no unit are degrees. Raises InputError naming file, line,
    column and expectation.
    """
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
    origin, factor = _match(path, names, wanted, degrees)
    if not origin:
        found = "" if _numeric(header, delimiter) else f" in '{shorten(header, 100)}'"
        raise InputError(
            f"{path}:{first}: no header{found}, expected a line of names such as "
            f"{','.join(wanted[:3])}, with commas, semicolons or tabs between them"
            + (f"; name its columns so, {SEE}" if found else "")
        )
    body = records[begin:]
    rows = _split(path, body, delimiter)
    number = [one for one, _ in body]
    for row, line in zip(rows, number, strict=True):
        while len(row) > len(names) and not row[-1].strip():
            row.pop()
        if len(row) != len(names):
            raise InputError(
                f"{path}:{line}: {len(row)} values, expected {len(names)} as in the header"
            )
    place = {name: names.index(header) for name, header in origin.items()}
    for name in _empty(place, rows):
        names[place.pop(name)] += " (empty)"
        del origin[name]
    columns: dict[str, Any] = {}
    for name, index in place.items():
        words = [row[index].strip() for row in rows]
        if delimiter != "," and name not in _WORDS:
            words = _with_points(words)
        if name in _WORDS:
            columns[name] = np.array(words, dtype=str)
        elif name == "time_s":
            columns[name] = _times(path, words, number, origin[name], factor[name])
        else:
            columns[name] = factor[name] * _numbers(path, words, number, name, origin[name])
    return PlainTable(path=path, columns=columns, line=number, origin=origin, headers=names)


def _empty(place: dict[str, int], rows: list[list[str]]) -> list[str]:
    """Columns of numbers without any, where that is no value of their own. place: of each."""
    some = {index for row in rows for index, word in enumerate(row) if word.strip()}
    own = (*_WORDS, *_GAPS)
    return [name for name, at in place.items() if rows and at not in some and name not in own]


def _with_points(words: list[str]) -> list[str]:
    """Numbers with decimal commas as ones with points; of a column without any points alone."""
    if any("." in word for word in words):
        return words
    return [word.replace(",", ".") if _DECIMAL_COMMA.fullmatch(word) else word for word in words]


def _match(
    path: Path, headers: list[str], wanted: tuple[str, ...], degrees: bool
) -> tuple[dict[str, str], dict[str, float]]:
    """The header of each column found, and the factor of its unit."""
    origin: dict[str, str] = {}
    factors: dict[str, float] = {}
    for header in headers:
        name, unit = _parted(header)
        for column in wanted:
            dimension = _dimension(column)
            units = UNITS.get(dimension, {})
            if name in NAMES[column] and (unit is None or unit in units):
                found = unit
            elif (parts := name.rpartition("_"))[0] in NAMES[column] and parts[2] in units:
                found = parts[2]
            elif name in NAMES[column]:
                known = ", ".join(units) or "none"
                raise InputError(
                    f"{path}: unit '{shorten(str(unit))}' of column '{shorten(header)}' is "
                    f"unknown, expected {known}"
                )
            else:
                continue
            if column in origin:
                raise InputError(
                    f"{path}: columns '{shorten(origin[column])}' and '{shorten(header)}' both "
                    f"mean {column}, expected one"
                )
            in_degrees = degrees and found is None and dimension in ("rad", "radps")
            origin[column] = header
            factors[column] = _DEGREE if in_degrees else units.get(found or "", 1.0)
            break
    return origin, factors


def _parted(header: str) -> tuple[str, str | None]:
    """A header's name and the unit in brackets behind it."""
    text = header.strip().lower()
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
    try:
        [float(word) for word in line.split(delimiter) if word.strip()]
    except ValueError:
        return False
    return True


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
        if name in _GAPS and word.lower() in ("", "nan"):
            found.append(float("nan"))
        else:
            found.append(number_or_fail(word, path, line, f"'{shorten(header)}'"))
    return np.array(found)


def _times(path: Path, words: list[str], lines: list[int], header: str, factor: float) -> Array:
    """Seconds; whole numbers of a smaller unit are divided once, so that none is rounded twice."""
    per_second = round(1 / factor)
    values = _numbers(path, words, lines, "time_s", header)
    if per_second > 1 and all(word.lstrip("+-").isdigit() for word in words):
        return np.array([int(word) / per_second for word in words])
    if len(values) and np.abs(values).max() / per_second > _SECONDS_END:
        unit = next(
            (u for u, n in _PER_SECOND.items() if np.abs(values).max() / n <= _SECONDS_END), "ns"
        )
        raise InputError(
            f"{path}:{lines[int(np.abs(values).argmax())]}: '{shorten(header)}' is "
            f"{np.abs(values).max():.0f}, expected a time in seconds; name the column "
            f"time_{unit} if "
            f"these are {unit}"
        )
    return values / per_second
