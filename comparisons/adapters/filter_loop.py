"""A filter driven through a log, epoch by epoch, with someone looking on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.attributes import measured_attributes
from comparisons.adapters.pose_landmark_measurements import (
    NoPoseLandmarkSource,
    PoseLandmarkRecorder,
    PoseLandmarkSource,
)
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array
from comparisons.logs.log import Log, Positions
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.measurements import REJECTED
from ekf_reference.core.state import FilterDivergedError


@runtime_checkable
class FilterObserver(Protocol):
    """An observer of the filter loop, which reads the filter and never changes it."""

    def before_predict(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """The filter has fused all earlier measurements and is about to predict from `time_s`."""
        ...

    def on_predict(self, ekf: Ekf) -> None:
        """The filter has predicted to an epoch and has fused nothing there yet."""
        ...

    def on_update(self, ekf: Ekf) -> None:
        """The filter has fused the measurements of the epoch."""
        ...

    def on_end(self, ekf: Ekf, time_s: float) -> None:
        """The filter has reached the end of the log, or broken down."""
        ...


class FilterObservers:
    """Several observers, called one after the other; an observer that does nothing without any."""

    _watching: Sequence[FilterObserver] = ()

    def __init__(self, watching: Sequence[FilterObserver] = ()) -> None:
        """watching: the observers, in the order of the calls."""
        self._watching = watching

    def before_predict(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """Call every observer."""
        for observer in self._watching:
            observer.before_predict(ekf, time_s, control, duration_s)

    def on_predict(self, ekf: Ekf) -> None:
        """Call every observer."""
        for observer in self._watching:
            observer.on_predict(ekf)

    def on_update(self, ekf: Ekf) -> None:
        """Call every observer."""
        for observer in self._watching:
            observer.on_update(ekf)

    def on_end(self, ekf: Ekf, time_s: float) -> None:
        """Call every observer."""
        for observer in self._watching:
            observer.on_end(ekf, time_s)


@dataclass(frozen=True, kw_only=True)
class FilterEpoch:
    """The filter at an epoch, with all its measurements fused.

    time_s: of the epoch. rows: of the log's measurements, landmark_indices: (m,) what became of
    them; `rejected` where the filter broke down first. arrived: (3,) the pose as predicted there.
    rejected_fixes: positions that the gate rejected. fault: what broke the filter down, which ends
    the drive.
    """

    time_s: float
    rows: slice
    landmark_indices: NDArray[np.intp]
    arrived: Array
    rejected_fixes: int
    fault: str | None


@dataclass(frozen=True)
class FilterAttachment:
    """What goes along with a filter.

    watching: observes. source: of measurements of pose landmarks, fused last and kept
    in the recorder.
    """

    watching: FilterObserver = field(default_factory=FilterObservers)
    source: PoseLandmarkSource = field(default_factory=NoPoseLandmarkSource)
    recorder: PoseLandmarkRecorder = field(default_factory=PoseLandmarkRecorder)


def run_filter_loop(
    ekf: Ekf,
    log: Log,
    timeline: Timeline,
    positions: Positions | None = None,
    beside: FilterAttachment | None = None,
) -> Iterator[FilterEpoch]:
    """Predict, fuse the measurements, fuse the positions, stop; and so on to the end.

    positions: to be fused; the timeline is built with the same.
    """
    beside = beside or FilterAttachment()
    watching, source, recorder = beside.watching, beside.source, beside.recorder
    steps, first = timeline.steps_until(), timeline.measurements_until()
    begins, durations = timeline.step_begin_s.tolist(), timeline.step_duration_s.tolist()
    first_fix = timeline.positions_until()
    measurements, done = log.measurements, 0
    z = np.column_stack((measurements.range_m, measurements.bearing_rad))
    sigma = np.column_stack((measurements.sigma_range_m, measurements.sigma_bearing_rad))
    reported = measured_attributes(log)
    for k, time_s in enumerate(timeline.epoch_time_s.tolist()):
        for i in range(done, int(steps[k])):
            control = timeline.control[i]
            watching.before_predict(ekf, begins[i], control, durations[i])
            ekf.predict(control, timeline.control_covariance[i], durations[i])
        done = int(steps[k])
        arrived = ekf.read_pose().pose
        watching.on_predict(ekf)
        rows = slice(int(first[k]), int(first[k + 1]))
        landmark_indices = np.full(rows.stop - rows.start, REJECTED, dtype=np.intp)
        rejected, fault = 0, None
        try:
            if rows.start < rows.stop:
                which = np.arange(rows.start, rows.stop)
                landmark_indices = ekf.observe(
                    z[rows], sigma[rows], measurements.landmark[rows], time_s, reported.take(which)
                )
            if positions is not None:
                for g in range(int(first_fix[k]), int(first_fix[k + 1])):
                    fix = positions.position_m[g], positions.covariance[g]
                    rejected += not ekf.fix_position(*fix)
            source.look(ekf, k, time_s, recorder)
        except FilterDivergedError as error:
            fault = str(error)
        watching.on_update(ekf)
        yield FilterEpoch(
            time_s=time_s,
            rows=rows,
            landmark_indices=landmark_indices,
            arrived=arrived,
            rejected_fixes=rejected,
            fault=fault,
        )
        if fault is not None:
            return
