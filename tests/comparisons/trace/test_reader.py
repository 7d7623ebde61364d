"""Traces are read as they were recorded; a bad one is one line with the event's number."""

import json
import os
import random
import re
import sqlite3
import struct
import time
import tracemalloc
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.audit.audit import audit
from comparisons.errors import InputError
from comparisons.trace import reader
from comparisons.trace import rows as trace_rows
from comparisons.trace.batch import COLUMNS, KINDS, ROW, pack, unpack
from comparisons.trace.events import Event
from comparisons.trace.reader import TABLES, TraceReader
from comparisons.trace.recorder import Recorder
from comparisons.trace.rows import EventReader, batch_rows

CHARTS = ["additive", "additive"]
P = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.25], [0.0, 0.25, 3.0]])
F = np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
Q = np.diag([0.0, 0.1, 0.2])
H = np.array([[1.0, 0.0], [0.0, 2.0]])
R = np.diag([0.5, 0.25])
PRIOR, DIRECTIONS, PREDICT, AGAIN, UPDATE, REJECT, AUGMENT, CLONE, RESET, SNAPSHOT, REMOVE = range(
    11
)
"""Numbers of the events of `record`, one of each kind."""


def record(path: Path) -> Path:
    """Record a trace of every kind of event."""
    with Recorder(path, gates={"gps": 0.99}, components={"gps": ("x", "y")}) as recorder:
        recorder.prior({"a": 2, "b": 1}, P)
        recorder.directions({"shift": [1.0, 0.0, 0.0], "turn": [0.0, 1.0, 2.0]}, ["odometry"])
        recorder.at(0.5)
        recorder.predict(F, Q)
        recorder.at(1.0)
        recorder.predict(F, Q)
        correction, gain = [1.0, 2.0, 3.0], np.arange(6.0).reshape(3, 2)
        recorder.update("gps", [0.1, 0.2], H, R, ["a"], correction=correction, gain=gain)
        recorder.reject("gps", [9.0, 9.0], H, R, ["a"])
        recorder.augment("c", [[1.0, 2.0]], [[1.0, 0.5]], R, ["a"])
        recorder.clone("a", "copy")
        recorder.reset(2.0, ["b"])
        recorder.snapshot(np.eye(2), ["b", "c"], mean=[1.0, 2.0, 3.0, 4.0], error=[0.5, 0.25])
        recorder.remove("b", "copy")
    return path


@pytest.fixture
def trace(tmp_path: Path) -> Path:
    return record(tmp_path / "run.trace")


def change(path: Path, sql: str, *values: Any) -> None:
    """Do something to a file."""
    with closing(sqlite3.connect(path, isolation_level=None)) as file:
        file.execute("PRAGMA synchronous = OFF")
        file.execute(sql, values)


def refused(path: Path) -> str:
    """The one line that a bad trace gives, without the file's name."""
    with pytest.raises(InputError) as found:
        list(TraceReader(path))
    said = str(found.value)
    assert said.startswith(str(path))
    assert said.isprintable()
    assert len(said) < len(str(path)) + 400
    return said.removeprefix(str(path))


def edit(path: Path, number: int, column: str, value: Any) -> None:
    """Change an event: its time, kind, use, blocks, text, or one of its matrices."""
    with closing(sqlite3.connect(path)) as file:
        ((data,),) = file.execute("SELECT data FROM batch")
        batch = unpack(data)
        rows = [list(row[:5]) + row[5] for row in zip(*batch[:6], strict=True)]
        texts = [json.dumps(text) for text in batch.texts]
        matrices = [b"" if one is None else one.tobytes() for one in batch.arrays]
        row = rows[number]
        if column in ("blocks", "text"):
            row[3 if column == "blocks" else 4] = len(texts)
            texts.append(value if isinstance(value, str) else json.dumps(value))
        elif column in ("time_s", "kind", "used"):
            row[("time_s", "kind", "used").index(column)] = value
        else:
            row[5 + COLUMNS[KINDS[row[1]]].index(column)] = -1 if value is None else len(matrices)
            matrices += [] if value is None else [value]
        packed = pack([ROW.pack(*one) for one in rows], texts, matrices)
        file.execute("UPDATE batch SET data = ?", (packed,))
        file.commit()


