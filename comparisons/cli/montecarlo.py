"""The command of Monte Carlo studies. Heavy imports stay inside it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from comparisons.cli.support import AGREE, guarded, print_result, progress_bar

if TYPE_CHECKING:
    from comparisons.experiments.montecarlo.config import MonteCarloConfig


def montecarlo(
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENARIO",
            help="circle, circle-range-bearing, bailey-loop, nieto-loop, a TOML file, or the "
            "config.toml of an earlier study. [circle]",
            show_default=False,
        ),
    ] = None,
    runs: Annotated[
        int | None, typer.Option(metavar="N", help="Runs; a run's number is its seed. [50]")
    ] = None,
    filters: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES", help="Some of ekf, fej, oc, riekf, ideal, with commas. [all]"
        ),
    ] = None,
    workers: Annotated[int, typer.Option(metavar="W", help="Processes on this machine.")] = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler's, to compute on its cluster."),
    ] = None,
    allow_changed_scenario: Annotated[
        bool,
        typer.Option(
            "--allow-changed-scenario", help="Use a scenario that is not the configuration's."
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder to write [slamcheck-montecarlo-SCENARIO]."),
    ] = None,
) -> None:
    """Run consistent variants of the EKF many times in simulation. Exits with 0.

    A killed job goes on when the same command is given again; more runs or filters are added.

    \b
    Examples:
      slamcheck montecarlo circle                     50 runs, five filters
      slamcheck montecarlo my-scenario.toml --runs 1000 --filters ekf,fej --workers 8
      slamcheck montecarlo circle --runs 10000 --scheduler tcp://head:8786
      slamcheck montecarlo slamcheck-montecarlo-circle/config.toml --out again
    """
    with guarded():
        from comparisons.atomic import folder_name
        from comparisons.experiments.montecarlo.chunk_files import check_folder
        from comparisons.experiments.montecarlo.study import read_study, run_study

        config = _configure(scenario, runs, filters)
        study = read_study(config, allow_changed=allow_changed_scenario)
        folder = out or Path(f"slamcheck-montecarlo-{folder_name(study.name)}")
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


def config_class() -> type[MonteCarloConfig]:
    """The class of a study's settings, for `slamcheck config`."""
    from comparisons.experiments.montecarlo.config import MonteCarloConfig

    return MonteCarloConfig


def _configure(scenario: str | None, runs: int | None, filters: str | None) -> MonteCarloConfig:
    """What was given over an earlier study's settings, if the scenario is such a file."""
    from comparisons.experiments.montecarlo.config import is_config
    from comparisons.settings import configure

    file, over = None, dict[str, Any]()
    if scenario is not None and is_config(scenario):
        file = Path(scenario)
    elif scenario is not None:
        over["scenario"] = scenario
    if runs is not None:
        over["runs"] = runs
    if filters is not None:
        over["filters"] = [part.strip() for part in filters.split(",") if part.strip()]
    return configure(config_class(), file, over=over)
