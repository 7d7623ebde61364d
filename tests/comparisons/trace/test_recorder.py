"""A recorder leaves a sound trace of what was committed, whatever happens to it."""

import resource
import shutil
import signal
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from comparisons.errors import InputError
from comparisons.trace import reader
from comparisons.trace.batch import unpack
from comparisons.trace.events import Augment, Clone, Event, Predict, Snapshot, TracePrior, Update
from comparisons.trace.reader import TraceReader
from comparisons.trace.recorder import COMMIT_EVENTS, Recorder
from tests.processes import python

P = np.array([[2.0, 0.5], [0.5, 1.0]])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.trace"


def predictions(recorder: Recorder, count: int, start: int = 0) -> None:
    """Record predictions that all differ."""
    for step in range(start, start + count):
        recorder.predict([[1.0, float(step)], [0.0, 1.0]], P)


def matrices(path: Path) -> list[int]:
    """Sizes of the matrices that the batches store."""
    with closing(sqlite3.connect(path)) as file:
        data = file.execute("SELECT data FROM batch ORDER BY first").fetchall()
    return [0 if one is None else one.size for (each,) in data for one in unpack(each).arrays]


def numbers(path: Path) -> list[int]:
    return [event.number for event in TraceReader(path)]


def test_matrices_that_repeat_are_stored_once(path: Path) -> None:
    """Whatever the kind, the sensor and the blocks."""
    with Recorder(path) as recorder:
        recorder.prior({"a": 1, "b": 1}, P)
        for factor in (1.0, 1.0, 2.0, 2.0, 1.0):
            recorder.predict(factor * P, P)
        for sensor, block in (("x", "a"), ("y", "a"), ("x", "a"), ("x", "b"), ("x", "a")):
            recorder.update(sensor, 1.0, 1.0, 1.0, [block])
    assert matrices(path) == [4, 4, 1]
    found = [event.jacobian[0, 0] for event in TraceReader(path) if isinstance(event, Predict)]
    assert found == [2.0, 2.0, 4.0, 4.0, 2.0]


def test_events_of_every_kind_are_recorded_again_as_they_were(path: Path) -> None:
    with Recorder(path) as recorder:
        recorder.at(0.5)
        recorder.prior({"a": 1, "q": 1}, P, point=[1.0, 2.0], charts={"q": "so3 left"})
        recorder.directions({"east": [1.0, 0.0]}, ["x"])
        recorder.predict(P, P, point=[1.0, 2.0], after=[3.0, 4.0])
        recorder.at(0.75)
        notes: dict[str, Any] = {"correction": [1.0, 2.0], "gain": [[0.5], [0.25]], "numbers": [7]}
        recorder.update("x", 1.0, [[1.0, 0.5]], 2.0, weight=0.5, **notes)
        recorder.update("y", 1.0, 2.0, 2.0, ["a"], point=[1.0], function=np.exp, measured=[3.0])
        recorder.reject("x", 3.0, 1.0, 2.0, ["q"], point=[2.0])
        recorder.augment("new", 2.0, 1.0, 4.0, ["a"], after=[1.0], weight=0.0, chart="se2")
        recorder.clone("q", "copy")
        recorder.remove("a", "copy")
        recorder.reset(2.0, ["q"])
        recorder.snapshot(P, mean=[1.0, 2.0, 3.0], error=[0.5, 0.25])
    events = list(TraceReader(path))
    assert {type(event) for event in events} == set(get_args(Event))
    again = path.with_name("again.trace")
    with Recorder(again) as recorder:
        for event in events:
            recorder.event(event)
    for event, copied in zip(events, TraceReader(again), strict=True):
        for name, value in event._asdict().items():
            np.testing.assert_array_equal(getattr(copied, name), value, strict=value is not None)


def test_a_minute_of_an_inertial_filter_is_small(path: Path) -> None:
    """60 s of 15 states at 100 Hz, of which a tenth of F changes each time."""
    f, q, draw = np.eye(15), np.diag(np.arange(15.0)), np.random.default_rng(2)
    with Recorder(path) as recorder:
        recorder.prior({"a": 15}, np.eye(15))
        for step in range(6000):
            f[3:6, 6:9], f[3:6, 9:12], f[6:9, 6:9] = draw.standard_normal((3, 3, 3))
            recorder.at(0.01 * step)
            recorder.predict(f, q)
            if step % 10 == 0:
                z = draw.standard_normal(15)
                recorder.update("gnss", z[:3], np.eye(3, 15), np.eye(3), correction=z)
                recorder.snapshot(draw.standard_normal((15, 15)))
    assert path.stat().st_size < 6e6


