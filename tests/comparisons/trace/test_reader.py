"""Traces are read as they were recorded; a bad one is one line with the event's number."""

from __future__ import annotations

import os
import random
import re
import sqlite3
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.audit.audit import audit
from comparisons.errors import InputError
from comparisons.trace import reader
from comparisons.trace import rows as trace_rows
from comparisons.trace.events import Event, Predict, Update
from comparisons.trace.reader import TABLES, Trace
from comparisons.trace.recorder import _COLUMNS, Recorder
from comparisons.trace.rows import EventReader

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
        list(Trace(path))
    said = str(found.value)
    assert said.startswith(str(path))
    assert said.isprintable()
    assert len(said) < len(str(path)) + 400
    return said.removeprefix(str(path))


def plain(event: Event) -> tuple[Any, ...]:
    return tuple(x.tolist() if isinstance(x, np.ndarray) else x for x in event)


def test_every_kind_is_read_as_it_was_recorded(trace: Path) -> None:
    found = Trace(trace)
    assert found.counts == (11, 2, 1)
    assert found.sensors == {"gps": (0.99, ("x", "y"))}
    events = list(found)
    names = [type(event).__name__ for event in events]
    assert names == [
        *("Prior", "Directions", "Predict", "Predict", "Update", "Update", "Augment"),
        *("Clone", "Reset", "Snapshot", "Remove"),
    ]
    a, ab, r = ("a",), ("a", "b"), R.tolist()
    basis = [[1.0, 0.0], [0.0, 1.0], [0.0, 2.0]]
    gain = [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]
    assert [plain(event) for event in events] == [
        (0, None, ab, (2, 1), P.tolist()),
        (1, None, ab, basis, ("shift", "turn"), ("odometry",)),
        (2, 0.5, ab, F.tolist(), Q.tolist()),
        (3, 1.0, ab, F.tolist(), Q.tolist()),
        (4, 1.0, "gps", a, [0.1, 0.2], H.tolist(), r, True, [1.0, 2.0, 3.0], gain),
        (5, 1.0, "gps", a, [9.0, 9.0], H.tolist(), r, False, None, None),
        (6, 1.0, "c", a, [[1.0, 2.0]], [[1.0, 0.5]], r),
        (7, 1.0, "copy", "a"),
        (8, 1.0, ("b",), [[2.0]]),
        (9, 1.0, ("b", "c"), [[1.0, 0.0], [0.0, 1.0]], [1.0, 2.0, 3.0, 4.0], [0.5, 0.25]),
        (10, 1.0, ("b", "copy")),
    ]
    assert [plain(event) for event in found] == [plain(event) for event in events], "once more"


