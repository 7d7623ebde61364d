"""`slamcheck logs` and `convert`: which logs there are, and any of them as a log folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comparisons.cli.flags import log_names
from comparisons.cli.support import guarded


def logs() -> None:
    """List the logs that can be named, and the formats that can be read."""
    from comparisons.logs.bundled import NAMED
    from comparisons.logs.readers import READERS

    typer.echo("Logs by name:")
    for name, entry in NAMED.items():
        options = f" ({', '.join(entry.takes)})" if entry.takes else ""
        typer.echo(f"  {name:16} {entry.kind}: {entry.what}{options}")
    typer.echo("Formats of logs by path (--format):")
    for name, reader in READERS.items():
        typer.echo(f"  {name:16} {reader.what}")


def convert(
    log: Annotated[
        str,
        typer.Argument(
            metavar="LOG",
            help="A bundled name (see `slamcheck logs`) or a path.",
            autocompletion=log_names,
        ),
    ],
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="The log folder to write.")],
    format_name: Annotated[
        str | None,
        typer.Option("--format", metavar="F", help="The log's format; recognised if left out."),
    ] = None,
    robot: Annotated[int, typer.Option(help="Robot number, for MR.CLAM folders.")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of a simulated log.")] = 0,
    loops: Annotated[int, typer.Option(help="Loops of a simulated log.")] = 1,
    noise_scale: Annotated[
        float, typer.Option(help="Factor on the noise of a simulated log.")
    ] = 1.0,
) -> None:
    """Write any readable log as a log folder.

    \b
    Example:
      slamcheck convert path/to/acfr_car_park car-park
    """
    with guarded():
        from comparisons.atomic import check_replaceable
        from comparisons.logs.bundled import SimulationChoices, open_log
        from comparisons.logs.log_folder import write_log_folder

        check_replaceable(folder)
        source = open_log(log, format_name, robot, SimulationChoices(seed, loops, noise_scale))
        write_log_folder(source, folder)
        records = ", ".join(f"{n:,} {name}" for name, n in source.records.items())
        typer.echo(f"{folder}: {records}")
