"""Whole commands with odd values of their settings, and with a disk that fills up."""

import functools
import json
import os
import re
import resource
import signal
import time
import types
import typing
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joblib.externals.loky import get_reusable_executor
from pydantic import BaseModel

from comparisons.atomic import is_unfinished
from comparisons.config import JOBS, config_class
from comparisons.extension_names import EXTENSIONS
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log, Truth
from comparisons.logs.log_folder import write_log_folder
from tests.fuzz.damage import cases, counted
from tests.fuzz.subjects import Subject
from tests.fuzz.test_hostile_files import QUIET, assert_whole_or_absent, outcome, run_main, words_in
from tests.fuzz.test_hostile_files import everything as sound_inputs
from tests.helpers import first_seconds

SECONDS, MEMORY_BYTES = 60, 2 * 2**30
"""What a command may take for a log of ten seconds: of the processor, ten times that on the wall of
a busy machine; a refusal for want of memory is allowed."""
VALUES = (
    *("0", "-0.0", "1", "-1", "2", "3", "0.5", "1e-3", "1e-9", "1e-30", "5e-324", "-1e-9"),
    *("100", "1000", "1e3", "1e4", "1e5", "1e6", "1e9", "1e30", "1e300", "-1e300", "1e308"),
    *("2147483648", "-2147483649", "9223372036854775808", "9" * 400, "nan", "inf", "-inf", "1.5"),
    *("''", "[]", "[1]", "true", "null", "abc"),
)  # fmt: skip
COMMANDS = {
    "run": "run LOG --out OUT",
    "run on scans": "run SCANS --out OUT",
    "solve": "solve LOG --out OUT",
    "check": "check LOG --estimate MINE --out OUT",
    "map": "map SCANS --out OUT",
    "odometry": "odometry SCANS --out OUT",
    "montecarlo": "montecarlo SMALL.TOML --runs 1 --filters ekf --out OUT",
    "convert": "convert LOG OUT",
    "convert a simulation": "convert simulated-loop OUT",
}


def few_scans(seconds: float = 12.0) -> Log:
    """The beginning of a drive with a laser."""
    log = first_seconds(open_log("occupancy-loop"), seconds)
    scans = log.scans
    assert scans is not None
    m = int(np.searchsorted(scans.time_s, seconds))
    names = ("time_s", "range_m", "intensity")
    few = replace(scans, **{name: getattr(scans, name)[:m] for name in names})
    return replace(log, scans=few, truth=Truth())


def everything(folder: Path) -> None:
    sound_inputs(folder)
    write_log_folder(few_scans(), folder / "scans")


WHOLE = Subject(everything, lambda folder: None)


def numeric(kind: type[BaseModel], section: str = "") -> Iterator[tuple[str, tuple[str, ...]]]:
    """Dotted names of settings that take a number, and what lies at their limits."""
    for name, field in kind.model_fields.items():
        hint = field.annotation
        kinds = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
        if any(one in (int, float) for one in kinds):
            limits = [
                getattr(one, word)
                for one in field.metadata
                for word in ("ge", "gt", "le", "lt")
                if hasattr(one, word)
            ]
            near = [limit + step for limit in limits for step in (0, 1, -1, 1e-12, -1e-12)]
            yield f"{section}{name}", tuple(map(repr, near))
        for one in kinds:
            if isinstance(one, type) and issubclass(one, BaseModel):
                yield from numeric(one, f"{section}{name}.")


_LONG = ("log.loops", "extensions.fastslam.clouds")


@functools.cache
def settable(command: str) -> dict[str, tuple[str, ...]]:
    """What takes a number, by option or setting, with values at its limits.

    Not the numbers of loops and clouds: thousands are allowed, announced, and take hours.
    """
    job = command.partition(" ")[0]
    if job == "montecarlo":
        return dict.fromkeys(("--runs", "--workers"), ())
    if job == "convert":
        return dict.fromkeys(("--robot", "--seed", "--noise-scale"), ())
    found = [*numeric(JOBS[job])]
    for name in EXTENSIONS if "extensions" in JOBS[job].model_fields else ():
        found += numeric(config_class(name), f"extensions.{name}.")
    return {name: near for name, near in found if name not in _LONG}


def in_child(
    action: Callable[[], tuple[int, str]],
    file_bytes: int | None = None,
    kill: tuple[int, float] | None = None,
) -> tuple[int, str]:
    """Exit code and standard error of an action in a process with bounds; 70 where it is killed.

    file_bytes: no file may grow beyond. kill: a signal that is sent, and when.
    """
    out, into = os.pipe()
    get_reusable_executor().shutdown()  # workers of an earlier test, on which a child would wait
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of threads that do not outlive a fork
        child = os.fork()
    if not child:
        try:
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(10 * SECONDS)
            resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))
            now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY_BYTES, now + MEMORY_BYTES))
            if file_bytes is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
            os.write(into, json.dumps(action()).encode()[-60_000:])
        finally:
            os._exit(0)
    os.close(into)
    if kill is not None:
        time.sleep(kill[1])
        os.kill(child, kill[0])
    with os.fdopen(out, "rb") as reported:
        answer = reported.read()
    status = os.waitpid(child, 0)[1]
    if not answer:
        return 70, f"ended by {status} (14, 24: took more than {SECONDS} s of the processor)"
    code, text = json.loads(answer)
    return code, text


