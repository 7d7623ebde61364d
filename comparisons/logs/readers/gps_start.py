"""Where a drive starts in the frame of its GPS: dead reckoning laid onto the first fixes."""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.log import Positions
from comparisons.logs.odometry import SteeringOdometry
from comparisons.logs.odometry_noise import added_between
from graphslam.increments import AckermannGeometry, Stabilisation, ackermann_samples

_LEAST_MOTION_M = 0.5
_STEPS = 5
"""Of Gauss-Newton, from the path laid rigidly."""
ALIGNED_RAD, LARGEST_RAD = float(np.deg2rad(1.0)), float(np.deg2rad(15.0))
"""Fixes are laid onto as much of the odometry as shows the start's heading so well, or at worst."""
_ALL = 1.2
"""Where all fixes do not show it, this times their variance is enough: the rest adds little."""
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
        (0.0, 0.0),
        Stabilisation(),
        AckermannGeometry(**vars(odometry.vehicle)),
    ).displacement.T
    heading = np.concatenate(([0.0], np.cumsum(turn[:-1])))
    step = (forward + 1j * left) * np.exp(1j * heading)
    path = np.concatenate(([0.0], np.cumsum(step)))
    return lay_path(odometry.time_s, path, positions, until_s)


class GpsStart(NamedTuple):
    """pose: (3,) x, y [m], heading [rad]. covariance: (3, 3) of its additive errors."""

    pose: Array
    covariance: Array


class Reckoned(NamedTuple):
    """Odometry from the origin at times (N,): pose (N, 3), antenna (N,) at those poses.

    covariance: (N - 1, 3, 3) of each motion, in the frame where it arrives.
    """

    time_s: Array
    pose: Array
    antenna: NDArray[np.complex128]
    covariance: Array


def lay_path(
    time_s: Array, path: NDArray[np.complex128], positions: Positions, until_s: float
) -> Array:
    """Return the rigid motion (3,) that lays a path, from the origin, onto the fixes up to until_s.

    time_s, path: (N,) of the antenna. Raises InputError where it has not moved enough by then.
    """
    early = (positions.time_s <= until_s) & (positions.time_s >= time_s[0])
    at_fixes = _at(positions.time_s[early], time_s, path)
    fixes = positions.position_m[early] @ np.array([1.0, 1j])
    if len(fixes) < 2 or np.ptp(np.abs(at_fixes - at_fixes[0])) < _LEAST_MOTION_M:
        raise InputError(
            f"positions: the first {until_s:g} s do not determine the heading, expected fixes "
            f"along at least {_LEAST_MOTION_M:g} m"
        )
    centre_path, centre_fixes = at_fixes.mean(), fixes.mean()
    start_heading = float(np.angle(np.vdot(at_fixes - centre_path, fixes - centre_fixes)))
    start = centre_fixes - np.exp(1j * start_heading) * centre_path
    return np.array([start.real, start.imag, start_heading])


def lay_reckoned(moved: Reckoned, positions: Positions, until_s: float) -> GpsStart:
    """Return the start that fixes up to `until_s` show, with the odometry's noise on the way there.

    Raises InputError where the vehicle has not moved enough by then.
    """
    pose = lay_path(moved.time_s, moved.antenna, positions, until_s)
    early = (positions.time_s <= until_s) & (positions.time_s >= moved.time_s[0])
    fixes = positions.chosen(early)
    for _ in range(_STEPS):
        information, vector = _shown(moved, fixes, pose)
        pose = pose + np.linalg.solve(information, vector)
    return GpsStart(pose, np.asarray(np.linalg.inv(information), dtype=np.float64))


class Laid(NamedTuple):
    """Fixes in the frame of the start pose, those behind the ones spent on finding it.

    covariance: (3, 3) of the start in that frame. spent: the last fix spent.
    """

    positions: Positions
    covariance: Array
    spent: int


def lay_fixes(moved: Reckoned, plane: Positions) -> Laid | None:
    """Lay fixes onto the odometry, and spend on that as many of the first as show the heading.

    What they know, less the odometry's noise on the way, is the covariance of the start. plane: of
    any origin and direction. None where no fix would be left.
    """
    spent, start = _spent(moved, plane)
    if start is None:
        return None
    x, y, heading = start.pose
    laid = (plane.position_m - (x, y)) @ np.array([1.0, 1j]) * np.exp(-1j * heading)
    turn = np.eye(3)
    turn[:2, :2] = (np.cos(heading), np.sin(heading)), (-np.sin(heading), np.cos(heading))
    covariance = turn[:2, :2] @ plane.covariance @ turn[:2, :2].T
    symmetric = (covariance + covariance.transpose(0, 2, 1)) / 2
    placed = np.column_stack((laid.real, laid.imag))
    positions = Positions(plane.time_s, placed, symmetric, plane.antenna_m)
    behind = positions.chosen(np.arange(spent + 1, len(plane.time_s)))
    return Laid(behind, turn @ start.covariance @ turn.T, spent)


