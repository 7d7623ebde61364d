"""`slamcheck odometry`: the scan front end alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from comparisons.cli.flags import Given, from_flags
from comparisons.cli.jobs import Job, do_job, start_job
from comparisons.options.table import of_job

if TYPE_CHECKING:
    from comparisons.config import OdometryConfig
    from comparisons.pipeline.odometry import FrontEnd
    from comparisons.pipeline.prepare import Progress


@from_flags(of_job("odometry"), "--guess --loop-closure --matcher --gps --cloud --seed")
def odometry(given: Given) -> None:
    """Run the scan front end alone: odometry and loop closure.

    Exit code 0: the optimum of the scan pose graph is verified; 3: it is not.

    \b
    Examples:
      slamcheck odometry scan-loop-fine             simulated scans, with truth
      slamcheck odometry path/to/acfr_car_park --cloud pcd
    """

    def work(progress: Progress) -> tuple[Job[OdometryConfig], FrontEnd]:
        from comparisons.config import OdometryConfig

        job = start_job(given, OdometryConfig)
        from comparisons.pipeline.odometry import run_front_end

        return job, run_front_end(job.log, job.config, progress)

    do_job(given, work)
