"""Nieto 2005, Table A.1, in place of the sigmas that were calibrated on the UTE's logs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from comparisons.logs.log import Log
from comparisons.logs.odometry import SteeringOdometry

FORMATS = ("acfr-car-park", "victoria-park", "aa3")
"""Logs of the vehicle of the thesis' Appendix A."""


@dataclass(frozen=True)
class SensorSigmas:
    """Of the UTE's encoders and laser; the defaults are Table A.1's."""

    speed_mps: float = 0.2
    steering_rad: float = float(np.deg2rad(2.0))
    range_m: float = 0.15
    bearing_rad: float = float(np.deg2rad(1.5))


def with_published_sigmas(log: Log) -> Log:
    """Return a log of the UTE with the table's sigmas; any other log as it is.

    Stabilisation noise, prior and positions keep theirs: the table has none. Both estimators read
    the one log. Source: Nieto 2005, Table A.1.
    """
    table = SensorSigmas()
    if log.format not in FORMATS or not isinstance(log.odometry, SteeringOdometry):
        return log
    noise = replace(
        log.odometry.noise, sigma_speed_mps=table.speed_mps, sigma_turn=table.steering_rad
    )
    count = len(log.measurements.time_s)
    return replace(
        log,
        odometry=replace(log.odometry, noise=noise),
        measurements=replace(
            log.measurements,
            sigma_range_m=np.full(count, table.range_m),
            sigma_bearing_rad=np.full(count, table.bearing_rad),
        ),
        provenance={**log.provenance, "sigmas": "Nieto 2005, Table A.1"},
    )
