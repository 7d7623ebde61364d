"""`slamcheck map`: a dense map beside the filter."""

from __future__ import annotations

from comparisons.cli.flags import Given, from_flags
from comparisons.cli.jobs import start_job
from comparisons.cli.support import AGREE, guarded, print_result, progress_bar
from comparisons.options.table import of_job

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
    with guarded(log_file=given.log_file):
        with progress_bar(given.output) as progress:
            from comparisons.config import MapConfig

            job = start_job(given, MapConfig, base=_DEFAULT)
            from comparisons.pipeline.dense_map import map_log

            mapping = map_log(job.log, job.config, progress)
            progress("report", 0, 0)
            from comparisons.report.dense_map import build_map_result, map_folder, map_summary
            from comparisons.report.folder import write_job_folder

            result = build_map_result(mapping, job.read)
            write_job_folder(map_folder(mapping, result), job.folder)
        print_result(map_summary(result), job.folder / "map.json", given.output)
        raise SystemExit(AGREE)
