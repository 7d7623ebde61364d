"""The command of Monte Carlo studies. Heavy imports stay inside it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comparisons.cli.options import OutOption
from comparisons.cli.support import AGREE, guarded, print_result, progress_bar


def montecarlo(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO",
            help="circle, circle-range-bearing, bailey-loop, nieto-loop, or a TOML file.",
        ),
    ] = "circle",
    runs: Annotated[int, typer.Option(metavar="N", help="Runs; a run's number is its seed.")] = 50,
    filters: Annotated[
        str,
        typer.Option(metavar="NAMES", help="Some of ekf, fej, oc, riekf, ideal, with commas."),
    ] = "ekf,fej,oc,riekf,ideal",
    workers: Annotated[int, typer.Option(metavar="W", help="Processes on this machine.")] = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler's, to compute on its cluster."),
    ] = None,
    out: OutOption = None,
) -> None:
    """Run consistent variants of the EKF many times in simulation. Exits with 0.

    A killed job goes on when the same command is given again; more runs or filters are added.

    \b
    Examples:
      slamcheck montecarlo circle                     50 runs, five filters
      slamcheck montecarlo my-scenario.toml --runs 1000 --filters ekf,fej --workers 8
      slamcheck montecarlo circle --runs 10000 --scheduler tcp://head:8786
    """
    with guarded():
        from comparisons.atomic import folder_name
        from comparisons.experiments.montecarlo.chunk_files import check_folder
        from comparisons.experiments.montecarlo.study import Study, run_study
        from comparisons.experiments.scenarios.scenario import read_scenario

        name = Path(scenario).stem if scenario.endswith(".toml") else scenario
        names = tuple(part.strip() for part in filters.split(",") if part.strip())
        study = Study(name, read_scenario(scenario), runs, names, scenario)
        folder = out or Path(f"slamcheck-montecarlo-{folder_name(name)}")
        check_folder(folder)
        from comparisons.experiments.montecarlo.folder import (
            build_montecarlo_result,
            print_montecarlo,
            write_montecarlo,
        )

        with progress_bar() as progress:
            outcome = run_study(study, folder, workers, scheduler, progress)
            result = build_montecarlo_result(outcome)
            progress("report", 0, 0)
            write_montecarlo(outcome, result, folder)
        print_result(lambda console: print_montecarlo(outcome, console), folder)
        raise SystemExit(AGREE)