def kinds(path: Path) -> list[str]:
    return [type(event).__name__ for event in TraceReader(path)]


def plain(event: Event) -> tuple[Any, ...]:
    return tuple(x.tolist() if isinstance(x, np.ndarray) else x for x in event)


def test_every_kind_is_read_as_it_was_recorded(trace: Path) -> None:
    found = TraceReader(trace)
    assert found.counts == (11, 2, 1)
    assert found.sensors == {"gps": (0.99, ("x", "y"))}
    events = list(found)
    assert kinds(trace) == [
        *("TracePrior", "Directions", "Predict", "Predict", "Update", "Update", "Augment"),
        *("Clone", "Reset", "Snapshot", "Remove"),
    ]
    a, ab, r = ("a",), ("a", "b"), R.tolist()
    basis = [[1.0, 0.0], [0.0, 1.0], [0.0, 2.0]]
    gain = [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]
    nothing = None, None, 1.0
    assert [plain(event) for event in events] == [
        (0, None, ab, (2, 1), P.tolist(), None, ()),
        (1, None, ab, basis, ("shift", "turn"), ("odometry",)),
        (2, 0.5, ab, F.tolist(), Q.tolist(), None, None),
        (3, 1.0, ab, F.tolist(), Q.tolist(), None, None),
        (4, 1.0, "gps", a, [0.1, 0.2], H.tolist(), r, True, [1.0, 2.0, 3.0], gain, *nothing),
        (5, 1.0, "gps", a, [9.0, 9.0], H.tolist(), r, False, None, None, *nothing),
        (6, 1.0, "c", a, [[1.0, 2.0]], [[1.0, 0.5]], r, None, *nothing, "additive"),
        (7, 1.0, "copy", "a"),
        (8, 1.0, ("b",), [[2.0]]),
        (9, 1.0, ("b", "c"), [[1.0, 0.0], [0.0, 1.0]], [1.0, 2.0, 3.0, 4.0], [0.5, 0.25]),
        (10, 1.0, ("b", "copy")),
    ]
    assert [plain(event) for event in found] == [plain(event) for event in events], "once more"


def test_what_a_check_needs_is_read_as_it_was_recorded(tmp_path: Path) -> None:
    path = tmp_path / "run.trace"
    with Recorder(path) as recorder:
        recorder.prior({"a": 2, "r": 1}, P, point=[1.0, 2.0], charts={"r": "so3 right"})
        recorder.predict(F, Q, point=[1.0], after=[2.0, 3.0])
        recorder.update("x", [0.1, 0.2], H, R, ["a"], point=[4.0], numbers=[7, 8], weight=0.25)
        recorder.reject("x", [0.1, 0.2], H, R, ["a"], numbers=9)
        more: dict[str, Any] = {"point": [5.0], "after": [6.0], "numbers": 3, "weight": 0.0}
        recorder.augment("c", [[1.0, 2.0]], [[1.0, 0.5]], R, ["a"], chart="se2", **more)
        recorder.clone("c", "d")
    assert kinds(path) == ["TracePrior", "Predict", "Update", "Update", "Augment", "Clone"]
    prior, predict, update, reject, augment, _ = TraceReader(path)
    assert plain(prior)[5:] == ([1.0, 2.0], ("additive", "so3 right"))
    assert plain(predict)[5:] == ([1.0], [2.0, 3.0])
    assert plain(update)[8:] == (None, None, [4.0], [7.0, 8.0], 0.25)
    assert plain(reject)[7:] == (False, None, None, None, [9.0], 1.0)
    assert plain(augment)[7:] == ([5.0], [6.0], [3.0], 0.0, "se2")
    with Recorder(tmp_path / "other") as recorder:
        recorder.prior({"a": 1}, 1.0)
        with pytest.raises(TypeError, match="unexpected keyword argument 'numbrs'"):
            recorder.update("x", 1.0, 1.0, 1.0, numbrs=1)  # type: ignore[call-arg]


