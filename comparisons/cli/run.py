"""`slamcheck run`: both estimators on one log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comparisons.cli.flags import Arguments, from_flags
from comparisons.cli.jobs import Job, do_job, start_job
from comparisons.options.table import of_job

if TYPE_CHECKING:
    from comparisons.config import RunConfig
    from comparisons.jobs.run import Comparison
    from comparisons.pipeline.clock import Progress

LiveOption = Annotated[
    bool,
    typer.Option("--live", hidden=True, help="Replay the run in the rerun viewer; needs rerun."),
]
RecordOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.rrd",
        hidden=True,
        help="Write a replay of the run for the rerun viewer; needs rerun.",
    ),
]
_SHOWN = (
    "--filter --association --gps --robust --third --landmarks --motion --dense --robot --seed "
    "--fail-on"
)


@from_flags(of_job("run"), _SHOWN, live=(LiveOption, False), record=(RecordOption, None))
def run(given: Arguments) -> None:
    """Run EKF and smoother on a log, compare them, write a report.

    \b
    Examples:
      slamcheck run                                 the bundled Victoria Park log
      slamcheck run simulated-loop --filter compressed --third fastslam
      slamcheck run path/to/MRCLAM_Dataset6 --robot 2 --out report
      slamcheck run path/to/acfr_car_park --motion both --dense points
      slamcheck run slamcheck-simulated-loop/config.toml --out again
    """
    live, record = bool(given.extra["live"]), given.extra["record"]

    def work(progress: Progress) -> tuple[Job[RunConfig], Comparison]:
        if live or record is not None:
            from comparisons.report.viewer import check_viewer

            check_viewer(live, record)
        from comparisons.config import RunConfig

        job = start_job(given, RunConfig)
        from comparisons.jobs.run import compare

        comparison = compare(job.log, job.config, progress)
        if record is not None:  # first: where that fails, no folder is left
            from comparisons.report.viewer import record_run

            record_run(comparison, record)
        return job, comparison

    def show(comparison: Comparison) -> None:
        if live:
            from comparisons.report.viewer import show_run

            show_run(comparison)

    do_job(given, work, show)