def test_a_block_of_another_size_repeats_nothing(path: Path) -> None:
    """Zeros of 2 x 3 are the bytes of zeros of 3 x 2."""
    with Recorder(path) as recorder:
        recorder.prior({"a": 3, "b": 1}, np.eye(4))
        recorder.update("x", np.zeros(2), np.zeros((2, 3)), np.eye(2), ["a"])
        recorder.remove("a")
        recorder.augment("a", np.zeros((2, 1)), np.eye(2), np.eye(2), ["b"])
        recorder.update("x", np.zeros(3), np.zeros((3, 2)), np.eye(3), ["a"])
    shapes = [event.jacobian.shape for event in TraceReader(path) if isinstance(event, Update)]
    assert shapes == [(2, 3), (3, 2)]


def test_a_sensor_named_as_nothing_else_is_kept_apart(path: Path) -> None:
    names = ["g'p\"s", "\u661f/\\\n", "", "event", "'); DROP TABLE event; --"]
    with Recorder(path, gates=dict.fromkeys(names, 0.9)) as recorder:
        recorder.prior(dict.fromkeys(names, 1), np.eye(5))
        for k, name in enumerate(names):
            recorder.update(name, [1.0], [[k]], [[1.0]], [name])
        recorder.clone("", "\u661f")
        recorder.remove(*names)
    trace = TraceReader(path)
    assert list(trace.sensors) == names
    events = [event for event in trace if isinstance(event, Update)]
    assert [(event.sensor, *event.blocks) for event in events] == [(name, name) for name in names]
    assert [event.jacobian[0, 0] for event in events] == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_odd_forms_of_numbers_are_taken(path: Path) -> None:
    """Whole numbers, lists, columns, other layouts, a number for 1 x 1."""
    with Recorder(path) as recorder:
        recorder.prior({"a": 2}, [[2, 0], [0, 1]])
        recorder.predict(np.asfortranarray(np.arange(4).reshape(2, 2)), P[::-1, ::-1].T)
        recorder.update("x", 1, [[1, 0]], 4, correction=[[1], [2]], gain=[[3], [4]])
        recorder.update("x", np.ones((2, 1)), np.eye(2, dtype=np.float32), P)
        recorder.augment("c", [[1.0, 2.0]], 1.0, 2.0)
        recorder.augment("d", np.ones((2, 1)), np.zeros((2, 0)), np.zeros((0, 0)), ["c"])
        recorder.snapshot(np.eye(5), mean=3.0, error=np.ones((5, 1)))
    events: list[Any] = list(TraceReader(path))
    _, predict, update, second, _, other, snapshot = events
    assert predict.jacobian.tolist() == [[0.0, 1.0], [2.0, 3.0]]
    assert predict.noise.tolist() == [[1.0, 0.5], [0.5, 2.0]]
    assert update.correction.tolist() == [1.0, 2.0]
    assert second.residual.tolist() == [1.0, 1.0]
    assert other.noise_jacobian.shape == (2, 0)
    assert snapshot.mean.tolist() == [3.0]


class Odd:
    """Is no number."""