SET = "UPDATE event SET "
BAD_EVENTS: list[tuple[int, str, Any, str]] = [
    (PRIOR, "covariance", b"", "covariance has 0 numbers, expected 3 x 3"),
    (PRIOR, "covariance", P.tobytes()[:-1], "covariance is not a blob of float64 numbers"),
    (PRIOR, "covariance", None, "covariance is not a blob of float64 numbers"),
    (PRIOR, "note", "[20000, 20000]", "makes the state larger than 20000 entries"),
    (PRIOR, "note", "[20000, 1]", "makes the state larger than 20000 entries"),
    (PRIOR, "note", "[19999, 1]", "covariance has 9 numbers, expected 20000 x 20000"),
    (PRIOR, "note", "[1e9, 1]", "blocks and note are not lists of names and of dimensions"),
    (PRIOR, "note", "[true, 1]", "blocks and note are not lists of names and of dimensions"),
    (PRIOR, "note", "[0, 3]", "blocks and note are not lists of names and of dimensions"),
    (PRIOR, "note", "[2]", "blocks and note are not lists of names and of dimensions"),
    (PRIOR, "note", "[" * 100_000, "blocks and note are not lists of names and of dimensions"),
    (PRIOR, "blocks", '["a", "a"]', "blocks and note are not lists of names and of dimensions"),
    (PRIOR, "blocks", "[]", "blocks and note are not lists of names and of dimensions"),
    (PRIOR, "kind", "predict", "is a predict, expected the prior first"),
    (DIRECTIONS, "note", "{}", "note is not {names: [...], blind: [...]}, both not empty"),
    (DIRECTIONS, "note", "7", "note is not {names: [...], blind: [...]}, both not empty"),
    (DIRECTIONS, "jacobian", bytes(8), "jacobian has 1 numbers, expected 3 x 2"),
    (PREDICT, "kind", "prior", "is a second prior; a filter that begins anew has a new trace"),
    (PREDICT, "kind", "dance", "kind 'dance', expected one of prior, predict, update, augment, "),
    (PREDICT, "kind", "\x1b[2J\n" * 1000, "kind '\\x1b[2J\\n"),
    (PREDICT, "time_s", "noon", "time_s 'noon', expected a number of seconds"),
    (PREDICT, "time_s", float("inf"), "time_s inf, expected a number of seconds"),
    (PREDICT, "jacobian", np.full(9, np.nan).tobytes(), "jacobian has a number that is not finite"),
    (PREDICT, "noise", np.full(9, np.inf).tobytes(), "noise has a number that is not finite"),
    (PREDICT, "noise", np.full(9, 1e300).tobytes(), "noise has a number that is not finite, or"),
    (PREDICT, "jacobian", None, "jacobian is missing, and the event before of this kind, sensor"),
    (PREDICT, "blocks", '["a"]', "jacobian has 9 numbers, expected 2 x 2"),
    (PREDICT, "blocks", '["z"]', "block 'z' is not in the state at that time"),
    (PREDICT, "blocks", '["a", "b"', 'blocks \'["a", "b"\', expected a list of distinct names'),
    (PREDICT, "blocks", "[" * 100_000, "blocks '[[[[["),
    (PREDICT, "blocks", '"a"', "blocks '\"a\"', expected a list of distinct names"),
    (PREDICT, "blocks", "[]", "blocks '[]', expected a list of distinct names"),
    (PREDICT, "blocks", "[1]", "blocks '[1]', expected a list of distinct names"),
    (PREDICT, "noise", np.diag([1.0, 1.0, -1e-6]).tobytes(), "noise (Q) has a negative eigenvalue"),
    (PREDICT, "noise", (P + F).tobytes(), "noise (Q) is not symmetric"),
    (AGAIN, "blocks", '["b", "a"]', "jacobian is missing, and the event before of this kind"),
    (UPDATE, "sensor", None, "sensor None, expected a name"),
    (UPDATE, "used", 2, "used is 2, expected 0 or 1"),
    (UPDATE, "used", None, "used is None, expected 0 or 1"),
    (UPDATE, "residual", b"", "residual is empty"),
    (UPDATE, "residual", bytes(24), "jacobian has 4 numbers, expected 3 x 2"),
    (UPDATE, "noise", np.diag([1.0, 0.0]).tobytes(), "noise (R) is not positive definite"),
    (UPDATE, "noise", np.ones((2, 2)).tobytes(), "noise (R) is not positive definite"),
    (UPDATE, "noise", H.tobytes()[8:], "noise has 3 numbers, expected 2 x 2"),
    (UPDATE, "correction", bytes(16), "correction has 2 numbers, expected 3"),
    (UPDATE, "gain", bytes(16), "gain has 2 numbers, expected 3 x 2"),
    (REJECT, "residual", bytes(8), "jacobian is missing, and the event before of this kind"),
    (REJECT, "sensor", "radar", "jacobian is missing, and the event before of this kind"),
    (AUGMENT, "note", '["a", 1]', "new block 'a' is in the state already"),
    (AUGMENT, "note", '["c", 20000]', "jacobian has 2 numbers, expected 20000 x 2"),
    (AUGMENT, "note", '["c", true]', "note '[\"c\", true]', expected a name and a dimension"),
    (AUGMENT, "note", f"[{'[' * 500}{']' * 500}, 1]", "the new block's name is not a text"),
    (AUGMENT, "noise", bytes(24), "noise has 3 numbers, expected 1 x 1"),
    (AUGMENT, "noise", np.diag([-1.0, 1.0]).tobytes(), "noise (R) has a negative eigenvalue"),
    (AUGMENT, "noise_jacobian", bytes(8), "noise_jacobian has 1 numbers, expected 1 x 2"),
    (CLONE, "blocks", '["a", "b"]', "clones 2 blocks, expected one"),
    (CLONE, "note", "b", "new block 'b' is in the state already"),
    (CLONE, "note", None, "the new block's name is not a text"),
    (RESET, "jacobian", bytes(16), "jacobian has 2 numbers, expected 1 x 1"),
    (SNAPSHOT, "covariance", bytes(8), "covariance has 1 numbers, expected 2 x 2"),
    (SNAPSHOT, "mean", "1", "mean is not a blob of float64 numbers"),
    (SNAPSHOT, "error", bytes(8), "error has 1 numbers, expected 2"),
    (REMOVE, "blocks", '["a", "b", "c", "copy"]', "removes the last block of the state"),
    (REMOVE, "number", 12, "stands after event 9, expected 10"),
]


