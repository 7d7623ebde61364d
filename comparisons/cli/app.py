"""The command line, `slamcheck`. A command's module is imported when it is asked for."""

from __future__ import annotations

import atexit
import io
import os
import signal
import sys
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from pkgutil import resolve_name
from types import FrameType
from typing import Annotated, Any, NoReturn

import typer

from comparisons.cli.flags import DenseHelpCommand
from comparisons.cli.support import BROKEN, INTERRUPTED, UNUSABLE, fail

PANELS = {
    "Main": {
        "run": "run:run",
        "compare": "compare:compare",
        "logs": "logs:logs",
        "explain": "explain:explain",
        "config": "config:config",
    },
    "Your own data and filter": {
        "new-log": "new_log:new_log",
        "convert": "logs:convert",
        "check": "check:check",
        "audit": "audit:audit",
        "baseline": "baseline:baseline",
        "export": "export:export",
    },
    "One estimator alone": {
        "solve": "solve:solve",
        "odometry": "odometry:odometry",
        "map": "map:map_command",
    },
    "Experiments": {
        "montecarlo": "montecarlo:montecarlo",
    },
}
"""Names of commands by panel of the help, and where each is found in this package."""
COMMANDS = {name: place for panel in PANELS.values() for name, place in panel.items()}
MOVED = {
    "reproduce": "the documents' figures are no part of the program; with a checkout of the "
    "project: python -m research.documents FIGURE ... --data FOLDER",
}
"""Commands of the release before, and what replaces them."""
PROGRAM = "slamcheck"
STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
AGAIN_S = 10.0
"""An exit that a signal asked for is tried again after so long."""
_USAGE: type[Any] = typer.BadParameter.__bases__[0]
"""What every misuse of the command line is raised as."""


class _Panels(typer.core.TyperGroup):
    """The commands under the titles of their panels, without rich."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the panels."""
        for title, names in PANELS.items():
            with formatter.section(title):
                formatter.write_dl([(name, self.commands[name].short_help) for name in names])


def build(name: str | None = None, *, whole: bool = False) -> Any:
    """Return one command, or the command line with all of them, to be called.

    whole: every command with its options, for the shell's completion; else with its first line
    alone, without rich, which takes longer to load than all the rest of this help.
    """
    app = typer.Typer(
        name=PROGRAM,
        cls=None if name or whole else _Panels,
        help="Run an EKF-SLAM and a GTSAM smoother on one log and report whether they agree.",
        epilog="Options of a command: slamcheck COMMAND --help. Exit codes: 0 agree, 1 disagree, "
        "2 unusable input or usage, 3 unverified, 70 internal error, 130 interrupted.",
        rich_markup_mode="rich" if name or whole else None,
        pretty_exceptions_enable=False,
    )
    app.callback(invoke_without_command=True)(_main)
    for one in COMMANDS if name is None else (name,):
        command = resolve_name(f"comparisons.cli.{COMMANDS[one]}")
        several = isinstance(command, typer.Typer)
        if name is None and not whole:
            about = command.info.help if several else command.__doc__
            app.command(one, help=about, short_help=(about or "").splitlines()[0])(_unasked)
        elif several:
            app.add_typer(command, name=one)
        else:
            app.command(one, cls=DenseHelpCommand)(command)
    found: Any = typer.main.get_command(app)
    if name is not None:
        found = found.commands[name]
    found.context_settings["help_option_names"] = ["--help", "-h"]
    if name is not None or whole:
        _tidy(found)
    return found


def _unasked() -> None:
    """In place of a command that is not the first word, as in `slamcheck -- run`."""
    raise typer.BadParameter("expected the command as the first word: slamcheck COMMAND ...")


def _tidy(command: Any) -> None:
    """Ready help texts for rich: brackets are no markup, and only examples keep their lines."""
    paragraphs = (command.help or "").split("\n\n")
    command.help = "\n\n".join(
        paragraph.removeprefix("\b\n")
        if paragraph.startswith("\b")
        else " ".join(paragraph.split())
        for paragraph in paragraphs
    ).replace("[", r"\[")
    command.help = command.help.replace(
        "\n\n", "\n\n\n", 1
    )  # else rich takes away examples' margin
    for parameter in command.params:
        parameter.help = parameter.help and parameter.help.replace("[", r"\[")
        if getattr(parameter, "is_flag", False):
            parameter.metavar = " "
    if any(getattr(one, "hidden", False) and one.name != "log" for one in command.params):
        job = "" if command.name in ("run", "save") else f" {command.name}"
        command.epilog = f"All other options and settings: slamcheck config{job}"
    for below in getattr(command, "commands", {}).values():
        _tidy(below)


