"""Filters of the user's in a study: a callable, or a command that reads and writes folders.

They are given a run's log without its truth. A run that fails is named with its reason.
"""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import signal
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from comparisons.arrays import Array
from comparisons.covariances import definite
from comparisons.errors import InputError, printable, shorten
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import ExternalEstimate, read_external
from comparisons.experiments.montecarlo.config import FILTER_NAMES
from comparisons.experiments.montecarlo.runs import RunRecords, recorded_steps
from comparisons.experiments.scenarios.world import ScenarioWorld, log_of_run
from comparisons.figures import Aside
from comparisons.logs.log import Log
from comparisons.logs.log_folder import write_log_folder
from comparisons.statistics import squared_distance
from ekf_reference.core.geometry import wrap_angle

Estimator = Callable[[Log], Estimate | ExternalEstimate]
TIMEOUT_S = 600.0
_PLAIN = re.compile(r"""[^\s'"\\#]+""")
_NAMED = re.compile(r"([a-z][a-z0-9_-]{0,19})=(.*)", re.DOTALL)
_LEAST_SHARE = 0.95
"""Of the instants with measurements at which an estimate must have a pose."""
_NEAR_S = 1e-3
_TAIL_BYTES = 4096


class EstimatorError(Exception):
    """An external filter that failed on a run. The text is the reason, in one line."""

    def __init__(self, reason: str, output: str = "") -> None:
        """output: the end of what it wrote on standard error."""
        super().__init__(printable(" ".join(reason.split()))[:300])
        self.output = output


@dataclass(frozen=True)
class Failure:
    """A run in which an external filter failed.

    Attributes:
        seed: seed of the run.
        reason: what happened.
        output: end of what it wrote on standard error; no part of a result file.
        log: folder of its log, where that is kept; likewise.
    """

    seed: int
    reason: str
    output: Aside[str] = ""
    log: Aside[Path | None] = None


@dataclass(frozen=True)
class ExternalProgram:
    """A program that reads a log folder and writes an estimate folder.

    words: with {log} and {out} among them, which stand for the two folders. No shell reads them.
    """

    words: tuple[str, ...]
    timeout_s: float = TIMEOUT_S

    @classmethod
    def parse(cls, text: str, timeout_s: float = TIMEOUT_S) -> ExternalProgram:
        """Split as a shell does. Raises InputError."""
        try:
            words = tuple(shlex.split(text))
        except ValueError as error:
            raise InputError(f"--command: {shorten(text, 200)}: {str(error).lower()}") from None
        for mark in ("{log}", "{out}"):
            if not any(mark in word for word in words):
                raise InputError(
                    f"--command: {shorten(text, 200)}: holds no {mark}, expected for example "
                    "python my_ekf.py {log} {out}"
                )
        return cls(words, timeout_s)

    @property
    def text(self) -> str:
        """What is split into these words, quoted where it has to be."""
        return " ".join(
            word if _PLAIN.fullmatch(word) else shlex.quote(word) for word in self.words
        )

    @property
    def sha256(self) -> str:
        """Of the words, and of every file that is named among them."""
        digest = hashlib.sha256(repr(self.words).encode())
        for path in map(Path, self.words):
            if path.is_file():
                digest.update(hashlib.sha256(path.read_bytes()).digest())
        return digest.hexdigest()

    def __call__(self, log: Log) -> ExternalEstimate:
        """Run it in the current folder. Raises EstimatorError."""
        with tempfile.TemporaryDirectory(prefix="slamcheck-run-") as name:
            place = Path(name)
            given, out = place / "log", place / "out"
            write_log_folder(log, given)
            self._run(place, {"{log}": str(given), "{out}": str(out)})
            try:
                return read_external(out)
            except InputError as error:
                reported = str(error).replace(f"{place}{os.sep}", "")
                raise EstimatorError(reported) from None

    def _run(self, place: Path, folders: Mapping[str, str]) -> None:
        words = list(self.words)
        for mark, folder in folders.items():
            words = [word.replace(mark, folder) for word in words]
        with (place / "stderr").open("w+b") as stderr:
            try:
                program = subprocess.Popen(  # noqa: S603
                    words,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=stderr,
                    start_new_session=True,
                )
            except (OSError, ValueError) as error:
                reason = error.strerror if isinstance(error, OSError) else error
                raise EstimatorError(f"{words[0]}: cannot be started ({reason})") from None
            try:
                with _ending_with_us(program.pid):
                    code = program.wait(self.timeout_s)
            except BaseException as error:  # it, and what it has started, end before we go on
                with suppress(OSError):
                    os.killpg(program.pid, signal.SIGKILL)
                program.wait()
                if isinstance(error, subprocess.TimeoutExpired):
                    reported = f"took longer than {self.timeout_s:g} s"
                    raise EstimatorError(reported, _tail(stderr)) from None
                raise
            if code:
                tail = _tail(stderr)
                last = next(
                    (line for line in tail.splitlines()[::-1] if line.strip()), "no message"
                )
                ended = f"exit code {code}" if code > 0 else f"killed by signal {-code}"
                raise EstimatorError(f"{ended}: {last}", tail)


