"""The full filter, driven scan by scan through a simulated log."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from comparisons.logs.log import Log
from comparisons.logs.odometry import SteeringOdometry
from ekf_reference.association import KnownAssociation
from ekf_reference.full_ekf import FullEkf, Stabilisation
from ekf_reference.motion import AckermannModel
from ekf_reference.trace import Trace


def scans(log: Log, trace: Trace | None = None) -> Iterator[tuple[float, FullEkf]]:
    """The filter after every scan with sightings, and the scan's time [s]."""
    odometry, seen = log.odometry, log.sightings
    assert isinstance(odometry, SteeringOdometry)
    noise = odometry.noise
    ekf = FullEkf(
        AckermannModel(**vars(odometry.vehicle)),
        KnownAssociation(),
        log.prior.pose,
        log.prior.covariance,
        Stabilisation(noise.variance_rate_position, noise.variance_rate_heading),
        trace,
    )
    control = np.column_stack((odometry.speed_mps, odometry.steering_rad))
    spread = np.diag((noise.sigma_speed_mps**2, noise.sigma_turn**2))
    duration = np.diff(odometry.time_s, append=2 * odometry.time_s[-1] - odometry.time_s[-2])
    done = 0
    for time in np.unique(seen.time_s):
        until = int(np.searchsorted(odometry.time_s, time - 1e-9))
        for i in range(done, until):
            ekf.predict(control[i], spread, float(duration[i]))
        done = until
        rows = seen.time_s == time
        z = np.column_stack((seen.range_m, seen.bearing_rad))[rows]
        sigma = np.column_stack((seen.sigma_range_m, seen.sigma_bearing_rad))[rows]
        ekf.observe(z, sigma, seen.landmark[rows], float(time))
        yield float(time), ekf
