"""Work in a second process: the same result, the same errors, and nothing left behind."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest

from comparisons.config import SolveConfig
from comparisons.errors import InputError
from comparisons.jobs.run import Comparison, compare
from comparisons.logs.log import Truth
from comparisons.pipeline import beside
from comparisons.pipeline.beside import BackgroundCall
from comparisons.pipeline.solve import solve
from comparisons.report.run import RunReport
from comparisons.report.solution import SolutionReport
from comparisons.settings import run_config
from tests.helpers import first_seconds, present, simulated

ROOT = Path(__file__).resolve().parents[2]
T = TypeVar("T")


@pytest.fixture
def second_core(monkeypatch: pytest.MonkeyPatch) -> None:
    """A core is free."""
    monkeypatch.setattr(beside, "cores", lambda: 2)


def gone(pid: int, within_s: float = 60.0) -> bool:
    """Whether a process ends in time."""
    end_s = time.monotonic() + within_s
    while True:
        try:
            if "State:\tZ" in Path(f"/proc/{pid}/status").read_text(encoding="ascii"):
                return True
        except (OSError, ProcessLookupError):
            return True
        if time.monotonic() >= end_s:
            return False
        time.sleep(0.02)


def elsewhere(function: Callable[..., T], *arguments: Any) -> BackgroundCall[T]:
    """Start a call that is large enough for a second process."""
    return BackgroundCall(function, *arguments, size=(1, 0, 0), pays_from=1)


def refuse(text: str) -> None:
    """Raise what a worker may raise."""
    raise InputError(f"log: {text}")


def sleeping(file: str) -> None:
    """Tell who works, and go on for longer than any test."""
    Path(f"{file}.part").write_text(str(os.getpid()), encoding="ascii")
    Path(f"{file}.part").rename(file)
    print("a library's print")
    time.sleep(600.0)


def worker(file: Path, within_s: float = 300.0) -> int:
    """Return the process that `sleeping` is in."""
    end_s = time.monotonic() + within_s
    while not file.exists():
        assert time.monotonic() < end_s
        time.sleep(0.02)
    return int(file.read_text(encoding="ascii"))


@pytest.mark.usefixtures("second_core")
def test_a_call_elsewhere_returns_the_same() -> None:
    x = np.random.default_rng(0).standard_normal((300, 300))
    with elsewhere(np.linalg.svd, x) as work:
        assert work.elsewhere
        found = work.result()
    assert work.cpu_s > 0.0
    for here, there in zip(np.linalg.svd(x), found, strict=True):
        assert here.tobytes() == there.tobytes()


@pytest.mark.slow
@pytest.mark.usefixtures("second_core")
def test_what_is_raised_there_is_raised_here() -> None:
    with elsewhere(refuse, "no landmark") as work:
        assert work.elsewhere
        with pytest.raises(InputError, match="log: no landmark"):
            work.result()


@pytest.mark.slow
@pytest.mark.usefixtures("second_core")
def test_a_killed_process_is_an_error_in_one_line(tmp_path: Path) -> None:
    with elsewhere(sleeping, str(tmp_path / "pid")) as work:
        os.kill(worker(tmp_path / "pid"), signal.SIGKILL)
        with pytest.raises(InputError, match=r"a second process.* was ended from outside"):
            work.result()


@pytest.mark.usefixtures("second_core")
def test_what_cannot_be_sent_is_done_here() -> None:
    with elsewhere(lambda lock: (lock.locked(), os.getpid()), threading.Lock()) as work:
        assert work.elsewhere
        assert work.result() == (False, os.getpid())


@pytest.mark.slow
@pytest.mark.usefixtures("second_core")
def test_an_interrupt_leaves_no_process(tmp_path: Path) -> None:
    pid = 0
    with (  # noqa: PT012
        pytest.raises(KeyboardInterrupt),
        elsewhere(sleeping, str(tmp_path / "pid")),
    ):
        pid = worker(tmp_path / "pid")
        raise KeyboardInterrupt
    assert gone(pid, 1.0)


@pytest.mark.slow
def test_without_the_block_a_process_stays(second_core: None, tmp_path: Path) -> None:
    """The broken variant: nobody ends it."""
    work = elsewhere(sleeping, str(tmp_path / "pid"))
    assert not gone(worker(tmp_path / "pid"), 0.5)
    work.__exit__(None, None, None)


ORPHANS = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from comparisons.experiments.montecarlo.workers import spread
from tests.comparisons.test_beside import sleeping
print("once", flush=True)
list(spread(sleeping, [(f"{sys.argv[1]}{i}",) for i in range(2)], 2))
"""
# Without a guard of `__main__`, as users write it: it is not run once more.
ORPHAN = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # also where the shell ignores it
from comparisons.pipeline import beside
from tests.comparisons.test_beside import elsewhere, sleeping
beside.cores = lambda: 2
with elsewhere(sleeping, sys.argv[1]) as work:
    print("once", flush=True)
    work.result()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "first"), [(ORPHAN, ""), (ORPHANS, "0")], ids=["beside", "spread"]
)
@pytest.mark.parametrize("ended_by", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_it_ends_with_the_process_that_asked(
    ended_by: signal.Signals, code: str, first: str, tmp_path: Path
) -> None:
    script = tmp_path / "script.py"
    script.write_text(code, encoding="ascii")
    with subprocess.Popen(
        [sys.executable, str(script), str(tmp_path / "pid")],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        text=True,
    ) as asking:
        pid = worker(tmp_path / f"pid{first}")
        assert not gone(pid, 0.5)
        asking.send_signal(ended_by)
        said = asking.communicate(timeout=60.0)[0]
        # A worker of `spread` prints where its parent does.
        assert (said.replace("a library's print\n", "") if first else said) == "once\n"
        assert gone(pid)


def _of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multiprocessing, "parent_process", object)


