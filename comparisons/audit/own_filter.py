"""A run of the reference EKF as the events of an audit.

Blocks are `pose`, `landmark 17` by the estimate's ids, and `scan landmark 3` by index; sensors are
`landmarks`, `scan landmarks`, `merges` and `positions`. A filter's trace keeps the order in time,
and of an instant that of each kind: landmarks are measured, then initialised, then positions are
fused, then scan landmarks measured, initialised and merged, and landmarks removed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.audit.directions import planar_directions
from comparisons.trace.events import (
    Augment,
    Blocks,
    Directions,
    Event,
    Predict,
    Prior,
    Remove,
    Snapshot,
    Update,
)
from comparisons.trace.recorder import Begun, Measured, Recorder
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import POINT, POSE, LandmarkKind
from ekf_reference.core.trace import VEHICLE as ORIGIN
from ekf_reference.core.trace import (
    MeasurementRecord,
    MeasurementRecords,
    RemovalRecord,
    StepRecord,
    Trace,
    stack_records,
)
from ekf_reference.filters.compressed import CompressedState
from ekf_reference.filters.misono import HeadingTrace

VEHICLE = "pose"
SENSORS = {POINT: "landmarks", POSE: "scan landmarks"}
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


def write_run(run: EkfRun, path: Path) -> None:
    """Write a run's trace for `slamcheck audit`.

    Args:
        run: As the filter made it.
        path: Of the trace.

    Raises:
        InputError: The file exists already, or cannot be written.
    """
    with Recorder(path) as record:
        for event in run_events(run):
            if event.time_s is not None:
                record.at(event.time_s)
            write_event(event, record)


def write_event(event: Event, record: Recorder) -> None:
    """Record an event of a run again, at the recorder's time.

    Args:
        event: As `run_events` yields it, or as it was read.
        record: A recorder that has recorded the events before.
    """
    match event:
        case Prior():
            blocks = dict(zip(event.blocks, event.dims, strict=True))
            charts = dict(zip(event.blocks, event.charts, strict=False))
            record.prior(blocks, event.covariance, point=event.point, charts=charts)
        case Directions():
            basis = dict(zip(event.names, event.basis.T, strict=True))
            record.directions(basis, event.blind, blocks=event.blocks)
        case Predict():
            points = {"point": event.point, "after": event.after}
            record.predict(event.jacobian, event.noise, event.blocks, **points)
        case Augment():
            begun: Begun = {"numbers": _needed(event.numbers), "weight": event.weight}
            begun |= {"point": _needed(event.point), "after": _needed(event.after)}
            g_x, g_z = event.jacobian, event.noise_jacobian
            record.augment(event.name, g_x, g_z, event.noise, event.blocks, **begun)
        case Update():
            more: Measured = {"point": _needed(event.point), "weight": event.weight}
            if event.correction is not None:
                more["correction"] = event.correction
            more["numbers"] = _needed(event.numbers)
            h, r = event.jacobian, event.noise
            record.update(event.sensor, event.residual, h, r, event.blocks, **more)
        case Remove():
            record.remove(*event.blocks)
        case Snapshot():
            record.snapshot(event.covariance, event.blocks, mean=event.mean)
        case _:
            raise TypeError(f"a run of the EKF has no {type(event).__name__}")


def _needed(values: Array | None) -> Array:
    """What every event of a run has."""
    if values is None:
        raise TypeError("a run's events have their points")
    return values


def watch(ekf: Ekf, run: EkfRun, take: Callable[[Event], object]) -> None:
    """Hand over what a filter does from now on, with a snapshot after each event.

    The events are those of `run_events`, with the corrections; a snapshot has the number of the
    event before it. There are none of a compressed state, which a look at it would change.

    Args:
        ekf: At its prior, the last that is done to it.
        run: What the same filter has done before.
        take: Is given the events.
    """
    if isinstance(ekf.state, CompressedState):
        return
    if isinstance(ekf.trace, HeadingTrace):
        inner = _Watch(ekf, ekf.trace.trace, run, take)
        ekf.trace = replace(ekf.trace, trace=inner)
    else:
        ekf.trace = _Watch(ekf, ekf.trace, run, take)


class _Watch(Trace):
    """Records what another trace does, and tells it with the state that follows."""

    def __init__(
        self, ekf: Ekf, trace: Trace, run: EkfRun, take: Callable[[Event], object]
    ) -> None:
        self._ekf, self._trace, self._take = ekf, trace, take
        self._size, self._made = len(run.trace.prior_pose), 0
        self._events = _Events(run)
        for event in self._events.begin():
            take(event)
        self._mean = np.zeros(0)
        self._snapshot()

    def step(self, step: StepRecord) -> None:
        """A prediction."""
        self._trace.step(step)
        self._made += 1
        self._done(self._events.predict(self._made, step))

    def measurement(self, used: MeasurementRecord) -> None:
        """An update."""
        self._trace.measurement(used)
        size = self._size if used.origin == ORIGIN else POSE.width
        rows = stack_records([(self._made, used)], size, used.kind)
        before = self._mean
        event = self._events.update(used.kind, rows)
        self._done(event._replace(correction=self._state()[2] - before))

    def initialisation(self, new: MeasurementRecord) -> None:
        """New landmarks, each in its place among all that are there."""
        self._trace.initialisation(new)
        kind = new.kind or POINT
        rows = stack_records([(self._made, new)], self._size, kind)
        for event in self._events.initialise(kind, rows):
            self._done(event)

    def removal(self, gone: RemovalRecord) -> None:
        """Landmarks that leave."""
        self._trace.removal(gone)
        for landmark_index in gone.landmark_index.tolist()[:-1]:
            self._take(self._events.remove(gone.kind, landmark_index))
        self._done(self._events.remove(gone.kind, int(gone.landmark_index[-1])))

    def _done(self, event: Event) -> None:
        self._take(event)
        self._snapshot(event.name if isinstance(event, Augment) else "")

    def _snapshot(self, last: str = "") -> None:
        """Tell the state, or its part up to a block."""
        names, dims, self._mean, covariance = self._state()
        count = names.index(last) + 1 if last else len(names)
        n = sum(dims[:count])
        blocks = tuple(names[:count])
        self._take(Snapshot(*self._events.now, blocks, covariance[:n, :n], self._mean[:n], None))

    def _state(self) -> tuple[list[str], list[int], Array, Array]:
        """Return names and dimensions of blocks, mean and covariance, in the trace's numbers."""
        state, (pose, own, jacobian) = self._ekf.state, self._ekf.read_pose()
        if self._size == len(own):
            pose, jacobian = own, np.eye(len(own))
        p, mean, covariance = len(own), state.mean, np.array(state.covariance)
        if len(pose) != p:
            cross = jacobian @ covariance[:p]
            covariance = np.block(
                [[cross[:, :p] @ jacobian.T, cross[:, p:]], [cross[:, p:].T, covariance[p:, p:]]]
            )
        found = sorted(
            (int(state.layout.first[kind][i]), kind.width, self._events.name(kind, i))
            for kind in SENSORS
            for i in state.layout.present(kind).tolist()
        )
        names, dims = [VEHICLE, *(one[2] for one in found)], [len(pose), *(one[1] for one in found)]
        return names, dims, np.concatenate((pose, mean[p:])), covariance


