"""Wheel odometry as the smoother's motion samples, and as motion between any instants."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from comparisons.adapters.timeline import Timeline, build_timeline
from comparisons.arrays import Array
from comparisons.errors import InputError, RecordError
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Log, Sightings
from comparisons.logs.odometry import RelativePoses, SteeringOdometry
from graphslam import increments
from graphslam.scan import planar

CLOCK_S = 1e-4
"""Times closer than this are one: a timeline resolves no more."""


def motion_samples(log: Log, timeline: Timeline) -> increments.Samples:
    """Body-frame displacements and covariances of all steps, by graphslam's vehicle models."""
    odometry = log.odometry
    if isinstance(odometry, RelativePoses):
        return increments.relative_pose_samples(timeline.control, timeline.control_covariance)
    noise = odometry.noise
    stabilisation = increments.Stabilisation(
        noise.variance_rate_position, noise.variance_rate_heading
    )
    first, second = timeline.control.T
    common = (timeline.step_duration_s, noise.sigma_speed_mps, noise.sigma_turn, stabilisation)
    if isinstance(odometry, SteeringOdometry):
        geometry = increments.AckermannGeometry(**vars(odometry.vehicle))
        return increments.ackermann_samples(first, second, *common, geometry)
    return increments.unicycle_samples(first, second, *common)


def motion_between(log: Log, time_s: Array) -> increments.Samples:
    """Dead reckoned motion up to each instant (N,), from the one before or from the start.

    Displacements (N, 3), and covariances (N, 3, 3) of the right perturbation. Raises InputError
    where the odometry has no poses at those times.
    """
    count = len(time_s)
    marks = Sightings(
        time_s=time_s,
        range_m=np.ones(count),
        bearing_rad=np.zeros(count),
        sigma_range_m=np.ones(count),
        sigma_bearing_rad=np.ones(count),
        landmark=np.zeros(count, dtype=np.int64),
        diameter_m=np.full(count, np.nan),
    )
    try:
        timeline = build_timeline(replace(log, sightings=marks))
    except RecordError as error:
        raise InputError(f"{log.name}: scans: {error.fault}") from None
    interval = np.searchsorted(timeline.sighting_epoch, timeline.step_epoch)
    before_last = interval < count
    samples = motion_samples(log, timeline)
    kept = increments.Samples(samples.displacement[before_last], samples.covariance[before_last])
    return increments.compose(kept, interval[before_last], count)


def poses_at(log: Log, estimate: Estimate, time_s: Array) -> Array:
    """(N, 3) an estimate's poses at times (N,), led on by the odometry in between.

    Times before and after the estimate's are taken for its first and its last.
    """
    known, wanted = np.round(estimate.time_s, 4), np.round(time_s, 4)
    wanted = np.clip(wanted, known[0], known[-1])
    instants = np.union1d(known, wanted)
    moved = _moved(log, instants)
    pose = np.empty((len(instants), 3))
    row = np.minimum(np.searchsorted(known, instants), len(known) - 1)
    at_epoch = np.abs(known[row] - instants) < 0.5 * CLOCK_S
    for i in range(len(instants)):
        at = estimate.pose[row[i]] if at_epoch[i] else planar.compose(pose[i - 1], moved[i - 1])
        pose[i] = at
    found: Array = pose[np.searchsorted(instants, wanted)]
    return found


def _moved(log: Log, instants: Array) -> Array:
    """(N - 1, 3) the odometry's motion from each of the instants (N,) [s] to the next.

    Between relative poses the vehicle is taken to move evenly, as DenseWatcher has it.
    """
    odometry = log.odometry
    if not isinstance(odometry, RelativePoses):
        moved: Array = motion_between(log, instants).displacement[1:]
        return moved
    begin = np.concatenate(([log.prior.time_s], odometry.time_s))
    row = np.clip(np.searchsorted(begin, instants, side="right") - 1, 0, len(begin) - 2)
    share = np.clip((instants - begin[row]) / np.diff(begin)[row], 0.0, 1.0)
    way = share[:, None] * odometry.displacement[row]
    path = increments.dead_reckoned(np.zeros(3), odometry.displacement)[row]
    at = [planar.compose(p, w) for p, w in zip(path, way, strict=True)]
    return np.array([planar.between(a, b) for a, b in pairwise(at)]).reshape(-1, 3)
