"""`slamcheck export`: an estimate's trajectory for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comparisons.cli.support import guarded
from comparisons.errors import InputError, shorten


def export(
    estimate: Annotated[
        Path,
        typer.Argument(metavar="ESTIMATE", help="Folder of an estimate, or a trajectory file."),
    ],
    file: Annotated[Path, typer.Argument(metavar="FILE", help="New trajectory file.")],
    format_name: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="tum|kitti|csv",
            help="Format of the new file. [by its suffix]",
        ),
    ] = None,
    times: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Time stamps of a KITTI trajectory. [times.txt beside it]"
        ),
    ] = None,
) -> None:
    """Write a trajectory as TUM, KITTI or CSV.

    KITTI files have no time stamps; they are written to times.txt beside the file.

    \b
    Examples:
      slamcheck export slamcheck-simulated-loop/ekf ekf.csv
      slamcheck export my-poses.txt mine.tum --times my-times.txt
      slamcheck export slamcheck-simulated-loop/smoother poses.txt --format kitti
    """
    with guarded():
        kind = _format(file, format_name)
        from comparisons.estimates.external import read_external
        from comparisons.estimates.trajectory_files import Trajectory, write_trajectory

        parts = [f"{estimate / name}" for name in ("ekf", "smoother") if (estimate / name).is_dir()]
        if parts:
            raise InputError(f"{estimate}: is no estimate; give {' or '.join(parts)}")
        given = read_external(estimate, times)
        trajectory = Trajectory(given.time_s, given.pose, given.pose_covariance)
        write_trajectory(trajectory, file, kind)
        typer.echo(f"{file}: {len(given.pose):,} poses{given.left_out and '; '}{given.left_out}")


def _format(file: Path, asked: str | None) -> str:
    """The format that the suffix or, where that says nothing, the option names."""
    from comparisons.estimates.trajectory_files import FORMATS

    suffix = file.suffix.lower().removeprefix(".")
    if suffix not in FORMATS and asked is None:
        known = ", ".join(f".{one}" for one in FORMATS)
        raise InputError(f"{file}: its suffix names no format, expected {known}, or --format")
    if suffix in FORMATS and asked not in (None, suffix):
        raise InputError(
            f"{file}: its suffix says {suffix}, --format {shorten(asked)}; give one of them"
        )
    return asked or suffix
