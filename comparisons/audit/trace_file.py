"""A filter's trace on disk: one SQLite file, a row an event, matrices as little-endian float64.

`docs/audit.md` describes the format for other languages. A file is read as it is written: its
tables must be those below, to the letter, so that nothing in it is ever evaluated.
"""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.events import (
    Augment,
    Blocks,
    Clone,
    Directions,
    Event,
    Predict,
    Prior,
    Remove,
    Reset,
    Sensor,
    Snapshot,
    Update,
)
from comparisons.errors import InputError, printable
from comparisons.files import check_regular

APPLICATION = 0x534C4154
VERSION = 1
TABLES = {
    "event": (
        "CREATE TABLE event (number INTEGER PRIMARY KEY, kind TEXT NOT NULL, time_s REAL, "
        "sensor TEXT, blocks TEXT NOT NULL, used INTEGER, jacobian BLOB, noise BLOB, "
        "noise_jacobian BLOB, residual BLOB, correction BLOB, gain BLOB, covariance BLOB, "
        "mean BLOB, error BLOB, note TEXT)"
    ),
    "sensor": "CREATE TABLE sensor (name TEXT PRIMARY KEY, gate REAL, components TEXT)",
}
REPEATED = ("jacobian", "noise", "noise_jacobian")
"""NULL in these columns stands for the matrix of the event before of the same kind, sensor and
blocks."""
MOST_BLOCKS, MOST_ENTRIES = 100_000, 20_000
"""Of a state."""
_LONGEST_BYTES = 1 << 30
_CHUNK = 512


class TraceCounts(NamedTuple):
    """Of a file: events, updates and snapshots."""

    events: int
    updates: int
    snapshots: int


