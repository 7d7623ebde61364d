"""`slamcheck map`: a dense map beside the filter."""

from __future__ import annotations

from comparisons.cli.flags import Arguments, from_flags
from comparisons.cli.jobs import do_plain_job
from comparisons.options.table import of_job

_DEFAULT = {"extensions": {"dense_maps": {"layers": ["occupancy"]}}}


_SHOWN = "--filter --association --gps --layer --resolution --dynamic --landmarks --cloud --seed"


@from_flags(of_job("map"), _SHOWN)
def map_command(given: Arguments) -> None:
    """Build a dense map of laser scans beside the EKF (DenseSLAM).

    \b
    Examples:
      slamcheck map occupancy-loop                  with true surfaces
      slamcheck map path/to/acfr_car_park --layer points --layer occupancy
      slamcheck map dynamic-places --dynamic        with moved objects
      slamcheck map scan-slam --landmarks scans --layer sog
    """
    do_plain_job(given, "MapConfig", "comparisons.extensions.dense_maps.job:map_log", _DEFAULT)
