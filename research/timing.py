"""Processor time of work, here or in a process of its own; two kinds of it in turns.

`research/peers/__main__.py` compares us with peers, `research/bench.py` the tree with a commit.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # of this process; of those it starts, too

import atexit
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ParamSpec, TypeVar

ROOT = Path(__file__).resolve().parents[1]
P = ParamSpec("P")
T = TypeVar("T")


class MissingError(Exception):
    """A peer or its data is not here: what is missing and how to get it, in one line."""


@dataclass(frozen=True)
class Spent:
    """Processor time [s], of children included, and wall time [s]."""

    cpu_s: float
    wall_s: float

    def __sub__(self, other: Spent) -> Spent:
        return Spent(self.cpu_s - other.cpu_s, self.wall_s - other.wall_s)


Side = Callable[[], Spent]
"""Does the work once."""


@dataclass(frozen=True, kw_only=True)
class TimedPair:
    """The same work by us and by a peer.

    name: with the peer's first. work: in words, with its size. ours, theirs: each does it once.
    goal: the greatest ratio of processor time that we aim at, None where the pair is for
    information. parts: the number of steps, poses or scans that a time is divided by, and their
    name. repeat: other than asked for, where the work takes long. notes: what both found, asked for
    after the last repetition.
    """

    name: str
    work: str
    ours: Side
    theirs: Side
    goal: float | None = None
    parts: tuple[int, str] = (1, "all")
    repeat: int | None = None
    notes: Callable[[], Sequence[str]] = field(default=lambda: ())


@dataclass(frozen=True)
class PairTimes:
    """What the repetitions of a pair took, in their order."""

    ours: tuple[Spent, ...]
    theirs: tuple[Spent, ...]

    @property
    def ratios(self) -> list[float]:
        """Ours over the peer's processor time, of each repetition."""
        both = zip(self.ours, self.theirs, strict=True)
        return [mine.cpu_s / other.cpu_s for mine, other in both]

    @property
    def ratio(self) -> float:
        """Median of the ratios."""
        return statistics.median(self.ratios)


def interleaved(ours: Side, theirs: Side, repeat: int) -> PairTimes:
    """Measure in turns: ours, the peer's, ours, and so on."""
    spent = [(ours(), theirs()) for _ in range(repeat)]
    return PairTimes(tuple(one for one, _ in spent), tuple(one for _, one in spent))


def median(spent: Sequence[Spent]) -> Spent:
    """Return the medians of processor time and of wall time."""
    return Spent(
        statistics.median(one.cpu_s for one in spent),
        statistics.median(one.wall_s for one in spent),
    )


def timed(function: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> tuple[T, float]:
    """Return what a function returns, and its processor time [s]."""
    begin_s = time.process_time()
    result = function(*arguments, **options)
    return result, time.process_time() - begin_s


def here(call: Callable[[], object]) -> Side:
    """Return a side that makes a call in this process."""

    def side() -> Spent:
        cpu, wall = time.process_time(), time.perf_counter()
        call()
        return Spent(time.process_time() - cpu, time.perf_counter() - wall)

    return side


@dataclass(frozen=True)
class Ran:
    """A program that ended: what it took, its children included, and what it printed."""

    spent: Spent
    printed: str


def run(words: Sequence[str | Path], fine: Sequence[int] = (0,), code: Path = ROOT) -> Ran:
    """Run a program in a process of its own.

    Args:
        words: The program and its arguments.
        fine: Exit codes of success.
        code: The folder whose code Python imports.

    Returns:
        Processor time of user and system, wall time, and both outputs together.

    Raises:
        RuntimeError: It ended with another code.
    """
    with tempfile.TemporaryFile() as printed:
        wall = time.perf_counter()
        process = subprocess.Popen(
            list(map(str, words)),
            cwd=code,
            env=os.environ | {"PYTHONPATH": str(code)},
            stdin=subprocess.DEVNULL,
            stdout=printed,
            stderr=subprocess.STDOUT,
        )
        _, status, usage = os.wait4(process.pid, 0)
        taken = time.perf_counter() - wall
        process.returncode = os.waitstatus_to_exitcode(status)
        printed.seek(0)
        text = printed.read().decode(errors="replace")
    if process.returncode not in fine:
        last = (text.strip() or "nothing printed").splitlines()[-1]
        raise RuntimeError(f"{words[0]} exited with {process.returncode}: {last}")
    return Ran(Spent(usage.ru_utime + usage.ru_stime, taken), text)


def scratch() -> Path:
    """Return a folder that is gone when this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="slamcheck-peers-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
