"""What a dense map holds of each log with scans, by the presets that concern it.

    python -m research.coverage [--data DATA]

A row a log and preset: the returns, the share that found a region, the regions, and how the command
`slamcheck map LOG --preset PRESET` ends: `agree`, or `unverified` (exit code 3) where the map holds
less than a tenth. Where a log measures no landmark, those of the scans are asked for (--landmarks
scans). --data: also the car park. The other two documents say nothing of dense maps.
"""

from __future__ import annotations

from pathlib import Path

from comparisons.config import MapConfig
from comparisons.extensions.dense_maps.job import map_log
from comparisons.extensions.dense_maps.report import MapReport
from comparisons.logs.bundled import NAMED, open_log
from research.script import options, print_head, print_row

PRESETS = "recommended", "nieto-2005"
CAR_PARK = "acfr_car_park"


def rows_of(source: str) -> None:
    """Print a row for each preset, nothing of a log without planar scans."""
    log = open_log(source)
    if log.scans is None:
        return
    extensions: dict[str, dict[str, object]] = {"dense_maps": {"layers": ("points",)}}
    if not len(log.measurements.time_s):
        extensions["scan_landmarks"] = {"landmarks": "scans"}
    for preset in PRESETS:
        where = {"source": source, "format": None if source in NAMED else log.format}
        config = MapConfig.of(preset=preset, log=where, extensions=extensions)
        report = MapReport.of(map_log(log, config))
        returns = report.result.returns
        share = f"{100.0 * returns.covered:.1f} %"
        print_row(
            log.name, preset, f"{returns.returns:,}", share, report.result.regions, report.outcome
        )


def main() -> None:
    """Print the table."""
    given = options(__doc__, data=str)
    print_head("log", "preset", "returns", "in a region", "regions", "ends as")
    for source in NAMED:
        rows_of(source)
    if given.data:
        rows_of(str(Path(given.data) / CAR_PARK))


if __name__ == "__main__":
    main()
