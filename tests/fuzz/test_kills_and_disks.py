"""Processes that are killed, and disks that are full: a target is whole, absent or the old one."""

import fcntl
import os
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from comparisons import atomic
from comparisons.atomic import fresh_folder, is_unfinished, write_whole
from comparisons.cli import app
from comparisons.cli.support import _start_log
from comparisons.errors import one_line
from comparisons.estimates.trajectory_files import Trajectory, write_trajectory
from comparisons.experiments.montecarlo.chunk_files import check_folder
from tests.fuzz.damage import cases, counted
from tests.fuzz.subjects import SUBJECTS
from tests.fuzz.test_hostile_files import assert_one_line, outcome, run_main
from tests.helpers import present
from tests.processes import ROOT, python

HOUR_AGO_S = 3700.0
WRITER = """
import sys, time
from pathlib import Path
from comparisons.cli.app import _stop_on_signals
from comparisons.atomic import OWN, fresh_folder, write_whole

_stop_on_signals()
kind, target, wait = sys.argv[1], Path(sys.argv[2]), float(sys.argv[3])
names = [f"{i}.csv" for i in range(20)]

def fill(place, text):
    for name in names:
        (place / name).write_text(text)
        time.sleep(wait)

print("begins", flush=True)
while True:
    for text in ("a" * 1000, "b" * 1000):
        if kind == "folder":
            with fresh_folder(target, "0.csv") as work:
                fill(work, text)
        else:
            write_whole(target, lambda part: (part.write_text(text), time.sleep(wait)), OWN)
"""
"""Writes the same target for ever."""
STUDY = """
import signal
import slamcheck.__main__ as program

signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
program._stop_at_once()  # as main does first; until then a signal ends Python itself
print("begins", flush=True)
program.main()
"""
"""Ends by any of the signals, with its code, from the line that it prints on."""
MARK = "SLAMCHECK_TEST_OF_KILLS"
PATIENCE_S = 600.0
"""However busy the machine is; a process that ends takes a moment."""


@pytest.fixture(autouse=True)
def hanging_up_stops() -> Iterator[None]:
    """Also where these tests run under nohup, whose processes ignore it."""
    handler = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, handler)