class _Events:
    """The events of a run, numbered as they are made. now: number and time of the last one."""

    def __init__(self, run: EkfRun) -> None:
        self._run, self._number = run, -1
        self._until = run.timeline.steps_until()
        self._time_s = float(run.estimate.time_s[0])

    @property
    def now(self) -> tuple[int, float]:
        return self._number, self._time_s

    def all(self) -> Iterator[Event]:
        """Yield all events."""
        trace = self._run.trace
        yield from self.begin()
        fused = {kind: _fused(one) for kind, one in trace.measurements.items()}
        fixes, merges = _fused(trace.positions), _by_step(trace.merges.step)
        initialised = {kind: _by_step(one.step) for kind, one in trace.initialisations.items()}
        gone = _by_step(trace.removals.step)
        for step in range(len(trace.f) + 1):
            if step:
                made = trace.departed, trace.arrived, trace.f, trace.q
                yield self.predict(step, StepRecord(*(column[step - 1] for column in made)))
            for kind in SENSORS:
                new, seen = initialised[kind].get(step, []), fused[kind].get(step, [])
                yield from self._landmarks(kind, new, seen)
                if kind == POINT:
                    for begin, end in fixes.get(step, []):
                        yield self.update(None, trace.positions.rows(np.arange(begin, end)))
            for row in merges.get(step, []):
                yield self.update(POSE, trace.merges.rows(np.array([row])))
            for row in gone.get(step, []):
                yield self.remove(trace.removals.kind[row], int(trace.removals.landmark_index[row]))
        yield self._snapshot()

    def begin(self) -> Iterator[Event]:
        """Yield the prior, and the directions."""
        trace = self._run.trace
        p = trace.prior_pose
        charts = ("se2",) if len(p) == _PLANAR else ()
        yield Prior(*self._next(), (VEHICLE,), (len(p),), trace.prior_covariance, p, charts)
        if not (trace.initialisations[POINT].number < 0).any():
            basis = np.column_stack(tuple(_directions(p).values()))
            blind = (*SENSORS.values(), MERGES)
            yield Directions(*self._next(), (VEHICLE,), basis, tuple(_directions(p)), blind)

    def predict(self, step: int, made: StepRecord) -> Predict:
        """Return a prediction; what follows is at the epoch that it is on the way to."""
        run = self._run
        self._time_s = float(run.timeline.step_end_s[step - 1])
        now, (departed, arrived, f, q) = self._next(), made
        epoch = min(int(np.searchsorted(self._until, step)), len(run.estimate.time_s) - 1)
        self._time_s = float(run.estimate.time_s[epoch])
        return Predict(*now, (VEHICLE,), f, q, departed, arrived)

    def initialise(self, kind: LandmarkKind, new: MeasurementRecords) -> Iterator[Augment]:
        """Yield an augmentation for each row."""
        for row, landmark_index in enumerate(new.landmark_index.tolist()):
            name = self.name(kind, landmark_index)
            matrices = new.jacobian_pose[row], new.jacobian_other[row], new.noise[row]
            points = new.pose[row], new.landmark[row], new.number[row : row + 1].astype(float)
            weight = float(new.weight[row])
            yield Augment(*self._next(), name, (VEHICLE,), *matrices, *points, weight)

    def update(self, kind: LandmarkKind | None, rows: MeasurementRecords) -> Update:
        """Return what the rows were fused as. kind: None for positions."""
        point: Array
        blocks: Blocks = (VEHICLE,)
        names: list[str] = []
        if kind is None:
            sensor = POSITIONS
        elif rows.origin[0] != ORIGIN:
            origin, names = int(rows.origin[0]), [self.name(kind, int(rows.landmark_index[0]))]
            sensor, blocks = MERGES, (self.name(kind, origin), *names)
        else:
            names = [self.name(kind, i) for i in rows.landmark_index.tolist()]
            sensor, blocks = SENSORS[kind], tuple(dict.fromkeys((VEHICLE, *names)))
        m, r, p = rows.jacobian_pose.shape
        width = rows.jacobian_other.shape[2]
        h = np.zeros((m * r, p + width * (len(blocks) - 1)))
        point = np.zeros(h.shape[1])
        h[:, :p], point[:p] = rows.jacobian_pose.reshape(m * r, p), rows.pose[0]
        for i, name in enumerate(names):
            at = p + width * (blocks.index(name) - 1)
            h[r * i : r * (i + 1), at : at + width] = rows.jacobian_other[i]
            point[at : at + width] = rows.landmark[i]
        return Update(
            *(*self._next(), sensor, blocks, rows.innovation.ravel(), h, _diagonal(rows.noise)),
            used=True,
            correction=None,
            gain=None,
            point=point,
            numbers=rows.number.astype(float),
            weight=float(rows.weight[0]),
        )

    def remove(self, kind: LandmarkKind, landmark_index: int) -> Remove:
        """Return the removal of a landmark."""
        return Remove(*self._next(), (self.name(kind, landmark_index),))

    def name(self, kind: LandmarkKind, landmark_index: int) -> str:
        """Return the block of a landmark."""
        if kind == POINT:
            return f"landmark {self._run.estimate.landmark_id[landmark_index]}"
        return f"scan landmark {landmark_index}"

    def _next(self) -> tuple[int, float]:
        self._number += 1
        return self.now

    def _landmarks(
        self, kind: LandmarkKind, initialised: list[int], fused: list[tuple[int, int]]
    ) -> Iterator[Event]:
        """Yield what is measured and initialised at one step, in this order where it can be."""
        new, seen = self._run.trace.initialisations[kind], self._run.trace.measurements[kind]
        first = new.rows(np.array(initialised, dtype=np.intp))
        again = []
        for begin, end in fused:
            rows = seen.rows(np.arange(begin, end))
            if np.isin(rows.landmark_index, first.landmark_index).any():
                again.append(rows)
            else:
                yield self.update(kind, rows)
        yield from self.initialise(kind, first)
        for rows in again:
            yield self.update(kind, rows)

    def _snapshot(self) -> Snapshot:
        run, e = self._run, self._run.estimate
        names = [self.name(POINT, i) for i in range(len(e.landmark))]
        names += [self.name(POSE, i) for i in e.pose_landmark_id.tolist()]
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
