"""A log whose sensors are scaled, offset or late by a known number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses, SteeringOdometry

Line = tuple[float, float]
"""A factor, and an offset that is added."""
UNCHANGED: Line = (1.0, 0.0)


def driven(log: Log, speed: Line = UNCHANGED, turn: Line = UNCHANGED) -> Log:
    """Return the log with other speeds and turns, its noise unchanged.

    speed: of the speed [m/s], or of the way between two poses [m]. turn: of the steering angle
    [rad], the yaw rate [rad/s], or the turn between two poses [rad].
    """
    return controlled(log, lambda v: speed[0] * v + speed[1], lambda w: turn[0] * w + turn[1])


def controlled(log: Log, speed: Callable[[Array], Array], turn: Callable[[Array], Array]) -> Log:
    """Return the log with functions of all speeds and turns (N,), as of `driven`.

    speed: of the way (N, 2) where the log has motions between poses.
    """
    odometry = log.odometry
    if isinstance(odometry, RelativePoses):
        way, turned = odometry.displacement[:, :2], odometry.displacement[:, 2]
        displacement = np.column_stack((speed(way), turn(turned)))
        return replace(log, odometry=replace(odometry, displacement=displacement))
    name = "steering_rad" if isinstance(odometry, SteeringOdometry) else "yaw_rate_radps"
    changed: dict[str, Any] = {name: turn(getattr(odometry, name))}
    return replace(log, odometry=replace(odometry, speed_mps=speed(odometry.speed_mps), **changed))


def sensed(log: Log, range_: Line = UNCHANGED, bearing: Line = UNCHANGED) -> Log:
    """Return the log with other ranges and bearings, its noise unchanged.

    range_: of the range [m], which stays positive. bearing: of the bearing [rad], which is wrapped.
    """
    measurements = log.measurements
    range_m = np.maximum(range_[0] * measurements.range_m + range_[1], 1e-3)
    angle = np.angle(np.exp(1j * (bearing[0] * measurements.bearing_rad + bearing[1])))
    return replace(log, measurements=replace(measurements, range_m=range_m, bearing_rad=angle))


def delayed(log: Log, delay_s: float) -> Log:
    """Return the log with measurements that come later, within the odometry's time.

    delay_s: negative for earlier.
    """
    first_s, last_s = log.prior.time_s, float(log.odometry.time_s[-1])
    time_s = np.clip(log.measurements.time_s + delay_s, first_s, last_s)
    return replace(log, measurements=replace(log.measurements, time_s=time_s))
