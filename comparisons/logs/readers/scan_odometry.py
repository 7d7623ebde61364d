"""Logs of scans alone, without measurements, with odometry given as poses."""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.log import LandmarkMeasurements, Log, Prior
from comparisons.logs.odometry import NOISE_TEXT, RelativePoses, displacements
from comparisons.logs.scans import Clouds, Scans

PRIOR_SIGMA = 1e-6


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
