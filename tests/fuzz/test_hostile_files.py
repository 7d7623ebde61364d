"""Damaged and hostile files of every kind: a clear line and exit code 2, or finite figures.

Never a traceback, never half an output. `make nightly` tries forty times as many.
"""

import contextlib
import importlib.util
import io
import json
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from comparisons.cli.app import STOPS, main
from comparisons.cli.support import guarded
from comparisons.logs.log_folder import write_log_folder
from tests.fuzz.damage import Damage, cases, counted, damages
from tests.fuzz.subjects import BAGS, SUBJECTS, Subject
from tests.helpers import simulated

QUIET = (HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much)


def outcome(command: Callable[[], object]) -> tuple[int, str]:
    """Exit code and standard error, as the command line would leave them."""
    reported = io.StringIO()
    with contextlib.redirect_stderr(reported), contextlib.redirect_stdout(io.StringIO()):
        try:
            with guarded():
                command()
        except SystemExit as stop:
            return int(stop.code or 0), reported.getvalue()
        except Exception:
            return 70, traceback.format_exc()
    return 0, reported.getvalue()


def assert_one_line(code: int, reported: str, place: Path) -> None:
    """Exit code 2 comes with one line, which names a file; no other fault is known."""
    assert code in (0, 2), reported[-3000:]
    if code == 2:
        assert reported.startswith("slamcheck: "), reported
        assert reported.count("\n") == 1, reported
        assert reported.endswith("\n"), reported
        assert reported[:-1].isprintable(), reported
        assert len(reported) < 1000, reported
        assert str(place) in reported, reported


def attempt(subject: Subject, hurt: list[Damage]) -> None:
    """Open a damaged one."""
    with subject.written() as folder:
        for damage in hurt:
            damage.apply(folder)
        assert_one_line(*outcome(lambda: subject.read(folder)), folder)


@pytest.mark.parametrize("name", SUBJECTS)
def test_a_sound_one_is_read(name: str) -> None:
    attempt(SUBJECTS[name], [])
    with SUBJECTS[name].written() as folder:
        SUBJECTS[name].read(folder)


@pytest.mark.slow
@pytest.mark.parametrize("name", SUBJECTS)
@settings(max_examples=cases(20, 820), suppress_health_check=QUIET)
@given(data=st.data())
def test_damage_is_one_line(name: str, data: st.DataObject) -> None:
    counted(f"damage: {name}")
    subject = SUBJECTS[name]
    attempt(subject, data.draw(damages(sorted(subject.files))))


@pytest.mark.skipif(not importlib.util.find_spec("rosbags"), reason="the extra ros is missing")
@pytest.mark.parametrize("name", BAGS)
@settings(max_examples=cases(20, 820), suppress_health_check=QUIET)
@given(data=st.data())
def test_damage_to_bags_is_one_line(name: str, data: st.DataObject) -> None:
    counted(f"damage: {name}")
    subject = BAGS[name]
    attempt(subject, data.draw(damages(sorted(subject.files))))


def everything(folder: Path) -> None:
    """A log, a filter's estimate of it, a baseline and a scenario."""
    write_log_folder(simulated(2, loop_s=10.0), folder / "log")
    (folder / "mine").mkdir()
    SUBJECTS["estimate folder"].write(folder / "mine")
    SUBJECTS["baseline"].write(folder)
    SUBJECTS["scenario"].write(folder)


WHOLE = Subject(everything, lambda folder: None)
COMMANDS = {
    "run": "run LOG --out OUT",
    "solve": "solve LOG --out OUT",
    "check": "check LOG --estimate MINE --out OUT",
    "convert": "convert LOG OUT",
    "baseline": "baseline compare LOG KEPT.JSON",
    "montecarlo": "montecarlo SMALL.TOML --runs 1 --filters ekf,oc --out OUT",
}
"""Capitals: paths, in the folder at hand."""


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
@settings(max_examples=cases(10, 150), suppress_health_check=QUIET)
@given(data=st.data())
def test_commands_leave_all_or_nothing(name: str, data: st.DataObject) -> None:
    """Exit code 2 leaves nothing behind; another one a folder with finite figures."""
    counted("damage under a command")
    words = COMMANDS[name].split()
    inputs = tuple(word.lower() for word in words if word.isupper() and word != "OUT")
    hurt = data.draw(damages([f for f in sorted(WHOLE.files) if f.startswith(inputs)]))
    with WHOLE.written() as folder:
        given_in = {path.name for path in folder.iterdir()}
        for damage in hurt:
            damage.apply(folder)
        code, reported = outcome(lambda: run_main(words_in(folder, COMMANDS[name])))
        assert code in (0, 1, 2, 3), reported[-3000:]
        left = assert_whole_or_absent(folder, given_in)
        if code == 2:
            assert_one_line(code, reported, folder)
            assert not left


def words_in(folder: Path, command: str) -> list[str]:
    """The words of a command, those in capitals as paths in a folder."""
    return [str(folder / word.lower()) if word.isupper() else word for word in command.split()]


def assert_whole_or_absent(folder: Path, given_in: set[str]) -> set[str]:
    """Return what a command left beside what was there: nothing, or an output of finite figures."""
    left = {path.name for path in folder.iterdir()} - given_in
    assert left <= {"out"}
    for path in folder.glob("out/*.json"):
        json.loads(path.read_text(), parse_constant=pytest.fail)
    return left


def run_main(arguments: list[str]) -> Any:
    """The console script's entry point in this process; its handlers of signals are undone."""
    kept = {number: signal.getsignal(number) for number in STOPS}
    try:
        with mock.patch.object(sys, "argv", ["slamcheck", *arguments]):
            main()
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
