"""The full filter, driven scan by scan through a simulated log."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from comparisons.experiments.reproduction.watched_run import watched_run
from comparisons.logs.log import Log
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array
from ekf_reference.core.trace import Trace
from ekf_reference.models.range_bearing import RangeBearing


def scans(
    log: Log, trace: Trace | None = None, predicted: Callable[[Ekf], None] | None = None
) -> Iterator[tuple[float, Ekf]]:
    """The filter after every scan with sightings, and the scan's time [s].

    predicted: shown the filter between prediction and update.
    """
    return watched_run(log, trace=trace, predicted=predicted or (lambda ekf: None))


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
