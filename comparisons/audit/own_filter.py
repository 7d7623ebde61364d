"""A run of the reference EKF as the events of an audit.

Blocks are `pose`, `landmark 17` by the estimate's ids, and `scan landmark 3` by index; sensors are
`measurements`, `scan landmarks`, `merges` and `positions`. A filter's trace keeps the order in
time, and of an instant that of each kind: landmarks are initialised, then measured, then positions
are fused, then scan landmarks initialised, measured and merged, and landmarks removed. A landmark
is initialised after the others are measured in truth; the linear problem is the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.audit.directions import planar_directions
from comparisons.audit.spurious import VEHICLE
from comparisons.trace.events import (
    Augment,
    Directions,
    Event,
    Predict,
    Prior,
    Remove,
    Snapshot,
    Update,
)
from ekf_reference.core.landmark_types import POINT, POSE, LandmarkKind
from ekf_reference.core.trace import MeasurementRecords

SENSORS = {POINT: "measurements", POSE: "scan landmarks"}
POSITIONS, MERGES = "positions", "merges"
_PLANAR = 3


def run_events(run: EkfRun) -> Iterator[Event]:
    """Yield the events of a run, with a snapshot of the last covariance.

    The directions of planar SLAM follow the prior, unless landmarks are surveyed. A pose of four
    entries is not in the snapshot, for a run keeps its covariance as x, y and heading alone.

    Args:
        run: As the filter made it.

    Yields:
        The events, numbered from 0.
    """
    return _Events(run).all()


class _Events:
    def __init__(self, run: EkfRun) -> None:
        self._run, self._number = run, -1
        self._points = _distinct(run.estimate.landmark_id)
        self._time_s: float | None = None

    def all(self) -> Iterator[Event]:
        """Yield all events."""
        run, trace = self._run, self._run.trace
        time_s = run.estimate.time_s
        until = run.timeline.steps_until()
        self._time_s = float(time_s[0])
        p = trace.prior_pose
        charts = ("se2",) if len(p) == _PLANAR else ()
        yield Prior(*self._next(), (VEHICLE,), (len(p),), trace.prior_covariance, p, charts)
        if not (trace.initialisations[POINT].number < 0).any():
            basis = np.column_stack(tuple(_directions(p).values()))
            blind = (*SENSORS.values(), MERGES)
            yield Directions(*self._next(), (VEHICLE,), basis, tuple(_directions(p)), blind)
        seen, seen_poses = (_fused(trace.measurements[kind]) for kind in SENSORS)
        fixes, merges = _fused(trace.positions), _by_step(trace.merges.step)
        new, new_poses = (_by_step(trace.initialisations[kind].step) for kind in SENSORS)
        gone = _by_step(trace.removals.step)
        made = zip(trace.f, trace.q, trace.departed, trace.arrived, strict=True)
        ends_s = run.timeline.step_end_s.tolist()
        epoch = np.minimum(np.searchsorted(until, np.arange(len(ends_s) + 1)), len(time_s) - 1)
        for step, stands_s in enumerate(time_s[epoch].tolist()):
            if step:
                self._time_s = ends_s[step - 1]
                yield Predict(*self._next(), (VEHICLE,), *next(made))
                self._time_s = stands_s
            yield from self._landmarks(POINT, new.get(step, []), seen.get(step, []))
            for begin, end in fixes.get(step, []):
                yield self._position(begin, end)
            yield from self._landmarks(POSE, new_poses.get(step, []), seen_poses.get(step, []))
            for row in merges.get(step, []):
                yield self._merge(row)
            for row in gone.get(step, []):
                i = int(trace.removals.landmark_index[row])
                yield Remove(*self._next(), (self._name(trace.removals.kind[row], i),))
        yield self._snapshot()

    def _next(self) -> tuple[int, float | None]:
        self._number += 1
        return self._number, self._time_s

    def _name(self, kind: LandmarkKind, landmark_index: int) -> str:
        if kind == POINT:
            return self._points[landmark_index]
        return f"scan landmark {landmark_index}"

    def _landmarks(
        self, kind: LandmarkKind, initialised: list[int], fused: list[tuple[int, int]]
    ) -> Iterator[Event]:
        """Yield what is initialised and measured at one step."""
        if not initialised and not fused:
            return
        new, seen = self._run.trace.initialisations[kind], self._run.trace.measurements[kind]
        width = kind.width
        for row in initialised:
            name = self._name(kind, int(new.landmark_index[row]))
            matrices = new.jacobian_pose[row], new.jacobian_other[row], new.noise[row]
            points = new.pose[row], new.landmark[row], new.number[row : row + 1].astype(float)
            weight = float(new.weight[row])
            yield Augment(*self._next(), name, (VEHICLE,), *matrices, *points, weight)
        for begin, end in fused:
            names = [self._name(kind, i) for i in seen.landmark_index[begin:end].tolist()]
            blocks = tuple(dict.fromkeys((VEHICLE, *names)))
            p, m = seen.jacobian_pose.shape[2], width * (end - begin)
            h = np.zeros((m, p + width * (len(blocks) - 1)))
            point = np.zeros(h.shape[1])
            point[:p] = seen.pose[begin]
            h[:, :p] = seen.jacobian_pose[begin:end].reshape(m, p)
            for i, name in enumerate(names):
                at = p + width * (blocks.index(name) - 1)
                h[width * i : width * (i + 1), at : at + width] = seen.jacobian_other[begin + i]
                point[at : at + width] = seen.landmark[begin + i]
            yield self._update(SENSORS[kind], blocks, h, point, (seen, slice(begin, end)))

    def _position(self, begin: int, end: int) -> Update:
        r = self._run.trace.positions
        h = np.concatenate(r.jacobian_pose[begin:end])
        return self._update(POSITIONS, (VEHICLE,), h, r.pose[begin], (r, slice(begin, end)))

    def _merge(self, row: int) -> Update:
        r = self._run.trace.merges
        blocks = self._name(POSE, int(r.origin[row])), self._name(POSE, int(r.landmark_index[row]))
        h = np.hstack((r.jacobian_pose[row], r.jacobian_other[row]))
        point = np.concatenate((r.pose[row], r.landmark[row]))
        return self._update(MERGES, blocks, h, point, (r, slice(row, row + 1)))

    def _update(
        self,
        sensor: str,
        blocks: tuple[str, ...],
        h: Array,
        point: Array,
        rows: tuple[MeasurementRecords, slice],
    ) -> Update:
        records, at = rows
        residual, noise = records.innovation[at].ravel(), _diagonal(records.noise[at])
        numbers, weight = records.number[at].astype(float), float(records.weight[at.start])
        return Update(
            *(*self._next(), sensor, blocks, residual, h, noise),
            used=True,
            correction=None,
            gain=None,
            point=point,
            numbers=numbers,
            weight=weight,
        )

    def _snapshot(self) -> Snapshot:
        run, e = self._run, self._run.estimate
        names = [self._name(POINT, i) for i in range(len(e.landmark))]
        names += [self._name(POSE, i) for i in e.pose_landmark_id.tolist()]
        p = e.joint_covariance
        if len(run.trace.prior_pose) == _PLANAR:
            return Snapshot(*self._next(), (VEHICLE, *names), p, None, None)
        return Snapshot(*self._next(), tuple(names), p[_PLANAR:, _PLANAR:], None, None)


def _directions(pose: Array) -> dict[str, Array]:
    """Of the first pose alone, about itself."""
    planar = planar_directions(pose[:_PLANAR])
    if len(pose) == _PLANAR:
        return planar
    from ekf_reference.filters.misono import along_circle

    along = along_circle(pose)
    return {name: along @ column for name, column in planar.items()}


def _distinct(landmark_id: Index) -> list[str]:
    """Names of points; of one that was initialised again, with how often."""
    seen: Counter[int] = Counter()
    names = []
    for one in landmark_id.tolist():
        seen[one] += 1
        names.append(f"landmark {one}" + (f" ({seen[one]})" if seen[one] > 1 else ""))
    return names


def _by_step(step: Index) -> dict[int, list[int]]:
    """Rows by the steps made before them, in order."""
    found: dict[int, list[int]] = {}
    for row, at in enumerate(step.tolist()):
        found.setdefault(at, []).append(row)
    return found


def _fused(r: MeasurementRecords) -> dict[int, list[tuple[int, int]]]:
    """Return, by step, begin and end of the rows that were fused together.

    They share a pose and a weight, and their numbers ascend.
    """
    count = len(r.step)
    found: dict[int, list[tuple[int, int]]] = {}
    if not count:
        return found
    new = np.ones(count, dtype=bool)
    new[1:] = (
        (r.step[1:] != r.step[:-1])
        | (r.pose[1:] != r.pose[:-1]).any(axis=1)
        | (r.weight[1:] != r.weight[:-1])
        | (r.number[1:] <= r.number[:-1])
    )
    begins = np.flatnonzero(new)
    for begin, end in zip(begins.tolist(), [*begins[1:].tolist(), count], strict=True):
        found.setdefault(int(r.step[begin]), []).append((begin, end))
    return found


def _diagonal(blocks: Array) -> Array:
    """Return (m r, m r) with blocks (m, r, r) on its diagonal."""
    m, r = blocks.shape[:2]
    whole = np.zeros((m, r, m, r))
    at = np.arange(m)
    whole[at, :, at] = blocks
    return whole.reshape(m * r, m * r)