NO_NAMES: tuple[Any, ...] = ('"a"', [], [1], {}, None, ["a", "a"], [["a"]])
NOT_A_NUMBER = "is no numbers, or has one that is not finite or too large"
BAD_EVENTS: list[tuple[int, str, Any, str]] = [
    (PRIOR, "covariance", b"", "covariance has 0 numbers, expected 3 x 3"),
    (PRIOR, "covariance", None, "covariance is missing"),
    *(
        (PRIOR, "text", text, "blocks and text are not names, and dimensions and charts")
        for text in (
            *([[1e9, 1], CHARTS], [[True, 1], CHARTS], [[0, 3], CHARTS], [[2], CHARTS], [2, 1]),
            *([[2, 1], ["additive", "round"]], [[2, 1], [[], []]], "7", "null"),
        )
    ),
    (PRIOR, "text", [[20000, 20000], CHARTS], "makes the state larger than 20000 entries"),
    (PRIOR, "text", [[19999, 1], CHARTS], "covariance has 9 numbers, expected 20000 x 20000"),
    (PRIOR, "blocks", ["a", "a"], "blocks and text are not names, and dimensions and charts"),
    (PRIOR, "blocks", [], "blocks and text are not names, and dimensions and charts"),
    (PRIOR, "kind", 1, "is a predict, expected the prior first"),
    (DIRECTIONS, "text", {}, "text is not {names: [...], blind: [...]}, both not empty"),
    (DIRECTIONS, "text", 7, "text is not {names: [...], blind: [...]}, both not empty"),
    (DIRECTIONS, "jacobian", bytes(8), "jacobian has 1 numbers, expected 3 x 2"),
    (PREDICT, "kind", 0, "is a second prior; a filter that begins anew has a new trace"),
    (PREDICT, "time_s", float("inf"), "time_s inf, expected a number of seconds"),
    (PREDICT, "jacobian", np.full(9, np.nan).tobytes(), f"jacobian {NOT_A_NUMBER}"),
    (PREDICT, "point", np.full(9, np.inf).tobytes(), f"point {NOT_A_NUMBER}"),
    (PREDICT, "jacobian", None, "jacobian is missing"),
    (PREDICT, "blocks", ["a"], "jacobian has 9 numbers, expected 2 x 2"),
    (PREDICT, "blocks", ["z"], "block 'z' is not in the state at that time"),
    *((PREDICT, "blocks", one, "blocks are no list of distinct names") for one in NO_NAMES),
    (UPDATE, "text", None, "sensor None, expected a name"),
    (UPDATE, "text", ["\x1b[2J\n" * 1000] * 9, "sensor ['\\x1b[2J\\n"),
    (UPDATE, "used", 2, "used is 2, expected 0 or 1"),
    (UPDATE, "residual", b"", "residual is empty"),
    (UPDATE, "residual", bytes(24), "jacobian has 4 numbers, expected 3 x 2"),
    (UPDATE, "noise", H.tobytes()[8:], "noise has 3 numbers, expected 2 x 2"),
    (UPDATE, "correction", bytes(16), "correction has 2 numbers, expected 3"),
    (UPDATE, "gain", bytes(16), "gain has 2 numbers, expected 3 x 2"),
    (UPDATE, "weight", np.array([1.5]).tobytes(), "weight is 1.5, expected 0 to 1"),
    (UPDATE, "weight", bytes(16), "weight has 2 numbers, expected 1"),
    (AUGMENT, "text", ["a", 1, "additive"], "new block 'a' is in the state already"),
    (AUGMENT, "text", ["c", 20000, "additive"], "jacobian has 2 numbers, expected 20000 x 2"),
    (AUGMENT, "text", ["c", True, "se2"], "text ['c', True, 'se2'], expected a name, a dimension"),
    (AUGMENT, "text", ["c", 1, "x"], "text ['c', 1, 'x'], expected a name, a dimension and a"),
    (AUGMENT, "text", [[[]], 1, "se2"], "the new block's name is not a text"),
    (AUGMENT, "noise", bytes(24), "noise_jacobian has 2 numbers, expected 1 x 1"),
    (AUGMENT, "noise_jacobian", bytes(8), "noise_jacobian has 1 numbers, expected 1 x 2"),
    (CLONE, "blocks", ["a", "b"], "clones 2 blocks, expected one"),
    (CLONE, "text", '"b"', "new block 'b' is in the state already"),
    (CLONE, "text", None, "the new block's name is not a text"),
    (RESET, "jacobian", bytes(16), "jacobian has 2 numbers, expected 1 x 1"),
    (SNAPSHOT, "covariance", bytes(8), "covariance has 1 numbers, expected 2 x 2"),
    (SNAPSHOT, "error", bytes(8), "error has 1 numbers, expected 2"),
    (REMOVE, "blocks", ["a", "b", "c", "copy"], "removes the last block of the state"),
]


