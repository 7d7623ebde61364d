"""What all commands share: exit codes, faults told in one line, a progress bar."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from comparisons.errors import InputError, printable

if TYPE_CHECKING:
    from rich.console import Console

    from comparisons.logs.log import Log
    from comparisons.pipeline.compare import Comparison, Progress

AGREE, DISAGREE, UNUSABLE, UNPROVEN = 0, 1, 2, 3
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
def guarded() -> Iterator[None]:
    """Known faults become one line on standard error and an exit code; warnings stay silent.

    What the numbers mean is checked where they are used, so numpy's and matplotlib's remarks
    would only tell the same twice.
    """
    import warnings

    import numpy as np

    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InputError as error:
        fail(str(error), UNUSABLE)
    except OSError as error:
        fail(f"{error.filename or 'a file'}: {error.strerror or error}", UNUSABLE)
    except MemoryError:
        fail("not enough memory for this log", UNUSABLE)
    except (ArithmeticError, ValueError, RuntimeError) as error:
        # Known by name, so that their modules need not be loaded for every command.
        if type(error).__name__ == "SingularProblemError":
            fail(f"unproven: {error}", UNPROVEN)
        if type(error).__name__ in ("Open3dMissingError", "CloudError"):
            fail(str(error), UNUSABLE)
        raise


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


def open_named(
    name: str, format_name: str | None, robot: int, seed: int, loops: int, noise_scale: float
) -> Log:
    """The log of a name or a path. Raises InputError."""
    from comparisons.logs.bundled import SimulationChoices, open_log

    return open_log(name, format_name, robot, SimulationChoices(seed, loops, noise_scale))


def read_named(
    name: str,
    format_name: str | None,
    robot: int,
    seed: int,
    loops: int,
    noise_scale: float,
    features: str,
) -> tuple[Log, float]:
    """The log with the features asked for, and the seconds that took."""
    from comparisons.logs.transforms.tree_features import choose_features

    start = time.perf_counter()
    log = open_named(name, format_name, robot, seed, loops, noise_scale)
    return choose_features(log, features), time.perf_counter() - start


def check_cloud(cloud: str | None) -> None:
    """Where Open3D is missing, or the format unknown, say so before the work."""
    if cloud is None:
        return
    if cloud not in ("pcd", "ply"):
        raise InputError(f"cloud '{cloud}' is unknown, expected pcd or ply")
    from graphslam.scan.open3d_library import open3d

    open3d()


def check_figures(formats: list[str]) -> None:
    """Say before the work which format of pictures is unknown."""
    for one in formats:
        if one not in ("png", "pdf"):
            raise InputError(f"figures '{one}' is unknown, expected png or pdf")


@dataclass(frozen=True)
class Extras:
    """What a run leaves besides its folder's usual files, when asked to. See report.viewer.

    trace: the filter's, see runs.trace_file.
    """

    figures: tuple[str, ...] = ()
    live: bool = False
    record: Path | None = None
    trace: bool = False

    def save(self, comparison: Comparison) -> None:
        """Write the replay, if it is to be kept."""
        if self.record is not None:
            from comparisons.report.viewer import record_run

            record_run(comparison, self.record)

    def show(self, comparison: Comparison) -> None:
        """Open the viewer, if it is wanted."""
        if self.live:
            from comparisons.report.viewer import show_run

            show_run(comparison)
