"""`slamcheck map`: a dense map beside the filter."""

from __future__ import annotations

from typing import TYPE_CHECKING

from comparisons.cli.flags import Given, from_flags
from comparisons.cli.jobs import Job, do_job, start_job
from comparisons.options.table import of_job

if TYPE_CHECKING:
    from comparisons.config import MapConfig
    from comparisons.pipeline.dense_map import DenseMapping
    from comparisons.pipeline.prepare import Progress

_DEFAULT = {"extensions": {"dense_maps": {"layers": ["occupancy"]}}}


_SHOWN = "--filter --association --gps --layer --resolution --dynamic --landmarks --cloud --seed"


@from_flags(of_job("map"), _SHOWN)
def map_command(given: Given) -> None:
    """Build a dense map of laser scans beside the EKF (DenseSLAM).

    \b
    Examples:
      slamcheck map occupancy-loop                  with true surfaces
      slamcheck map path/to/acfr_car_park --layer points --layer occupancy
      slamcheck map dynamic-places --dynamic        with moved objects
      slamcheck map scan-slam --landmarks scans --layer sog
    """

    def work(progress: Progress) -> tuple[Job[MapConfig], DenseMapping]:
        from comparisons.config import MapConfig

        job = start_job(given, MapConfig, base=_DEFAULT)
        from comparisons.pipeline.dense_map import map_log

        return job, map_log(job.log, job.config, progress)

    do_job(given, work)