WRONG: list[tuple[Callable[[Recorder], None], str]] = [
    (lambda r: r.prior({"a": 1}, 1.0), "is a second prior; a filter that begins anew has a new"),
    (lambda r: r.predict(np.eye(3), P), "F is 3 x 3, expected 2 x 2"),
    (lambda r: r.predict(P, 1.0), "Q is a number, expected 2 x 2"),
    (lambda r: r.predict(P.ravel(), P), "F is 4, expected 2 x 2"),
    (lambda r: r.predict(P, [[1.0], [2.0, 3.0]]), "Q is not an array of numbers"),
    (lambda r: r.predict(P * 1j, P), "F is not an array of numbers"),
    (lambda r: r.predict(Odd(), P), "F is not an array of numbers"),  # type: ignore[arg-type]
    (lambda r: r.predict(P, P, ["z"]), "block 'z' is not in the state; it has a, b"),
    (lambda r: r.predict(P, P, []), "expected blocks, none of them twice"),
    (lambda r: r.predict(P, P, ["a", "a"]), "expected blocks, none of them twice"),
    (lambda r: r.update("x", [], np.zeros((0, 2)), np.zeros((0, 0))), "residual is empty"),
    (lambda r: r.update("x", P, P, P), "residual is 2 x 2, expected 4 numbers"),
    (lambda r: r.update("x", [1.0, 2.0], [[1.0, 0.0]], 1.0), "H is 1 x 2, expected 2 x 2"),
    (lambda r: r.update("x", 1.0, [[1.0, 0.0]], P), "R is 2 x 2, expected 1 x 1"),
    (
        lambda r: r.update("x", 1.0, [[1.0, 0.0]], 1.0, correction=P),
        "correction is 2 x 2, expected",
    ),
    (lambda r: r.update("x", 1.0, [[1.0, 0.0]], 1.0, gain=[[1.0, 2.0]]), "gain is 1 x 2, expected"),
    (lambda r: r.augment("a", P, P, P), "block 'a' is in the state already; remove it first"),
    (lambda r: r.augment("c", P, [1.0, 2.0], P), "G_z is not a matrix"),
    (lambda r: r.augment("c", [[1.0]], [[1.0]], 1.0), "G_x is 1 x 1, expected 1 x 2"),
    (lambda r: r.augment("c", np.ones((1, 2)), [[1.0]], P), "R is 2 x 2, expected 1 x 1"),
    (lambda r: r.clone("z", "c"), "block 'z' is not in the state; it has a, b"),
    (lambda r: r.clone("a", "b"), "block 'b' is in the state already; remove it first"),
    (lambda r: r.remove("a", "b"), "removes the last block of the state"),
    (lambda r: r.remove(), "expected blocks, none of them twice"),
    (lambda r: r.reset(1.0), "J is a number, expected 2 x 2"),
    (lambda r: r.snapshot(P, ["a"]), "P is 2 x 2, expected 1 x 1"),
    (lambda r: r.snapshot(P, error=[1.0]), "error is 1, expected 2 numbers"),
    (lambda r: r.directions({}, ["x"]), "directions or sensors are missing"),
    (lambda r: r.directions({"turn": [1.0, 2.0]}, ["x", "x"]), "directions or sensors are missing"),
    (lambda r: r.directions({"turn": [1.0]}, ["x"]), "basis of 'turn' is 1, expected 2 numbers"),
    (lambda r: r.at(float("nan")), "time_s is not finite"),
]


@pytest.mark.parametrize(("call", "said"), WRONG)
def test_a_wrong_call_records_nothing_and_the_recording_goes_on(
    path: Path, call: Callable[[Recorder], None], said: str
) -> None:
    with Recorder(path) as recorder:
        recorder.prior({"a": 1, "b": 1}, P)
        recorder.predict(P, P)
        with pytest.raises(InputError) as found:
            call(recorder)
        assert str(found.value).startswith(f"{path}, event 2: {said}")
        recorder.predict(P, P)
        recorder.clone("a", "c")
        recorder.update("x", 1.0, 1.0, 1.0, ["c"])
    assert [type(event).__name__ for event in TraceReader(path)] == [
        *("TracePrior", "Predict", "Predict", "Clone", "Update")
    ]


@pytest.mark.parametrize(
    ("blocks", "covariance", "said"),
    [
        ({}, np.zeros((0, 0)), "the state has 0 entries, expected 1 to 20000"),
        ({"a": 0}, np.zeros((0, 0)), "dimension 0, expected 1 to 20000"),
        ({"a": 1.5}, P, "dimension 1.5, expected 1 to 20000"),
        ({"a": 19_000, "b": 19_000}, P, "the state has 38000 entries, expected 1 to 20000"),
        ({"a": 3}, P, "P is 2 x 2, expected 3 x 3"),
    ],
)
def test_a_wrong_prior_may_be_mended(
    path: Path, blocks: dict[str, int], covariance: Any, said: str
) -> None:
    with Recorder(path) as recorder:
        with pytest.raises(InputError, match=f"event 0: {said}"):
            recorder.prior(blocks, covariance)
        with pytest.raises(InputError, match="event 0: expected blocks, none of them twice; rec"):
            recorder.predict(P, P)
        recorder.prior({"a": 2}, P)
    assert numbers(path) == [0]


