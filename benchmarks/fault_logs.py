"""Short simulated logs on which planted defects show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from comparisons.config import EkfConfig
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import SteeringOdometry
from comparisons.logs.simulate.drive import Drive, simulate

LOGS = ("loop", "closing", "uneven", "positions")
ANTENNA_M = (0.6, -0.3)
"""Little enough for a filter without it to accept most positions."""
_POSITION_SIGMA_M = 0.3
_KEPT = 0.8
_CLOSING_S = 35.0


def open_case(name: str, seed: int, loop_s: float = 60.0) -> tuple[Log, EkfConfig]:
    """A log of LOGS, and what a filter is to do with it.

    loop: long enough for the heading to pass pi. closing: until its beginning is in view again.
    uneven: the same, with a fifth of the odometry's
    records lost. positions: the same with a position of an antenna every second, to be fused.
    Raises ValueError for another name.
    """
    if name not in LOGS:
        raise ValueError(f"log '{name}' is unknown, expected one of {', '.join(LOGS)}")
    rng = np.random.default_rng(seed)
    log = simulate(rng, Drive(loop_s=loop_s, extra_s=_CLOSING_S if name == "closing" else 0.0))
    if name == "uneven":
        log = _thinned(log, rng)
    if name == "positions":
        return _with_positions(log, rng), EkfConfig(association="known", gps="on")
    return log, EkfConfig(association="known")


def _thinned(log: Log, rng: np.random.Generator) -> Log:
    odometry = log.odometry
    if not isinstance(odometry, SteeringOdometry):
        raise TypeError("the simulated vehicle steers")
    kept = rng.random(len(odometry.time_s)) < _KEPT
    kept[0] = True
    columns = (odometry.time_s[kept], odometry.speed_mps[kept], odometry.steering_rad[kept])
    return replace(log, odometry=SteeringOdometry(*columns, odometry.vehicle, odometry.noise))


def _with_positions(log: Log, rng: np.random.Generator) -> Log:
    truth = log.truth.poses
    if truth is None:
        raise TypeError("the simulated drive has true poses")
    time, pose = truth.time_s[40::40], truth.pose[40::40]
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    forward, left = ANTENNA_M
    arm = np.column_stack((cos * forward - sin * left, sin * forward + cos * left))
    place = pose[:, :2] + arm + _POSITION_SIGMA_M * rng.standard_normal((len(pose), 2))
    covariance = np.broadcast_to(_POSITION_SIGMA_M**2 * np.eye(2), (len(pose), 2, 2))
    return replace(log, positions=Positions(time, place, covariance, ANTENNA_M))
