"""The full filter, driven scan by scan through a simulated log."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from comparisons.logs.log import Log
from comparisons.logs.odometry import SteeringOdometry
from ekf_reference.association import KnownAssociation
from ekf_reference.full_ekf import FullEkf, Stabilisation
from ekf_reference.motion import AckermannModel
from ekf_reference.observation import RangeBearing
from ekf_reference.trace import Trace
from tests.helpers import Array


def scans(
    log: Log, trace: Trace | None = None, predicted: Callable[[FullEkf], None] | None = None
) -> Iterator[tuple[float, FullEkf]]:
    """The filter after every scan with sightings, and the scan's time [s].

    predicted: shown the filter between prediction and update.
    """
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
        if predicted is not None:
            predicted(ekf)
        ekf.observe(z, sigma, seen.landmark[rows], float(time))
        yield float(time), ekf


def true_landmarks(log: Log) -> Array:
    """(L, 2) [m] true places, in the order in which the filter meets the landmarks."""
    truth, (label, first) = log.truth, np.unique(log.sightings.landmark, return_index=True)
    assert truth is not None
    assert truth.landmarks is not None
    place = dict(zip(truth.landmarks.id.tolist(), truth.landmarks.position_m, strict=True))
    return np.array([place[k] for k in label[np.argsort(first)].tolist()])


def dense_sightings(
    rng: np.random.Generator, true_pose: Array, pose: Array, count: int
) -> tuple[Array, Array, Array]:
    """Points seen once by a precise sensor, 3 to 20 m ahead, and by nobody else.

    Returns where they are (count, 2), where the estimated pose (3,) puts them (count, 2), and the
    sensor's covariance there (count, 2, 2).
    """
    z = rng.uniform((3.0, -1.5), (20.0, 1.5), (count, 2))
    sigma = np.array((0.03, 0.002))
    true = RangeBearing().invert(true_pose, z).point
    seen = RangeBearing().invert(pose, z + sigma * rng.standard_normal(z.shape))
    j = seen.jacobian_sighting
    return true, seen.point, j @ np.diag(sigma**2) @ j.transpose(0, 2, 1)
