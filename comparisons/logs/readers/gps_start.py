"""Where a drive starts in the frame of its GPS: dead reckoning laid onto the first fixes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comparisons.errors import InputError
from comparisons.logs.log import Positions
from comparisons.logs.odometry import SteeringOdometry
from graphslam.increments import AckermannGeometry, Stabilisation, ackermann_samples

_LEAST_MOTION_M = 0.5


def start_from_gps(
    odometry: SteeringOdometry, positions: Positions, until_s: float
) -> NDArray[np.float64]:
    """(3,) x, y [m], heading [rad] of the vehicle at its first odometry sample, in the GPS frame.

    The rigid motion that lays dead reckoning onto the fixes up to `until_s`. Dead reckoning is the
    vehicle's own equations (Nieto 2005, A.4) from the origin; the antenna is taken to be at the
    pose, which is the laser's. Raises InputError where the vehicle has not moved enough by then.
    """
    forward, left, turn = ackermann_samples(
        odometry.speed_mps[:-1],
        odometry.steering_rad[:-1],
        np.diff(odometry.time_s),
        0.0,
        0.0,
        Stabilisation(),
        AckermannGeometry(**vars(odometry.vehicle)),
    ).displacement.T
    heading = np.concatenate(([0.0], np.cumsum(turn[:-1])))
    step = (forward + 1j * left) * np.exp(1j * heading)
    path = np.concatenate(([0.0], np.cumsum(step)))
    early = (positions.time_s <= until_s) & (positions.time_s >= odometry.time_s[0])
    times = positions.time_s[early]
    at_fixes = np.interp(times, odometry.time_s, path.real) + 1j * np.interp(
        times, odometry.time_s, path.imag
    )
    fixes = positions.position_m[early] @ np.array([1.0, 1j])
    if len(fixes) < 2 or np.ptp(np.abs(at_fixes - at_fixes[0])) < _LEAST_MOTION_M:
        raise InputError(
            f"positions: the first {until_s:g} s do not show the heading, expected fixes along "
            f"{_LEAST_MOTION_M:g} m at least"
        )
    centre_path, centre_fixes = at_fixes.mean(), fixes.mean()
    start_heading = float(np.angle(np.vdot(at_fixes - centre_path, fixes - centre_fixes)))
    start = centre_fixes - np.exp(1j * start_heading) * centre_path
    return np.array([start.real, start.imag, start_heading])