@contextmanager
def _ending_with_us(group: int) -> Iterator[None]:
    """Have a group of processes end where this process ends meanwhile, also by SIGKILL.

    A shell waits for a line that only this process can send, or for the end of its input.
    """
    watch = subprocess.Popen(  # noqa: S603
        ("/bin/sh", "-c", 'read line || kill -s KILL -- "-$0"', str(group)),
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield
    finally:
        watch.communicate(b"\n")


def _tail(file: IO[bytes]) -> str:
    size = file.seek(0, os.SEEK_END)
    file.seek(max(size - _TAIL_BYTES, 0))
    return file.read().decode("utf-8", errors="replace")


def parse_commands(
    texts: Iterable[str], timeout_s: float = TIMEOUT_S
) -> dict[str, ExternalProgram]:
    """Commands by name, each as NAME=COMMAND, or COMMAND alone, which is called mine.

    Raises InputError.
    """
    if not 0.0 < timeout_s < np.inf:
        raise InputError(f"--timeout is {timeout_s:g}, expected seconds above 0")
    found: dict[str, ExternalProgram] = {}
    for text in texts:
        named = _NAMED.fullmatch(text.strip())
        name, command = named.groups() if named else ("mine", text)
        if name in found:
            raise InputError(f"--command: two are called {name}; give NAME=COMMAND")
        found[name] = ExternalProgram.parse(command, timeout_s)
    check_names(found)
    return found


def check_names(names: Iterable[str]) -> None:
    """Raise InputError for a name that a column cannot have."""
    for name in names:
        if name in FILTER_NAMES or not _NAMED.fullmatch(f"{name}="):
            raise InputError(
                f"estimator '{shorten(name)}': expected up to 20 of a-z, 0-9, _ and -, from a "
                f"letter on, and none of {', '.join(FILTER_NAMES)}"
            )


def run_external(
    estimator: Estimator, world: ScenarioWorld, run: int, name: str
) -> RunRecords | Failure:
    """Return one run's records (1, T), or why there are none. name: of the log."""
    try:
        estimate = estimator(log_of_run(world, run, name))
        given = ExternalEstimate.of(estimate) if isinstance(estimate, Estimate) else estimate
        if not isinstance(given, ExternalEstimate):
            raise EstimatorError(
                f"returned {type(given).__name__}, expected an Estimate or a ExternalEstimate"
            )
        return errors_of(given, world)
    except EstimatorError as error:
        return Failure(run, str(error), error.output)
    except Exception as error:
        import traceback

        reported = str(EstimatorError(f"{type(error).__name__}: {error}"))
        return Failure(run, reported, traceback.format_exc()[-_TAIL_BYTES:])


def errors_of(given: ExternalEstimate, world: ScenarioWorld) -> RunRecords:
    """Records (1, T) of one estimate, NaN at recorded steps without a pose.

    Of landmarks there is the final map alone, at the last step. Raises EstimatorError.
    """
    _check_finite(given)
    row = _rows(given.time_s, world)
    recorded = np.array(recorded_steps(len(world.control)))
    columns = np.flatnonzero(row[recorded] >= 0)
    steps = recorded[columns]
    at = row[steps]
    error = world.pose[steps] - given.pose[at]
    error[:, 2] = wrap_angle(error[:, 2])
    records = RunRecords(*(np.full((1, len(recorded)), np.nan) for _ in RunRecords._fields))
    records.position_square[0, columns] = (error[:, :2] ** 2).sum(axis=1)
    records.heading_square[0, columns] = error[:, 2] ** 2
    if given.pose_covariance is not None:
        covariance = given.pose_covariance[at]
        _check_positive("pose", covariance, [f"{given.time_s[i]:g} s" for i in at])
        records.pose_nees[0, columns] = squared_distance(error, covariance)
        records.position_nees[0, columns] = squared_distance(error[:, :2], covariance[:, :2, :2])
        records.heading_nees[0, columns] = error[:, 2] ** 2 / covariance[:, 2, 2]
    if given.landmark_id is not None and given.landmark is not None:
        known = np.isin(given.landmark_id, np.arange(len(world.landmark)))
        if not known.any():
            raise EstimatorError("landmarks: none has an id of the log's")
        ids = given.landmark_id[known]
        missed = world.landmark[ids] - given.landmark[known]
        records.landmark_square[0, -1] = (missed**2).sum(axis=1).mean()
        if given.landmark_covariance is not None:
            own = given.landmark_covariance[known]
            _check_positive("landmark", own, [str(i) for i in ids])
            records.landmark_nees[0, -1] = squared_distance(missed, own).mean()
    return records


def _rows(time_s: Array, world: ScenarioWorld) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """(K + 1,) row of the estimate at each step's instant, -1 for none. Raises EstimatorError."""
    instants = world.robot.step_s * np.arange(len(world.control) + 1)
    row = np.clip(np.searchsorted(time_s, instants), 1, max(len(time_s) - 1, 1))
    row -= np.abs(time_s[row - 1] - instants) < np.abs(time_s[row % len(time_s)] - instants)
    row = np.minimum(row, len(time_s) - 1)
    near = np.abs(time_s[row] - instants) <= min(_NEAR_S, 0.1 * world.robot.step_s)
    if not near[-1]:
        raise EstimatorError(
            f"no pose at {instants[-1]:g} s, where the log ends; its last is at {time_s[-1]:g} s"
        )
    seen = np.array([False, *(len(which) > 0 for which in world.seen)])
    if (found := int((near & seen).sum())) < _LEAST_SHARE * seen.sum():
        raise EstimatorError(
            f"poses at {found:,} of the {int(seen.sum()):,} instants with measurements, expected "
            f"at {100 * _LEAST_SHARE:.0f} %"
        )
    return np.where(near, row, -1)


def _check_finite(given: ExternalEstimate) -> None:
    """What a folder's reader checks, of what a callable returns. Raises EstimatorError."""
    if not len(given.time_s) or not (np.diff(given.time_s) > 0.0).all():
        raise EstimatorError("times: expected some, each after the one before")
    for what, values in vars(given).items():
        if isinstance(values, np.ndarray) and not np.isfinite(values).all():
            raise EstimatorError(f"{what} holds a value that is not a finite number")


def _check_positive(what: str, covariance: Array, where: list[str]) -> None:
    bad = np.flatnonzero(~definite(covariance))
    if len(bad):
        raise EstimatorError(f"{what} covariance of {where[bad[0]]} is not positive definite")