@pytest.mark.parametrize("name", ["\ud800", 7, None])
def test_a_name_that_is_no_text_is_refused(path: Path, name: Any) -> None:
    with Recorder(path) as recorder:
        recorder.prior({"a": 2}, P)
        calls: list[Callable[[], None]] = [
            lambda: recorder.update(name, 1.0, [[1.0, 2.0]], 1.0),
            lambda: recorder.clone("a", name),
            lambda: recorder.directions({name: [1.0, 2.0]}, ["x"]),
        ]
        for call in calls:
            with pytest.raises(InputError, match="expected a text of whole characters"):
                call()
    assert numbers(path) == [0]


def test_what_is_known_of_sensors_is_checked_before_a_file_is_made(path: Path) -> None:
    for gate in (0.0, 1.0, 95.0, float("nan")):
        with pytest.raises(InputError, match=r"gate of 'gps' is .*, expected 0 < p < 1"):
            Recorder(path, gates={"gps": gate})
    for parts in ("xy", ("x", "x")):
        with pytest.raises(InputError, match="components of 'gps' are not distinct names"):
            Recorder(path, components={"gps": parts})
    assert not path.exists()


def test_an_existing_file_is_never_written_anew(path: Path, tmp_path: Path) -> None:
    with Recorder(path) as recorder:
        recorder.prior({"a": 2}, P)
    with pytest.raises(InputError, match="exists already; give a new name, or append=True"):
        Recorder(path)
    other = tmp_path / "notes.txt"
    other.write_text("mine")
    with pytest.raises(InputError, match="is not an SQLite file, expected a filter's trace"):
        Recorder(other, append=True)
    assert other.read_text() == "mine"
    with pytest.raises(InputError, match="no such file"):
        Recorder(tmp_path / "none", append=True)
    with pytest.raises(InputError, match="cannot be written \\(No such file or directory\\)"):
        Recorder(tmp_path / "none" / "run.trace")
    with pytest.raises(InputError, match="exists already"):
        Recorder(tmp_path)
    assert sorted(tmp_path.iterdir()) == [other, path]


def test_a_hostile_trace_is_not_appended_to(path: Path) -> None:
    with Recorder(path) as recorder:
        recorder.prior({"a": 2}, P)
    with closing(sqlite3.connect(path)) as file:
        file.execute("CREATE TRIGGER batch AFTER INSERT ON batch BEGIN DELETE FROM batch; END")
    with pytest.raises(InputError, match="table 'batch' is not as a recorder's"):
        Recorder(path, append=True)


def test_a_recording_is_gone_on_with(path: Path) -> None:
    """Blocks and numbers go on; no matrix is taken for one of before."""
    with Recorder(path, gates={"gps": 0.9}) as recorder:
        recorder.prior({"a": 2, "b": 1}, np.eye(3))
        recorder.clone("a", "copy")
        recorder.augment("new", [[1.0]], [[1.0]], 1.0, ["b"])
        recorder.remove("a")
        recorder.predict(P, P, ["copy"])
    for _ in range(2):
        with Recorder(path, append=True, gates={"gps": 0.95}) as recorder:
            recorder.predict(P, P, ["copy"])
            recorder.snapshot(np.eye(4))
    trace = TraceReader(path)
    assert trace.sensors["gps"].gate == 0.95
    events: list[Any] = list(trace)
    assert [event.number for event in events] == list(range(9))
    assert events[-1].blocks == ("b", "copy", "new")
    assert events[5].jacobian.tolist() == P.tolist()


def test_a_recording_without_events_is_gone_on_with(path: Path) -> None:
    Recorder(path).close()
    with pytest.raises(InputError, match="holds no events"):
        list(TraceReader(path))
    with Recorder(path, append=True) as recorder:
        recorder.prior({"a": 2}, P)
    assert numbers(path) == [0]


def _fail(recorder: Recorder) -> None:
    recorder.prior({"a": 2}, P)
    predictions(recorder, 10)
    raise ZeroDivisionError


def test_what_is_recorded_before_an_exception_stays(path: Path) -> None:
    recorder = Recorder(path)
    with pytest.raises(ZeroDivisionError), recorder:
        _fail(recorder)
    assert numbers(path) == list(range(11))
    for call in (recorder.commit, lambda: recorder.predict(P, P), lambda: recorder.remove("a")):
        with pytest.raises(InputError, match=r"run\.trace: is closed"):
            call()
    recorder.close()


