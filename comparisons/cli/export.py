"""`slamcheck export`: an estimate's trajectory for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comparisons.cli.support import guarded
from comparisons.errors import InputError


def export(
    estimate: Annotated[
        Path, typer.Argument(metavar="ESTIMATE", help="An estimate's folder, or a trajectory.")
    ],
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The new file to write.")],
    format_name: Annotated[
        str, typer.Option("--format", metavar="tum|kitti|csv", help="What to write.")
    ] = "csv",
    times: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Times of a KITTI file, else times.txt beside it."),
    ] = None,
) -> None:
    """Write an estimate's trajectory in another format; KITTI also writes times.txt beside it.

    \b
    Examples:
      slamcheck export slamcheck-simulated-loop/ekf ekf.csv
      slamcheck export my-poses.txt mine.tum --format tum --times my-times.txt
    """
    with guarded():
        from comparisons.estimates.external import read_given
        from comparisons.estimates.trajectory_files import Trajectory, write_trajectory

        parts = [f"{estimate / name}" for name in ("ekf", "smoother") if (estimate / name).is_dir()]
        if parts:
            raise InputError(f"{estimate}: is no estimate; give {' or '.join(parts)}")
        given = read_given(estimate, times)
        trajectory = Trajectory(given.time_s, given.pose, given.pose_covariance)
        write_trajectory(trajectory, file, format_name)
        typer.echo(f"{file}: {len(given.pose):,} poses")
