"""`slamcheck compare`: results of several jobs, or trajectories, side by side."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comparisons.cli.support import AGREE, guarded
from comparisons.errors import InputError, naming

if TYPE_CHECKING:
    from comparisons.report.side_by_side import ComparedResult, Page


def compare(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="PATH",
            help="Output folders; or trajectories, of which the first is the reference.",
        ),
    ],
    align: Annotated[
        bool,
        typer.Option(help="Turn and move each trajectory to the first before, without scale."),
    ] = False,
    only: Annotated[
        list[str],
        typer.Option(
            metavar="PATTERN",
            help="Show figures of this name, as accuracy or agreement.*_sigma, also where they "
            "are equal; repeat it for several.",
        ),
    ] = [],  # noqa: B006
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the table also to a .csv, .tex or .html file."),
    ] = None,
) -> None:
    """Put the results of several runs, or several trajectories, side by side.

    Of output folders the table shows verdicts, causes and the figures that differ. They may be of
    run, solve, check, odometry, map and montecarlo, also mixed: equal names share a row.

    Of trajectories (TUM, KITTI, CSV, EuRoC, a bag, a folder with trajectory.tum) it shows the
    errors against the first by the definitions of evo's ape and rpe, and NEES where there are
    covariances. Their stamps agree within 0.01 s.

    \b
    Examples:
      slamcheck compare report-full report-compressed
      slamcheck compare a b c --only accuracy --out table.tex
      slamcheck compare truth.tum mine.tum theirs.tum --align
    """
    with guarded():
        from rich.console import Console

        from comparisons.report import side_by_side as report

        if out is not None:
            report.check_table(out)
        if any(report.is_result(path) for path in paths):
            results, page, compared = _of_jobs(paths, align=align), None, paths
        else:
            results, page = _of_trajectories(paths, align=align)
            compared, only = paths[1:], only or ["*"]
        rows = report.side_by_side(results, only)
        names = [path.name for path in compared]
        titles = [
            str(path) if names.count(path.name) > 1 else path.name or str(path) for path in compared
        ]
        report.print_side_by_side(titles, rows, Console())
        if out is not None:
            report.write_table(titles, rows, out, page)
        raise SystemExit(AGREE)


def _of_jobs(folders: list[Path], *, align: bool) -> list[ComparedResult]:
    from comparisons.report.side_by_side import read_results

    if align:
        raise InputError(f"{folders[0]}: holds a result; --align is for trajectories")
    return read_results(folders)


def _of_trajectories(paths: list[Path], *, align: bool) -> tuple[list[ComparedResult], Page]:
    """The errors of each against the first, and what makes a page of them. Raises InputError."""
    from comparisons.checks.path_errors import path_errors
    from comparisons.estimates.external import read_external
    from comparisons.report.side_by_side import result_of_path
    from comparisons.report.trajectories import trajectories_page

    if len(paths) < 2:
        raise InputError(
            f"{paths[0]}: holds no result of a job, and a trajectory alone has nothing to be "
            "compared with; give the reference before it"
        )
    reference, *estimates = (read_external(path) for path in paths)
    every = []
    for path, estimate in zip(paths[1:], estimates, strict=True):
        with naming(path):
            every.append(path_errors(estimate, reference, align=align))
    name = paths[0].name
    results = [result_of_path(errors, name, aligned=align) for errors in every]
    return results, partial(trajectories_page, (name, reference), every)