@pytest.mark.parametrize(("number", "column", "value", "said"), BAD_EVENTS)
def test_a_bad_event_is_one_line(
    trace: Path, number: int, column: str, value: Any, said: str
) -> None:
    change(trace, f"{SET}{column} = ? WHERE number = ?", value, number)
    at = value if column == "number" else number
    assert refused(trace).startswith(f", event {at}: {said}")


def test_a_removed_block_is_gone(trace: Path) -> None:
    change(
        trace,
        "INSERT INTO event (number, kind, sensor, blocks, used, jacobian, noise, residual) "
        "SELECT 11, kind, sensor, blocks, used, jacobian, noise, residual FROM event "
        "WHERE number = 4",
    )
    assert list(Trace(trace))[-1].number == 11
    change(trace, SET + "blocks = '[\"copy\"]' WHERE number = 11")
    assert refused(trace) == ", event 11: block 'copy' is not in the state at that time"


def test_a_gap_in_the_numbers_is_named(trace: Path) -> None:
    change(trace, "DELETE FROM event WHERE number = 5")
    assert refused(trace) == ", event 6: stands after event 4, expected 5"


HOSTILE: tuple[Any, ...] = (
    *(None, 0, -1, 2**62, 1.5, float("inf"), "", "x", "1", "null", "[]", "{}", '["a"]', '["a", 1]'),
    *("[" * 2000, "[1]", '{"names": 1}', "\x00", b"", b"x", bytes(8), bytes(72), b"\xff" * 72),
)
"""Values to put in any column."""


def test_any_value_in_any_column_is_read_or_refused(trace: Path) -> None:
    """Nothing but InputError, with the number of the event or a later one that it spoils."""
    with closing(sqlite3.connect(trace)) as file:
        rows = file.execute("SELECT * FROM event").fetchall()
    said = []
    for number, row in enumerate(rows):
        for column in range(len(row)):
            for value in HOSTILE:
                changed = [*rows[:number], (*row[:column], value, *row[column + 1 :])]
                try:
                    EventReader(trace).events([*changed, *rows[number + 1 :]])
                except InputError as error:
                    said.append(str(error))
    assert len(said) > 1500
    for one in said:
        assert one.isprintable()
        assert one.startswith(f"{trace}, event ")
        assert len(one) < len(str(trace)) + 300


