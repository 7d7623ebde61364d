"""Wheel odometry as the smoother's motion samples, and as motion between any instants."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from comparisons.adapters.timeline import Timeline, build_timeline
from comparisons.arrays import Array, Index
from comparisons.errors import InputError, RecordError
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import LandmarkMeasurements, Log
from comparisons.logs.odometry import (
    OdometryNoise,
    RelativePoses,
    SteeringOdometry,
    VelocityOdometry,
    wheel_samples,
)
from graphslam import increments
from graphslam.scan import planar

CLOCK_S = 1e-4
"""Times closer than this are one where nothing but their order counts."""
LEAST_EIGENVALUE = 1e-7
"""Of an increment's correlation matrix. At 1.8e-7 the filter and the frozen smoothers still agree
to 3e-10; from 3e-8 on elimination takes the information for singular."""
_DECADES = range(-10, 7)
"""Of the noise advised, in m^2/s: 1e-10 is a hundredth of a millimetre after a second."""


def motion_samples(log: Log, timeline: Timeline) -> increments.MotionSamples:
    """Body-frame displacements and covariances of all steps, by graphslam's vehicle models."""
    odometry = log.odometry
    if isinstance(odometry, RelativePoses):
        return increments.MotionSamples(timeline.control, timeline.control_covariance)
    return wheel_samples(odometry, timeline.control.T, timeline.step_duration_s, log.integration)


def composed_motion(log: Log, timeline: Timeline) -> increments.MotionSamples:
    """Motion from each epoch to the next: displacements (K - 1, 3), covariances (K - 1, 3, 3)."""
    count = len(timeline.epoch_time_s) - 1
    return increments.compose(motion_samples(log, timeline), timeline.step_epoch - 1, count)


def check_regular(log: Log, timeline: Timeline) -> None:
    """Raise InputError unless the motion between any two consecutive epochs has full rank.

    Speed and turn leave one direction of a sample's motion without noise, standing still more.
    Over the samples of a curve all have some; where not, the error says how much stabilisation
    noise will do. Relative poses are regular one by one.
    """
    odometry = log.odometry
    if isinstance(odometry, RelativePoses):
        return
    bad, count = _singular(log, timeline)
    if len(bad):
        begin_s, end_s = timeline.epoch_time_s[bad[0] : bad[0] + 2]
        odometry_noise, noise = _enough(log, odometry, timeline, bad), odometry.noise
        p, h = odometry_noise.variance_rate_position, odometry_noise.variance_rate_heading
        said = [f"variance_rate_position = {p:.0e} (m^2/s)"] * (p > noise.variance_rate_position)
        said += [f"variance_rate_heading = {h:.0e} (rad^2/s)"] * (h > noise.variance_rate_heading)
        raise InputError(
            f"{log.name}: odometry noise: the covariance of the motion from {begin_s:.4f} to "
            f"{end_s:.4f} s is singular, one of {len(bad)} among {count}, for speed "
            "and turn leave a direction without noise; expected stabilisation noise, such as "
            + " and ".join(said)
        )


def with_regular_motion(log: Log) -> Log:
    """The log with as much stabilisation noise as check_regular asks for, at least its own."""
    odometry = log.odometry
    if isinstance(odometry, RelativePoses):
        return log
    timeline = build_timeline(log, log.positions)
    bad, _ = _singular(log, timeline)
    if not len(bad):
        return log
    return replace(log, odometry=replace(odometry, noise=_enough(log, odometry, timeline, bad)))


def _singular(log: Log, timeline: Timeline) -> tuple[Index, int]:
    """Numbers of the motions whose covariance is singular, among how many."""
    covariance = composed_motion(log, timeline).covariance
    return np.flatnonzero(least_eigenvalues(covariance) < LEAST_EIGENVALUE), len(covariance)


def _enough(
    log: Log, odometry: SteeringOdometry | VelocityOdometry, timeline: Timeline, rows: Index
) -> OdometryNoise:
    """The least rates of stabilisation noise, powers of ten, that make increments (n,) regular.

    Raises InputError where none does.
    """
    noise = odometry.noise

    def of(noise: OdometryNoise) -> Array:
        alone = replace(log, odometry=replace(odometry, noise=noise))
        return composed_motion(alone, timeline).covariance[rows]

    controls = of(OdometryNoise(noise.sigma_speed_mps, noise.sigma_turn, 0.0, 0.0))
    per_position, per_heading = (
        of(OdometryNoise(0.0, 0.0, 1.0, 0.0)),
        of(OdometryNoise(0.0, 0.0, 0.0, 1.0)),
    )
    for exponent in _DECADES:
        position, heading = 10.0**exponent, 10.0 ** (exponent - 2)
        for by_position, by_heading in ((position, 0.0), (0.0, heading), (position, heading)):
            p = max(by_position, noise.variance_rate_position)
            h = max(by_heading, noise.variance_rate_heading)
            total = controls + p * per_position + h * per_heading
            if (least_eigenvalues(total) >= LEAST_EIGENVALUE).all():
                return replace(noise, variance_rate_position=p, variance_rate_heading=h)
    raise InputError(
        f"{log.name}: odometry noise: the covariance of the motion between two observations is "
        "singular, and no stabilisation noise mends it, for the sigmas of speed and turn, over "
        "these intervals, are too large beside it; expected smaller sigmas or intervals"
    )


def least_eigenvalues(covariance: Array) -> Array:
    """(N,) of the correlation matrices of covariances (N, 3, 3); 0 where a variance is zero."""
    sigma = np.sqrt(np.einsum("nii->ni", covariance))
    rows = np.flatnonzero((sigma > 0.0).all(axis=1))
    kept = sigma[rows]
    least = np.zeros(len(covariance))
    least[rows] = np.linalg.eigvalsh(covariance[rows] / (kept[:, :, None] * kept[:, None]))[:, 0]
    return least


def motion_between(log: Log, time_s: Array) -> increments.MotionSamples:
    """Dead reckoned motion up to each instant (N,), from the one before or from the start.

    Displacements (N, 3), and covariances (N, 3, 3) of the right perturbation. Raises InputError
    where the odometry has no poses at those times.
    """
    count = len(time_s)
    marks = LandmarkMeasurements(
        time_s=time_s,
        range_m=np.ones(count),
        bearing_rad=np.zeros(count),
        sigma_range_m=np.ones(count),
        sigma_bearing_rad=np.ones(count),
        landmark=np.zeros(count, dtype=np.int64),
    )
    try:
        timeline = build_timeline(replace(log, measurements=marks))
    except RecordError as error:
        raise InputError(f"{log.name}: scans: {error.fault}") from None
    interval = np.searchsorted(timeline.measurement_epoch, timeline.step_epoch)
    before_last = interval < count
    samples = motion_samples(log, timeline)
    kept = increments.MotionSamples(
        samples.displacement[before_last], samples.covariance[before_last]
    )
    return increments.compose(kept, interval[before_last], count)


def poses_at(log: Log, estimate: Estimate, time_s: Array) -> Array:
    """(N, 3) an estimate's poses at times (N,), led on by the odometry in between.

    Times before and after the estimate's are taken for its first and its last.
    """
    known = estimate.time_s
    wanted = np.clip(time_s, known[0], known[-1])
    instants = np.union1d(known, wanted)
    motion = _moved(log, instants)
    pose = np.empty((len(instants), 3))
    row = np.minimum(np.searchsorted(known, instants), len(known) - 1)
    at_epoch = known[row] == instants
    for i in range(len(instants)):
        at = estimate.pose[row[i]] if at_epoch[i] else planar.compose(pose[i - 1], motion[i - 1])
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
