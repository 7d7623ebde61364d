"""The command line in this process: what a process of its own would print and end with."""

import contextlib
import io
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

from comparisons.cli.app import main
from tests.graphslam.skips import pass_on


class Done(NamedTuple):
    """How a command ended, as `subprocess.CompletedProcess` has it."""

    returncode: int
    stdout: str
    stderr: str


def slamcheck(*arguments: str, cwd: Path, columns: int = 100) -> Done:
    """Run a command in a folder. Raises MissingLibraryError where it says that it lacks one."""
    return called(main, *arguments, cwd=cwd, columns=columns)


def called(program: Callable[[], None], *arguments: str, cwd: Path, columns: int = 100) -> Done:
    """Call a program's entry in a folder. Raises MissingLibraryError as `slamcheck` does."""
    printed, said = io.StringIO(), io.StringIO()
    with (
        patch.object(sys, "argv", ["slamcheck", *arguments]),
        patch.dict(os.environ, {"COLUMNS": str(columns), "NO_COLOR": "1", "TERM": "dumb"}),
        contextlib.chdir(cwd),
        contextlib.redirect_stdout(printed),
        contextlib.redirect_stderr(said),
    ):
        try:
            program()
            code: object = 0
        except SystemExit as stop:
            code = stop.code or 0
    assert isinstance(code, int), code
    pass_on(said.getvalue())
    return Done(code, printed.getvalue(), said.getvalue())


def works(*arguments: str, cwd: Path) -> str:
    """Return what a command prints that ends well."""
    done = slamcheck(*arguments, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done.stdout


def refused(*arguments: str, cwd: Path) -> str:
    """Return why a command refuses: in one line, or in a box under the usage, and nothing else."""
    done = slamcheck(*arguments, cwd=cwd)
    assert (done.returncode, done.stdout) == (2, ""), done
    in_a_box = "\u2500 Error \u2500" in done.stderr
    one_line = done.stderr.startswith("slamcheck: ") and done.stderr.count("\n") == 1
    assert in_a_box or one_line, done.stderr
    return flat(done.stderr)


def flat(text: str) -> str:
    """What rich has put into a box of several lines, as one."""
    return " ".join(re.sub("[\u2500-\u257f]", " ", text).split())


def files_in(folder: Path) -> set[str]:
    """Paths of all files, in the folder."""
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def job_files(*own: str, estimates: tuple[str, ...] = ()) -> set[str]:
    """What a job writes: what every one does, its own files and folders of estimates."""
    estimate = ("covariances.npz", "estimate.toml", "landmarks.csv", "trajectory.tum")
    each = {f"{name}/{file}" for name in estimates for file in estimate}
    return {"config.toml", "files.sha256", "report.html", *own, *each}
