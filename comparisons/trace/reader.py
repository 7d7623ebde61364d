"""A filter's trace on disk: batches of events in one SQLite file, or one after the other in a file.

`docs/audit-format.md` describes the format for other languages. An SQLite file is read as it is
written: its tables must be those below, to the letter, so that nothing in it is ever evaluated.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, NamedTuple

from comparisons.errors import InputError, check_regular, quoted, shorten
from comparisons.trace.batch import unpack
from comparisons.trace.events import Event, SensorDescription
from comparisons.trace.rows import EventReader, batch_rows, distinct, is_block

APPLICATION = 0x534C4154
VERSION = 2
TABLES = {
    "batch": (
        "CREATE TABLE batch (first INTEGER PRIMARY KEY, events INTEGER NOT NULL, "
        "updates INTEGER NOT NULL, snapshots INTEGER NOT NULL, state TEXT NOT NULL, "
        "data BLOB NOT NULL)"
    ),
    "sensor": "CREATE TABLE sensor (name TEXT PRIMARY KEY, gate REAL, components TEXT)",
}
_COUNTS = "SELECT SUM(events), SUM(updates), SUM(snapshots) FROM batch"
_CUT_OFF = "ends within a batch, as where its recording was killed; that batch is left out"
RAW = b"slamcheck events"
"""Begins a file of batches without SQLite."""
_RAW_HEAD = struct.Struct("<2q")
_RAW_BATCH = struct.Struct("<6q")
_OTHERS = {b"PK": " but an archive as numpy's (.npz)", b"\x89HDF": " but HDF5", b"#": " but text"}
"""What may be taken for a trace, by its first bytes."""
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


class Stored(NamedTuple):
    """A batch as a file holds it. first: number of its first event. state: after its last, JSON."""

    first: int
    events: int
    state: Any
    data: bytes


class TraceReader:
    """A trace that is read; iterate over its events in order.

    sensors: those that were described. remarks: what a reader should know of the file. unsound: by
    event, of those read so far, what is wrong with its noise, or the prior's P, where that is no
    covariance. singular: likewise, which R has no inverse. Raises InputError, with the event's
    number, where the file is no trace, is damaged, or an event cannot be what it says. It may be
    recorded meanwhile.
    """

    def __init__(self, path: Path) -> None:
        """Open a file and check what it is, not yet its events."""
        self.path = path
        self.sensors: dict[str, SensorDescription] = {}
        self.remarks: tuple[str, ...] = ()
        self.unsound: dict[int, str] = {}
        self.singular: dict[int, str] = {}
        self._raw = _is_raw(path)
        if self._raw:
            raw = _RawFile(path)
            self.counts, described = raw.summary()
            if raw.cut_off:
                self.remarks = (f"{path.name} {_CUT_OFF}",)
        else:
            with self._open() as file:
                self._check(file)
                counts = file.execute(_COUNTS).fetchone()
                self.counts = TraceCounts(*(int(n or 0) for n in counts))
                described = list(file.execute("SELECT * FROM sensor"))
        for name, gate, components in described:
            self.sensors[name] = self._sensor(name, gate, components)

    def __iter__(self) -> Iterator[Event]:
        """Yield every event."""
        reader = EventReader(self.path)
        self.unsound, self.singular = reader.unsound, reader.singular
        yield from self._batches(reader)
        if reader.at < 0:
            raise InputError(f"{self.path}: holds no events, expected a filter's trace")

    def _batches(self, reader: EventReader) -> Iterator[Event]:
        stored = _RawFile(self.path).batches() if self._raw else self._stored()
        for one in stored:
            try:
                batch = unpack(one.data)
            except ValueError as error:
                raise InputError(
                    f"{self.path}, after event {reader.at}: the batch holds {error}"
                ) from None
            if one.first != reader.at + 1:
                raise InputError(
                    f"{self.path}, event {quoted(one.first)}: stands after event {reader.at}, "
                    f"expected {reader.at + 1}"
                )
            yield from reader.events(batch_rows(batch, one.first))
            if one.events != len(batch.kind) or _json(one.state) != reader.state:
                raise InputError(
                    f"{self.path}, event {reader.at}: the batch says that it has other events, or "
                    "leads to other blocks"
                )

    def _stored(self) -> Iterator[Stored]:
        """Yield the batches of an SQLite file."""
        asked = "SELECT first, events, state, data FROM batch WHERE first > ? ORDER BY first"
        after = -1
        with self._open() as file:
            self._check(file)
            while True:
                # A statement holds a lock that keeps the recorder from writing, so it ends here.
                with closing(file.execute(asked, (after,))) as rows:
                    row = rows.fetchone()
                if row is None:
                    return
                after, events, state, data = row
                if not isinstance(data, bytes):
                    raise InputError(f"{self.path}, event {quoted(after)}: the batch is no blob")
                yield Stored(after, events, state, data)

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        """Yield the file, opened to be read; a killed recording's last transaction is undone."""
        path = self.path
        try:
            with ExitStack() as stack:
                found = self._resolved()
                file = stack.enter_context(closing(_connect(found, "ro")))
                if _is_to_be_undone(file):
                    copy = Path(stack.enter_context(TemporaryDirectory())) / "trace"
                    _copy(found, copy)
                    file = stack.enter_context(closing(_connect(copy, "rw")))
                file.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST_BYTES)
                file.set_progress_handler(_patience(path), _STEPS)
                file.execute("PRAGMA trusted_schema = OFF")
                file.execute("PRAGMA cell_size_check = ON")
                yield file
        except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
            raise _unreadable(path, error) from None
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from None

    def _resolved(self) -> Path:
        """Return where SQLite shall open the file, after a look at its first bytes.

        It follows links before it looks for a journal, so its look and ours are at the same file.
        """
        check_regular(self.path)
        path = Path(os.path.realpath(self.path))
        check_regular(_journal(path))
        if not path.exists():
            raise InputError(f"{self.path}: no such file, expected a filter's trace")
        with path.open("rb") as start:
            header = start.read(20)
        if header[:16] != _MAGIC:
            known = next((what for begin, what in _OTHERS.items() if header.startswith(begin)), "")
            raise InputError(
                f"{self.path}: is not an SQLite file{known}, expected a filter's trace, as "
                "slamcheck.Recorder writes it"
            )
        if _WAL in header[18:20]:
            raise InputError(
                f"{self.path}: has a write-ahead log, which a trace has not; "
                "PRAGMA journal_mode = DELETE ends it"
            )
        if _last_bytes(_journal(path), 8) == _JOURNAL_MAGIC:
            raise InputError(f"{_journal(path)}: names another file, as a recorder's never does")
        return path

    def _check(self, file: sqlite3.Connection) -> None:
        """Raise InputError where version or tables are not those of a recorder."""
        (application,), (version,) = (
            file.execute(f"PRAGMA {name}").fetchone() for name in ("application_id", "user_version")
        )
        if application != APPLICATION:
            raise InputError(f"{self.path}: is no filter's trace, but another SQLite file")
        if version == 1:
            raise InputError(
                f"{self.path}: is a trace of version 1, of a development version after slamcheck "
                "0.2, which no release reads; record the filter anew with slamcheck.Recorder"
            )
        if version != VERSION:
            raise InputError(
                f"{self.path}: is a trace of version {version}, expected {VERSION}; "
                "use the version of slamcheck that it was recorded for"
            )
        expected = math.prod(
            file.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "page_size")
        )
        size = Path(file.execute("PRAGMA database_list").fetchone()[2]).stat().st_size
        if size < expected:
            raise InputError(f"{self.path}: is cut off: {size} bytes, expected {expected}")
        found = list(file.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL"))
        for name, sql in [*TABLES.items(), *found]:
            if (name, sql) not in found or TABLES.get(name) != sql:
                raise InputError(f"{self.path}: table {quoted(name)} is not as a recorder's")

    def _sensor(self, name: Any, gate: Any, components: Any) -> SensorDescription:
        names = distinct(_json("[]" if components is None else components))
        sound = gate is None or (isinstance(gate, float) and 0.0 < gate < 1.0)
        if not isinstance(name, str) or not sound or names is None:
            raise InputError(
                f"{self.path}, sensor {quoted(name)}: gate {quoted(gate)} or components "
                f"{quoted(components)} are not as expected: a probability and a list of names"
            )
        return SensorDescription(gate, names)


class _RawFile:
    """A file of batches, one after the other. The last one may be cut off, as by a kill."""

    def __init__(self, path: Path) -> None:
        self.path, self.cut_off = path, False

    def summary(self) -> tuple[TraceCounts, list[Any]]:
        """Return the counts, and what is known of sensors. Raises InputError."""
        counts = [0, 0, 0]
        with self._open() as file:
            described = self._described(file)
            while head := self._head(file):
                counts = [a + b for a, b in zip(counts, head[1:4], strict=True)]
                file.seek(head[4] + head[5], os.SEEK_CUR)
        return TraceCounts(*counts), described

    def batches(self) -> Iterator[Stored]:
        """Yield every batch. Raises InputError."""
        with self._open() as file:
            self._described(file)
            while head := self._head(file):
                state = file.read(head[4]).rstrip(b"\0").decode("utf-8", "replace")
                yield Stored(head[0], head[1], state, file.read(head[5]))

    @contextmanager
    def _open(self) -> Iterator[BinaryIO]:
        try:
            with self.path.open("rb") as file:
                self._size = os.fstat(file.fileno()).st_size
                yield file
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read ({error.strerror})") from None

    def _described(self, file: BinaryIO) -> list[Any]:
        """Return rows of sensors."""
        file.seek(len(RAW))
        head = file.read(_RAW_HEAD.size)
        version, size = _RAW_HEAD.unpack(head) if len(head) == _RAW_HEAD.size else (0, 0)
        if version != VERSION or not 0 <= size <= self._size:
            raise InputError(
                f"{self.path}: is of version {version}, expected {VERSION}; or is cut off"
            )
        found = _json(file.read(size).rstrip(b"\0").decode("utf-8", "replace"))
        if not isinstance(found, list) or not all(
            isinstance(one, list) and len(one) == 3 for one in found
        ):
            raise InputError(f"{self.path}: describes its sensors by {quoted(found)}")
        return [(one[0], one[1], None if one[2] is None else json.dumps(one[2])) for one in found]

    def _head(self, file: BinaryIO) -> tuple[int, ...]:
        """Return first number, events, updates, snapshots and sizes of the next batch, or none."""
        head = file.read(_RAW_BATCH.size)
        if not head:
            return ()
        if len(head) == _RAW_BATCH.size:
            found = _RAW_BATCH.unpack(head)
            if min(found) < 0 or max(found[4:]) > _LONGEST_BYTES:
                raise InputError(f"{self.path}: a batch has sizes that none has")
            if file.tell() + found[4] + found[5] <= self._size:
                return found
        self.cut_off = True
        return ()


def last_state(path: Path) -> tuple[int, list[list[Any]]]:
    """Return the number of a trace's next event, and name, dimension and chart of each block.

    Raises:
        InputError: The file is no trace in SQLite.
    """
    trace = TraceReader(path)
    if trace._raw:
        raise InputError(
            f"{path}: is a plain file, which no recording continues; record a new file"
        )
    with trace._open() as file:
        asked = "SELECT first + events, state FROM batch ORDER BY first DESC LIMIT 1"
        number, said = file.execute(asked).fetchone() or (0, "[]")
    state = _json(said)
    sound = isinstance(state, list) and all(
        is_block(one) and isinstance(one[0], str) for one in state
    )
    if type(number) is not int or not sound:
        raise InputError(f"{path}: its last batch says {quoted(said)} of its blocks")
    return number, state


def _is_raw(path: Path) -> bool:
    """Whether a file is of batches without SQLite."""
    check_regular(path)
    try:
        with path.open("rb") as file:
            return file.read(len(RAW)) == RAW
    except OSError:
        return False  # which SQLite's way says better


def _json(text: Any) -> Any:
    """What a text in JSON says; None where it is none."""
    try:
        return json.loads(text)
    except (TypeError, ValueError, RecursionError):
        return None


def _unreadable(where: object, error: Exception) -> InputError:
    return InputError(
        f"{where}: SQLite cannot read it ({shorten(str(error), 100)}); record it again, or "
        "recover it with the sqlite3 shell's .recover"
    )


def _journal(path: Path) -> Path:
    return path.with_name(f"{path.name}-journal")


def _connect(path: Path, mode: str) -> sqlite3.Connection:
    # A reading that an error ends may be closed by whichever thread collects its frames.
    return sqlite3.connect(f"{path.as_uri()}?mode={mode}", uri=True, check_same_thread=False)


def _is_to_be_undone(file: sqlite3.Connection) -> bool:
    """Whether a journal is a killed recording's, for which SQLite would have to write."""
    try:
        file.execute("PRAGMA application_id").fetchone()
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode != sqlite3.SQLITE_READONLY_ROLLBACK:
            raise
        return True
    return False


def _copy(path: Path, copy: Path) -> None:
    """Copy a file and its journal: nothing that was handed in is written. Raises InputError."""
    shutil.copyfile(path, copy)
    shutil.copyfile(_journal(path), _journal(copy))
    if _last_bytes(_journal(copy), 8) == _JOURNAL_MAGIC:
        raise InputError(f"{_journal(path)}: names another file, as a recorder's never does")


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