def assert_clean(code: int, reported: str) -> None:
    """A verdict without a word, or one line and exit code 2 or 3; misuse shows the usage."""
    assert code in (0, 1, 2, 3), reported[-3000:]
    if code == 2 and reported.startswith("Usage: slamcheck "):
        return
    reported = re.sub(r"slamcheck: [^\n]* \d+\.\d s\n", "", reported)  # the stages of a long job
    assert reported.count("\n") <= 1, reported
    if code == 2:
        assert reported.startswith("slamcheck: "), reported
        assert reported[:-1].isprintable(), reported
        assert len(reported) < 1000, reported


def arguments(command: str, folder: Path, given_values: list[tuple[str, str]]) -> list[str]:
    words = words_in(folder, COMMANDS[command])
    for name, value in given_values:
        words += [name, value] if name.startswith("--") else ["--set", f"{name}={value}"]
    return words


def odd(command: str, given_values: list[tuple[str, str]]) -> tuple[int, str]:
    """A command with odd values, in a folder of its own."""
    with WHOLE.written() as folder:
        given_in = {path.name for path in folder.iterdir()}
        words = arguments(command, folder, given_values)
        code, reported = in_child(lambda: outcome(lambda: run_main(words)))
        assert_clean(code, f"{given_values}\n{reported}" if code == 70 else reported)
        assert_whole_or_absent(folder, given_in)
        return code, reported


def full_disk(command: str, file_bytes: int, earlier: bool) -> int:
    """A command where no file can grow beyond some bytes, beside an earlier output or not."""
    with WHOLE.written() as folder:
        out = folder / "out"
        words = arguments(command, folder, [])
        if earlier and not command.startswith("convert"):
            assert in_child(lambda: outcome(lambda: run_main(words)))[0] < 4
        given_in = {path.name for path in folder.iterdir()}
        before = {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
        code, reported = in_child(lambda: outcome(lambda: run_main(words)), file_bytes)
        assert_clean(code, reported)
        if code == 2:
            assert "File too large" in reported
            assert str(folder) in reported
        if code == 2 and command != "montecarlo":  # whose finished chunks stay
            assert {path.name for path in folder.iterdir()} == given_in
            assert {p: p.read_bytes() for p in out.rglob("*") if p.is_file()} == before
        assert not [p for p in folder.rglob("*") if is_unfinished(p.name)]
        again, reported = in_child(lambda: outcome(lambda: run_main(words)))
        if code == 2:
            assert again < 4, reported
        else:  # a log is never overwritten
            assert again == (2 if command.startswith("convert") else code), reported
        return code


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
@settings(max_examples=cases(1, 15), suppress_health_check=QUIET)
@given(file_bytes=st.integers(0, 60_000), earlier=st.booleans())
def test_a_full_disk_leaves_what_was_there(command: str, file_bytes: int, earlier: bool) -> None:
    counted("full disks under a command")
    full_disk(command, file_bytes, earlier)


@pytest.mark.slow
@settings(max_examples=cases(2, 100), suppress_health_check=QUIET)
@given(
    command=st.sampled_from(sorted(COMMANDS)),
    number=st.sampled_from([signal.SIGTERM, signal.SIGHUP, signal.SIGKILL]),
    delay_s=st.floats(0.0, 1.5),
)
def test_a_killed_command_goes_again(command: str, number: int, delay_s: float) -> None:
    """The target is whole or absent; the same command works, but no log is ever overwritten."""
    counted("kills of a command")
    with WHOLE.written() as folder:
        words = arguments(command, folder, [])
        code, reported = in_child(lambda: outcome(lambda: run_main(words)), kill=(number, delay_s))
        left = [p for p in folder.rglob("*") if is_unfinished(p.name)]
        assert not left or number == signal.SIGKILL
        assert code in (0, 1, 3, 70, 128 + number), reported
        assert code != 70 or reported.startswith("ended by "), reported  # no traceback
        out = folder / "out"
        whole = {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()}
        for path in out.glob("*.json"):
            assert command == "montecarlo" or set(json.loads(path.read_text())["files"]) == whole
        assert (
            command.startswith(("montecarlo", "convert")) or not whole or list(out.glob("*.json"))
        )
        again, reported = in_child(lambda: outcome(lambda: run_main(words)))
        assert again in (0, 1, 3) or (again == 2 and command.startswith("convert")), reported


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
@settings(max_examples=cases(2, 100), suppress_health_check=QUIET)
@given(data=st.data())
def test_odd_values_end_cleanly(command: str, data: st.DataObject) -> None:
    counted("odd values of a command")
    names = settable(command)
    one = st.sampled_from(sorted(names)).flatmap(
        lambda name: st.tuples(st.just(name), st.sampled_from((*names[name] * 2, *VALUES)))
    )
    odd(command, data.draw(st.lists(one, min_size=1, max_size=2)))