def test_two_recorders_of_one_file_do_not_mix(path: Path) -> None:
    with Recorder(path) as recorder:
        recorder.prior({"a": 2}, P)
    one, two = Recorder(path, append=True), Recorder(path, append=True)
    predictions(one, 3)
    predictions(two, 5)
    one.commit()
    with pytest.raises(InputError, match=r"cannot be written \(UNIQUE .* ends before event 1$"):
        two.commit()
    with pytest.raises(InputError, match="ends before event 1"):
        two.predict(P, P)
    two.close()
    predictions(one, 3)
    one.close()
    assert numbers(path) == list(range(7))


@contextmanager
def little_room(size: int) -> Iterator[None]:
    """No file grows beyond a size."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_ends_the_recording(path: Path) -> None:
    with Recorder(path) as recorder:
        recorder.prior({"a": 2}, P)
        with little_room(500_000), pytest.raises(InputError) as found:
            predictions(recorder, 20_000)
        with pytest.raises(InputError, match="cannot be written"):
            recorder.predict(P, P)
    said = str(found.value)
    assert said.startswith(f"{path}: cannot be written (")
    end = int(said.split()[-1])
    assert end >= COMMIT_EVENTS
    assert numbers(path) == list(range(end))


def test_a_disk_without_room_for_the_first_page(path: Path) -> None:
    with little_room(1000), pytest.raises(InputError, match="cannot be written"):
        Recorder(path)
    assert not path.exists()


def test_a_file_that_is_removed_meanwhile_is_an_error(path: Path) -> None:
    recorder = Recorder(path)
    recorder.prior({"a": 2}, P)
    path.unlink()
    with pytest.raises(InputError, match="cannot be written"):
        recorder.close()
    assert not path.exists()


def test_an_interrupt_loses_no_event(path: Path) -> None:
    class Interrupted:
        """A connection whose first commit is interrupted."""

        def __init__(self, file: sqlite3.Connection) -> None:
            self._file, self._left = file, 1

        def execute(self, sql: str, *values: Any) -> Any:
            if sql == "COMMIT" and self._left:
                self._left = 0
                raise KeyboardInterrupt
            return self._file.execute(sql, *values)

        def __getattr__(self, name: str) -> Any:
            return getattr(self._file, name)

    recorder = Recorder(path)
    recorder._file = Interrupted(recorder._file)  # type: ignore[assignment]
    recorder.prior({"a": 2}, P)
    with pytest.raises(KeyboardInterrupt):
        recorder.commit()
    predictions(recorder, 3)
    recorder.close()
    assert numbers(path) == list(range(4))


def test_large_snapshots_are_written_early(path: Path) -> None:
    """Not two thousand of them are held in memory."""
    n = 500
    with Recorder(path) as recorder:
        recorder.prior({"a": n}, np.eye(n))
        for _ in range(20):
            recorder.snapshot(np.random.default_rng(_).standard_normal((n, n)))
        assert TraceReader(path).counts.events >= 15


CHILD = """
import os, signal, sys
import numpy as np
from comparisons.trace.recorder import Recorder

class Killed:
    def __init__(self, file):
        self.file, self.left = file, 2
    def execute(self, sql, *values):
        if sql == "COMMIT":
            self.left -= 1
            if self.left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
        return self.file.execute(sql, *values)
    def __getattr__(self, name):
        return getattr(self.file, name)

recorder = Recorder(sys.argv[1])
recorder.prior({"a": 20}, np.eye(20))
if sys.argv[2] == "kill":
    recorder._file.execute("PRAGMA cache_size = 10")
    recorder._file = Killed(recorder._file)
    for step in range(5000):
        recorder.predict(np.full((20, 20), step), np.eye(20))
recorder.predict(np.eye(20), np.eye(20))
child = os.fork()
if child == 0:
    recorder.predict(np.eye(20), np.eye(20))
    try:
        recorder.commit()
    except ValueError as error:
        print(error, flush=True)
    with recorder:
        pass
    sys.exit()
