"""What all commands share: exit codes, known faults in one line, the log, a progress bar."""

from __future__ import annotations

import logging
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from comparisons.errors import InputError, note, one_line, printable, unusable_file

if TYPE_CHECKING:
    from rich.console import Console

    from comparisons.logs.log import Log
    from comparisons.pipeline.clock import Progress
    from comparisons.report.terminal import Summary

AGREE, DISAGREE, UNUSABLE, UNVERIFIED = 0, 1, 2, 3
VERDICTS = {"agree": AGREE, "verified": AGREE, "disagree": DISAGREE, "unverified": UNVERIFIED}
BROKEN, INTERRUPTED = 70, 130
FIRST = "reading"
"""The stage before a job names one."""
QUIET_S = 5.0
"""A job that takes less says nothing of its stages where no terminal shows them."""


class Output(Enum):
    """What a job prints: a few lines, these and all figures, the result as JSON, or nothing."""

    BRIEF, VERBOSE, JSON, QUIET = range(4)


def chosen_output(*, verbose: bool, json: bool, quiet: bool) -> Output:
    """Return what is printed. Raises InputError where more than one is asked for."""
    asked = {Output.VERBOSE: verbose, Output.JSON: json, Output.QUIET: quiet}
    chosen = [output for output, given in asked.items() if given]
    if len(chosen) > 1:
        names = " and ".join(f"--{output.name.lower()}" for output in chosen)
        raise InputError(f"{names} exclude each other: give one of them")
    return chosen[0] if chosen else Output.BRIEF


def print_result(summary: Summary, file: Path, output: Output) -> None:
    """Print what was asked for. file: the result as JSON, in the report's folder."""
    from comparisons.report.terminal import print_summary

    verbose = output is Output.VERBOSE
    if output is Output.JSON:
        text = file.read_text(encoding="utf-8")
        print_text(lambda console: console.file.write(text))
    elif output is not Output.QUIET:
        print_text(
            lambda console: print_summary(summary, console, str(file.parent), verbose=verbose)
        )


def print_text(write: Callable[[Console], object]) -> None:
    """Write to standard output; a full disk does not change the verdict."""
    from rich.console import Console

    try:
        write(Console(soft_wrap=True))
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


@contextmanager
def guarded(*, log_file: Path | None = None) -> Iterator[None]:
    """Known faults become one line on standard error and an exit code.

    Warnings of libraries and numbers that overflow go to a log. What the numbers mean is checked
    where they are used, so that nobody needs to read it. log_file: where the log is kept.
    """
    import warnings

    import numpy as np

    try:
        shown = _start_log(log_file)
        numbers = np.errstate(all="log" if shown else "ignore", call=_FloatingPoint())
        with warnings.catch_warnings(), numbers:
            warnings.simplefilter("default")
            logging.captureWarnings(capture=True)
            yield
    except InputError as error:
        fail(str(error), UNUSABLE)
    except OSError as error:
        fail(unusable_file(error), UNUSABLE)
    except MemoryError:
        fail("not enough memory for this log", UNUSABLE)
    except RecursionError:
        fail("an input is nested too deep", UNUSABLE)
    except ModuleNotFoundError as error:
        if error.name != "gtsam":
            raise
        fail(str(error), UNUSABLE)
    except Exception as error:
        if _is(error, "graphslam.marginals", "SingularProblemError"):
            fail(f"unverified: {error}", UNVERIFIED)
        if _is(error, "graphslam.scan.libraries", "MissingLibraryError") or _is(
            error, "graphslam.scan.clouds", "CloudError"
        ):
            fail(str(error), UNUSABLE)
        if isinstance(error, np.linalg.LinAlgError):
            logging.getLogger("slamcheck").info("no decomposition", exc_info=error)
            fail(
                "unverified: a covariance is singular to rounding: sigmas and prior of the log "
                f"lie too many powers of ten apart for double precision ({error}; --log FILE "
                "tells where)",
                UNVERIFIED,
            )
        raise
    finally:
        logging.captureWarnings(capture=False)


