"""The command line, `slamcheck`. Heavy imports stay inside the commands."""

from __future__ import annotations

import io
import os
import signal
import sys
import traceback
from pathlib import Path
from typing import Annotated

import typer

from comparisons.cli.baseline import baseline, side_by_side
from comparisons.cli.export import export
from comparisons.cli.montecarlo import montecarlo
from comparisons.cli.options import (
    FormatOption,
    LogArgument,
    LoopsOption,
    NoiseOption,
    RobotOption,
    SeedOption,
)
from comparisons.cli.reproduce import reproduce
from comparisons.cli.run import check, run, solve
from comparisons.cli.scans import map_command, odometry
from comparisons.cli.support import (
    BROKEN,
    INTERRUPTED,
    UNUSABLE,
    fail,
    guarded,
    open_named,
)

app = typer.Typer(
    name="slamcheck",
    help="Is my EKF-SLAM right? Runs an EKF and a smoother on one log and judges the EKF.",
    epilog="Exit codes: 0 agree, 1 disagree, 2 unusable input or usage, 3 unproven, "
    "70 a fault of slamcheck itself, 130 interrupted.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


for job in (run, solve, check):
    app.command()(job)
app.add_typer(baseline, name="baseline")
app.command("compare")(side_by_side)
app.command()(odometry)
app.command("map")(map_command)
app.command()(montecarlo)
app.command()(export)
app.command()(reproduce)


@app.command()
def logs() -> None:
    """List the logs that can be named, and the formats that can be read."""
    from comparisons.logs.bundled import NAMED
    from comparisons.logs.readers import READERS

    typer.echo("Logs by name:")
    for name, entry in NAMED.items():
        typer.echo(f"  {name:16} {entry.kind}: {entry.what}")
    typer.echo("Formats of logs by path (--format):")
    for name, reader in READERS.items():
        typer.echo(f"  {name:16} {reader.what}")


@app.command()
def convert(
    log: LogArgument,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="The log folder to write.")],
    format_name: FormatOption = None,
    robot: RobotOption = 1,
    seed: SeedOption = 0,
    loops: LoopsOption = 1,
    noise_scale: NoiseOption = 1.0,
) -> None:
    """Write any readable log as a log folder.

    \b
    Example:
      slamcheck convert path/to/acfr_car_park car-park
    """
    with guarded():
        from comparisons.logs.log_folder import write_log_folder

        source = open_named(log, format_name, robot, seed, loops, noise_scale)
        write_log_folder(source, folder)
        records = ", ".join(f"{n:,} {name}" for name, n in source.records.items())
        typer.echo(f"{folder}: {records}")


@app.callback(invoke_without_command=True)
def _main(
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
) -> None:
    if version:
        from importlib.metadata import version as installed

        typer.echo(f"slamcheck {installed('slamcheck')}")
        raise typer.Exit


def main() -> None:
    """Entry point of the console script.

    BLAS gets one thread unless the user says otherwise: the matrices are small, and threads that
    wait for each other on a busy machine cost several times the work. A failure that is nobody's
    known fault shows its traceback and exits with 70, never with a verdict's code.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    try:
        code = app(standalone_mode=False)
        sys.exit(code if isinstance(code, int) else 0)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except Exception as error:
        if hasattr(error, "format_message"):  # a usage error of the option parser
            fail(f"{error.format_message()} (see slamcheck --help)", UNUSABLE)
        if type(error).__name__ == "Abort":
            sys.exit(INTERRUPTED)
        traceback.print_exc()
        sys.exit(BROKEN)