os.waitpid(child, 0)
recorder.close()
"""


def test_a_killed_recording_is_valid_to_its_last_commit(path: Path) -> None:
    """The second commit is killed when its pages are in the file, and the journal is hot."""
    assert python("-c", CHILD, path, "kill").returncode == -signal.SIGKILL
    journal = path.with_name("run.trace-journal")
    assert journal.stat().st_size > 512
    assert path.stat().st_size > 1.5 * COMMIT_EVENTS * 3200, "more than is committed"
    kept = path.read_bytes(), journal.read_bytes()
    assert numbers(path) == list(range(COMMIT_EVENTS))
    assert (path.read_bytes(), journal.read_bytes()) == kept, "a reader writes nothing"
    with Recorder(path, append=True) as recorder:
        recorder.predict(np.eye(20), np.eye(20))
    assert not journal.exists()
    assert numbers(path) == list(range(COMMIT_EVENTS + 1))


def test_commits_are_on_the_disk_unless_told_otherwise(path: Path) -> None:
    """SQLite's levels: 3 is EXTRA, 0 OFF."""

    def level(recorder: Recorder) -> int:
        return int(recorder._file.execute("PRAGMA synchronous").fetchone()[0])

    with Recorder(path) as recorder:
        recorder.prior({"a": 2}, P)
        assert level(recorder) == 3
    with Recorder(path, append=True) as recorder:
        assert level(recorder) == 3
    with Recorder(path, append=True, synced=False) as recorder:
        assert level(recorder) == 0


def test_a_child_of_a_fork_leaves_the_file_alone(path: Path) -> None:
    done = python("-c", CHILD, path, "fork")
    assert done.returncode == 0, done.stderr
    assert done.stdout == (
        f"{path}: was opened by another process; after a fork only the parent records\n"
    )
    assert numbers(path) == [0, 1]


@pytest.mark.parametrize("guarded", [True, False])
def test_a_hostile_journal_deletes_no_file(
    path: Path, tmp_path: Path, guarded: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SQLite deletes the file that a hot journal names, if that names no journals."""
    with Recorder(path) as recorder:
        recorder.prior({"a": 2}, P)
        predictions(recorder, 3000)
    hostile, victim = tmp_path / "hostile.trace", tmp_path / "victim"
    victim.write_text("mine\n")
    with closing(sqlite3.connect(path, isolation_level=None)) as file:
        file.execute("PRAGMA cache_size = 1")
        file.execute("BEGIN")
        file.execute("UPDATE batch SET updates = 7")
        shutil.copy(path, hostile)
        shutil.copy(f"{path}-journal", f"{hostile}-journal")
    magic, prey = reader._JOURNAL_MAGIC, str(victim).encode()
    with Path(f"{hostile}-journal").open("ab") as journal:
        journal.write(struct.pack(">I", 2**30 // 32768 + 1) + prey)
        journal.write(struct.pack(">II", len(prey), sum(prey)) + magic)
    if guarded:
        link = tmp_path / "link.trace"
        link.symlink_to(hostile)
        Path(f"{link}-journal").write_text("not the one that SQLite reads\n")
        for name in (hostile, link):
            with pytest.raises(InputError, match="names another file, as a recorder's never does"):
                TraceReader(name)
    else:
        monkeypatch.setattr(reader, "_JOURNAL_MAGIC", b"")
        assert TraceReader(hostile).counts.events == 3001
    assert victim.exists() == guarded


def test_blocks_are_followed_as_the_reader_does(path: Path) -> None:
    """A hundred random changes of the state: what is recorded is read."""
    draw = np.random.default_rng(3)
    dims = {"a": 2, "b": 1}
    with Recorder(path) as recorder:
        recorder.prior(dims, np.eye(3))
        for step in range(300):
            names = list(dims)
            some = [names[k] for k in draw.permutation(len(names))[: draw.integers(1, 4)]]
            n = sum(dims[name] for name in some)
            kind = draw.integers(4)
            if kind == 0:
                recorder.clone(some[0], f"c{step}")
                dims[f"c{step}"] = dims[some[0]]
            elif kind == 1 and len(some) < len(dims):
                recorder.remove(*some)
                dims = {name: dim for name, dim in dims.items() if name not in some}
            elif kind == 2:
                d = int(draw.integers(1, 4))
                recorder.augment(f"n{step}", np.ones((d, n)), np.ones((d, 1)), 1.0, some)
                dims[f"n{step}"] = d
            recorder.snapshot(np.eye(sum(dims.values())))
    now: dict[str, int] = {}
    for event in TraceReader(path):
        if isinstance(event, TracePrior):
            now = dict(zip(event.blocks, event.dims, strict=True))
        elif isinstance(event, Augment):
            now[event.name] = len(event.jacobian)
        elif isinstance(event, Clone):
            now[event.name] = now[event.source]
        elif isinstance(event, Snapshot):
            assert len(event.covariance) == sum(now[name] for name in event.blocks)
    assert {name for name in now if name in dims} == set(dims)