_LOG_LINE = rb"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} \S+ [A-Z]+: "
"""As _start_log has them written."""


class _FloatingPoint:
    """Where numpy writes that a number overflowed or is not one."""

    def write(self, message: str) -> None:
        """Log it."""
        logging.getLogger("numpy").info(message.strip())


def _start_log(file: Path | None) -> bool:
    """Send the log to where it was asked for. Return whether anybody sees it."""
    handlers: list[logging.Handler] = [logging.NullHandler()]
    if file is not None:
        from comparisons.atomic import Kind, begins, check_file

        if file.is_dir():
            raise InputError(
                f"{file}: is a folder; --log names the file that warnings are written to; "
                f"a log stands without an option: slamcheck COMMAND {file}"
            )
        check_file(file, Kind("an earlier log", begins(_LOG_LINE)))
        handlers.append(logging.FileHandler(file, mode="w", encoding="utf-8"))
    logging.raiseExceptions = False  # a full disk or a closed terminal cuts the log short, no more
    logging.basicConfig(
        level=logging.INFO,
        format="%(asctime)s %(name)s %(levelname)s: %(message)s",
        handlers=handlers,
        force=True,
    )
    return len(handlers) > 1


def _is(error: Exception, module: str, name: str) -> bool:
    """Whether an error is of a class of a module, which need not be loaded for every command."""
    loaded = sys.modules.get(module)
    return loaded is not None and isinstance(error, getattr(loaded, name))


def say_streams(log: Log, source: str) -> None:
    """Print which topics of a bag a log was read from, and what of them was left out."""
    from comparisons.logs.readers import ros_bag, rosbag

    if ros_bag.recognise_bag(Path(source).expanduser()) is not None:
        for line in rosbag.streams_of(log):
            note(f"{log.name}: {line}")


def fail(message: str, code: int) -> NoReturn:
    """One line on standard error, and the exit code."""
    with suppress(OSError, ValueError):
        print(f"slamcheck: {printable(one_line(' '.join(message.split())))}", file=sys.stderr)
    raise SystemExit(code)


@contextmanager
def progress_bar(output: Output = Output.BRIEF) -> Iterator[Progress]:
    """Show stages on standard error: a bar on a terminal, else one line each of a long job."""
    if output is Output.QUIET:
        yield lambda name, done, total: None
        return
    terminal = sys.stderr is not None and sys.stderr.isatty()  # None: closed by the caller
    with _bar() if terminal else _lines() as show:
        yield show


@contextmanager
def _bar() -> Iterator[Progress]:
    """A bar for each stage beside the time since all began, which no stage's end stops."""
    from datetime import timedelta

    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
    from rich.text import Text

    start_s = time.monotonic()

    class SinceStart(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text(str(timedelta(seconds=int(time.monotonic() - start_s))))

    columns = (TextColumn("{task.description}"), BarColumn(), SinceStart())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        stage, task = FIRST, bar.add_task(FIRST, total=None)

        def show(name: str, done: int, total: int) -> None:
            nonlocal stage, task
            if name != stage:  # a new task, for rich takes no total away
                bar.remove_task(task)
                stage, task = name, bar.add_task(name, total=total or None)
            bar.update(task, completed=done)

        yield show


@contextmanager
def _lines() -> Iterator[Progress]:
    """A line for each stage that has ended, with its time, once the job takes QUIET_S."""
    start_s = since_s = time.monotonic()
    stage, waiting = FIRST, list[str]()

    def show(name: str, done: int, total: int) -> None:
        nonlocal stage, since_s
        now_s = time.monotonic()
        if name == stage:
            return
        waiting.append(f"slamcheck: {stage} {now_s - since_s:.1f} s")
        stage, since_s = name, now_s
        if now_s - start_s >= QUIET_S and sys.stderr is not None:
            with suppress(OSError, ValueError):
                print(*waiting, sep="\n", file=sys.stderr, flush=True)
            waiting.clear()

    yield show
    show("", 0, 0)
