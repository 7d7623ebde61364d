"""`slamcheck logs` and `convert`: which logs there are, and any of them as a log folder."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from comparisons.cli.flags import argument, log_names, of_flag, set_parameters
from comparisons.cli.support import guarded, say_streams
from comparisons.options.table import of_job

if TYPE_CHECKING:
    from comparisons.logs.log import Log


def logs(log: str | None, **given: Any) -> None:
    """List the bundled logs and readable formats; with LOG, examine that log.

    Columns, clocks, places, frames, labels and sigmas: the smoother solves a part of the log with
    its labels, as it is and with each change of each.

    \b
    Examples:
      slamcheck logs
      slamcheck logs my-drive
    """
    if log is None:
        _list()
        return
    with guarded():
        from comparisons.checks.diagnosis.log_doctor import examine

        source = _read(log, given)
        records = ", ".join(f"{n:,} {name}" for name, n in source.records.items())
        typer.echo(f"{source.name}: {records}; {source.duration_s:.1f} s")
        examination = examine(source)
        test = examination.test
        if examination.lacks:
            typer.echo(f"not examined: {examination.lacks}")
        elif examination.words:
            typer.echo(examination.words)
            raise typer.Exit(1)
        else:
            fits = "fits its sigmas" if test.reading == "plausible" else f"is {test.reading}"
            typer.echo(
                "no fault found in columns, clocks, places, frames, labels or sigmas: "
                f"chi-square{examination.part} {fits} "
                f"({test.chi2:.4g} for {test.dof} degrees of freedom)"
            )


def _read(log: str, given: dict[str, Any]) -> Log:
    """A log with the options of its reader."""
    from comparisons.config import LogSection
    from comparisons.pipeline.read import load_log

    asked = {flag.field.removeprefix("log."): given[flag.name] for flag in _FLAGS}
    chosen = {name: value for name, value in asked.items() if value not in (None, [])}
    found = load_log(LogSection.of(source=log, **chosen))
    say_streams(found, log)
    return found


def _list() -> None:
    from comparisons.logs.bundled import NAMED
    from comparisons.logs.readers import READERS

    most = max((entry.takes for entry in NAMED.values()), key=len)
    for kind, entries in groupby(NAMED.items(), lambda item: item[1].kind):
        takes = f" ({', '.join(most)})" if kind == "simulated" else ""
        typer.echo(f"Logs by name, {kind}{takes}:")
        for name, entry in entries:
            less = [option for option in most if takes and option not in entry.takes]
            typer.echo(f"  {name:16} {entry.what}{''.join(f'; no {one}' for one in less)}")
    typer.echo("Logs by path; the format is recognised, or given by --format:")
    for name, reader in READERS.items():
        typer.echo(f"  {name:16} {reader.what}")
    typer.echo("CSV files: slamcheck new-log --help")


def convert(log: str, folder: Path, **given: Any) -> None:
    """Write any readable log as a log folder.

    \b
    Examples:
      slamcheck convert path/to/acfr_car_park car-park
      slamcheck convert drive.mcap drive --topic /markers --start 60 --end 180
    """
    with guarded():
        from comparisons.atomic import check_replaceable
        from comparisons.logs.log_folder import write_log_folder

        check_replaceable(folder)
        source = _read(log, given)
        write_log_folder(source, folder)
        records = ", ".join(f"{n:,} {name}" for name, n in source.records.items())
        typer.echo(f"{folder}: {records}")
        said = ("scans", "passed over", "passed_over", "lines_passed_over", "left_out")
        for key in ("odometry", "times", "edges", "frame", *said):
            if source.provenance.get(key):
                typer.echo(f"{key.replace('_', ' ')}: {source.provenance[key]}")


_FLAGS = [flag for flag in of_job("solve") if flag.field.startswith("log.") and flag.help]
set_parameters(
    logs,
    argument("log", str | None, "LOG", "Log to examine. [list the logs]", log_names),
    *map(of_flag, _FLAGS),
)
set_parameters(
    convert,
    argument("log", str, "LOG", "Name in `slamcheck logs`, or path.", log_names),
    argument("folder", Path, "FOLDER", "Log folder to write, new or empty."),
    *map(of_flag, _FLAGS),
)
