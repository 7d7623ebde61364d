"""The command that reproduces the documents' figures. Heavy imports stay inside it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comparisons.cli.support import AGREE, DISAGREE, guarded, print_text, progress_bar
from comparisons.errors import note


def reproduce(
    figures: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="FIGURE|all",
            help="Figures to reproduce, as N3.5 (Nieto, Fig. 3.5); G Guivant, M Misono.",
        ),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder of the real logs: victoria_park/, acfr_car_park/, mrclam/.",
        ),
    ] = None,
    drives: Annotated[
        int, typer.Option(metavar="N", help="Number of simulated drives per statistical claim.")
    ] = 10,
    workers: Annotated[
        int | None, typer.Option(metavar="W", help="Number of parallel processes. [cores]")
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Output folder.")] = Path(
        "slamcheck-reproduction"
    ),
) -> None:
    """Reproduce figures and claims of the source documents.

    Without names it lists the figures. Exit code 0: all claims hold; 1: some do not.

    \b
    Examples:
      slamcheck reproduce                           list the figures
      slamcheck reproduce N3.5 N3.12
      slamcheck reproduce all --workers 1 --out figures
      slamcheck reproduce all --data path/to/logs
    """
    with guarded():
        if not figures:
            _list()
            raise SystemExit(AGREE)
        from comparisons.atomic import check_replaceable
        from comparisons.experiments.montecarlo.workers import one_each_core
        from comparisons.experiments.reproduction.folder import (
            CLAIMS,
            print_claims,
            write_gallery,
        )
        from comparisons.experiments.reproduction.interface import Sources
        from comparisons.experiments.reproduction.runner import reproduce as run

        check_replaceable(out, CLAIMS)
        with progress_bar() as progress:
            number = one_each_core() if workers is None else workers
            try:
                found = run(tuple(figures), Sources(data, drives), number, progress)
            except (KeyboardInterrupt, SystemExit):
                note(f"stopped: nothing is written to {out}; give fewer figures for a shorter job")
                raise
            progress("gallery", 0, 0)
            write_gallery(found, out)
        print_text(lambda console: print_claims(found, out, console))
        raise SystemExit(AGREE if found.holds else DISAGREE)


def _list() -> None:
    from comparisons.experiments.reproduction.registry import FIGURES

    for figure in FIGURES:
        needs, library = figure.experiment.needs, figure.experiment.library
        extra = f" (needs --data with {needs}/)" if needs else ""
        extra += " (needs slamcheck[scans])" if library else ""
        typer.echo(f"{figure.name:6} {figure.source}: {figure.title}{extra}")
