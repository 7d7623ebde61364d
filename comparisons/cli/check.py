"""`slamcheck check`: an external estimate against a filter like it and the smoother's."""

from __future__ import annotations

from pathlib import Path

from comparisons.cli.flags import Given, from_flags
from comparisons.cli.jobs import start_job
from comparisons.cli.support import VERDICTS, guarded, print_result, progress_bar
from comparisons.errors import InputError
from comparisons.options.table import of_job

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
    with guarded(log_file=given.log_file):
        with progress_bar(given.output) as progress:
            from comparisons.config import CheckConfig
            from comparisons.estimates.external import ExternalEstimate, read_external

            handed_in: list[ExternalEstimate] = []

            def read_first(config: CheckConfig) -> None:
                if not config.estimate:
                    raise InputError(
                        "--estimate is missing: give a trajectory or an estimate's folder"
                    )
                estimate = Path(config.estimate)
                handed_in.append(read_external(estimate, config.times, config.trace))

            job = start_job(given, CheckConfig, check=read_first)
            from comparisons.pipeline.check import check as check_estimate

            checked = check_estimate(job.log, handed_in[0], job.config, progress)
            progress("report", 0, 0)
            from comparisons.report.check import build_check_result, check_folder, check_summary
            from comparisons.report.folder import write_job_folder

            result = build_check_result(checked, job.read)
            write_job_folder(check_folder(checked, result), job.folder)
        print_result(check_summary(result), job.folder / "check.json", given.output)
        raise SystemExit(VERDICTS[checked.outcome])
