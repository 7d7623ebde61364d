"""`slamcheck odometry`: the scan front end alone."""

from __future__ import annotations

from comparisons.cli.flags import Arguments, from_flags
from comparisons.cli.jobs import do_plain_job
from comparisons.options.table import of_job


@from_flags(of_job("odometry"), "--guess --loop-closure --matcher --gps --cloud --seed")
def odometry(given: Arguments) -> None:
    """Run the scan front end alone: odometry and loop closure.

    Exit code 0: the optimum of the scan pose graph is verified; 3: it is not.

    \b
    Examples:
      slamcheck odometry scan-loop-fine             simulated scans, with truth
      slamcheck odometry path/to/acfr_car_park --cloud pcd
    """
    do_plain_job(given, "OdometryConfig", "comparisons.extensions.scan_motion.job:run_front_end")
