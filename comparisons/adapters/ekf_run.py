"""Run the reference EKF over a log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import build_ekf
from comparisons.adapters.filter_loop import FilterAttachment, run_filter_loop
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.pose_landmark_measurements import PoseLandmarkRecorder
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array
from comparisons.config import EkfConfig
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Log, Positions
from comparisons.logs.transforms.known_landmarks import surveyed
from comparisons.shown import Brief
from comparisons.trace.events import SensorDescription
from ekf_reference.core.ekf import Ekf, PoseReading
from ekf_reference.core.landmark_types import POINT, POSE, LandmarkKind
from ekf_reference.core.measurements import AMBIGUOUS, CANDIDATE, DYNAMIC, REJECTED
from ekf_reference.core.trace import RecordedTrace, TraceArrays
from ekf_reference.filters.compressed import CompressedState
from graphslam.problem import PoseLandmarkMeasurements

_FARTHEST_M = 1e6
"""A pose so far from the start has diverged; what follows is not worth comparing."""


UNUSED = {
    REJECTED: "rejected",
    AMBIGUOUS: "ambiguous",
    CANDIDATE: "candidate",
    DYNAMIC: "dynamic",
}
"""Why a measurement was not used, by its code."""


class Compression(NamedTuple):
    """What a compressed filter has saved (Guivant 2002, section 4).

    The fields are those of the result, EkfFigures.

    updates: of measurements. updates_with_passive: those that left some landmarks passive.
    active_share: of all states, mean over the updates. global_updates: that carried something over.
    global_update_spared: mean share of the passive covariance that these left alone.
    """

    updates: int
    updates_with_passive: int
    active_share: float
    global_updates: int
    global_update_spared: float


@dataclass(frozen=True, kw_only=True, repr=False)
class EkfRun(Brief):
    """An estimate with what the other estimators need of it.

    timeline: what the filter was given; when it broke down, only up to there.
    positions: those that were given. fix_number: (G,) which of them were fused. rejected_fixes:
    how many the gate rejected. deactivated: (R,) landmarks that were found to stand where things
    move; they stay in the state, and nothing is matched with them any more.
    landmark_index: (M,) landmark of each of the timeline's measurements, a negative code where
    unused (see ekf_reference.core.measurements).
    departed: (K, 3) the pose when each epoch was done. arrived: (K, 3) as predicted there.
    final: the last pose, against the trace's. own_axes: the filter fuses measurements as points in
    the vehicle's axes, not as range and bearing.
    cut_off: scans in which joint compatibility visited its most nodes, and took the best set.
    compression: what a compressed filter has saved, None of others. breakdown: what stopped the
    filter, None when it reached the end. pose_landmarks: measurements of pose landmarks, as the
    smoother takes them; their ids in the estimate are their landmark indices.
    """

    estimate: Estimate
    timeline: Timeline
    trace: TraceArrays
    landmark_index: NDArray[np.intp]
    departed: Array
    arrived: Array
    final: PoseReading
    own_axes: bool
    positions: Positions | None
    fix_number: NDArray[np.intp]
    rejected_fixes: int
    cut_off: int = 0
    compression: Compression | None = None
    breakdown: str | None = None
    pose_landmarks: PoseLandmarkMeasurements = field(default_factory=PoseLandmarkMeasurements)
    deactivated: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    @property
    def sensors(self) -> dict[str, SensorDescription]:
        """What the filter fuses, with the components of one measurement."""
        point = ("forward", "left") if self.own_axes else ("range", "bearing")
        pose = ("forward", "left", "heading")
        found = {
            "measurements": SensorDescription(None, point),
            "positions": SensorDescription(None, ("east", "north")),
            "scan landmarks": SensorDescription(None, pose),
            "merges": SensorDescription(None, pose),
        }
        for kind in self.single_entries:
            sensor = "positions" if kind is None else "measurements"
            names = found[sensor].components
            found |= {f"{name} of {sensor}": SensorDescription(None, (name,)) for name in names}
        return found

    @cached_property
    def single_entries(self) -> dict[LandmarkKind | None, Array]:
        """Which entries of measurements, and positions, were used, where some were not.

        (M, 2) by kind, as of MeasurementRecords.
        """
        uses = {POINT: self.trace.measurements[POINT], None: self.trace.positions}
        found = {kind: records.entries for kind, records in uses.items()}
        return {kind: entries for kind, entries in found.items() if not entries.all()}

    def sensor_of(self, sensor: str, entry: int) -> str:
        """Return the name of one entry of a sensor, where it is fused alone.

        Args:
            sensor: Its name.
            entry: Of its measurement.
        """
        return f"{self.sensors[sensor].components[entry]} of {sensor}"

    @property
    def pose_landmark_places(self) -> Array:
        """(Q, 3) of the estimate by landmark index, NaN for those that were fused with others."""
        places = np.full((self.pose_landmarks.count, 3), np.nan)
        places[self.estimate.pose_landmark_id] = self.estimate.pose_landmarks
        return places

    @property
    def unused(self) -> dict[str, int]:
        """Measurements that were not used, by reason."""
        return {
            name: int(np.count_nonzero(self.landmark_index == code))
            for code, name in UNUSED.items()
        }


def run_ekf(
    log: Log,
    timeline: Timeline,
    config: EkfConfig,
    positions: Positions | None = None,
    setup: FilterSetup | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> EkfRun:
    """Drive the filter through all epochs, or as far as it comes.

    config: settled. positions: to be fused; the timeline is built with the same. setup: what
    stands beside the filter. progress: called with epochs done and in all.
    """
    beside = setup or FilterSetup()
    trace, recorder = RecordedTrace(), PoseLandmarkRecorder()
    ekf = build_ekf(log, config, trace)
    deactivated = beside.apply(ekf)
    watching = beside.watcher()
    ekf.insert_surveyed(*surveyed(log)[1:])
    epochs = len(timeline.epoch_time_s)
    departed, arrived = np.empty((epochs, 3)), np.empty((epochs, 3))
    covariance = np.empty((epochs, 3, 3))
    landmark_index = np.full(len(log.measurements.time_s), REJECTED, dtype=np.intp)
    breakdown, rejected_fixes = None, 0
    epoch_states = run_filter_loop(
        ekf, log, timeline, positions, FilterAttachment(watching, beside.source, recorder)
    )
    for k, state in enumerate(epoch_states):
        landmark_index[state.rows], arrived[k] = state.landmark_indices, state.arrived
        rejected_fixes += state.rejected_fixes
        departed[k], _, read = ekf.read_pose()
        covariance[k] = read @ ekf.state.pose_covariance @ read.T
        away = float(np.abs(departed[k, :2] - log.prior.pose[:2]).max())
        fault = state.fault
        if fault is None and not away <= _FARTHEST_M:
            fault = f"its pose is {away:.2g} m from the start"
        if fault is not None:
            breakdown = f"the EKF broke down at {timeline.epoch_time_s[k]:.3f} s: {fault}"
            epochs = k + 1
            break
        if k % 64 == 0:
            progress(k, epochs)
    progress(epochs, epochs)
    watching.on_end(ekf, float(timeline.epoch_time_s[epochs - 1]))
    joint = _joint_covariance(ekf)
    if not np.isfinite(ekf.state.mean).all():
        raise InputError(
            f"{log.name}: the EKF's mean is not finite, so there is nothing to compare"
        )
    if breakdown is None and not np.isfinite(joint).all():
        breakdown = "the EKF broke down: its covariance is not finite at the end"
    timeline = timeline.prefix(epochs)
    arrays = trace.arrays()
    pose_landmarks = recorder.reported()
    _check_counts(log, timeline, arrays, pose_landmarks)
    landmark_index = _as_used(landmark_index[: len(timeline.measurement_epoch)], arrays)
    if np.isnan(ekf.state.landmarks).any():
        raise InputError(f"{log.name}: the EKF removed point landmarks, which must stay")
    pose_landmark_id = ekf.state.layout.present(POSE)
    estimate = Estimate(
        time_s=timeline.epoch_time_s,
        pose=departed[:epochs],
        pose_covariance=covariance[:epochs],
        landmark_id=_landmark_ids(
            log.measurements.landmark[: len(landmark_index)],
            landmark_index,
            ekf.state.landmark_count,
            config,
            surveyed(log)[0],
        ),
        landmark=ekf.state.landmarks.copy(),
        joint_covariance=joint,
        information="filtered",
        provenance={
            "estimator": f"ekf_reference, {config.filter} EKF",
            "association": str(config.association),
        },
        pose_landmark_id=pose_landmark_id,
        pose_landmarks=ekf.state.places(POSE)[pose_landmark_id],
        labels=log.labels if config.association == "known" else {},
    )
    fused = np.unique(arrays.positions.number)
    return EkfRun(
        estimate=estimate,
        timeline=timeline,
        trace=arrays,
        landmark_index=landmark_index,
        departed=departed[:epochs],
        arrived=arrived[:epochs],
        final=ekf.read_recorded_pose(),
        own_axes=config.own_axes,
        positions=positions,
        fix_number=fused,
        rejected_fixes=rejected_fixes,
        cut_off=_cut_off(ekf),
        compression=_compression(ekf),
        breakdown=breakdown,
        pose_landmarks=pose_landmarks,
        deactivated=np.array(sorted(deactivated), dtype=np.intp),
    )


def _cut_off(ekf: Ekf) -> int:
    """Return how often joint compatibility was cut off, whatever is wrapped around it."""
    rule: Any = ekf.association
    while rule is not None and not hasattr(rule, "most_nodes"):
        rule = getattr(rule, "rule", None)
    return 0 if rule is None else int(rule.counts["cut off"])


def _check_counts(
    log: Log, timeline: Timeline, trace: TraceArrays, pose_landmarks: PoseLandmarkMeasurements
) -> None:
    """Raise InputError for a filter that made something of data that it was not given."""
    measurements, frames = (
        np.concatenate((trace.measurements[w].number, trace.initialisations[w].number))
        for w in (POINT, POSE)
    )
    for what, made, given in (
        ("predictions", len(trace.departed), len(timeline.control)),
        ("measurements", int(measurements.max(initial=-1)) + 1, len(timeline.measurement_epoch)),
        (
            "positions",
            int(trace.positions.number.max(initial=-1)) + 1,
            len(timeline.position_epoch),
        ),
        (
            "measurements of pose landmarks",
            int(frames.max(initial=-1)) + 1,
            len(pose_landmarks.measured),
        ),
    ):
        if made > given or (what == "predictions" and made < given):
            raise InputError(
                f"{log.name}: the EKF recorded {made} {what}, expected {given}: one is called "
                "twice, or left out"
            )


def _joint_covariance(ekf: Ekf) -> Array:
    """Of the last pose as x, y, heading, and all landmarks, points first."""
    read, own, packed = ekf.read_pose().jacobian, ekf.state.covariance, ekf.state.layout.by_kind()
    own = own[np.ix_(packed, packed)]
    p = read.shape[1]
    joint = np.empty((len(own) - p + 3, len(own) - p + 3))
    joint[:3, :3] = read @ own[:p, :p] @ read.T
    joint[:3, 3:] = read @ own[:p, p:]
    joint[3:, :3] = joint[:3, 3:].T
    joint[3:, 3:] = own[p:, p:]
    return joint


def _compression(ekf: Ekf) -> Compression | None:
    if not isinstance(ekf.state, CompressedState):
        return None
    saved = [update.saved for update in ekf.state.updates if update.passive]
    work = ekf.state.work
    return Compression(
        updates=work.updates,
        updates_with_passive=work.compressed,
        active_share=work.active_share / work.updates if work.updates else 1.0,
        global_updates=len(saved),
        global_update_spared=float(np.mean(saved)) if saved else 0.0,
    )


def _as_used(landmark_index: NDArray[np.intp], trace: TraceArrays) -> NDArray[np.intp]:
    """Landmark indices as recorded: a breakdown in the midst of a scan leaves part of it used."""
    used = np.where(landmark_index >= 0, REJECTED, landmark_index)
    for records in (trace.measurements[POINT], trace.initialisations[POINT]):
        seen = records.number >= 0
        used[records.number[seen]] = records.landmark_index[seen]
    return used


def _landmark_ids(
    label: NDArray[np.int64],
    landmark_index: NDArray[np.intp],
    count: int,
    config: EkfConfig,
    index_of: dict[int, int],
) -> NDArray[np.int64]:
    """The log's labels where they were trusted, else the landmark indices themselves."""
    ids = np.arange(count)
    ids[list(index_of.values())] = list(index_of)
    if config.association == "known":
        used = landmark_index >= 0
        ids[landmark_index[used]] = label[used]
    return ids