def _spent(moved: Reckoned, plane: Positions) -> tuple[int, GpsStart | None]:
    """The last fix to spend on the start, and what it then is; None where no fix would be left."""
    found: dict[int, GpsStart | None] = {}

    def variance(last: int) -> float:
        try:
            found[last] = start = lay_reckoned(moved, plane, float(plane.time_s[last]))
        except InputError:
            return np.inf
        return float(start.covariance[2, 2])

    whole = len(plane.time_s) - 1
    enough = max(ALIGNED_RAD**2, _ALL * variance(whole))
    spent = bisect_left(range(whole), True, key=lambda last: variance(last) <= enough)
    if enough > LARGEST_RAD**2 or spent == whole:
        return whole, None
    return spent, found[spent]


def _shown(moved: Reckoned, fixes: Positions, start: Array) -> tuple[Array, Array]:
    """Information matrix and vector on a change of the start, from the last fix back to it.

    Errors are turns and shifts of the plane about the start, so that motions add noise and nothing
    else: between two fixes an information L becomes (L^-1 + N)^-1, N what the motions add.
    """
    turn = np.exp(1j * start[2])
    place = turn * (moved.pose[1:, :2] @ np.array([1.0, 1j]))
    heading = np.exp(1j * moved.pose[1:, 2]) * turn
    arrived = np.tile(np.eye(3), (len(place), 1, 1))
    arrived[:, 0, 0] = arrived[:, 1, 1] = heading.real
    arrived[:, 0, 1], arrived[:, 1, 0] = -heading.imag, heading.imag
    arrived[:, 0, 2], arrived[:, 1, 2] = place.imag, -place.real
    added = arrived @ moved.covariance @ arrived.transpose(0, 2, 1)
    noise = added_between(np.append(moved.time_s[0], fixes.time_s), moved.time_s, added)
    lever = turn * _at(fixes.time_s, moved.time_s, moved.antenna)
    slopes = np.tile(np.eye(2, 3), (len(lever), 1, 1))
    slopes[:, 0, 2], slopes[:, 1, 2] = -lever.imag, lever.real
    missed = fixes.position_m - start[:2] - np.column_stack((lever.real, lever.imag))
    weighted = np.linalg.solve(fixes.covariance, slopes).transpose(0, 2, 1)
    own, vectors = weighted @ slopes, np.einsum("nij,nj->ni", weighted, missed)
    information, vector = np.zeros((3, 3)), np.zeros(3)
    for row in reversed(range(len(own))):
        information, vector = information + own[row], vector + vectors[row]
        kept = np.linalg.inv(np.eye(3) + information @ noise[row])
        information, vector = kept @ information, kept @ vector
    return (information + information.T) / 2, vector


def _at(wanted_s: Array, time_s: Array, path: NDArray[np.complex128]) -> NDArray[np.complex128]:
    return np.interp(wanted_s, time_s, path.real) + 1j * np.interp(wanted_s, time_s, path.imag)


def east_north(latitude: Array, longitude: Array, altitude: Array) -> Array:
    """(N, 2) east and north [m] of WGS 84 fixes, in the plane that touches at the first.

    latitude, longitude: (N,) [degrees]. altitude: (N,) above the ellipsoid [m]. By way of
    earth-centred coordinates, so exact at any distance.
    """
    phi, lam = np.deg2rad(latitude), np.deg2rad(longitude)
    square = _FLATTENING * (2.0 - _FLATTENING)
    normal = _EQUATOR_M / np.sqrt(1.0 - square * np.sin(phi) ** 2)
    x = (normal + altitude) * np.cos(phi) * np.cos(lam)
    y = (normal + altitude) * np.cos(phi) * np.sin(lam)
    centred = np.stack((x, y, (normal * (1.0 - square) + altitude) * np.sin(phi)), axis=1)
    moved = centred - centred[0]
    east = np.array((-np.sin(lam[0]), np.cos(lam[0]), 0.0))
    north = np.array(
        (-np.sin(phi[0]) * np.cos(lam[0]), -np.sin(phi[0]) * np.sin(lam[0]), np.cos(phi[0]))
    )
    plane: Array = moved @ np.column_stack((east, north))
    return plane