def _main(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
) -> None:
    if version:
        from importlib.metadata import version as installed

        typer.echo(f"slamcheck {installed('slamcheck')}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(UNUSABLE)


def main() -> None:
    """Entry point of the console script.

    BLAS gets one thread unless the user says otherwise: the matrices are small, and threads that
    wait for each other on a busy machine cost several times the work. A failure that is nobody's
    known fault shows its traceback and exits with 70, never with a verdict's code.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for name in ("stdout", "stderr"):
        setattr(sys, name, _for_any_reader(getattr(sys, name)))
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    stopped = _stop_on_signals()
    try:
        _run(stopped)
    except BaseException:
        if stopped:  # whatever a library's import or our own guard made of the exit
            sys.exit(128 + stopped[0])
        raise


class _Pipe(io.FileIO):
    """Where a command writes. What a reader who has left, as `head` does, no longer takes is lost.

    Neither the command line's libraries nor Python's exit see that: each has an exit code of its
    own for it, and 1 is a verdict.
    """

    def write(self, data: Any) -> int:
        """Return how many bytes were written or lost."""
        try:
            return super().write(data)
        except BrokenPipeError:
            return memoryview(data).nbytes


def _for_any_reader(stream: Any) -> Any:
    """Return a standard stream whose reader may leave; None was closed by the caller."""
    if stream is None:
        return open(os.devnull, "w")
    buffer = getattr(stream, "buffer", None)
    raw = getattr(buffer, "raw", buffer)  # the same of python -u
    if not isinstance(raw, io.FileIO):
        return stream
    try:
        pipe = _Pipe(stream.fileno(), "wb", closefd=False)
    except OSError:  # closed beneath it
        return stream
    stream.flush()
    return io.TextIOWrapper(
        pipe if raw is buffer else io.BufferedWriter(pipe),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def _run(stopped: Sequence[int]) -> NoReturn:
    """Run what the command line asks for, and exit. stopped: a signal that has come since."""
    asked = sys.argv[1] if len(sys.argv) > 1 else ""
    if asked in MOVED:
        fail(f"{asked}: {MOVED[asked]}", UNUSABLE)
    try:
        if asked in COMMANDS:  # without the options of all, which take longer to load than help
            name, command, words = f"{PROGRAM} {asked}", build(asked), sys.argv[2:]
        else:
            whole = f"_{PROGRAM.upper()}_COMPLETE" in os.environ
            name, command, words = PROGRAM, build(whole=whole), sys.argv[1:]
        code = command(args=words, prog_name=name, standalone_mode=False)
        sys.exit(code if isinstance(code, int) else 0)
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(INTERRUPTED)
    except _USAGE as error:
        from typer.rich_utils import rich_format_error

        # An Enum's parser puts its own class of error in front.
        error.message = error.message.replace("Value error, ", "") + _meant(asked, error.message)
        with suppress(OSError):  # nobody reads it; the exit code stays
            rich_format_error(error)
        sys.exit(UNUSABLE)
    except OSError as error:  # of what a command prints outside of its own guard, such as help
        fail(f"standard output: {error.strerror or error}", UNUSABLE)
    except Exception:
        if not stopped:
            traceback.print_exc()
        sys.exit(BROKEN)


def _meant(command: str, message: str) -> str:
    """The option that a word without one was meant for."""
    stray = message.removeprefix("Got unexpected extra argument(s) (").removesuffix(")")
    if command != "check" or stray == message or " " in stray:
        return ""
    from comparisons.cli.check import as_meant

    log = next((word for word in sys.argv[2:] if not word.startswith("-")), "LOG")
    return f"; the estimate goes with --estimate: {as_meant(log, stray)}"


def _stop_on_signals() -> list[int]:
    """Clean up and exit with 128 and the signal's number; one that is ignored stays so (nohup).

    A closing terminal sends its signal twice: what repeats within a second is the same request, and
    must not cut short the cleaning up. An exit that was lost, as in a library's callback, is tried
    again. Returns the list that gets the signal's number.
    """
    asked: list[int] = []
    last_s = 0.0

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal last_s
        before_s, last_s = last_s, time.monotonic()
        if asked and number != signal.SIGALRM and last_s - before_s < 1.0:
            return
        if not asked:
            asked.append(number)
            signal.signal(signal.SIGALRM, stop)
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
        sys.exit(128 + asked[0])

    for number in STOPS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, stop)
    atexit.register(signal.setitimer, signal.ITIMER_REAL, 0.0)  # an exit that is under way is kept
    return asked
