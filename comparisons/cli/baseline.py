"""`slamcheck baseline`: keep what was found on a log, and compare what is found later with it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from comparisons.cli.flags import Arguments, DenseHelpCommand, from_flags
from comparisons.cli.jobs import read_job
from comparisons.cli.support import AGREE, DISAGREE, guarded, print_text, progress_bar
from comparisons.errors import InputError, quoted
from comparisons.options import GRADE, Flag
from comparisons.options.table import of_job

if TYPE_CHECKING:
    from comparisons.baseline import Baseline, Change, Found
    from comparisons.config import CheckConfig, RunConfig
    from comparisons.logs.log import Log

baseline = typer.Typer(
    help="Save the figures of a run; compare later runs with them.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="The baseline, a JSON file.")]
RunsOption = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="Number of runs, whose spread sets the tolerances. [2]",
        show_default=False,
    ),
]


_MOST_RUNS = 1000
RUN, CHECK = of_job("run"), of_job("check")
_ESTIMATE = [flag for flag in CHECK if flag.panel == GRADE and flag.option != "--trace"]
_SHOWN = "--estimate --require --filter --association --seed"


@baseline.command(
    cls=DenseHelpCommand, short_help="Save the figures of a run or of a check, with tolerances."
)
@from_flags((*RUN, *_ESTIMATE), _SHOWN, prints=False, file=(FileArgument,), runs=(RunsOption, None))
def save(given: Arguments) -> None:
    """Save the figures of a run, or of a check of --estimate, with tolerances.

    \b
    Examples:
      slamcheck baseline save my-log my-log.json --estimate mine
      slamcheck baseline save my-log our-ekf.json
      slamcheck baseline save our-run/config.toml our-ekf.json
    """
    with guarded(log_file=given.log_file):
        from comparisons.atomic import check_file
        from comparisons.baseline import BASELINE, build_baseline, compare_with, write_baseline
        from comparisons.config import CheckConfig, RunConfig

        target = given.extra["file"]
        estimate = any(flag.field == "estimate" for flag, _ in given.flags)
        runs = _runs(given.extra["runs"], estimate=estimate)
        _check_order("save", given.log, target)
        check_file(target, BASELINE)
        given = given._replace(flags=_fitting(given.flags, estimate=estimate))
        if given.out is not None:
            raise InputError(f"--out {given.out}: baseline save writes {target} and no folder")
        if target.exists() and not given.replace:
            raise InputError(
                f"{target}: holds a baseline; `slamcheck baseline compare --update` keeps its "
                "tolerances, --replace makes it anew"
            )
        kind: type[RunConfig | CheckConfig] = CheckConfig if estimate else RunConfig
        log, config, _ = read_job(given, kind)
        found = [_find(log, config) for _ in range(runs)]
        kept = build_baseline(found, config)
        write_baseline(kept, target)
        grade = f", grade {kept.words['grade']}" if estimate else ""
        figures = f"{len(compare_with(kept, found[0]))} figures of {kept.log}"
        typer.echo(f"{target}: {figures}, verdict {kept.verdict}{grade}")


@baseline.command(cls=DenseHelpCommand)
def compare(
    log: Annotated[
        str, typer.Argument(metavar="LOG", help="Log of the baseline, a name or a path.")
    ],
    file: FileArgument,
    estimate: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Estimate to check, for a baseline of an estimate."),
    ] = None,
    times: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Time stamps of a KITTI trajectory. [times.txt beside it]"
        ),
    ] = None,
    junit: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a JUnit report to this file.")
    ] = None,
    update: Annotated[
        bool, typer.Option("--update", help="Replace the baseline's figures, exit with 0.")
    ] = False,
) -> None:
    """Run a baseline's settings again and compare the figures.

    Exit code 0: no figure is worse than its tolerance; 1: some are. Better figures are reported
    only. --update keeps tolerances that were changed by hand.

    \b
    Examples:
      slamcheck baseline compare my-log my-log.json --estimate my-filter-output
      slamcheck baseline compare my-log our-ekf.json --junit report.xml
    """
    with guarded():
        from comparisons.atomic import check_file
        from comparisons.baseline import (
            JUNIT,
            compare_with,
            read_baseline,
            updated,
            write_baseline,
            write_junit,
        )
        from comparisons.pipeline.read import read_for

        if junit is not None:
            check_file(junit, JUNIT)
        _check_order("compare", log, file)
        kept = read_baseline(file)
        try:
            wanted = kept.config_at(log).model_copy(update=_named(kept, file, estimate, times))
            source, config, _ = read_for(wanted, allow_changed=True)
            found = _find(source, config)
            changes = compare_with(kept, found)
        except InputError as error:
            raise InputError(f"{error} (compared with {file})") from None
        if junit is not None:
            write_junit(changes, kept.log, junit, found.causes)
        _print_changes(changes, found)
        if update:
            write_baseline(updated(kept, found, config), file)
            typer.echo(f"{file}: updated")
            raise SystemExit(AGREE)
        states = {change.state for change in changes}
        if states != {"holds"}:
            meant = "if that is meant, keep it" if "broken" in states else "to keep it"
            print_text(lambda console: console.file.write(f"{meant} in {file}: --update\n"))
        raise SystemExit(DISAGREE if "broken" in states else AGREE)


def _print_changes(changes: Sequence[Change], found: Found) -> None:
    """Print how much holds, if less than before the cause, then what is worse, better or new."""
    from comparisons.report.terminal import deciding, fit

    counts, lines = {}, list[str]()
    for state in ("broken", "better", "new"):
        some = [change for change in changes if change.state == state]
        lines += [f"{state}: {change}" for change in some]
        if some:
            counts[state] = f"{len(some)} {state}"
    listed = f"slamcheck {found.config['job']} -v lists them"
    why = [line.text for line in deciding(found.causes, listed=listed) if "broken" in counts]
    outcome = "worse" if "broken" in counts else "not worse"
    holding = sum(change.state == "holds" for change in changes)
    parts = [f"{holding} of {len(changes)} figures hold", *counts.values()]
    verdict = fit(f"verdict: {outcome} than the baseline; {', '.join(parts)}", after="  ")
    figures = [text for line in lines for text in fit(line, after="  ")]
    text = "".join(f"{line}\n" for line in (*verdict, *why, *figures))
    print_text(lambda console: console.file.write(text))


def _check_order(command: str, log: str | None, file: Path) -> None:
    """Raise InputError where the baseline's file and the log stand in each other's place."""
    if log and Path(log).suffix == ".json" and file.suffix != ".json":
        meant = f"slamcheck baseline {command} {shlex.quote(str(file))} {shlex.quote(log)}"
        raise InputError(f"{log}: is no log, expected the baseline's file last; say {meant}")


def _runs(given: int | None, *, estimate: bool) -> int:
    """How often the figures are made. Raises InputError."""
    if estimate and given is not None:
        raise InputError("--runs repeats a run; an estimate is as it is: leave --runs out")
    runs = (1 if estimate else 2) if given is None else given
    if not 1 <= runs <= _MOST_RUNS:
        raise InputError(f"runs is {quoted(runs)}, expected 1 to {_MOST_RUNS}")
    return runs


def _fitting(flags: Sequence[tuple[Flag, Any]], *, estimate: bool) -> list[tuple[Flag, Any]]:
    """Return the flags as those of the job. Raises InputError for one that it does not have."""
    known = {flag.option: flag for flag in (CHECK if estimate else RUN)}
    for flag, _ in flags:
        if flag.option not in known:
            reported = "is of a run, not of a check: leave it or --estimate out"
            raise InputError(f"{flag.option} {reported if estimate else 'goes with --estimate'}")
    return [(known[flag.option], value) for flag, value in flags]


def _named(
    kept: Baseline, file: Path, estimate: Path | None, times: Path | None
) -> dict[str, str | None]:
    """Return the settings that say which estimate. Raises InputError where there must be another.

    file: the baseline's.
    """
    if kept.of_estimate and estimate is None:
        raise InputError(f"{file}: is of an estimate; give one with --estimate PATH")
    if not kept.of_estimate and (estimate or times) is not None:
        raise InputError(
            f"{file}: is of slamcheck run, not of an estimate; make another one: slamcheck "
            "baseline save LOG FILE --estimate PATH"
        )
    found = {"estimate": estimate, "times": times}
    return {name: str(path) for name, path in found.items() if path is not None}


def _find(log: Log, config: RunConfig | CheckConfig) -> Found:
    """Run the log, or check the estimate that the configuration names."""
    from comparisons.config import CheckConfig

    with progress_bar() as progress:
        if isinstance(config, CheckConfig):
            from comparisons.jobs.check import check
            from comparisons.pipeline.read import read_estimate
            from comparisons.report.check import CheckReport

            given = read_estimate(config)
            return CheckReport.build(check(log, given, config, progress))
        from comparisons.jobs.run import compare as compare_estimators
        from comparisons.report.run import RunReport

        return RunReport.build(compare_estimators(log, config, progress))
