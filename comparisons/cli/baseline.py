"""`slamcheck baseline`: keep what a run found, and hold later runs against it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comparisons.cli.options import (
    AssociationOption,
    FeaturesOption,
    FilterOption,
    FormatOption,
    GpsOption,
    LogArgument,
    LoopsOption,
    NoiseOption,
    RobotOption,
    SeedOption,
)
from comparisons.cli.support import AGREE, DISAGREE, guarded, progress_bar, read_named
from comparisons.errors import InputError

if TYPE_CHECKING:
    from comparisons.baseline import Settings
    from comparisons.logs.log import Log
    from comparisons.report.models import Result

baseline = typer.Typer(
    help="Keep what a run found, and hold later runs against it.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="The baseline, a JSON file.")]


@baseline.command()
def save(
    log: LogArgument,
    file: FileArgument,
    runs: Annotated[int, typer.Option(help="Repetitions that tell the noise floor.")] = 2,
    filter_name: FilterOption = "full",
    association: AssociationOption = None,
    features: FeaturesOption = "log",
    gps: GpsOption = "off",
    format_name: FormatOption = None,
    robot: RobotOption = 1,
    seed: SeedOption = 0,
    loops: LoopsOption = 1,
    noise_scale: NoiseOption = 1.0,
) -> None:
    """Run a log and write what was found, with a tolerance for each figure.

    \b
    Example:
      slamcheck baseline save my-log my-log.baseline.json
    """
    with guarded():
        from comparisons.baseline import Settings, build_baseline, write_baseline

        if runs < 1:
            raise InputError(f"runs is {runs}, expected 1 or more")
        settings = Settings(
            filter=filter_name,
            association=association or "",
            features=features,
            gps=gps,
            format=format_name or "",
            robot=robot,
            seed=seed,
            loops=loops,
            noise_scale=noise_scale,
        )
        source = _read(log, settings)
        results = [_run(source, settings) for _ in range(runs)]
        kept = build_baseline(results, settings)
        write_baseline(kept, file)
        typer.echo(f"{file}: {len(kept.metrics)} figures of {kept.log}, verdict {kept.verdict}")


@baseline.command()
def compare(
    log: LogArgument,
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
        from comparisons.baseline import compare_with, read_baseline, write_junit

        kept = read_baseline(file)
        try:
            changes = compare_with(kept, _run(_read(log, kept.settings), kept.settings))
        except InputError as error:
            raise InputError(f"{error} (compared with {file})") from None
        if junit is not None:
            write_junit(changes, kept.log, junit)
        broken = [change for change in changes if not change.holds]
        for change in broken:
            typer.echo(str(change))
        typer.echo(f"{len(changes) - len(broken)} of {len(changes)} figures hold")
        raise SystemExit(DISAGREE if broken else AGREE)


def side_by_side(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Folders that runs left.")],
) -> None:
    """Put several runs side by side: verdicts, causes, and the figures that differ.

    \b
    Example:
      slamcheck compare report-full report-compressed
    """
    with guarded():
        from rich.console import Console

        from comparisons.report import side_by_side as report

        results = report.read_results(runs)
        titles = [folder.name or str(folder) for folder in runs]
        report.print_side_by_side(titles, report.side_by_side(results), Console(soft_wrap=True))
        raise SystemExit(AGREE)


def _read(log: str, settings: Settings) -> Log:
    source, _ = read_named(
        log,
        settings.format or None,
        settings.robot,
        settings.seed,
        settings.loops,
        settings.noise_scale,
        settings.features,
    )
    return source


def _run(source: Log, settings: Settings) -> Result:
    from comparisons.adapters.ekf_factory import EkfChoices
    from comparisons.pipeline.compare import compare_estimators
    from comparisons.report.result import build_result

    choices = EkfChoices(settings.filter, settings.association or None, settings.gps)
    with progress_bar() as progress:
        return build_result(compare_estimators(source, choices, progress=progress), 0.0)