def _of_one_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beside, "cores", lambda: 1)


def _without_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")


@pytest.mark.usefixtures("second_core")
@pytest.mark.parametrize("how", [_of_another, _of_one_core, _without_python])
def test_where_no_process_is_to_be_had_the_call_is_made_here(
    how: Callable[[pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    how(monkeypatch)
    with elsewhere(os.getpid) as work:
        assert not work.elsewhere
        assert work.result() == os.getpid()


@pytest.mark.usefixtures("second_core")
def test_no_process_for_little_work_nor_in_a_thread_nor_without_memory() -> None:
    assert not BackgroundCall(os.getpid, size=(4, 5, 1), pays_from=10).elsewhere
    assert not BackgroundCall(os.getpid, size=(10**9, 10**9, 10), pays_from=10).elsewhere
    seen: list[bool] = []
    thread = threading.Thread(target=lambda: seen.append(elsewhere(os.getpid).elsewhere))
    thread.start()
    thread.join()
    assert seen == [False]


def _watched(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Record where each call was made; all are large enough."""
    seen: list[bool] = []
    init, result = BackgroundCall.__init__, BackgroundCall.result

    def starting(self: BackgroundCall[Any], *arguments: Any, size: Any, pays_from: int) -> None:
        init(self, *arguments, size=size, pays_from=0)

    def watching(self: BackgroundCall[Any]) -> Any:
        seen.append(self.elsewhere)
        return result(self)

    monkeypatch.setattr(BackgroundCall, "__init__", starting)
    monkeypatch.setattr(BackgroundCall, "result", watching)
    return seen


def _text(result: Any) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(result.model_dump_json())
    assert found.pop("seconds")
    assert found.pop("cpu_s")
    return found


def _arrays(content: Any) -> list[bytes]:
    """All arrays in a tree of dataclasses, by their bytes."""
    if isinstance(content, np.ndarray):
        return [content.tobytes()]
    parts: list[Any] = []
    if is_dataclass(content):
        parts = [getattr(content, field.name) for field in fields(content)]
    elif isinstance(content, Mapping):
        parts = list(content.values())
    elif isinstance(content, (tuple, list)):
        parts = list(content)
    return [x for part in parts for x in _arrays(part)]


@pytest.mark.slow
def test_a_run_with_its_own_association_is_the_same_to_the_bit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log = replace(first_seconds(simulated(0), 15.0), truth=Truth())
    config = run_config(association="nn", smoother_association="own")
    seen = _watched(monkeypatch)
    found = list[Comparison]()
    for cores in (1, 2):
        monkeypatch.setattr(beside, "cores", lambda cores=cores: cores)
        found.append(compare(log, config))
    assert seen == [False, False, True, True]  # F1 with F2, and S'
    here, there = (_text(RunReport.build(one)) for one in found)
    assert here == there
    assert here["own_association"]["landmarks"] > 3
    assert list(found[0].prepared.clock.seconds) == list(found[1].prepared.clock.seconds)
    for name in ("frozen", "own association"):  # what the other process has done counts
        assert found[1].prepared.clock.cpu_s[name] > 0.1
    arrays = [
        [x for one in (f.known.gaps.recorded, f.known.gaps.model) for x in _arrays(one)]
        for f in found
    ]
    assert arrays[0] == arrays[1]


@pytest.mark.slow
def test_a_solution_is_the_same_to_the_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    log = first_seconds(simulated(0), 15.0)
    seen = _watched(monkeypatch)
    texts = []
    for cores in (1, 2):
        monkeypatch.setattr(beside, "cores", lambda cores=cores: cores)
        solution = solve(log, SolveConfig(association="own"))
        names = [one.name for one in present(solution.association_check).variants]
        texts.append(_text(SolutionReport.build(solution)))
    assert seen == [False, True]
    assert texts[0] == texts[1]
    assert names == ["reversed time", "shifted borders", "looser settings", "stricter settings"]
