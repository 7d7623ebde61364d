"""Run the reference EKF over a log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.errors import InputError
from comparisons.logs.log import Log, RelativePoses, SteeringOdometry
from comparisons.runs.estimate import Array, Estimate
from comparisons.runs.timeline import Timeline
from ekf_reference.association import REJECTED, Association, KnownAssociation, NearestNeighbour
from ekf_reference.full_ekf import FullEkf, Stabilisation
from ekf_reference.kalman import FilterDivergedError
from ekf_reference.motion import AckermannModel, MotionModel, RelativePoseModel, UnicycleModel
from ekf_reference.trace import RecordedTrace, TraceArrays

ASSOCIATIONS = ("known", "nn")


@dataclass(frozen=True)
class EkfRun:
    """An estimate with what the other estimators need of it.

    timeline: what the filter was given; when it broke down, only up to there.
    slot: (M,) landmark of each of the timeline's sightings, REJECTED where unused.
    departed: (K, 3) the pose when each epoch was done. arrived: (K, 3) as predicted there.
    breakdown: what stopped the filter, None when it reached the end.
    """

    estimate: Estimate
    timeline: Timeline
    trace: TraceArrays
    slot: NDArray[np.intp]
    departed: Array
    arrived: Array
    breakdown: str | None = None

    @property
    def rejected(self) -> int:
        """Sightings that were not used."""
        return int(np.count_nonzero(self.slot == REJECTED))


def choose_association(log: Log, name: str | None) -> str:
    """The name itself, or `known` when every sighting is labelled, else `nn`.

    Raises InputError for an unknown name, or for `known` without labels.
    """
    if name is None:
        return "known" if log.sightings.labelled else "nn"
    if name not in ASSOCIATIONS:
        raise InputError(f"association '{name}' is unknown, expected {' or '.join(ASSOCIATIONS)}")
    if name == "known" and not log.sightings.labelled:
        raise InputError(
            f"{log.name}: its sightings do not all name their landmark; use --association nn"
        )
    return name


def build_ekf(log: Log, association: str, trace: RecordedTrace) -> FullEkf:
    """The filter that a log calls for, standing at its prior."""
    odometry = log.odometry
    stabilisation = Stabilisation()
    motion: MotionModel
    if isinstance(odometry, RelativePoses):
        motion = RelativePoseModel()
    else:
        noise = odometry.noise
        stabilisation = Stabilisation(noise.variance_rate_position, noise.variance_rate_heading)
        if isinstance(odometry, SteeringOdometry):
            motion = AckermannModel(**vars(odometry.vehicle))
        else:
            motion = UnicycleModel()
    rule: Association = (
        KnownAssociation(log.sightings.label_gate) if association == "known" else NearestNeighbour()
    )
    return FullEkf(motion, rule, log.prior.pose, log.prior.covariance, stabilisation, trace)


def run_ekf(
    log: Log,
    timeline: Timeline,
    association: str,
    progress: Callable[[int, int], None] = lambda done, total: None,
    modify: Callable[[FullEkf], None] = lambda ekf: None,
) -> EkfRun:
    """Drive the filter through all epochs, or as far as it comes.

    progress: called with epochs done and in all. modify: may replace parts of the filter before
    it starts, which is how defects are planted.
    """
    trace = RecordedTrace()
    ekf = build_ekf(log, association, trace)
    modify(ekf)
    epochs = len(timeline.epoch_time_s)
    steps, first = timeline.steps_until(), timeline.sightings_until()
    seen = log.sightings
    z = np.column_stack((seen.range_m, seen.bearing_rad))
    sigma = np.column_stack((seen.sigma_range_m, seen.sigma_bearing_rad))
    departed, arrived = np.empty((epochs, 3)), np.empty((epochs, 3))
    covariance = np.empty((epochs, 3, 3))
    breakdown, done = None, 0
    for k in range(epochs):
        for i in range(done, int(steps[k])):
            ekf.predict(
                timeline.control[i],
                timeline.control_covariance[i],
                float(timeline.step_duration_s[i]),
            )
        done = int(steps[k])
        arrived[k] = ekf.state.pose
        rows = slice(int(first[k]), int(first[k + 1]))
        try:
            if rows.start < rows.stop:
                ekf.observe(z[rows], sigma[rows], seen.landmark[rows])
        except FilterDivergedError as error:
            breakdown = f"the EKF broke down at {timeline.epoch_time_s[k]:.3f} s: {error}"
            epochs = k + 1
        departed[k] = ekf.state.pose
        covariance[k] = ekf.state.covariance[:3, :3]
        if breakdown:
            break
        if k % 64 == 0:
            progress(k, epochs)
    progress(epochs, epochs)
    joint = np.array(ekf.state.covariance)
    if not (np.isfinite(joint).all() and np.isfinite(ekf.state.mean).all()):
        raise InputError(f"{log.name}: the EKF's estimate is not finite")
    timeline = timeline.prefix(epochs)
    arrays = trace.arrays()
    slot = _slots(arrays, len(timeline.sighting_epoch))
    estimate = Estimate(
        timeline.epoch_time_s,
        departed[:epochs],
        covariance[:epochs],
        _landmark_ids(seen.landmark[: len(slot)], slot, ekf.state.landmark_count, association),
        ekf.state.landmarks.copy(),
        joint,
        "filtered",
        {"estimator": "ekf_reference, full EKF", "association": association},
    )
    return EkfRun(estimate, timeline, arrays, slot, departed[:epochs], arrived[:epochs], breakdown)


def _slots(trace: TraceArrays, count: int) -> NDArray[np.intp]:
    """Which landmark each sighting was used for, from what the filter recorded."""
    slot = np.full(count, REJECTED, dtype=np.intp)
    for records in (trace.updates, trace.augmentations):
        slot[records.sighting] = records.slot
    return slot


def _landmark_ids(
    label: NDArray[np.int64], slot: NDArray[np.intp], count: int, association: str
) -> NDArray[np.int64]:
    """The log's labels where they were trusted, else the slots themselves."""
    ids = np.arange(count)
    if association == "known":
        used = slot != REJECTED
        ids[slot[used]] = label[used]
    return ids