def test_a_truncated_file_is_refused_at_any_length(trace: Path) -> None:
    whole = trace.read_bytes()
    for length in [*range(0, 200, 7), *range(200, len(whole), 3001), len(whole) - 1]:
        trace.write_bytes(whole[:length])
        said = refused(trace)
        assert "SQLite" in said or f": is cut off: {length} bytes, expected {len(whole)}" in said
    trace.write_bytes(whole)
    assert len(list(Trace(trace))) == 11


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
            list(Trace(trace))
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
            "user_version = 1",
        ):
            file.execute(f"PRAGMA {pragma}")
        for table in TABLES.values():
            file.execute(table)
        file.execute("INSERT INTO event (number, kind, blocks) VALUES (0, 'prior', '[]')")
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
    "a later version": (("PRAGMA user_version = 2",), ": is a trace of version 2, expected 1; use"),
    "a table more": (("CREATE TABLE x (y)",), ": table 'x' is not as a recorder's"),
    "an index": (("CREATE INDEX x ON event (kind)",), ": table 'x' is not as a recorder's"),
    "a trigger": (
        ("CREATE TRIGGER event AFTER INSERT ON event BEGIN DELETE FROM event; END",),
        ": table 'event' is not as a recorder's",
    ),
    "a view": (
        ("ALTER TABLE event RENAME TO x", "CREATE VIEW event AS SELECT * FROM x"),
        " is not as a recorder's",
    ),
    "a generated column": (
        ("DROP TABLE sensor", TABLES["sensor"].replace("gate REAL", "gate REAL AS (0.5)")),
        ": table 'sensor' is not as a recorder's",
    ),
    "a table less": (("DROP TABLE sensor",), ": table 'sensor' is not as a recorder's"),
    "no events": (("DELETE FROM event",), ": holds no events, expected a filter's trace"),
    "a write-ahead log": (("PRAGMA journal_mode = WAL",), ": has a write-ahead log, which a trace"),
    "a gate of two": (("UPDATE sensor SET gate = 2",), ", sensor 'gps': gate 2.0 or components"),
    "a gate of text": (("UPDATE sensor SET gate = 'x'",), ", sensor 'gps': gate 'x' or components"),
    "a nameless sensor": (("UPDATE sensor SET name = NULL",), ", sensor None: gate 0.99 or"),
    "components of a number": (("UPDATE sensor SET components = 7",), ", sensor 'gps': gate 0.99"),
    "text that is no UTF-8": (
        ("UPDATE event SET blocks = CAST(x'ff' AS TEXT) WHERE number = 3",),
        ", after event 2: SQLite cannot read it (Could not decode to UTF-8 column 'blocks'",
    ),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_is_one_line(trace: Path, name: str) -> None:
    statements, said = BAD_FILES[name]
    for sql in statements:
        change(trace, sql)
    assert said in refused(trace)


def _missing(path: Path) -> None:
    path.unlink()


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def _piped_journal(path: Path) -> None:
    os.mkfifo(f"{path}-journal")


def _garbage(path: Path) -> None:
    path.write_bytes(random.Random(2).randbytes(200_000))  # noqa: S311


def _garbage_pages(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:100] + random.Random(3).randbytes(131_072 - 100))  # noqa: S311


def _text(path: Path) -> None:
    path.write_text("number,kind\n0,prior\n")


def _empty(path: Path) -> None:
    path.write_bytes(b"")


def _garbage_journal(path: Path) -> None:
    Path(f"{path}-journal").mkdir()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (_missing, ": no such file, expected a filter's trace"),
        (_folder, ": is not a regular file"),
        (_pipe, ": is not a regular file"),
        (_piped_journal, "-journal: is not a regular file"),
        (_garbage_journal, "-journal: is not a regular file"),
        (_garbage, ": is not an SQLite file, expected a filter's trace"),
        (_text, ": is not an SQLite file, expected a filter's trace"),
        (_empty, ": is not an SQLite file, expected a filter's trace"),
        (_garbage_pages, ": SQLite cannot read it ("),
    ],
)
def test_what_is_no_trace_is_one_line(trace: Path, make: Callable[[Path], None], said: str) -> None:
    make(trace)
    assert refused(trace).startswith(said)


def test_a_folder_without_a_name_is_one_line() -> None:
    for path in (Path("."), Path("/"), Path("..")):
        with pytest.raises(InputError, match=f"^{path}: is not a regular file$"):
            Trace(path)


