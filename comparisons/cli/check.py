"""`slamcheck check`: an external estimate against a filter like it and the smoother's."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from comparisons.cli.flags import Arguments, from_flags
from comparisons.cli.jobs import Job, do_job, start_job
from comparisons.cli.support import Output, guarded
from comparisons.errors import InputError, note
from comparisons.options.table import of_job

if TYPE_CHECKING:
    from comparisons.config import CheckConfig
    from comparisons.jobs.external_check import ExternalCheck
    from comparisons.pipeline.clock import Progress

_SHOWN = "--estimate --require --min-coverage --association --gps --robust --seed"


@from_flags(of_job("check"), _SHOWN)
def check(given: Arguments) -> None:
    """Grade an external estimate against EKF and smoother.

    Grades: equal to the reference EKF, like it (5 %), plausible (no farther from the
    smoother's optimum than the optimum's own uncertainty), or wrong. Exit code 0: the grade that
    --require asks for; 1: a lower one; 3: the smoother's optimum is not verified.

    \b
    Examples:
      slamcheck check simulated-loop --estimate my-filter-output
      slamcheck check my-log --estimate trajectory.tum
      slamcheck check my-log --estimate my-filter-output --require like
    """
    with guarded():
        _check_places(given)

    def work(progress: Progress) -> tuple[Job[CheckConfig], ExternalCheck]:
        from comparisons.config import CheckConfig
        from comparisons.estimates.external import ExternalEstimate
        from comparisons.pipeline.read import read_estimate

        handed_in: list[ExternalEstimate] = []

        def read_first(config: CheckConfig) -> None:
            if not config.estimate:
                raise InputError("--estimate is missing: give a trajectory or an estimate's folder")
            handed_in.append(read_estimate(config))
            if handed_in[0].source and given.output is not Output.QUIET:
                note(f"estimate: {handed_in[0].source}")

        job = start_job(given, CheckConfig, check=read_first)
        from comparisons.jobs.check import check as check_estimate

        return job, check_estimate(job.log, handed_in[0], job.config, progress)

    do_job(given, work)


def as_meant(log: str, estimate: str) -> str:
    """Return the command for a log and an estimate, whichever stands first."""
    if _is_estimate(Path(log)) and _is_log(Path(estimate)):
        log, estimate = estimate, log
    return f"slamcheck check {shlex.quote(log)} --estimate {shlex.quote(estimate)}"


def _check_places(given: Arguments) -> None:
    """Raise InputError where the estimate stands in the log's place, or the log behind --log."""
    named = {flag.field: value for flag, value in given.flags}
    estimate, file = named.get("estimate"), given.log_file
    if file is not None and _is_log(file):
        meant = as_meant(str(file), str(estimate or given.log or "PATH"))
        raise InputError(f"--log {file}: is a log, expected a file for warnings; say {meant}")
    if given.log and estimate and _is_log(Path(estimate)) and _is_estimate(Path(given.log)):
        meant = as_meant(given.log, str(estimate))
        raise InputError(f"{given.log}: is an estimate, and {estimate} a log; say {meant}")


def _is_log(path: Path) -> bool:
    from comparisons.logs.log_meta import MARK

    return (path / MARK).is_file()


def _is_estimate(path: Path) -> bool:
    """Whether a path is a trajectory or a folder with one."""
    return path.suffix == ".tum" or ((path / "trajectory.tum").is_file() and not _is_log(path))