@pytest.mark.parametrize(("number", "column", "value", "said"), BAD_EVENTS)
def test_a_bad_event_is_one_line(
    trace: Path, number: int, column: str, value: Any, said: str
) -> None:
    edit(trace, number, column, value)
    assert refused(trace).startswith(f", event {number}: {said}")


UNSOUND = [
    (PRIOR, "covariance", np.full(9, np.nan), f"covariance (P) {NOT_A_NUMBER}"),
    (PRIOR, "covariance", np.diag([1.0, 1.0, -1.0]), "covariance (P) has a negative eigenvalue"),
    (PREDICT, "noise", np.full(9, np.inf), f"noise (Q) {NOT_A_NUMBER}"),
    (PREDICT, "noise", np.full(9, 1e300), f"noise (Q) {NOT_A_NUMBER}"),
    (PREDICT, "noise", np.diag([1.0, 1.0, -1e-6]), "noise (Q) has a negative eigenvalue"),
    (PREDICT, "noise", P + F, "noise (Q) is not symmetric"),
    (UPDATE, "noise", np.diag([1.0, -1.0]), "noise (R) has a negative eigenvalue"),
    (UPDATE, "noise", np.ones((2, 2)) - np.eye(2), "noise (R) has a negative eigenvalue"),
    (AUGMENT, "noise", np.diag([-1.0, 1.0]), "noise (R) has a negative eigenvalue"),
    (AUGMENT, "noise", np.full(4, np.nan), f"noise (R) {NOT_A_NUMBER}"),
]


@pytest.mark.parametrize(("number", "column", "value", "said"), UNSOUND)
def test_a_noise_that_is_no_covariance_is_kept_with_its_fault(
    trace: Path, number: int, column: str, value: Array, said: str
) -> None:
    edit(trace, number, column, value.tobytes())
    read = TraceReader(trace)
    assert len(list(read)) == 11
    assert read.unsound == {number: said}
    assert read.singular == {}


@pytest.mark.parametrize("value", [np.diag([1.0, 0.0]), np.ones((2, 2)), np.zeros((2, 2))])
def test_a_noise_of_a_perfect_measurement_is_singular(trace: Path, value: Array) -> None:
    edit(trace, UPDATE, "noise", value.tobytes())
    read = TraceReader(trace)
    assert len(list(read)) == 11
    assert (read.unsound, read.singular) == ({}, {UPDATE: "noise (R) is singular"})


def stored(path: Path) -> bytes:
    with closing(sqlite3.connect(path)) as file:
        ((data,),) = file.execute("SELECT data FROM batch")
    return bytes(data)


@pytest.mark.slow
def test_any_byte_of_a_batch_is_read_or_refused(trace: Path) -> None:
    """Whole events, or ValueError and InputError; and never more numbers than a batch may hold."""
    whole, draw, fine, said = stored(trace), random.Random(3), 0, list[str]()  # noqa: S311
    for length in range(0, len(whole), 11):
        with pytest.raises((ValueError, struct.error)):
            unpack(whole[:length])
    for trial in range(3000):
        damaged = bytearray(whole)
        for at in draw.sample(range(len(whole)), 1 + trial % 3):
            damaged[at] = draw.randrange(256)
        try:
            events = EventReader(trace).events(batch_rows(unpack(bytes(damaged)), 0))
        except ValueError as error:  # InputError is one
            said.append(str(error))
        else:
            fine += len(events) == 11
    assert 0 < fine < 2900
    assert all(one.isprintable() for one in said)


BATCHES = {
    "no blob": ("data = 7", ", event 0: the batch is no blob"),
    "empty": ("data = x''", ", after event -1: the batch holds "),
    "many numbers": (
        f"data = x'{struct.pack('<4I4xI', 0, 2, 1, 0, 0).hex()}'",
        ", after event -1: the batch holds ",
    ),
    "another first": ("first = 1", ", event 1: stands after event -1, expected 0"),
    "other blocks": ("state = '[]'", ", event 10: the batch says that it has other events, or"),
    "no state": ("state = '['", ", event 10: the batch says that it has other events, or leads"),
    "other count": ("events = 12", ", event 10: the batch says that it has other events, or leads"),
}


