"""`slamcheck odometry`: the scan front end alone."""

from __future__ import annotations

from comparisons.cli.flags import Given, from_flags
from comparisons.cli.jobs import start_job
from comparisons.cli.support import VERDICTS, guarded, print_result, progress_bar
from comparisons.options.table import of_job


@from_flags(of_job("odometry"), "--guess --loop-closure --matcher --gps --cloud --seed")
def odometry(given: Given) -> None:
    """Run the scan front end alone: odometry and loop closure.

    Exit code 0: the optimum of the scan pose graph is verified; 3: it is not.

    \b
    Examples:
      slamcheck odometry scan-loop-fine             simulated scans, with truth
      slamcheck odometry path/to/acfr_car_park --cloud pcd
    """
    with guarded(log_file=given.log_file):
        with progress_bar(given.output) as progress:
            from comparisons.config import OdometryConfig

            job = start_job(given, OdometryConfig)
            from comparisons.pipeline.odometry import run_front_end

            front_end = run_front_end(job.log, job.config, progress)
            progress("report", 0, 0)
            from comparisons.report.folder import write_job_folder
            from comparisons.report.odometry import (
                build_front_end_result,
                front_end_folder,
                front_end_summary,
            )

            result = build_front_end_result(front_end, job.read)
            write_job_folder(front_end_folder(front_end, result), job.folder)
        print_result(front_end_summary(result), job.folder / "odometry.json", given.output)
        raise SystemExit(VERDICTS[result.verdict])