@contextmanager
def writing(kind: str, target: Path, wait_s: float) -> Iterator[subprocess.Popen[str]]:
    """A process that writes a target again and again, killed in the end."""
    job = subprocess.Popen(
        (sys.executable, "-c", WRITER, kind, str(target), str(wait_s)),
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert present(job.stdout).readline() == "begins\n"
        yield job
    finally:
        job.kill()
        job.communicate()


def unfinished(folder: Path) -> list[Path]:
    return [p for p in folder.iterdir() if is_unfinished(p.name)]


def workplace(folder: Path) -> Path:
    """The only unfinished output, once its process holds the lock and has written a file."""
    deadline = time.monotonic() + 30.0
    while time.monotonic() < deadline:
        for place in unfinished(folder):
            if (place / "new" / "0.csv").exists():
                return place
        time.sleep(0.01)
    raise AssertionError("nothing was written")


def assert_whole(kind: str, target: Path) -> None:
    """Of one text throughout, or not there."""
    files = [target] if kind == "file" else [target / f"{i}.csv" for i in range(20)]
    if target.exists():
        texts = {path.read_text() for path in files}
        assert len(texts) == 1
        assert len(texts.pop()) == 1000


def grow_old(folder: Path) -> None:
    then = time.time() - HOUR_AGO_S
    os.utime(folder, (then, then))


def write_beside(folder: Path, name: str = "next") -> None:
    """What a next process does: it writes beside."""
    atomic._sweep.cache_clear()
    write_whole(folder / name, lambda part: part.write_text("x"), atomic.OWN)


def one_kill(kind: str, number: int, delay_s: float, folder: Path) -> None:
    target = folder / "out"
    with writing(kind, target, 0.0002) as job:
        time.sleep(delay_s)
        job.send_signal(number)
        reported = job.communicate(timeout=30)[1]
    assert job.returncode == (-number if number == signal.SIGKILL else 128 + number)
    assert not reported
    left = unfinished(folder)
    if number != signal.SIGKILL:
        assert not left
    assert {p.name for p in folder.iterdir()} <= {"out", *(p.name for p in left)}
    was_there = target.exists() or any((place / "old" / "out").exists() for place in left)
    assert_whole(kind, target)
    for place in left:
        grow_old(place)
    write_beside(folder)
    assert not unfinished(folder)
    assert target.exists() == was_there
    assert_whole(kind, target)


@pytest.mark.parametrize("kind", ["file", "folder"])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_target_outlives_its_writer(kind: str, number: int, tmp_path: Path) -> None:
    one_kill(kind, number, 0.05, tmp_path)


def marked(mark: str) -> list[int]:
    """Processes with a mark in their environment that have not ended, whoever started them."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            state = place.joinpath("stat").read_text().rpartition(")")[2].split()[0]
            if f"{MARK}={mark}".encode() in place.joinpath("environ").read_bytes() and state != "Z":
                found.append(int(place.name))
    return found


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="processes are in /proc")
@pytest.mark.slow
@settings(max_examples=cases(1, 60), suppress_health_check=tuple(HealthCheck))
@given(
    number=st.sampled_from([signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT]),
    delay_s=st.floats(0.0, 6.0),
)
def test_no_process_outlives_a_killed_study(number: signal.Signals, delay_s: float) -> None:
    """Its workers and what starts them end with it, and the next run is clean."""
    counted("kills of a study with workers")
    mark = uuid.uuid4().hex
    environment = {**os.environ, "PYTHONPATH": str(ROOT), MARK: mark}
    with tempfile.TemporaryDirectory() as place:
        SUBJECTS["scenario"].write(Path(place))
        words = [sys.executable, "-c", STUDY, "montecarlo", "small.toml", "--runs", "40"]
        words += ["--filters", "ekf", "--workers", "2", "--out", "out"]
        with Path(place, "said").open("w+") as said:
            job = subprocess.Popen(
                words, cwd=place, env=environment, stdout=subprocess.PIPE, stderr=said
            )
            assert present(job.stdout).readline() == b"begins\n"
            with suppress(subprocess.TimeoutExpired):
                job.communicate(timeout=delay_s)
            job.send_signal(number)
            end_s = time.monotonic() + PATIENCE_S
            while (left := marked(mark)) and time.monotonic() < end_s:
                job.poll()
                time.sleep(0.05)
            for one in left:
                os.kill(one, signal.SIGKILL)
            job.communicate()
        reported = Path(place, "said").read_text()
        assert not left, (number, delay_s)
        done = -number if number == signal.SIGKILL else 128 + number
        assert job.returncode in (0, done), reported
        assert "Traceback" not in reported
        again = subprocess.run(
            words, cwd=place, env=environment, capture_output=True, text=True, check=False
        )
        assert again.returncode == 0, again.stderr
        assert Path(place, "out", "montecarlo.json").is_file()
        assert not marked(mark)


def exit_after(count: int, act: Callable[[], object]) -> bool:
    """Have an exit come once an act has made so many calls of what is written in C.

    There an interpreter handles a signal. Returns whether so many were made.
    """
    left = count

    def profile(frame: FrameType, event: str, about: object) -> None:
        nonlocal left
        if event == "c_return":
            left -= 1
            if left == 0:
                raise SystemExit(3)

    ended = False
    before = sys.getprofile()
    sys.setprofile(profile)
    try:
        act()
    except SystemExit:
        ended = True
    finally:
        sys.setprofile(before)
    assert ended == (left <= 0), f"the exit after {count} calls was lost"
    return ended


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_an_exit_after_any_call_ends_the_writing(kind: str, tmp_path: Path) -> None:
    """A signal's exit may come anywhere. It is not lost, and nothing unfinished is left."""
    target = tmp_path / "out"

    def write() -> None:
        if kind == "file":
            write_whole(target, lambda part: part.write_text("a"), atomic.OWN)
        else:
            with fresh_folder(target, "0.csv") as work:
                (work / "0.csv").write_text("a")

    write()
    calls = 0
    while exit_after(calls + 1, write):
        calls += 1
        assert not unfinished(tmp_path), calls
        assert target.exists(), calls
    assert calls > 100


def left_behind(folder: Path, name: str = f"{atomic._PREFIX}0123456789abcdef") -> Path:
    """As after a kill between the two moves, more than an hour ago."""
    place = folder / name
    place.mkdir(0o700)
    (place / "new").mkdir()
    (place / "new" / "half.txt").write_text("half")
    (place / "old" / "out").mkdir(parents=True)
    (place / "old" / "out" / "result.json").write_text("{}")
    grow_old(place)
    return place


def test_an_output_that_was_moved_away_comes_back(tmp_path: Path) -> None:
    left_behind(tmp_path)
    write_beside(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["next", "out"]
    assert (tmp_path / "out" / "result.json").read_text() == "{}"


def test_an_output_that_was_replaced_does_not_come_back(tmp_path: Path) -> None:
    left_behind(tmp_path)
    (tmp_path / "out").mkdir()
    write_beside(tmp_path)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["next", "out"]


def young(place: Path) -> None:
    os.utime(place)


def open_to_others(place: Path) -> None:
    place.chmod(0o755)


def with_a_thesis(place: Path) -> None:
    (place / "thesis.tex").write_text("years of work")
    grow_old(place)


def of_somebody_else(place: Path) -> None:
    if os.getuid() != 0:
        pytest.skip("only root gives files away")
    os.chown(place, 65534, 65534)


def as_a_link(place: Path) -> None:
    place.rename(place.with_name("elsewhere"))
    place.symlink_to("elsewhere")


NOT_OURS: dict[str, Callable[[Path], object]] = {
    "young": young,
    "open to others": open_to_others,
    "with a thesis": with_a_thesis,
    "of somebody else": of_somebody_else,
    "as a link": as_a_link,
    "of another machine": lambda place: place.rename(
        place.with_name(".slamcheck-00000000-0123456789abcdef")
    ),
    "with a longer name": lambda place: place.rename(place.with_name(f"{place.name}-kept")),
    "of another name": lambda place: place.rename(place.with_name(".out-abcdefgh")),
}


@pytest.mark.parametrize("name", NOT_OURS)
def test_what_is_not_surely_ours_stays(name: str, tmp_path: Path) -> None:
    NOT_OURS[name](left_behind(tmp_path))
    before = sorted(tmp_path.rglob("*"))
    write_beside(tmp_path)
    (tmp_path / "next").unlink()
    assert sorted(tmp_path.rglob("*")) == before


def test_what_a_process_still_writes_stays(tmp_path: Path) -> None:
    with writing("folder", tmp_path / "out", 1000.0):
        place = workplace(tmp_path)
        grow_old(place)
        write_beside(tmp_path)
        assert unfinished(tmp_path) == [place]
    write_beside(tmp_path, "again")
    assert not unfinished(tmp_path)


def test_a_file_system_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files are written; what is left there is not judged."""

    def refuse(*_: object) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", refuse)
    place = left_behind(tmp_path)
    write_beside(tmp_path)
    assert unfinished(tmp_path) == [place]
    assert (tmp_path / "next").read_text() == "x"


@pytest.mark.parametrize("twice", [False, True])
def test_a_closing_terminal_signals_twice(twice: bool, tmp_path: Path) -> None:
    with writing("folder", tmp_path / "out", 1000.0) as job:
        workplace(tmp_path)
        job.send_signal(signal.SIGHUP)
        if twice:
            job.send_signal(signal.SIGTERM)
        job.wait(30)
    assert job.returncode in (129, 143)
    assert not unfinished(tmp_path)


def test_an_exit_that_is_lost_is_tried_again(tmp_path: Path) -> None:
    """As in a library's callback, whose exceptions are dropped."""
    lost = """
import sys, time
from comparisons.cli import app
app.AGAIN_S = 0.2
app._stop_on_signals()
try:
    print("begins", flush=True)
    time.sleep(60)
except SystemExit:
    print("lost", flush=True)
time.sleep(60)
"""
    job = subprocess.Popen((sys.executable, "-c", lost), stdout=subprocess.PIPE, text=True,
                           env={**os.environ, "PYTHONPATH": str(ROOT)})  # fmt: skip
    try:
        assert present(job.stdout).readline() == "begins\n"
        job.send_signal(signal.SIGTERM)
        assert job.communicate(timeout=30)[0] == "lost\n"
    finally:
        job.kill()
    assert job.returncode == 143


@pytest.mark.parametrize("number", app.STOPS)
@pytest.mark.parametrize(
    "fault", [SystemError("recursion depth mismatch"), ImportError("numpy"), SystemExit(2)]
)
def test_a_fault_that_an_exit_became_is_no_traceback(
    number: int,
    fault: BaseException,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """As where an import is interrupted."""

    def run(**_: object) -> int:
        try:
            os.kill(os.getpid(), number)
        except SystemExit:
            raise fault from None
        return 0

    monkeypatch.setattr(app, "build", lambda names: run)
    before = signal.signal(number, signal.SIG_DFL)  # a job in the background ignores SIGINT
    try:
        with pytest.raises(SystemExit) as stop:
            run_main(["run"])
    finally:
        signal.signal(number, before)
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    assert stop.value.code == 128 + number
    assert not capsys.readouterr().err


AT_ONCE = """
import atexit, os, signal, sys
import slamcheck.__main__ as program

signal.signal(signal.SIGINT, signal.default_int_handler)
when, number = sys.argv[1], int(sys.argv[2])
sys.argv[1:] = ["--version"]
if when == "start-up":
    program.check_packages = lambda: os.kill(os.getpid(), number)
else:
    atexit.register(os.kill, os.getpid(), number)
program.main()
"""


@pytest.mark.parametrize("number", app.STOPS)
@pytest.mark.parametrize("when", ["start-up", "shutdown"])
def test_a_signal_has_its_code_and_no_traceback_whenever_it_comes(when: str, number: int) -> None:
    done = python("-c", AT_ONCE, when, str(int(number)))
    assert (done.returncode, done.stderr) == (128 + number, "")


def test_an_ignored_signal_stays_ignored(tmp_path: Path) -> None:
    """As nohup asks for."""
    handler = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with writing("file", tmp_path / "out", 0.01) as job:
            job.send_signal(signal.SIGHUP)
            time.sleep(0.2)
            assert job.poll() is None
    finally:
        signal.signal(signal.SIGHUP, handler)


BAD_TARGETS = (
    "/",
    ".",
    "..",
    "",
    "DIR",
    "n" * 300,
    "/dev/null/x",
    "/dev/full",
    "nowhere/..",
    "a\0b",
)
TARGETS: dict[str, Callable[[Path], object]] = {
    "file": lambda path: write_whole(path, lambda part: part.write_text("x")),
    "folder": lambda path: fresh_folder(path).__enter__(),
    "file, before": lambda path: atomic.check_file(path, atomic.NEW),
    "folder, before": atomic.check_replaceable,
    "study, before": check_folder,
    "log": lambda path: _start_log(path),
    "kitti": lambda path: write_trajectory(
        Trajectory(np.zeros(1), np.zeros((1, 3)), None), path, "kitti"
    ),
}


@pytest.mark.parametrize("kind", TARGETS)
@pytest.mark.parametrize("target", BAD_TARGETS)
def test_bad_targets_are_one_line(
    kind: str, target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "DIR").mkdir()
    (tmp_path / "DIR" / "mine.txt").write_text("")
    code, reported = outcome(lambda: TARGETS[kind](Path(target)))
    assert code == 2
    assert_one_line(code, reported, Path(one_line(target.replace("\0", "?")).removesuffix("...")))
    assert [p.name for p in tmp_path.rglob("*")] == ["DIR", "mine.txt"]


@pytest.mark.parametrize(
    "words",
    [
        ["run", "no-such-log", "--out", "/"],
        ["baseline", "save", "no-such-log", "/"],
        ["baseline", "compare", "no-such-log", "no-such-baseline", "--junit", "/"],
        ["convert", "no-such-log", "/"],
        ["run", "no-such-log", "--log", "/"],
    ],
)
def test_a_bad_target_is_told_before_the_work(words: list[str]) -> None:
    code, reported = outcome(lambda: run_main(words))
    assert code == 2
    assert reported.startswith("slamcheck: /: is ")
    assert reported.count("\n") == 1


@pytest.mark.parametrize("words", [["--version"], ["logs"], ["config"]])
def test_a_full_standard_output_is_one_line(words: list[str]) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            (sys.executable, "-c", "from comparisons.cli.app import main; main()", *words),
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=60,
        )
    assert done.returncode == 2
    assert done.stderr.endswith(": No space left on device\n")
    assert done.stderr.count("\n") == 1


@pytest.mark.slow
@settings(max_examples=cases(8, 300), suppress_health_check=(HealthCheck.too_slow,))
@given(
    kind=st.sampled_from(["file", "folder"]),
    number=st.sampled_from([signal.SIGTERM, signal.SIGHUP, signal.SIGKILL]),
    delay_s=st.floats(0.0, 0.1),
)
def test_killed_at_any_moment(
    kind: str, number: int, delay_s: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    counted("kills of a writer")
    one_kill(kind, number, delay_s, tmp_path_factory.mktemp("kill"))