@pytest.mark.parametrize("name", BATCHES)
def test_a_bad_batch_is_one_line(trace: Path, name: str) -> None:
    changed, said = BATCHES[name]
    change(trace, f"UPDATE batch SET {changed}")  # noqa: S608
    assert refused(trace).startswith(said)


def test_a_batch_of_more_numbers_than_it_may_hold_is_refused() -> None:
    head = struct.pack("<4I", 0, 2, 4, 0) + b"[]".ljust(8, b"\0")
    with pytest.raises(ValueError, match="more than 4194344 numbers"):
        unpack(head + struct.pack("<4I", *[2**31] * 4))


@pytest.mark.parametrize("count", [50, 400])
def test_a_small_batch_takes_little_memory(count: int) -> None:
    """Of a hundred thousand numbers each, all as the first."""
    size = 100_000
    mask = np.arange(count * size) < size
    packed = np.packbits(mask, bitorder="little").tobytes()
    data = struct.pack("<4I", 0, 2, count, 0) + b"[]".ljust(8, b"\0")
    data += np.full(count, size, "<u4").tobytes() + packed + np.zeros(size).tobytes()
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="more than") if count == 400 else nullcontext():
            unpack(data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 50 * len(data) + 200e6
    assert count * size * 13 > 50 * len(data) + 200e6 or count == 50


def test_a_truncated_file_is_refused_at_any_length(trace: Path) -> None:
    whole = trace.read_bytes()
    for length in [*range(0, 200, 7), *range(200, len(whole), 3001), len(whole) - 1]:
        trace.write_bytes(whole[:length])
        said = refused(trace)
        assert "SQLite" in said or f": is cut off: {length} bytes, expected {len(whole)}" in said
    trace.write_bytes(whole)
    assert len(list(TraceReader(trace))) == 11


def test_damaged_bytes_are_read_or_refused(trace: Path) -> None:
    whole, draw = trace.read_bytes(), random.Random(1)  # noqa: S311
    used = [at for at in range(len(whole)) if whole[at]]
    said = []
    for _ in range(300):
        damaged = bytearray(whole)
        for at in draw.sample(used, 3):
            damaged[at] = draw.randrange(256)
        trace.write_bytes(damaged)
        try:
            list(TraceReader(trace))
        except InputError as error:
            said.append(str(error))
    assert len(said) > 100
    assert all(one.isprintable() for one in said)


def test_pages_that_lead_to_the_same_pages_end(trace: Path) -> None:
    """A tree of 12 pages that is walked 50^10 times."""
    size, fan = 512, 50
    trace.unlink()
    with closing(sqlite3.connect(trace)) as file:
        for pragma in (
            f"page_size = {size}",
            f"application_id = {reader.APPLICATION}",
            "user_version = 2",
        ):
            file.execute(f"PRAGMA {pragma}")
        for table in TABLES.values():
            file.execute(table)
        file.execute("INSERT INTO batch VALUES (0, 1, 0, 0, '[]', x'00')")
        file.commit()
    pages = bytearray(trace.read_bytes())
    count = len(pages) // size
    leaf = pages[size : 2 * size]
    for level in range(10):
        child = count + level + 1
        cells = b"".join(struct.pack(">IB", child, key) for key in range(fan))
        start = size - len(cells)
        head = struct.pack(">BHHHBI", 5, 0, fan, start, 0, child)
        pointers = b"".join(struct.pack(">H", start + 5 * key) for key in range(fan))
        page = (head + pointers).ljust(start, b"\0") + cells
        if level == 0:
            pages[size : 2 * size] = page
        else:
            pages += page
    pages += leaf
    pages[28:32] = struct.pack(">I", len(pages) // size)
    trace.write_bytes(pages)
    begin = time.process_time()
    assert "interrupted" in refused(trace)
    assert time.process_time() - begin < 5.0


BAD_FILES: dict[str, tuple[tuple[str, ...], str]] = {
    "another application": (("PRAGMA application_id = 7",), ": is no filter's trace, but another"),
    "an earlier version": (
        ("PRAGMA user_version = 1", "DROP TABLE batch", "CREATE TABLE event (number INTEGER)"),
        ": is a trace of version 1, of a development version after slamcheck 0.2, which no "
        "release reads; record the filter anew with slamcheck.Recorder",
    ),
    "a later version": (("PRAGMA user_version = 3",), ": is a trace of version 3, expected 2; use"),
    "a table more": (("CREATE TABLE x (y)",), ": table 'x' is not as a recorder's"),
    "an index": (("CREATE INDEX x ON batch (events)",), ": table 'x' is not as a recorder's"),
    "a trigger": (
        ("CREATE TRIGGER batch AFTER INSERT ON batch BEGIN DELETE FROM batch; END",),
        ": table 'batch' is not as a recorder's",
    ),
    "a view": (
        ("ALTER TABLE batch RENAME TO x", "CREATE VIEW batch AS SELECT * FROM x"),
        " is not as a recorder's",
    ),
    "a generated column": (
        ("DROP TABLE sensor", TABLES["sensor"].replace("gate REAL", "gate REAL AS (0.5)")),
        ": table 'sensor' is not as a recorder's",
    ),
    "a table less": (("DROP TABLE sensor",), ": table 'sensor' is not as a recorder's"),
    "no events": (("DELETE FROM batch",), ": holds no events, expected a filter's trace"),
    "a write-ahead log": (("PRAGMA journal_mode = WAL",), ": has a write-ahead log, which a trace"),
    "a gate of two": (("UPDATE sensor SET gate = 2",), ", sensor 'gps': gate 2.0 or components"),
    "a gate of text": (("UPDATE sensor SET gate = 'x'",), ", sensor 'gps': gate 'x' or components"),
    "a nameless sensor": (("UPDATE sensor SET name = NULL",), ", sensor None: gate 0.99 or"),
    "components of a number": (("UPDATE sensor SET components = 7",), ", sensor 'gps': gate 0.99"),
    "text that is no UTF-8": (
        ("UPDATE batch SET state = CAST(x'ff' AS TEXT)",),
        ": SQLite cannot read it (Could not decode to UTF-8 column 'state'",
    ),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_is_one_line(trace: Path, name: str) -> None:
    statements, said = BAD_FILES[name]
    for sql in statements:
        change(trace, sql)
    assert said in refused(trace)


def garbage(seed: int, size: int) -> bytes:
    return random.Random(seed).randbytes(size)  # noqa: S311


NO_SQLITE = ": is not an SQLite file, expected a filter's trace"
OTHERS: dict[str, tuple[Callable[[Path], object], str]] = {
    "text": (lambda path: path.write_bytes(b"number,kind\n0,prior\n"), NO_SQLITE),
    "nothing": (lambda path: path.write_bytes(b""), NO_SQLITE),
    "garbage": (lambda path: path.write_bytes(garbage(2, 200_000)), NO_SQLITE),
    "garbage behind the head": (
        lambda path: path.write_bytes(path.read_bytes()[:100] + garbage(3, 131_072 - 100)),
        ": SQLite cannot read it (",
    ),
    "missing": (Path.unlink, ": no such file, expected a filter's trace"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_another_file_is_one_line(trace: Path, name: str) -> None:
    make, said = OTHERS[name]
    make(trace)
    assert refused(trace).startswith(said)


@pytest.mark.parametrize("make", [os.mkdir, os.mkfifo])
@pytest.mark.parametrize("which", ["", "-journal"])
def test_what_is_no_file_is_one_line(trace: Path, which: str, make: Callable[[Path], None]) -> None:
    place = Path(f"{trace}{which}")
    place.unlink(missing_ok=True)
    make(place)
    assert refused(trace).startswith(f"{which}: is not a regular file")


def test_a_folder_without_a_name_is_one_line() -> None:
    for path in (Path("."), Path("/"), Path("..")):
        with pytest.raises(InputError, match=f"^{path}: is not a regular file$"):
            TraceReader(path)


def test_an_unreadable_file_is_one_line(trace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", denied)
    assert refused(trace) == ": cannot be read (Permission denied)"


def test_a_value_beyond_the_limit_is_not_loaded(
    trace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reader, "_LONGEST_BYTES", 100_000)
    assert len(list(TraceReader(trace))) == 11
    change(trace, "UPDATE batch SET data = zeroblob(200000)")
    said = refused(trace)
    assert said.startswith(": SQLite cannot read it (string or blob too big)")


PAGE = (Path(__file__).resolve().parents[3] / "docs" / "audit-format.md").read_text("utf-8")


def test_the_page_has_the_tables_and_kinds_as_they_are() -> None:
    assert re.findall(r"^CREATE TABLE .*$", PAGE, re.MULTILINE) == list(TABLES.values())
    assert f"{reader.APPLICATION} (0x{reader.APPLICATION:X})" in PAGE
    rows = dict(re.findall(r"^\| `(\w+)` \| [^|]* \|[^|]*\|(.*)\|$", PAGE, re.MULTILINE))
    assert list(rows) == list(KINDS)
    for kind, ours in COLUMNS.items():
        assert tuple(re.findall(r"`(\w+)`", rows[kind])) == ours, kind


def test_the_pages_example_is_a_trace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (text,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    exec(compile(text, "audit-format.md", "exec"), {})  # noqa: S102
    assert audit(tmp_path / "by-hand.events").sound
    shown = "$ slamcheck audit by-hand.events\nverdict: sound\n"
    assert f"```console\n{shown}```" in PAGE  # what the command prints first
    assert kinds(tmp_path / "by-hand.events") == ["TracePrior", "Predict", "Update", "Snapshot"]


def test_an_odd_name_is_read(tmp_path: Path) -> None:
    for name in ("a b.trace", "100%?x=1#y.trace", "\u661f's.trace", "-.trace"):
        assert len(list(TraceReader(record(tmp_path / name)))) == 11


def faults(stack: Array, *, definite: bool) -> list[tuple[int, str]]:
    """What the reader says of matrices."""
    return list(trace_rows._faults(stack, definite=definite))


def covariance(smallest: float, draw: np.random.Generator, n: int = 5) -> Array:
    """A matrix of odd units whose correlation-like form has this least eigenvalue."""
    axes = np.linalg.qr(draw.standard_normal((n, n)))[0]
    values = np.append(draw.uniform(0.5, 2.0, n - 1), smallest)
    unit = axes @ np.diag(values) @ axes.T
    sigma = 10.0 ** draw.uniform(-6, 6, n)
    found: Array = unit * np.outer(sigma, sigma)
    return 0.5 * (found + found.T)


@pytest.mark.parametrize("definite", [True, False])
def test_definiteness_is_that_of_the_eigenvalues(definite: bool) -> None:
    draw = np.random.default_rng(4)
    cases: list[tuple[float, bool]] = [
        (1e-3, True), (1e-7, True), (-1e-12, not definite), (-1e-6, False), (-0.1, False),
    ]  # fmt: skip
    for smallest, sound in cases:
        for _ in range(20):
            stack = np.stack([covariance(0.1, draw), covariance(smallest, draw)])
            found = faults(stack, definite=definite)
            assert [index for index, _ in found] == ([] if sound else [1]), smallest


def test_known_entries_have_no_variance() -> None:
    nothing = np.zeros((1, 3, 3))
    assert faults(nothing, definite=False) == []
    assert faults(nothing, definite=True) == [(0, "is singular")]
    half = nothing.copy()
    half[0, :2, :2] = 1.0
    assert faults(half, definite=False) == []
    for within in (1.0, 0.5):
        half[0, 0, 1] = half[0, 1, 0] = within
        half[0, 1, 2] = half[0, 2, 1] = 1e-3
        assert faults(half, definite=False) == [(0, "has a negative eigenvalue")]


@pytest.mark.parametrize(("turn", "sound"), [(1e-8, True), (1e-4, False)])
def test_asymmetry_beyond_rounding_is_named(turn: float, sound: bool) -> None:
    draw = np.random.default_rng(5)
    wrong = covariance(0.5, draw)
    wrong[1, 3] += turn * np.sqrt(wrong[1, 1] * wrong[3, 3])
    found = faults(np.stack([wrong] * 3), definite=True)
    assert found == ([] if sound else [(i, "is not symmetric") for i in range(3)])


def test_single_precision_is_allowed_its_rounding() -> None:
    """A singular Q of a filter that computes in float32; not a negative one, nor one in float64."""
    g = np.random.default_rng(6).standard_normal((40, 3, 1)).astype(np.float32)
    q = (g @ g.transpose(0, 2, 1)).astype(np.float64)
    assert np.linalg.eigvalsh(q).min() < -1e-9
    assert faults(q, definite=False) == []
    wrong = q.copy()
    wrong[7] -= np.float32(1e-3) * np.eye(3)
    found = faults(wrong.astype(np.float32).astype(np.float64), definite=False)
    assert found == [(7, "has a negative eigenvalue")]
    double = q.copy()
    double[:, 0, 0] *= 1.0 + 1e-12
    assert faults(double, definite=False)


def test_all_of_several_faults_are_named(tmp_path: Path) -> None:
    """Covariances are checked by the hundred; a matrix is stored once, and wrong at each use."""
    path = tmp_path / "run.trace"
    with Recorder(path) as recorder:
        recorder.prior({"a": 1}, 1.0)
        for number in range(1, 500):
            recorder.predict(1.0, -1.0 if number in (303, 310) else float(number))
        recorder.update("gps", 1.0, 1.0, -1.0)
    read = TraceReader(path)
    assert len(list(read)) == 501
    negative = "noise (Q) has a negative eigenvalue"
    unsound = {303: negative, 310: negative, 500: "noise (R) has a negative eigenvalue"}
    assert read.unsound == unsound
    edit(path, 302, "jacobian", b"")
    assert refused(path) == ", event 302: jacobian has 0 numbers, expected 1 x 1"


def test_a_recording_is_read_while_it_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "run.trace"
    with Recorder(path) as recorder:
        recorder.prior({"a": 1}, 1.0)
        for _ in range(3000):
            recorder.predict(1.0, 1.0)
        events = iter(TraceReader(path))
        for _ in range(1000):
            next(events)
        for _ in range(3000):
            recorder.predict(1.0, 1.0)
        rest = sum(1 for _ in events)
    assert rest == 5000
    assert len(list(TraceReader(path))) == 6001


@pytest.mark.slow
def test_memory_holds_few_events_at_once(tmp_path: Path) -> None:
    """Sixty snapshots of 2 MB: only some of them are held."""
    path, n = tmp_path / "run.trace", 500
    draw = np.random.default_rng(1)
    with Recorder(path) as recorder:
        recorder.prior({"a": n}, np.eye(n))
        for _ in range(60):
            recorder.snapshot(draw.standard_normal((n, n)))
    tracemalloc.start()
    found = kinds(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.count("Snapshot") == 60
    assert peak < 0.6 * 60 * 8 * n**2


def test_matrices_that_are_repeated_are_one(trace: Path) -> None:
    events: list[Any] = list(TraceReader(trace))
    first, again, used, rejected = events[2:6]
    assert first.jacobian is again.jacobian
    assert used.noise is rejected.noise


def test_rounding_beside_the_state_is_no_negative_noise(tmp_path: Path) -> None:
    """Of a block that stands still, as a regression leaves it; what is larger is a fault."""
    for noise, sound in ((2e-16, True), (2e-7, False)):
        q = np.diag((0.01, 0.0)) + noise * np.array(((0.0, 1.0), (1.0, -1.0)))
        with Recorder(tmp_path / f"{noise}.trace") as recorder:
            recorder.prior({"pose": 1, "landmark": 1}, np.diag((0.1, 0.5)))
            recorder.predict(np.eye(2), q)
        read = TraceReader(tmp_path / f"{noise}.trace")
        assert len(list(read)) == 2
        assert read.unsound == ({} if sound else {1: "noise (Q) has a negative eigenvalue"})


def test_a_reading_that_is_given_up_may_be_closed_by_another_thread(tmp_path: Path) -> None:
    """As garbage that an error leaves is, whose frames any thread may collect."""
    events = iter(TraceReader(record(tmp_path / "run.trace")))
    next(events)
    assert isinstance(events, Generator)
    with ThreadPoolExecutor(1) as other:
        other.submit(events.close).result()
