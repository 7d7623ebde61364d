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
from ekf_reference.core.measurements import REJECTED, MeasuredAttributes
from ekf_reference.core.state import FilterDivergedError


@runtime_checkable
class Watcher(Protocol):
    """Someone who looks on while the filter runs, and reads only."""

    def stepping(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """The filter, all that was seen until now fused, is about to predict from this time."""
        ...

    def arrived(self, ekf: Ekf) -> None:
        """It has predicted up to an epoch, and fused nothing there yet."""
        ...

    def updated(self, ekf: Ekf) -> None:
        """It has fused what was seen at the epoch."""
        ...

    def finished(self, ekf: Ekf, time_s: float) -> None:
        """It has come to its end, or as far as it could."""
        ...


class Watchers:
    """Several, one after the other."""

    def __init__(self, watching: Sequence[Watcher]) -> None:
        """In the order in which they are told."""
        self._watching = watching

    def stepping(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """Tell all."""
        for one in self._watching:
            one.stepping(ekf, time_s, control, duration_s)

    def arrived(self, ekf: Ekf) -> None:
        """Tell all."""
        for one in self._watching:
            one.arrived(ekf)

    def updated(self, ekf: Ekf) -> None:
        """Tell all."""
        for one in self._watching:
            one.updated(ekf)

    def finished(self, ekf: Ekf, time_s: float) -> None:
        """Tell all."""
        for one in self._watching:
            one.finished(ekf, time_s)


class NoWatcher:
    """Looks away."""

    def stepping(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """Nothing."""

    def arrived(self, ekf: Ekf) -> None:
        """Nothing."""

    def updated(self, ekf: Ekf) -> None:
        """Nothing."""

    def finished(self, ekf: Ekf, time_s: float) -> None:
        """Nothing."""


@dataclass(frozen=True, kw_only=True)
class Stop:
    """The filter at an epoch, all that was seen there fused.

    time_s: of it. rows: of the log's measurements, landmark_indices: (m,) what became of them;
    `rejected` where the filter broke down first. arrived: (3,) the pose as predicted there.
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
class Beside:
    """What goes along with a filter.

    watching: observes. source: of measurements of pose landmarks, fused last and kept
    in the recorder. reported: what the measurements tell besides places, None for what the log
    says.
    """

    watching: Watcher = field(default_factory=NoWatcher)
    source: PoseLandmarkSource = field(default_factory=NoPoseLandmarkSource)
    recorder: PoseLandmarkRecorder = field(default_factory=PoseLandmarkRecorder)
    reported: MeasuredAttributes | None = None


def drive(
    ekf: Ekf,
    log: Log,
    timeline: Timeline,
    positions: Positions | None = None,
    beside: Beside | None = None,
) -> Iterator[Stop]:
    """Predict, fuse the measurements, fuse the positions, stop; and so on to the end.

    positions: to be fused; the timeline is built with the same.
    """
    beside = beside or Beside()
    watching, source, recorder = beside.watching, beside.source, beside.recorder
    steps, first = timeline.steps_until(), timeline.measurements_until()
    begins, first_fix = timeline.step_begin_s(), timeline.positions_until()
    seen, done = log.measurements, 0
    z = np.column_stack((seen.range_m, seen.bearing_rad))
    sigma = np.column_stack((seen.sigma_range_m, seen.sigma_bearing_rad))
    reported = beside.reported or measured_attributes(log)
    for k, time_s in enumerate(timeline.epoch_time_s.tolist()):
        for i in range(done, int(steps[k])):
            control, duration = timeline.control[i], float(timeline.step_duration_s[i])
            watching.stepping(ekf, float(begins[i]), control, duration)
            ekf.predict(control, timeline.control_covariance[i], duration)
        done = int(steps[k])
        arrived = ekf.read_pose().pose
        watching.arrived(ekf)
        rows = slice(int(first[k]), int(first[k + 1]))
        landmark_indices = np.full(rows.stop - rows.start, REJECTED, dtype=np.intp)
        rejected, fault = 0, None
        try:
            if rows.start < rows.stop:
                which = np.arange(rows.start, rows.stop)
                landmark_indices = ekf.observe(
                    z[rows], sigma[rows], seen.landmark[rows], time_s, reported.take(which)
                )
            if positions is not None:
                for g in range(int(first_fix[k]), int(first_fix[k + 1])):
                    fix = positions.position_m[g], positions.covariance[g]
                    rejected += not ekf.fix_position(*fix)
            source.look(ekf, k, time_s, recorder)
        except FilterDivergedError as error:
            fault = str(error)
        watching.updated(ekf)
        yield Stop(
            time_s=time_s,
            rows=rows,
            landmark_indices=landmark_indices,
            arrived=arrived,
            rejected_fixes=rejected,
            fault=fault,
        )
        if fault is not None:
            return
