"""The command of Monte Carlo studies. Heavy imports stay inside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_type_hints

import typer

from comparisons.cli.flags import OUTPUT, parameter, set_parameters
from comparisons.cli.support import AGREE, chosen_output, guarded, print_result, progress_bar
from comparisons.errors import note

if TYPE_CHECKING:
    from comparisons.experiments.montecarlo.config import MonteCarloConfig
    from comparisons.experiments.montecarlo.external import ExternalProgram
    from comparisons.experiments.montecarlo.study import Study


class _Given(NamedTuple):
    """The command's parameters, as typer reads them."""

    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENARIO",
            help="Scenario: circle, circle-range-bearing, bailey-loop, nieto-loop, a scenario "
            "file, or the config.toml of an earlier study. [circle]",
            show_default=False,
        ),
    ] = None
    runs: Annotated[
        int | None, typer.Option(metavar="N", help="Number of runs; run n has seed n. [50]")
    ] = None
    filters: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="EKF variants, with commas: ekf, fej (first-estimates Jacobian), oc "
            "(observability constrained), riekf (right-invariant), ideal (Jacobians at the true "
            "state). [all]",
        ),
    ] = None
    command: Annotated[
        list[str],
        typer.Option(
            metavar="[NAME=]COMMAND",
            help="Your filter: a program that reads the log folder {log} and writes the estimate "
            "folder {out}; repeat it for several. [NAME: mine]",
            show_default=False,
        ),
    ] = []  # noqa: RUF012
    timeout: Annotated[
        float,
        typer.Option(
            metavar="S", hidden=True, help="Time limit of one run of a --command in seconds."
        ),
    ] = 600.0
    reuse: Annotated[
        bool,
        typer.Option(
            "--reuse",
            hidden=True,
            help="Use the earlier results of a --command whose text and files are unchanged.",
        ),
    ] = False
    keep: Annotated[
        int | None,
        typer.Option(metavar="SEED", min=0, hidden=True, help="Keep the log of this run in logs/."),
    ] = None
    workers: Annotated[
        int | None,
        typer.Option(metavar="W", help="Number of parallel processes. [cores; 1 for --command]"),
    ] = None
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Address of a Dask scheduler to compute on."),
    ] = None
    allow_changed_scenario: Annotated[
        bool,
        typer.Option(
            "--allow-changed-scenario",
            hidden=True,
            help="Use a scenario that has changed since the configuration file was written.",
        ),
    ] = False
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Output folder. [slamcheck-montecarlo-SCENARIO]"),
    ] = None
    verbose: bool = False
    json: bool = False
    quiet: bool = False


def montecarlo(**values: Any) -> None:
    """Run filters many times in simulation; test their consistency.

    The same command given again continues an interrupted study, or adds runs and filters to it.

    \b
    Examples:
      slamcheck montecarlo circle                   50 runs, five filters
      slamcheck montecarlo my-scenario.toml --runs 1000 --workers 8
      slamcheck montecarlo nieto-loop --command 'python my_ekf.py {log} {out}'
      slamcheck montecarlo circle --runs 10000 --scheduler tcp://head:8786
      slamcheck montecarlo slamcheck-montecarlo-circle/config.toml --out again
    """
    given = _Given(**values)
    with guarded():
        output = chosen_output(verbose=given.verbose, json=given.json, quiet=given.quiet)
        from comparisons.atomic import folder_name
        from comparisons.experiments.montecarlo.chunk_files import check_folder
        from comparisons.experiments.montecarlo.external import parse_commands
        from comparisons.experiments.montecarlo.study import (
            External,
            keep_log,
            read_study,
            record_commands,
            run_study,
        )

        commands = parse_commands(given.command, given.timeout)
        config = _configure(given)
        study = read_study(config, allow_changed=given.allow_changed_scenario)
        study = record_commands(study, commands)
        folder = given.out or Path(f"slamcheck-montecarlo-{folder_name(study.name)}")
        check_folder(folder)
        from comparisons.experiments.montecarlo.folder import (
            RESULT,
            montecarlo_summary,
            write_montecarlo,
        )
        from comparisons.experiments.montecarlo.workers import one_each_core

        with progress_bar(output) as progress, _kept_if_stopped(study, folder, commands):
            ours = one_each_core() if given.workers is None else given.workers
            theirs = 1 if given.workers is None else given.workers
            external = External(commands, given.reuse, theirs)
            outcome = run_study(study, folder, ours, given.scheduler, progress, external)
            progress("report", 0, 0)
            write_montecarlo(outcome, folder, commands)
            if given.keep is not None:
                keep_log(study, folder, given.keep)
        print_result(montecarlo_summary(outcome), folder / RESULT, output)
        raise SystemExit(AGREE)


@contextmanager
def _kept_if_stopped(
    study: Study, folder: Path, commands: Mapping[str, ExternalProgram]
) -> Iterator[None]:
    """Say what a study keeps that is stopped, and how it goes on."""
    from comparisons.experiments.montecarlo.study import kept_runs

    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        kept = kept_runs(study, folder, commands)
        of_all = study.config.runs * (len(study.config.filters) + len(commands))
        on = "give the same command to go on"
        if commands:
            on += ", with --reuse to keep the runs of --command"
        note(f"stopped: {folder} keeps {kept:,} of {of_all:,} runs; {on}")
        raise


_HINTS = get_type_hints(_Given, include_extras=True)
_HINTS |= {name: one.annotation for name, one in OUTPUT.items()}
set_parameters(
    montecarlo,
    *(parameter(name, hint, _Given._field_defaults[name]) for name, hint in _HINTS.items()),
)


def config_class() -> type[MonteCarloConfig]:
    """The class of a study's settings, for `slamcheck config`."""
    from comparisons.experiments.montecarlo.config import MonteCarloConfig

    return MonteCarloConfig


def _configure(given: _Given) -> MonteCarloConfig:
    """What was given over an earlier study's settings, if the scenario is such a file."""
    from comparisons.experiments.montecarlo.config import is_config
    from comparisons.settings import configure

    scenario, runs, filters = given.scenario, given.runs, given.filters
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