class Trace:
    """A trace that is read; iterate over its events in order.

    sensors: those that were described. Raises InputError, with the event's number, where the file
    is no trace, is damaged, or an event cannot be what it says.
    """

    def __init__(self, path: Path) -> None:
        """Open a file and check what it is, not yet its events."""
        self.path = path
        self.sensors: dict[str, Sensor] = {}
        with self._open() as file:
            self._check(file)
            counts = "SELECT COUNT(*), SUM(kind = 'update'), SUM(kind = 'snapshot') FROM event"
            self.counts = TraceCounts(*(int(n or 0) for n in file.execute(counts).fetchone()))
            for name, gate, components in file.execute("SELECT * FROM sensor"):
                self.sensors[name] = self._sensor(name, gate, components)
        if not self.counts.events:
            raise InputError(f"{path}: holds no events, expected a filter's trace")

    def __iter__(self) -> Iterator[Event]:
        """Yield every event."""
        reader = _EventReader(self.path)
        with self._open() as file:
            rows = file.execute("SELECT * FROM event ORDER BY number")
            while chunk := rows.fetchmany(_CHUNK):
                for row in chunk:
                    yield reader.event(row)
                    del row
                reader.at = int(chunk[-1][0])

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        """Yield the file, opened to be read; a killed recording's last transaction is undone."""
        path = self.path
        try:
            check_regular(path)
            if not path.exists():
                raise InputError(f"{path}: no such file, expected a filter's trace")
            with path.open("rb") as start:
                if start.read(16) != b"SQLite format 3\0":
                    raise InputError(f"{path}: is not an SQLite file, expected a filter's trace")
            mode = "rw" if path.with_name(path.name + "-journal").exists() else "ro"
            uri = f"{path.absolute().as_uri()}?mode={mode}"
            with closing(sqlite3.connect(uri, uri=True)) as file:
                file.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST_BYTES)
                file.execute("PRAGMA trusted_schema = OFF")
                yield file
        except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
            raise InputError(
                f"{path}: SQLite cannot read it ({printable(str(error))}); record it again, or "
                "recover it with the sqlite3 shell's .recover"
            ) from None
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from None

    def _check(self, file: sqlite3.Connection) -> None:
        """Raise InputError where the tables are not those that a recorder makes."""
        (application,), (version,) = (
            file.execute(f"PRAGMA {name}").fetchone() for name in ("application_id", "user_version")
        )
        found = dict(file.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL"))
        if application != APPLICATION:
            raise InputError(f"{self.path}: is no filter's trace, but another SQLite file")
        if version != VERSION:
            raise InputError(
                f"{self.path}: is a trace of version {version}, expected {VERSION}; "
                "use the version of slamcheck that it was recorded for"
            )
        for name in {**TABLES, **found}:
            if found.get(name) != TABLES.get(name):
                raise InputError(f"{self.path}: table {printable(name)} is not as a recorder's")

    def _sensor(self, name: Any, gate: Any, components: Any) -> Sensor:
        names = _texts(components or "[]")
        sound = gate is None or (isinstance(gate, float) and 0.0 < gate < 1.0)
        if not isinstance(name, str) or not sound or names is None:
            raise InputError(
                f"{self.path}, sensor {printable(str(name))}: gate {gate!r} or components "
                f"{components!r:.60} are not as expected: a probability and a list of names"
            )
        return Sensor(gate, names)


def _texts(text: Any) -> tuple[str, ...] | None:
    """A list of distinct texts out of JSON; None where it is none."""
    try:
        found = json.loads(text)
    except (ValueError, TypeError, RecursionError):
        return None
    if not isinstance(found, list) or not all(isinstance(one, str) for one in found):
        return None
    return tuple(found) if len(set(found)) == len(found) else None


class _EventReader:
    """Makes events of rows, and follows which blocks there are."""

    def __init__(self, path: Path) -> None:
        self.at = -1
        self._path = path
        self._dims: dict[str, int] = {}
        self._size = 0
        self._blocks: dict[str, tuple[Blocks, int]] = {}
        self._last: dict[tuple[str, str | None, str, str], Array] = {}
        self._make: dict[str, Callable[[tuple[Any, ...]], Event]] = {
            "prior": self._prior,
            "predict": self._predict,
            "update": self._update,
            "augment": self._augment,
            "clone": self._clone,
            "remove": self._remove,
            "reset": self._reset,
            "snapshot": self._snapshot,
            "directions": self._directions,
        }

    def event(self, row: tuple[Any, ...]) -> Event:
        """Return the event of a row. Raises InputError."""
        number, kind, time_s = row[:3]
        if number != self.at + 1:
            raise self._bad(number, f"stands after event {self.at}, expected {self.at + 1}")
        self.at = number
        make = self._make.get(kind)
        if make is None:
            raise self._bad(number, f"kind {kind!r:.40}, expected one of {', '.join(self._make)}")
        if time_s is not None and not (isinstance(time_s, float) and math.isfinite(time_s)):
            raise self._bad(number, f"time_s {time_s!r:.40}, expected a number of seconds")
        if not self._dims and kind != "prior":
            raise self._bad(number, f"is a {kind}, expected the prior first")
        return make(row)

    def _prior(self, row: tuple[Any, ...]) -> Prior:
        number, _, time_s, _, text = row[:5]
        if self._dims:
            raise self._bad(number, "is a second prior; a filter that begins anew has a new trace")
        names, dims = _texts(text), _counts(row[15])
        if not names or dims is None or len(dims) != len(names):
            raise self._bad(number, "blocks and note are not lists of names and of dimensions")
        self._dims = dict(zip(names, dims, strict=True))
        self._changed(number)
        n = self._size
        return Prior(number, time_s, names, dims, self._square(row, 12, "covariance", n))

    def _predict(self, row: tuple[Any, ...]) -> Predict:
        blocks, n = self._named(row)
        f = self._repeated(row, 6, "jacobian", n, n)
        return Predict(row[0], row[2], blocks, f, self._repeated(row, 7, "noise", n, n))

    def _update(self, row: tuple[Any, ...]) -> Update:
        number, _, time_s, sensor, _, used = row[:6]
        blocks, n = self._named(row)
        if not isinstance(sensor, str):
            raise self._bad(number, f"sensor {sensor!r:.40}, expected a name")
        if used not in (0, 1):
            raise self._bad(number, f"used is {used!r:.40}, expected 0 or 1")
        residual = self._array(row, 9, "residual")
        m = len(residual)
        correction, gain = row[10], row[11]
        return Update(
            number,
            time_s,
            sensor,
            blocks,
            residual,
            self._repeated(row, 6, "jacobian", m, n),
            self._repeated(row, 7, "noise", m, m),
            bool(used),
            None if correction is None else self._shaped(row, 10, "correction", self._size),
            None if gain is None else self._shaped(row, 11, "gain", self._size, m),
        )

    def _augment(self, row: tuple[Any, ...]) -> Augment:
        number, _, time_s = row[:3]
        blocks, n = self._named(row)
        name, d = self._new(row)
        g_x = self._repeated(row, 6, "jacobian", d, n)
        noise = self._array(row, 7, "noise") if row[7] is not None else None
        m = math.isqrt(len(noise)) if noise is not None else -1
        found = self._repeated(row, 7, "noise", m, m)
        g_z = self._repeated(row, 8, "noise_jacobian", d, len(found))
        self._dims[name] = d
        self._changed(number)
        return Augment(number, time_s, name, blocks, g_x, g_z, found)

    def _clone(self, row: tuple[Any, ...]) -> Clone:
        blocks, _ = self._named(row)
        if len(blocks) != 1:
            raise self._bad(row[0], f"clones {len(blocks)} blocks, expected one")
        name = self._unused(row[0], row[15])
        self._dims[name] = self._dims[blocks[0]]
        self._changed(row[0])
        return Clone(row[0], row[2], name, blocks[0])

    def _remove(self, row: tuple[Any, ...]) -> Remove:
        blocks, _ = self._named(row)
        for name in blocks:
            del self._dims[name]
        if not self._dims:
            raise self._bad(row[0], "removes the last block of the state")
        self._changed(row[0])
        return Remove(row[0], row[2], blocks)

    def _reset(self, row: tuple[Any, ...]) -> Reset:
        blocks, n = self._named(row)
        return Reset(row[0], row[2], blocks, self._repeated(row, 6, "jacobian", n, n))

    def _snapshot(self, row: tuple[Any, ...]) -> Snapshot:
        blocks, n = self._named(row)
        return Snapshot(
            row[0],
            row[2],
            blocks,
            self._shaped(row, 12, "covariance", n, n),
            None if row[13] is None else self._array(row, 13, "mean"),
            None if row[14] is None else self._shaped(row, 14, "error", n),
        )

    def _directions(self, row: tuple[Any, ...]) -> Directions:
        blocks, n = self._named(row)
        try:
            note = json.loads(row[15])
            names, blind = (_texts(json.dumps(note[key])) for key in ("names", "blind"))
        except (ValueError, TypeError, KeyError, RecursionError):
            names = blind = None
        if not names or not blind:
            raise self._bad(row[0], "note is not {names: [...], blind: [...]}, both not empty")
        basis = self._shaped(row, 6, "jacobian", n, len(names))
        return Directions(row[0], row[2], blocks, basis, names, blind)

    def _named(self, row: tuple[Any, ...]) -> tuple[Blocks, int]:
        """Blocks that an event is on, and how many entries they have together."""
        text = row[4]
        found = self._blocks.get(text)
        if found is None:
            names = _texts(text)
            if not names:
                raise self._bad(row[0], f"blocks {text!r:.60}, expected a list of distinct names")
            for name in names:
                if name not in self._dims:
                    raise self._bad(
                        row[0], f"block {printable(name)!r:.60} is not in the state at that time"
                    )
            found = self._blocks[text] = names, sum(self._dims[name] for name in names)
        return found

    def _new(self, row: tuple[Any, ...]) -> tuple[str, int]:
        """Name and dimension of a block that begins."""
        try:
            name, dim = json.loads(row[15])
        except (ValueError, TypeError, RecursionError):
            name, dim = None, None
        if not isinstance(dim, int) or not 0 < dim <= MOST_ENTRIES:
            raise self._bad(row[0], f"note {row[15]!r:.60}, expected a name and a dimension")
        return self._unused(row[0], name), dim

    def _unused(self, number: int, name: Any) -> str:
        if not isinstance(name, str) or name in self._dims:
            raise self._bad(number, f"new block {name!r:.60}, expected a name that is not in use")
        return name

    def _changed(self, number: int) -> None:
        """Take note of another set of blocks."""
        self._blocks.clear()
        self._size = sum(self._dims.values())
        if len(self._dims) > MOST_BLOCKS or self._size > MOST_ENTRIES:
            raise self._bad(number, f"makes the state larger than {MOST_ENTRIES} entries")

    def _repeated(self, row: tuple[Any, ...], column: int, name: str, *shape: int) -> Array:
        """A matrix, or that of the event before that was like it."""
        key = row[1], row[3], row[4], name
        if row[column] is None:
            found = self._last.get(key)
            if found is None or found.shape[1] != shape[1] or shape[0] not in (-1, len(found)):
                raise self._bad(
                    row[0], f"{name} is missing, and no event before has one of this shape"
                )
            return found
        found = self._last[key] = self._shaped(row, column, name, *shape)
        return found

    def _square(self, row: tuple[Any, ...], column: int, name: str, n: int) -> Array:
        return self._shaped(row, column, name, n, n)

    def _shaped(self, row: tuple[Any, ...], column: int, name: str, *shape: int) -> Array:
        found = self._array(row, column, name)
        if len(found) != math.prod(shape):
            raise self._bad(
                row[0], f"{name} has {len(found)} numbers, expected {' x '.join(map(str, shape))}"
            )
        return found.reshape(shape)

    def _array(self, row: tuple[Any, ...], column: int, name: str) -> Array:
        """The numbers (n,) of a blob."""
        blob = row[column]
        if not isinstance(blob, bytes) or len(blob) % 8:
            raise self._bad(row[0], f"{name} is not a blob of float64 numbers")
        found: Array = np.frombuffer(blob, "<f8")
        if not math.isfinite(np.add.reduce(found)):
            raise self._bad(row[0], f"{name} has a number that is not finite, or too large")
        return found

    def _bad(self, number: Any, fault: str) -> InputError:
        return InputError(f"{self._path}, event {number!r:.20}: {fault}")


def _counts(text: Any) -> tuple[int, ...] | None:
    """A list of positive whole numbers out of JSON; None where it is none."""
    try:
        found = json.loads(text)
    except (ValueError, TypeError, RecursionError):
        return None
    if not isinstance(found, list):
        return None
    sound = all(isinstance(one, int) and 0 < one <= MOST_ENTRIES for one in found)
    return tuple(found) if sound else None
