"""Settings of high level landmarks."""

from __future__ import annotations

from comparisons.config import ExtensionConfig, setting
from comparisons.options import SWITCH, Option


class HighLevelConfig(ExtensionConfig):
    """High level landmarks: objects found in the filter's dense map (Nieto 2005, section 6.1).

    Section 6.1.3 searches every minute; in the worlds here a loop takes 77 s, and an object stays
    within reach for less than half of a minute.
    """

    extension = "comparisons.extensions.high_level.extension:HighLevel"
    switch = Option("--high-level", jobs=("run",), settings=SWITCH, off=True)
    cell_m: float = setting(
        0.2, "Cell size of the map and least distance of its Gaussians in metres", ge=0.05, le=2.0
    )
    pair_m: float = setting(
        12.0, "Greatest distance of two corners of a landmark in metres", ge=1.0, le=100.0
    )
    least: int = setting(200, "Least number of Gaussians of a landmark", ge=3, le=10**6)
    every_s: float = setting(20.0, "Seconds between two searches", ge=0.1, le=1e6)
    only_in_view: bool = setting(True, "Align only what of a template should be in view")
    variance_factor: float = setting(
        4.0, "Variance of a measurement over that of its alignment", ge=1.0, le=100.0
    )
