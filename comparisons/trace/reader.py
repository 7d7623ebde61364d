"""A filter's trace on disk: one SQLite file, a row an event, matrices as little-endian float64.

`docs/audit-format.md` describes the format for other languages. A file is read as it is written:
its tables must be those below, to the letter, so that nothing in it is ever evaluated.
"""

from __future__ import annotations

import math
import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from comparisons.errors import InputError, check_regular, printable
from comparisons.trace.events import Event, Sensor
from comparisons.trace.rows import EventReader, shown, texts

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
_MAGIC = b"SQLite format 3\0"
_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
"""At the end of a journal that is one of several files' journals, which a recorder's never is."""
_WAL = 2
"""Of the header's bytes 18 and 19: written and read with a write-ahead log."""
_LONGEST_BYTES = 1 << 30
"""Of a value."""
_STEPS = 1_000_000
_STEPS_PER_BYTE = 4
"""Of SQLite's virtual machine, more than any sound file takes. A damaged one might go on for ever,
by pages that lead to the same pages."""


class TraceCounts(NamedTuple):
    """Of a file: events, updates and snapshots."""

    events: int
    updates: int
    snapshots: int


class Trace:
    """A trace that is read; iterate over its events in order.

    sensors: those that were described. Raises InputError, with the event's number, where the file
    is no trace, is damaged, or an event cannot be what it says. It may be recorded meanwhile.
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

    def __iter__(self) -> Iterator[Event]:
        """Yield every event."""
        reader = EventReader(self.path)
        asked = "SELECT * FROM event WHERE number > ? ORDER BY number"
        with self._open() as file:
            self._check(file)
            while True:
                # A statement holds a lock that keeps the recorder from writing, so it ends here.
                with closing(file.execute(asked, (reader.at,))) as rows:
                    events = reader.events(rows)
                if not events:
                    break
                yield from events
        if reader.at < 0:
            raise InputError(f"{self.path}: holds no events, expected a filter's trace")

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        """Yield the file, opened to be read; a killed recording's last transaction is undone."""
        path = self.path
        try:
            with closing(sqlite3.connect(self._address(), uri=True)) as file:
                file.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST_BYTES)
                file.set_progress_handler(_patience(path), _STEPS)
                file.execute("PRAGMA trusted_schema = OFF")
                file.execute("PRAGMA cell_size_check = ON")
                yield file
        except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
            raise InputError(
                f"{path}: SQLite cannot read it ({printable(str(error)):.100}); record it again, "
                "or recover it with the sqlite3 shell's .recover"
            ) from None
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from None

    def _address(self) -> str:
        """Return where SQLite shall open the file, after a look at its first bytes."""
        path = self.path
        check_regular(path)
        journal = Path(f"{path}-journal")
        check_regular(journal)
        if not path.exists():
            raise InputError(f"{path}: no such file, expected a filter's trace")
        with path.open("rb") as start:
            header = start.read(20)
        if header[:16] != _MAGIC:
            raise InputError(f"{path}: is not an SQLite file, expected a filter's trace")
        if _WAL in header[18:20]:
            raise InputError(
                f"{path}: has a write-ahead log, which a trace has not; "
                "PRAGMA journal_mode = DELETE ends it"
            )
        mode = "ro"
        if journal.exists():
            mode = "rw"  # SQLite undoes what is in a journal, for which it must write.
            if _last_bytes(journal, 8) == _JOURNAL_MAGIC:
                raise InputError(f"{journal}: names another file, which SQLite would delete")
        return f"{path.absolute().as_uri()}?mode={mode}"

    def _check(self, file: sqlite3.Connection) -> None:
        """Raise InputError where the tables are not those that a recorder makes."""
        (application,), (version,) = (
            file.execute(f"PRAGMA {name}").fetchone() for name in ("application_id", "user_version")
        )
        if application != APPLICATION:
            raise InputError(f"{self.path}: is no filter's trace, but another SQLite file")
        if version != VERSION:
            raise InputError(
                f"{self.path}: is a trace of version {version}, expected {VERSION}; "
                "use the version of slamcheck that it was recorded for"
            )
        expected = math.prod(
            file.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "page_size")
        )
        size = self.path.stat().st_size
        if size < expected:
            raise InputError(f"{self.path}: is cut off: {size} bytes, expected {expected}")
        found = list(file.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL"))
        for name, sql in [*TABLES.items(), *found]:
            if (name, sql) not in found or TABLES.get(name) != sql:
                raise InputError(f"{self.path}: table {shown(name)} is not as a recorder's")

    def _sensor(self, name: Any, gate: Any, components: Any) -> Sensor:
        names = texts("[]" if components is None else components)
        sound = gate is None or (isinstance(gate, float) and 0.0 < gate < 1.0)
        if not isinstance(name, str) or not sound or names is None:
            raise InputError(
                f"{self.path}, sensor {shown(name)}: gate {shown(gate)} or components "
                f"{shown(components)} are not as expected: a probability and a list of names"
            )
        return Sensor(gate, names)


def _last_bytes(path: Path, count: int) -> bytes:
    """Return the end of a file; none where it has just been deleted, as by a commit."""
    try:
        with path.open("rb") as file:
            file.seek(-min(count, file.seek(0, os.SEEK_END)), os.SEEK_END)
            return file.read(count)
    except FileNotFoundError:
        return b""


def _patience(path: Path) -> Callable[[], bool]:
    """Return what ends a statement that takes more steps than a file of its size can need."""
    called = 0

    def beyond() -> bool:
        nonlocal called
        called += 1
        return called * _STEPS > 10 * _STEPS + _STEPS_PER_BYTE * path.stat().st_size

    return beyond
