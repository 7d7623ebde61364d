"""`slamcheck new-log`: a log folder from a user's own CSV files."""

from __future__ import annotations

import inspect
import shlex
from collections.abc import Sequence
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from comparisons.cli.flags import argument, parameter, set_parameters
from comparisons.cli.support import guarded
from comparisons.errors import InputError, quoted, shorten
from comparisons.logs.schema import COLUMNS, KINDS, OPTIONS, POSES, STREAMS

if TYPE_CHECKING:
    from comparisons.logs.plain_csv import PlainTable

_Text = str | None
_File = Path | None
_OPTIONS: dict[str, tuple[Any, str, str]] = {
    **{
        stream.argument: (Path if stream.is_required else _File, "FILE", stream.help)
        for stream in STREAMS
        if stream.option
    },
    **{
        stated.option.removeprefix("--").replace("-", "_"): (_Text, stated.unit, stated.help)
        for column in COLUMNS.values()
        if (stated := column.stated) is not None
    },
    "prior_pose": (_Text, "X,Y,RAD", "Start pose. [truth, else 0,0,0]"),
    "kind": (
        _Text,
        "KIND",
        f"Odometry: {', '.join(KINDS)}. [by the columns]",
    ),
    "unit": (
        list[str],
        "COLUMN=UNIT",
        "Unit where a header names none, as bearing=deg or truth:yaw=deg; repeatable.",
    ),
    "column": (
        list[str],
        "COLUMN=HEADER",
        "Header of a column, as time=stamp_unix_ns; repeatable.",
    ),
    "imu": (_File, "FILE", "Yaw rates, in place of the odometry's."),
}


def new_log(folder: Path, **given: Any) -> None:
    """Make a log folder from CSV files.

    Columns, in any order: time, v, omega (or steering; x, y, yaw; dx, dy, dyaw) and time, range,
    bearing, label; or a ROS message's fields, as any tool exports them. Units: SI and radians, or
    in the header: bearing_deg, t_ns, range_mm, v_kmh. A sigma is in SI, or has a unit of its own:
    0.5deg, 5cm.

    \b
    Example:
      slamcheck new-log my-drive --odometry odo.csv --measurements trees.csv \\
        --sigma-speed 0.1 --sigma-turn 0.02 --sigma-range 0.1 --sigma-bearing 0.01
    """
    with guarded():
        from dataclasses import replace

        from comparisons.adapters.motion import with_regular_motion
        from comparisons.atomic import check_replaceable
        from comparisons.checks.diagnosis.log_doctor import examine
        from comparisons.logs.log_folder import read_log_folder, write_log_folder
        from comparisons.logs.new_log import UserFiles, build

        check_replaceable(folder)
        units = _pairs("--unit", given["unit"] or (), "COLUMN=UNIT, as bearing=deg")
        columns = _pairs("--column", given["column"] or (), "COLUMN=HEADER, as time=stamp_unix_ns")
        stated = {
            column: value
            for column, option in OPTIONS.items()
            if (value := given[option.removeprefix("--").replace("-", "_")]) is not None
        }
        truth = given["truth"]
        files = UserFiles(
            name=folder.resolve().name,
            stated=stated,
            truth=None if truth is None else partial(_read_truth, truth, units, columns),
            prior_pose=_pose(given["prior_pose"]),
            units=units,
            columns=columns,
            paths={
                stream.argument: path
                for stream in STREAMS
                if stream.option and (path := given[stream.argument]) is not None
            },
            **{name: given[name] for name in ("kind", "imu")},
        )
        found = build(files)
        log = with_regular_motion(found.log)
        examined = examine(log)
        if any(finding.unit for finding in examined.findings):
            raise InputError(f"the files contradict each other: {examined.words}")
        write_log_folder(replace(log, format="new-log"), folder, found.remarks)
        records = ", ".join(f"{n:,} {name}" for name, n in read_log_folder(folder).records.items())
        for note in found.notes:
            typer.echo(note)
        typer.echo(f"{folder}: {records}; {log.duration_s:.1f} s; defaults in {folder}/log.toml")
        if examined.words:
            typer.echo(f"warning: {examined.words}")
        name = shlex.quote(str(folder))
        typer.echo(f"next: slamcheck run {name}, or slamcheck check {name} --estimate PATH")


def _pairs(option: str, given: Sequence[str], expected: str) -> dict[str, str]:
    """What a repeatable option says, of `COLUMN=VALUE` and `STREAM:COLUMN=VALUE`."""
    found = {}
    for text in given:
        column, equals, value = text.partition("=")
        if not (equals and column and value):
            raise InputError(f"{option} is '{shorten(text)}', expected {expected}")
        found[column] = value
    return found


def _read_truth(
    path: Path, units: dict[str, str], columns: dict[str, str], start_s: int
) -> PlainTable:
    """Poses of a CSV file with a header, or of a file of numbers alone (TUM), after a start."""
    from comparisons.estimates.trajectory_files import read_trajectory_file
    from comparisons.logs.new_log import column_options
    from comparisons.logs.plain_csv import PlainTable, read_plain
    from comparisons.logs.stamps import after_ns
    from comparisons.logs.table import read_text

    names = POSES.needed
    lines = [line for line in read_text(path).splitlines() if line.strip() and line[0] != "#"]
    if not lines or not lines[0].split()[0][:1].isdigit():
        options = column_options(units, columns, "truth")
        return read_plain(path, names, options=options, start_s=start_s)
    trajectory = read_trajectory_file(path)
    if trajectory.left_out:
        typer.echo(trajectory.left_out)
    time_s = trajectory.time_s - start_s
    if trajectory.time_ns is not None:
        time_s = after_ns(trajectory.time_ns, Decimal(start_s))
    values = dict(zip(names, (time_s, *trajectory.pose.T), strict=True))
    line = list(range(1, len(trajectory.time_s) + 1))
    return PlainTable(path=path, columns=values, line=line, origin={}, headers=[])


def _pose(text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    try:
        x, y, heading = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(
            f"--prior-pose is {quoted(text)}, expected x,y,heading in m and rad"
        ) from None
    return x, y, heading


def _option(name: str, kind: Any, metavar: str, text: str) -> inspect.Parameter:
    option = typer.Option(
        f"--{name.replace('_', '-')}",
        metavar=metavar,
        help=text,
        show_default=False,
    )
    return parameter(name, Annotated[kind, option], *([] if kind is Path else [None]))


set_parameters(
    new_log,
    argument("folder", Path, "FOLDER", "Log folder to write, new or empty."),
    *(_option(name, *words) for name, words in _OPTIONS.items()),
)
