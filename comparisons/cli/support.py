"""What all commands share: exit codes, known faults in one line, the log, a progress bar."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from comparisons.errors import InputError, printable

if TYPE_CHECKING:
    from rich.console import Console

    from comparisons.pipeline.prepare import Progress

AGREE, DISAGREE, UNUSABLE, UNVERIFIED = 0, 1, 2, 3
VERDICTS = {"agree": AGREE, "verified": AGREE, "disagree": DISAGREE, "unverified": UNVERIFIED}
BROKEN, INTERRUPTED = 70, 130


def print_result(summary: Callable[[Console], None], folder: Path) -> None:
    """Print a summary and where the report is; a reader who has left changes nothing."""
    from rich.console import Console

    try:
        console = Console(soft_wrap=True)
        summary(console)
        console.print(f"report: {folder}", highlight=False, markup=False)
        sys.stdout.flush()
    except OSError:  # nobody listens any more; that does not change the verdict
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


@contextmanager
def guarded(*, verbose: bool = False, log_file: Path | None = None) -> Iterator[None]:
    """Known faults become one line on standard error and an exit code.

    Warnings of libraries and numbers that overflow go to a log. What the numbers mean is checked
    where they are used, so that nobody needs to read it. verbose: show the log on standard error;
    log_file: keep it in a file.
    """
    import warnings

    import numpy as np

    try:
        shown = _start_log(verbose, log_file)
        numbers = np.errstate(all="log" if shown else "ignore", call=_FloatingPoint())
        with warnings.catch_warnings(), numbers:
            warnings.simplefilter("default")
            logging.captureWarnings(capture=True)
            yield
    except InputError as error:
        fail(str(error), UNUSABLE)
    except OSError as error:
        fail(f"{error.filename or 'a file'}: {error.strerror or error}", UNUSABLE)
    except MemoryError:
        fail("not enough memory for this log", UNUSABLE)
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
                f"lie too many powers of ten apart for double precision ({error}; --verbose "
                "tells where)",
                UNVERIFIED,
            )
        raise
    finally:
        logging.captureWarnings(capture=False)


class _FloatingPoint:
    """Where numpy writes that a number overflowed or is not one."""

    def write(self, message: str) -> None:
        """Log it."""
        logging.getLogger("numpy").info(message.strip())


def _start_log(verbose: bool, file: Path | None) -> bool:
    """Send the log to where it was asked for. Return whether anybody sees it."""
    handlers: list[logging.Handler] = [logging.NullHandler()]
    if verbose:
        handlers.append(logging.StreamHandler(sys.stderr))
    if file is not None:
        from comparisons.atomic import check_file

        check_file(file)
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


def fail(message: str, code: int) -> NoReturn:
    """One line on standard error, and the exit code."""
    with suppress(OSError, ValueError):
        print(f"slamcheck: {printable(' '.join(message.split()))}", file=sys.stderr)
    raise SystemExit(code)


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A progress bar on standard error, when that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task("reading", total=None)

        def show(stage: str, done: int, total: int) -> None:
            bar.update(task, description=stage, completed=done, total=total or None)

        yield show
