"""What may be wrong with a log's units, signs, columns or sigmas, and the words that name it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.faults.of_logs import other_frame
from comparisons.logs.log import Log
from comparisons.logs.odometry import VelocityOdometry
from comparisons.logs.transforms.calibration import delayed, driven, sensed

Change = Callable[[Log], Log]


def stated(name: str, change: Callable[[Array], Any]) -> Change:
    """Other sigmas than the log has."""
    return lambda log: replace(
        log,
        measurements=replace(log.measurements, **{name: change(getattr(log.measurements, name))}),
    )


def late(log: Log, delay_s: float) -> Log:
    """Measurements later than they were; those that would come after the end are missing."""
    inside = log.measurements.time_s + delay_s <= log.odometry.time_s[-1]
    return delayed(replace(log, measurements=log.measurements.chosen(inside)), delay_s)


def in_milliseconds(log: Log) -> Log:
    """Speeds per millisecond, and turns where they are rates, too."""
    rate = 1e3 if isinstance(log.odometry, VelocityOdometry) else 1.0
    return driven(log, (1e3, 0.0), (rate, 0.0))


_DEGREE = np.pi / 180
EVERY: dict[str, tuple[Change, str]] = {
    "clockwise bearings": (lambda g: sensed(g, bearing=(-1.0, 0.0)), "bearings grow clockwise"),
    "clockwise turns": (lambda g: driven(g, turn=(-1.0, 0.0)), "grows clockwise"),
    "bearings from the left": (
        lambda g: sensed(g, bearing=(1.0, np.pi / 2)),
        "bearings are from the left",
    ),
    "radians taken for degrees": (
        lambda g: sensed(g, bearing=(_DEGREE, 0.0)),
        "bearings are radians",
    ),
    "ranges in cm": (lambda g: sensed(g, (100.0, 0.0)), "ranges are cm"),
    "turns in degrees": (lambda g: driven(g, turn=(1.0 / _DEGREE, 0.0)), "is in degrees"),
    "a clock of 0.5 s": (lambda g: late(g, 0.5), "s later than the log says"),
    "a scale of 1.1": (lambda g: driven(g, (1.1, 0.0)), "times the log's"),
    "range's variance": (stated("sigma_range_m", np.square), "the sigma of ranges"),
    "bearing's variance": (stated("sigma_bearing_rad", np.square), "the sigma of bearings"),
    "bearing's sigma taken for degrees": (
        stated("sigma_bearing_rad", lambda sigma: _DEGREE * sigma),
        "was taken for degrees",
    ),
}
WHEELS: dict[str, tuple[Change, str]] = {
    "milliseconds": (in_milliseconds, "times are milliseconds"),
    "km/h": (lambda g: driven(g, (3.6, 0.0)), "speeds are km/h"),
}
POSES: dict[str, tuple[Change, str]] = {
    "y to the right": (
        lambda g: other_frame(g, "x", "-y", 1.0),
        "y of the poses grows to the right",
    ),
    "x and y exchanged": (
        lambda g: other_frame(g, "y", "x", 1.0),
        "x and y of the poses are exchanged",
    ),
}
