"""Logs of scans alone: odometry given as poses becomes one displacement per scan.

Poses are planar. Dead reckoned poses carry no covariance of their displacements, so one is stated
here: variances grow with the way and with the turn, hence do not depend on how often the scanner
fires. It is generous for wheels indoors, since scan matching corrects what it leaves open.
"""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.log import LandmarkMeasurements, Log, Prior
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.scans import Clouds, Scans

SIGMA_M_PER_SQRT_M = 0.1
"""Forward and sideways: 10 % after one metre."""
SIGMA_M_PER_SQRT_RAD = 0.05
SIGMA_RAD_PER_SQRT_M = 0.05
SIGMA_RAD_PER_SQRT_RAD = 0.1
"""Of the heading: 10 % after one radian."""
_LEAST_SIGMA = np.array([1e-3, 1e-3, 1e-3])
PRIOR_SIGMA = 1e-6
_LONGEST_S = 0.5

NOISE_TEXT = (
    f"stated: {SIGMA_M_PER_SQRT_M:g} m per root metre and {SIGMA_M_PER_SQRT_RAD:g} m per root "
    f"radian, {SIGMA_RAD_PER_SQRT_M:g} rad per root metre and {SIGMA_RAD_PER_SQRT_RAD:g} rad per "
    "root radian"
)


def displacements(time_s: Array, pose: Array) -> RelativePoses:
    """Motion from each pose to the next, with the stated covariance.

    time_s: (N,), increasing. pose: (N, 3) x, y [m], heading [rad], wrapped or not. The result has
    N - 1 records and departs from the first pose, which is the prior's; none for one pose.
    """
    step = (np.diff(pose[:, 0]) + 1j * np.diff(pose[:, 1])) * np.exp(-1j * pose[:-1, 2])
    turn = np.angle(np.exp(1j * np.diff(pose[:, 2])))
    way, swing = np.abs(step), np.abs(turn)
    position = SIGMA_M_PER_SQRT_M**2 * way + SIGMA_M_PER_SQRT_RAD**2 * swing
    heading = SIGMA_RAD_PER_SQRT_M**2 * way + SIGMA_RAD_PER_SQRT_RAD**2 * swing
    variance = np.column_stack((position, position, heading)) + _LEAST_SIGMA**2
    moved = np.column_stack((step.real, step.imag, turn))
    return RelativePoses(time_s[1:], moved, variance[:, :, None] * np.eye(3))


def poses_at(time_s: Array, sample_s: Array, pose: Array) -> Array:
    """(N, 3) poses interpolated at the instants (N,) among the samples (M,), (M, 3).

    Headings are interpolated the short way round. The instants must lie within the samples' time.
    """
    whole = np.column_stack((pose[:, :2], np.unwrap(pose[:, 2])))
    return np.column_stack([np.interp(time_s, sample_s, column) for column in whole.T])


def instants_of(wanted_s: Array, sample_s: Array) -> Array:
    """(N,) instants wanted, both ends of the samples, and one of them in each empty half second.

    wanted_s: (M,) within the samples' time. Without the latter a trajectory would cut its corners.
    """
    cell = np.floor(sample_s / _LONGEST_S)
    first = np.unique(cell, return_index=True)[1]
    empty = ~np.isin(cell[first], np.floor(wanted_s / _LONGEST_S))
    return np.unique(np.concatenate((wanted_s, sample_s[[0, -1]], sample_s[first[empty]])))


def no_measurements() -> LandmarkMeasurements:
    """What a log of scans alone brings."""
    none = np.zeros(0)
    return LandmarkMeasurements(
        time_s=none,
        range_m=none,
        bearing_rad=none,
        sigma_range_m=none,
        sigma_bearing_rad=none,
        landmark=np.zeros(0, dtype=np.int64),
        diameter_m=none,
    )


def scan_log(
    name: str,
    format_name: str,
    time_s: Array,
    pose: Array | None,
    provenance: dict[str, str],
    *,
    scans: Scans | None = None,
    clouds: Clouds | None = None,
) -> Log:
    """A log that starts at its first scan, in the frame of the vehicle's pose there.

    time_s: (N,) the instants of all its scans, increasing. pose: (N, 3) the odometry's poses then,
    or None where there is no odometry.
    """
    if pose is None:
        odometry = RelativePoses(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))
        noise = "no odometry"
    else:
        odometry, noise = displacements(time_s, pose), NOISE_TEXT
    return Log(
        name=name,
        format=format_name,
        prior=Prior(float(time_s[0]), np.zeros(3), PRIOR_SIGMA**2 * np.eye(3)),
        odometry=odometry,
        measurements=no_measurements(),
        scans=scans,
        clouds=clouds,
        provenance={**provenance, "odometry_noise": noise},
    )
