"""`slamcheck check`: an external estimate against a filter like it and the smoother's."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from comparisons.cli.flags import Given, from_flags
from comparisons.cli.jobs import Job, do_job, start_job
from comparisons.errors import InputError
from comparisons.options.table import of_job

if TYPE_CHECKING:
    from comparisons.config import CheckConfig
    from comparisons.pipeline.check import ExternalCheck
    from comparisons.pipeline.prepare import Progress

_SHOWN = "--estimate --require --min-coverage --association --gps --robust --seed"


@from_flags(of_job("check"), _SHOWN)
def check(given: Given) -> None:
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

    def work(progress: Progress) -> tuple[Job[CheckConfig], ExternalCheck]:
        from comparisons.config import CheckConfig
        from comparisons.estimates.external import ExternalEstimate, read_external

        handed_in: list[ExternalEstimate] = []

        def read_first(config: CheckConfig) -> None:
            if not config.estimate:
                raise InputError("--estimate is missing: give a trajectory or an estimate's folder")
            handed_in.append(read_external(Path(config.estimate), config.times, config.trace))

        job = start_job(given, CheckConfig, check=read_first)
        from comparisons.pipeline.check import check as check_estimate

        return job, check_estimate(job.log, handed_in[0], job.config, progress)

    do_job(given, work)
