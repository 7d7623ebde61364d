"""Where a drive starts in the frame of its GPS: dead reckoning laid onto the first fixes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.log import Positions
from comparisons.logs.odometry import SteeringOdometry
from graphslam.increments import AckermannGeometry, Stabilisation, ackermann_samples

_LEAST_MOTION_M = 0.5
_EQUATOR_M, _FLATTENING = 6378137.0, 1.0 / 298.257223563


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
    return lay_path(odometry.time_s, path, positions, until_s).pose


class Start(NamedTuple):
    """pose: (3,) x, y [m], heading [rad]. covariance: (3, 3), as if the path were exact."""

    pose: Array
    covariance: Array


def lay_path(
    time_s: Array, path: NDArray[np.complex128], positions: Positions, until_s: float
) -> Start:
    """Return the rigid motion that lays a path, from the origin, onto the fixes up to `until_s`.

    time_s, path: (N,) of the antenna. Raises InputError where it has not moved enough by then.
    """
    early = (positions.time_s <= until_s) & (positions.time_s >= time_s[0])
    times = positions.time_s[early]
    at_fixes = np.interp(times, time_s, path.real) + 1j * np.interp(times, time_s, path.imag)
    fixes = positions.position_m[early] @ np.array([1.0, 1j])
    if len(fixes) < 2 or np.ptp(np.abs(at_fixes - at_fixes[0])) < _LEAST_MOTION_M:
        raise InputError(
            f"positions: the first {until_s:g} s do not show the heading, expected fixes along "
            f"{_LEAST_MOTION_M:g} m at least"
        )
    centre_path, centre_fixes = at_fixes.mean(), fixes.mean()
    start_heading = float(np.angle(np.vdot(at_fixes - centre_path, fixes - centre_fixes)))
    start = centre_fixes - np.exp(1j * start_heading) * centre_path
    lever = np.exp(1j * start_heading) * at_fixes
    slopes = np.zeros((len(fixes), 2, 3))
    slopes[:, 0, 0] = slopes[:, 1, 1] = 1.0
    slopes[:, 0, 2], slopes[:, 1, 2] = -lever.imag, lever.real
    weighted = np.linalg.solve(positions.covariance[early], slopes)
    information = np.einsum("nij,nik->jk", slopes, weighted)
    return Start(np.array([start.real, start.imag, start_heading]), np.linalg.inv(information))


def east_north(latitude: Array, longitude: Array, altitude: Array) -> Array:
    """(N, 2) east and north [m] of WGS 84 fixes, in the plane that touches at the first.

    latitude, longitude: (N,) [degrees]. altitude: (N,) above the ellipsoid [m]. By way of
    earth-centred coordinates, so exact at any distance.
    """
    phi, lam = np.deg2rad(latitude), np.deg2rad(longitude)
    square = _FLATTENING * (2.0 - _FLATTENING)
    normal = _EQUATOR_M / np.sqrt(1.0 - square * np.sin(phi) ** 2)
    centred = np.stack(
        (
            (normal + altitude) * np.cos(phi) * np.cos(lam),
            (normal + altitude) * np.cos(phi) * np.sin(lam),
            (normal * (1.0 - square) + altitude) * np.sin(phi),
        ),
        axis=1,
    )
    moved = centred - centred[0]
    east = np.array((-np.sin(lam[0]), np.cos(lam[0]), 0.0))
    north = np.array(
        (-np.sin(phi[0]) * np.cos(lam[0]), -np.sin(phi[0]) * np.sin(lam[0]), np.cos(phi[0]))
    )
    plane: Array = moved @ np.column_stack((east, north))
    return plane
