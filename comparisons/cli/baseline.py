"""`slamcheck baseline`: keep what a run found, and compare later runs with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comparisons.cli.flags import Given, from_flags
from comparisons.cli.jobs import read_job
from comparisons.cli.support import AGREE, DISAGREE, guarded, progress_bar
from comparisons.errors import InputError
from comparisons.options import RUN

if TYPE_CHECKING:
    from comparisons.config import RunConfig
    from comparisons.logs.log import Log
    from comparisons.report.models import Result

baseline = typer.Typer(
    help="Keep what a run found, and compare later runs with it.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="The baseline, a JSON file.")]
RunsOption = Annotated[int, typer.Option(help="Repetitions that measure the noise floor. [2]")]


@baseline.command()
@from_flags(RUN, file=(FileArgument,), runs=(RunsOption, 2))
def save(given: Given) -> None:
    """Run a log and write what was found, with a tolerance for each figure.

    \b
    Examples:
      slamcheck baseline save my-log my-log.baseline.json
      slamcheck baseline save my-run/config.toml my-log.baseline.json
    """
    with guarded(verbose=given.verbose, log_file=given.log_file):
        from comparisons.atomic import check_file
        from comparisons.baseline import build_baseline, write_baseline
        from comparisons.config import RunConfig

        runs, target = given.extra["runs"], given.extra["file"]
        if runs < 1:
            raise InputError(f"runs is {runs}, expected 1 or more")
        check_file(target)
        log, config, _ = read_job(given, RunConfig)
        kept = build_baseline([_run(log, config) for _ in range(runs)], config)
        write_baseline(kept, target)
        typer.echo(f"{target}: {len(kept.metrics)} figures of {kept.log}, verdict {kept.verdict}")


@baseline.command()
def compare(
    log: Annotated[str, typer.Argument(metavar="LOG", help="The baseline's log, by name or path.")],
    file: FileArgument,
    junit: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a JUnit report there.")
    ] = None,
) -> None:
    """Run a log as its baseline was run. Exits with 0 when all figures hold, else with 1.

    \b
    Example:
      slamcheck baseline compare my-log my-log.baseline.json --junit report.xml
    """
    with guarded():
        from comparisons.atomic import check_file
        from comparisons.baseline import compare_with, read_baseline, write_junit
        from comparisons.pipeline.read import read_for

        if junit is not None:
            check_file(junit)
        kept = read_baseline(file)
        try:
            source, config, _ = read_for(kept.config_at(log), allow_changed=True)
            changes = compare_with(kept, _run(source, config))
        except InputError as error:
            raise InputError(f"{error} (compared with {file})") from None
        if junit is not None:
            write_junit(changes, kept.log, junit)
        broken = [change for change in changes if not change.holds]
        for change in broken:
            typer.echo(str(change))
        typer.echo(f"{len(changes) - len(broken)} of {len(changes)} figures hold")
        raise SystemExit(DISAGREE if broken else AGREE)


def _run(log: Log, config: RunConfig) -> Result:
    from comparisons.pipeline.compare import compare as compare_estimators
    from comparisons.report.result import build_result

    with progress_bar() as progress:
        return build_result(compare_estimators(log, config, progress))
