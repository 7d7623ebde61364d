"""`slamcheck compare`: results of several jobs side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comparisons.cli.support import AGREE, guarded


def compare(
    folders: Annotated[
        list[Path], typer.Argument(metavar="FOLDER", help="Output folders to compare.")
    ],
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
    """Put the results of several runs side by side.

    The table shows verdicts, causes and the figures that differ. The folders may be of run, solve,
    check, odometry, map and montecarlo, also mixed: equal names share a row.

    \b
    Examples:
      slamcheck compare report-full report-compressed
      slamcheck compare a b c --only accuracy --out table.tex
    """
    with guarded():
        from rich.console import Console

        from comparisons.report import side_by_side as report

        if out is not None:
            report.check_table(out)
        rows = report.side_by_side(report.read_results(folders), only)
        names = [folder.name for folder in folders]
        titles = [
            str(folder) if names.count(folder.name) > 1 else folder.name or str(folder)
            for folder in folders
        ]
        report.print_side_by_side(titles, rows, Console())
        if out is not None:
            report.write_table(titles, rows, out)
        raise SystemExit(AGREE)
