"""A filter run over a log as a reference: what it knew of the pose at any instant, and its map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import build_ekf, motion_model
from comparisons.adapters.filter_loop import (
    FilterAttachment,
    FilterObserver,
    FilterObservers,
    run_filter_loop,
)
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array
from comparisons.config import EkfConfig
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.transforms.known_landmarks import surveyed
from ekf_reference.core.ekf import Ekf, StepNoise
from ekf_reference.core.state import FilterDivergedError
from ekf_reference.core.trace import Trace
from ekf_reference.models.motion import MotionStep


class KnownMap(NamedTuple):
    """The map at an instant.

    landmark_id: (L,). landmark: (L, 2). joint_covariance: (3 + 2 L, 3 + 2 L) of the pose then and
    these.
    """

    time_s: float
    landmark_id: NDArray[np.int64]
    landmark: Array
    joint_covariance: Array


@dataclass(frozen=True, kw_only=True)
class FilterRun:
    """What a filter knew: at the beginning of each step, all that was seen until then fused.

    time_s: (N + 1,), the last is the end's. pose: (N + 1, 3). covariance: (N + 1, 3, 3).
    before, before_covariance: the same without what was seen at that very instant. map: at an
    instant that was asked for.
    """

    log: Log
    timeline: Timeline
    noise: StepNoise
    time_s: Array
    pose: Array
    covariance: Array
    before: Array
    before_covariance: Array
    map: KnownMap

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Return poses (K, 3) and covariances (K, 3, 3) at times (K,), predicted from the last."""
        row = np.maximum(np.searchsorted(self.time_s, time_s, side="right") - 1, 0)
        pose, covariance = self.pose[row], self.covariance[row]
        late_s = time_s - self.time_s[row]
        for k in np.flatnonzero((late_s > 0.0) & (row < len(self.timeline.control))):
            pose[k], f, q = _part_of_step(self, int(row[k]), pose[k], float(late_s[k]))
            covariance[k] = f @ covariance[k] @ f.T + q
        return pose, covariance

    def before_updates(self) -> FilterRun:
        """Return the same run with the poses before each instant's measurements."""
        return replace(self, pose=self.before, covariance=self.before_covariance)


def _part_of_step(run: FilterRun, i: int, pose: Array, late_s: float) -> MotionStep:
    """Return the pose some time into a step, F and Q."""
    timeline = run.timeline
    control, own = timeline.control[i], timeline.control_covariance[i]
    if isinstance(run.log.odometry, RelativePoses):
        share = late_s / timeline.step_duration_s[i]
        control, own = share * control, share * own
    pose, f, b = motion_model(run.log).step(pose, control, late_s)
    return MotionStep(pose, f, b @ own @ b.T + run.noise.covariance(late_s, pose))


class _Recorder(FilterObservers):
    """Notes pose and covariance before each step and on each arrival, and the map at an instant."""

    def __init__(self, map_s: float) -> None:
        self.map_s = map_s
        self.time_s: list[float] = []
        self.pose: list[Array] = []
        self.covariance: list[Array] = []
        self.before: dict[int, tuple[Array, Array]] = {}
        self.map: tuple[float, Array, Array] | None = None

    def before_predict(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """All that was seen until this time is fused."""
        self.time_s.append(time_s)
        self.pose.append(ekf.state.pose)
        self.covariance.append(ekf.state.pose_covariance)
        if self.map is None or time_s <= self.map_s < time_s + duration_s:
            self.map = time_s, ekf.state.landmarks, np.array(ekf.state.covariance)

    def on_predict(self, ekf: Ekf) -> None:
        """Nothing of this instant is."""
        self.before[len(self.pose)] = ekf.state.pose, ekf.state.pose_covariance

    def on_end(self, ekf: Ekf, time_s: float) -> None:
        """Note the end."""
        self.map = None if time_s <= self.map_s else self.map
        self.before_predict(ekf, time_s, np.zeros(0), 0.0)

    def known_map(self, label: dict[int, int]) -> KnownMap:
        """Return the map; label: landmarks' ids by landmark index."""
        if self.map is None:
            raise ValueError("the filter has not finished")
        time_s, landmark, joint = self.map
        ids = np.array(
            [label.get(landmark_index, landmark_index) for landmark_index in range(len(landmark))],
            dtype=np.int64,
        )
        return KnownMap(time_s, ids, landmark, joint)


def run_reference(
    log: Log,
    timeline: Timeline,
    config: EkfConfig,
    positions: Positions | None = None,
    *,
    kind: type[Ekf] = Ekf,
    map_s: float = np.inf,
    started: Callable[[Ekf], FilterObserver] | None = None,
) -> FilterRun | None:
    """Run the full EKF, or a variant of it, over a log; None where it breaks down.

    config: settled, of the full filter. positions: to be fused. map_s: when the map is noted.
    started: called with the filter before it starts, which it may change; what it returns observes.
    """
    plain = build_ekf(log, config, Trace())
    ekf = kind(plain.motion, plain.association, log.prior.pose, log.prior.covariance)
    ekf.stabilisation, ekf.fixes, ekf.splitter = plain.stabilisation, plain.fixes, plain.splitter
    index_of, *known = surveyed(log)
    ekf.insert_surveyed(*known)
    recorder, label = _Recorder(map_s), dict(zip(index_of.values(), index_of, strict=True))
    watching = FilterObservers([recorder, *([] if started is None else [started(ekf)])])
    try:
        for state in run_filter_loop(ekf, log, timeline, positions, FilterAttachment(watching)):
            if state.fault is not None:
                return None
            if config.association == "known":
                names = log.measurements.landmark[state.rows].tolist()
                label |= {
                    s: n
                    for s, n in zip(state.landmark_indices.tolist(), names, strict=True)
                    if s >= 0
                }
    except (FilterDivergedError, np.linalg.LinAlgError):
        return None
    recorder.on_end(ekf, float(timeline.epoch_time_s[-1]))
    pose, covariance = np.array(recorder.pose), np.array(recorder.covariance)
    before, before_covariance = pose.copy(), covariance.copy()
    for row, (at, spread) in recorder.before.items():
        before[row], before_covariance[row] = at, spread
    if not (np.isfinite(ekf.state.mean).all() and np.isfinite(ekf.state.covariance).all()):
        return None
    return FilterRun(
        log=log,
        timeline=timeline,
        noise=ekf.stabilisation,
        time_s=np.array(recorder.time_s),
        pose=pose,
        covariance=covariance,
        before=before,
        before_covariance=before_covariance,
        map=recorder.known_map(label),
    )