def test_an_unreadable_file_is_one_line(trace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", denied)
    assert refused(trace) == ": cannot be read (Permission denied)"


def test_a_value_beyond_the_limit_is_not_loaded(
    trace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reader, "_LONGEST_BYTES", 100_000)
    assert len(list(Trace(trace))) == 11
    change(trace, SET + "noise = zeroblob(200000) WHERE number = 3")
    said = refused(trace)
    assert said.startswith(", after event 1: SQLite cannot read it (string or blob too big)")


PAGE = (Path(__file__).resolve().parents[3] / "docs" / "audit-format.md").read_text("utf-8")


def test_the_page_has_the_tables_and_kinds_as_they_are() -> None:
    assert re.findall(r"^CREATE TABLE .*$", PAGE, re.MULTILINE) == list(TABLES.values())
    assert f"{reader.APPLICATION} (0x{reader.APPLICATION:X})" in PAGE
    rows = dict(re.findall(r"^\| `(\w+)` \| [^|]* \|(.*)\|$", PAGE, re.MULTILINE))
    columns = set(re.findall(r"(\w+) (?:REAL|TEXT|INTEGER|BLOB)", TABLES["event"]))
    common = {"number", "kind", "time_s", "blocks"}
    for kind, ours in _COLUMNS.items():
        assert set(re.findall(r"`(\w+)`", rows[kind])) & columns - common == set(ours), kind


def test_the_pages_example_is_a_trace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (text,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    exec(compile(text, "audit-format.md", "exec"), {})  # noqa: S102
    assert audit(tmp_path / "by-hand.trace").sound
    events = list(Trace(tmp_path / "by-hand.trace"))
    assert [type(event).__name__ for event in events] == ["Prior", "Predict", "Update", "Snapshot"]


def test_an_odd_name_is_read(tmp_path: Path) -> None:
    for name in ("a b.trace", "100%?x=1#y.trace", "\u661f's.trace", "-.trace"):
        assert len(list(Trace(record(tmp_path / name)))) == 11


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
            found = trace_rows._fault(stack, definite=definite)
            assert (found is None) == sound, smallest
            if found is not None:
                assert found[0] == 1


def test_known_entries_have_no_variance() -> None:
    nothing = np.zeros((1, 3, 3))
    assert trace_rows._fault(nothing, definite=False) is None
    assert trace_rows._fault(nothing, definite=True) == (0, "is not positive definite")
    half = nothing.copy()
    half[0, :2, :2] = 1.0
    assert trace_rows._fault(half, definite=False) is None
    half[0, 1, 2] = half[0, 2, 1] = 1e-3
    assert trace_rows._fault(half, definite=False) == (0, "has a negative eigenvalue")


@pytest.mark.parametrize(("turn", "sound"), [(1e-8, True), (1e-4, False)])
def test_asymmetry_beyond_rounding_is_refused(turn: float, sound: bool) -> None:
    draw = np.random.default_rng(5)
    wrong = covariance(0.5, draw)
    wrong[1, 3] += turn * np.sqrt(wrong[1, 1] * wrong[3, 3])
    found = trace_rows._fault(np.stack([wrong] * 3), definite=True)
    assert found == (None if sound else (0, "is not symmetric"))


def test_the_first_of_several_faults_is_named(tmp_path: Path) -> None:
    """Covariances are checked by the hundred; an event before the wrong one is not blamed."""
    path = tmp_path / "run.trace"
    with Recorder(path) as recorder:
        recorder.prior({"a": 1}, 1.0)
        for number in range(1, 500):
            recorder.predict(1.0, -1.0 if number in (303, 310) else float(number))
        recorder.update("gps", 1.0, 1.0, -1.0)
    assert refused(path) == ", event 303: noise (Q) has a negative eigenvalue"
    change(path, SET + "jacobian = x'00' WHERE number = 305")
    assert refused(path) == ", event 303: noise (Q) has a negative eigenvalue"
    change(path, SET + "jacobian = x'00' WHERE number = 302")
    assert refused(path) == ", event 302: jacobian is not a blob of float64 numbers"


def test_a_recording_is_read_while_it_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "run.trace"
    with Recorder(path) as recorder:
        recorder.prior({"a": 1}, 1.0)
        for _ in range(3000):
            recorder.predict(1.0, 1.0)
        events = iter(Trace(path))
        for _ in range(1000):
            next(events)
        for _ in range(3000):
            recorder.predict(1.0, 1.0)
        rest = sum(1 for _ in events)
    assert rest == 5000
    assert len(list(Trace(path))) == 6001


def test_memory_holds_few_events_at_once(tmp_path: Path) -> None:
    """Sixty snapshots of 2 MB: only some of them are held."""
    path, n = tmp_path / "run.trace", 500
    with Recorder(path) as recorder:
        recorder.prior({"a": n}, np.eye(n))
        for _ in range(60):
            recorder.snapshot(np.eye(n))
    events_of, sizes = EventReader(path), []
    with closing(sqlite3.connect(path)) as file:
        rows: Iterator[Any] = file.execute("SELECT * FROM event")
        while events := events_of.events(rows):
            sizes.append(len(events))
    assert sum(sizes) == 61
    assert max(sizes) < 12


def test_matrices_that_are_repeated_are_one(trace: Path) -> None:
    first, again, used, rejected = list(Trace(trace))[2:6]
    assert isinstance(first, Predict)
    assert isinstance(again, Predict)
    assert isinstance(used, Update)
    assert isinstance(rejected, Update)
    assert first.jacobian is again.jacobian
    assert used.noise is rejected.noise
