"""A run of the reference EKF as the events of an audit.

Blocks are `pose`, `landmark 17` by the estimate's ids, and `scan landmark 3` by index; sensors are
`measurements`, `scan landmarks`, `merges` and `positions`. Events stand in the order in which the
filter did them.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.audit.directions import planar_directions
from comparisons.audit.replay import LongFormReplay, Replay, ShortFormReplay
from comparisons.audit.spurious import VEHICLE
from comparisons.logs.log import Log
from comparisons.trace.events import (
    Augment,
    Blocks,
    Directions,
    Event,
    Predict,
    Remove,
    Snapshot,
    TracePrior,
    Update,
)
from comparisons.trace.recorder import Recorder
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.core.landmark_types import POINT, POSE, LandmarkKind
from ekf_reference.core.trace import VEHICLE as ORIGIN
from ekf_reference.core.trace import (
    MeasurementRecord,
    MeasurementRecords,
    PlacedRecord,
    RemovalRecord,
    RemovalRecords,
    StepRecord,
    Trace,
    TraceArrays,
    stack_records,
)
from ekf_reference.filters.compressed import CompressedState
from ekf_reference.models.range_bearing import RangeBearing

SENSORS = {POINT: "measurements", POSE: "scan landmarks"}
POSITIONS, MERGES = "positions", "merges"
_PLANAR = 3
_NEARER = 0.5
"""So much nearer to the mean after an update its last iterate is than to the one before."""


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
    """Write a run's trace for `slamcheck audit`, in a folder that is synced as a whole.

    Args:
        run: As the filter made it.
        path: Of the trace.

    Raises:
        InputError: The file exists already, or cannot be written.
    """
    components = {name: sensor.components for name, sensor in run.sensors.items()}
    with Recorder(path, components=components, synced=False) as record:
        for event in run_events(run):
            record.event(event)


def sound_recursion(run: EkfRun) -> tuple[Array, Array] | None:
    """Return what a sound filter of double precision comes to with the matrices of a run.

    It has the short form of the covariance. Two others, of Joseph's form, follow its corrections:
    what they hold for the error of its estimate is rounding.

    Args:
        run: As the filter made it.

    Returns:
        The last covariance (n, n) and errors (2, n) of the estimate; None where the run has no
        snapshot of a whole pose.
    """
    last: Event | None = None
    for event in run_events(run):
        if isinstance(event, TracePrior):
            short, others = ShortFormReplay(event), (Replay(event), LongFormReplay(event))
        fused, last = short.apply(event), event
        if isinstance(event, Update) and fused is not None:
            event = event._replace(correction=fused.applied)
        for replay in others:
            replay.apply(event)
    if not isinstance(last, Snapshot) or len(last.covariance) < len(run.estimate.joint_mean):
        return None
    at = short.layout.columns(last.blocks)
    return short.covariance[at][:, at], np.array([replay.mean[at] for replay in others])


def residuals_at_points(run: EkfRun) -> Array:
    """Return the residuals of measurements of points, z - h(point), at the points of H.

    An iterated update records residual = z - h(point) - H (mean - point), with the last iterate as
    its point, so that its correction is gain times residual. It is known by its point, which is
    nearer to the mean after the update than to the one before it.

    Args:
        run: As the filter made it.

    Returns:
        (M, 2), a row for each record: those of other updates as they were recorded.
    """
    used = run.trace.measurements[POINT]
    residual, entries, before = used.innovation.copy(), used.entries > 0.0, np.zeros(0)
    for event, rows, mean, replay in _means(run):
        if isinstance(event, Update) and event.sensor.endswith(SENSORS[POINT]):
            at, point = replay.layout.columns(event.blocks), np.asarray(event.point)
            off, left = before[at] - point, mean[at] - point
            if np.abs(left).max() < _NEARER * np.abs(off).max():
                shift = np.zeros(entries[rows].shape)
                shift[entries[rows]] = event.jacobian @ off
                residual[rows] += shift
        before = mean
    return residual


def distances_of(run: EkfRun, log: Log) -> tuple[Array, Array]:
    """Return the normalised innovations squared of a log's measurements, used or not.

    Args:
        run: As the filter made it, with the log's labels.
        log: Whose measurements they are.

    Returns:
        (M,) by the state before the updates of each instant, and (M,) by that before its own turn;
        NaN of what the filter has not mapped by then.
    """
    index, epoch = run.landmark_index, run.timeline.measurement_epoch
    label = log.measurements.landmark[: len(index)]
    name_of = {int(label[k]): int(index[k]) for k in np.flatnonzero(index >= 0)}
    step = run.timeline.steps_until()[epoch]
    events, made = _Events(run), 0
    before, alone = np.full(len(index), np.nan), np.full(len(index), np.nan)
    for event, _, mean, replay in _means(run):
        at_turn = not isinstance(event, TracePrior | Predict)
        if isinstance(event, Predict):
            made += 1
        rows = np.flatnonzero(step == made)
        if at_turn and isinstance(event, Update | Augment) and event.numbers is not None:
            rows = rows[rows > event.numbers.max()]
        for row in rows.tolist():
            block = events.name(POINT, name_of[int(label[row])]) if label[row] in name_of else ""
            if block in replay.layout.dims:
                alone[row] = _distance(log, row, mean, replay, block)
                if not at_turn:
                    before[row] = alone[row]
    return before, alone


def _distance(log: Log, row: int, mean: Array, replay: Replay, block: str) -> float:
    """Return the normalised innovation squared of a measurement of a point."""
    measurements, at = log.measurements, replay.layout.columns((VEHICLE, block))
    x, p = mean[at], replay.covariance[at][:, at]
    z, by_pose, by_point = RangeBearing().predict(x[:_PLANAR], x[None, _PLANAR:])
    h = np.hstack((by_pose[0], by_point[0]))
    off = np.array([measurements.range_m[row], measurements.bearing_rad[row]]) - z[0]
    off[1] = wrap_angle(off[1])
    r = np.diag((measurements.sigma_range_m[row], measurements.sigma_bearing_rad[row])) ** 2
    return float(off @ np.linalg.solve(h @ p @ h.T + r, off))


def _means(run: EkfRun) -> Iterator[tuple[Event, slice, Array, Replay]]:
    """Yield each event with its rows, if it is an update, and the mean and covariance after it."""
    events, mean = _Events(run), run.trace.prior_pose.copy()
    replay: Replay
    for event in events.all():
        if isinstance(event, TracePrior):
            replay = Replay(event)
            yield event, events.rows, mean, replay
            continue
        if isinstance(event, Predict | Augment):
            mean = _moved(mean, event)
        fused = replay.apply(event)
        if fused is not None:
            mean = mean + fused.applied
        yield event, events.rows, mean, replay


def _moved(mean: Array, event: Predict | Augment) -> Array:
    """Return a mean (n,) after a prediction of the pose, or with a new landmark behind it."""
    if event.point is None or event.after is None:
        raise ValueError("an event without its points")
    off = event.jacobian @ (mean[: len(event.point)] - event.point)
    if isinstance(event, Augment):
        return np.concatenate((mean, event.after + off))
    return np.concatenate((event.after + off, mean[len(off) :]))


def watch(ekf: Ekf, run: EkfRun, take: Callable[[Event], object]) -> None:
    """Hand over what a filter does from now on, with a snapshot after each event.

    The events are those of `run_events`, with the corrections; a snapshot has the number of the
    event before it. There are none of a compressed state, which a look at it would change.

    Args:
        ekf: At its prior, the last that is done to it.
        run: What the same filter has done before.
        take: Is given the events.
    """
    from ekf_reference.filters.misono import HeadingTrace

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
        rows = stack_records([PlacedRecord(self._made, 0, used)], size, used.kind)
        before = self._mean
        event = self._events.update(used.kind, rows, 0, len(rows.step))
        self._done(event._replace(correction=self._state()[2] - before))

    def initialisation(self, new: MeasurementRecord) -> None:
        """New landmarks, each in its place among all that are there."""
        self._trace.initialisation(new)
        kind = new.kind or POINT
        rows = stack_records([PlacedRecord(self._made, 0, new)], self._size, kind)
        for event in self._events.initialise(kind, rows, range(len(rows.step))):
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
    """The events of a run, numbered as they are made.

    now: number and time of the last one. rows: of the records that the last update was of.
    """

    def __init__(self, run: EkfRun) -> None:
        self._run, self._number = run, -1
        self._points = _distinct(run.estimate.landmark_id)
        time_s, self._step_end_s = run.estimate.time_s, run.timeline.step_end_s.tolist()
        made = np.arange(len(self._step_end_s) + 1)
        epoch = np.minimum(np.searchsorted(run.timeline.steps_until(), made), len(time_s) - 1)
        self._stands_s = time_s[epoch].tolist()
        self._time_s = float(time_s[0])
        self.rows = slice(0, 0)
        self._entries: dict[LandmarkKind | None, Array] = run.single_entries

    @property
    def now(self) -> tuple[int, float]:
        return self._number, self._time_s

    def all(self) -> Iterator[Event]:
        """Yield all events, in the order in which the filter did them."""
        trace, uses = self._run.trace, _uses(self._run.trace)
        yield from self.begin()
        steps = zip(trace.departed, trace.arrived, trace.f, trace.q, strict=True)
        for made in range(len(trace.f) + 1):
            if made:
                yield self.predict(made, StepRecord(*next(steps)))
            for use in uses.get(made, ()):
                yield from self._events_of(use)
        yield self._snapshot()

    def _events_of(self, use: _Use) -> Iterator[Event]:
        """Yield what the filter did with records that it used together."""
        records, kind = use.records, use.kind
        if isinstance(records, RemovalRecords):
            for row in use.rows:
                yield self.remove(records.kind[row], int(records.landmark_index[row]))
        elif use.initialises and kind is not None:
            yield from self.initialise(kind, records, use.rows)
        else:
            yield self.update(kind, records, use.rows.start, use.rows.stop)

    def begin(self) -> Iterator[Event]:
        """Yield the prior, and the directions."""
        trace = self._run.trace
        p = trace.prior_pose
        charts = ("se2",) if len(p) == _PLANAR else ()
        yield TracePrior(*self._next(), (VEHICLE,), (len(p),), trace.prior_covariance, p, charts)
        if not (trace.initialisations[POINT].number < 0).any():
            basis = np.column_stack(tuple(_directions(p).values()))
            blind = (*SENSORS.values(), MERGES)
            yield Directions(*self._next(), (VEHICLE,), basis, tuple(_directions(p)), blind)

    def predict(self, step: int, made: StepRecord) -> Predict:
        """Return a prediction; what follows is at the epoch that it is on the way to."""
        self._time_s = self._step_end_s[step - 1]
        now, (departed, arrived, f, q) = self._next(), made
        self._time_s = self._stands_s[step]
        return Predict(*now, (VEHICLE,), f, q, departed, arrived)

    def initialise(
        self, kind: LandmarkKind, new: MeasurementRecords, rows: Iterable[int]
    ) -> Iterator[Augment]:
        """Yield an augmentation for each of some rows."""
        for row in rows:
            name = self.name(kind, int(new.landmark_index[row]))
            matrices = new.jacobian_pose[row], new.jacobian_other[row], new.noise[row]
            points = new.pose[row], new.landmark[row], new.number[row : row + 1].astype(float)
            weight = float(new.weight[row])
            yield Augment(*self._next(), name, (VEHICLE,), *matrices, *points, weight)

    def update(
        self, kind: LandmarkKind | None, used: MeasurementRecords, begin: int, end: int
    ) -> Update:
        """Return what rows from begin to end were fused as. kind: None for positions."""
        at, origin = slice(begin, end), int(used.origin[begin])
        self.rows = at
        index = used.landmark_index[at].tolist()
        names = [] if kind is None else [self.name(kind, i) for i in index]
        first, sensor = VEHICLE, POSITIONS if kind is None else SENSORS[kind]
        if kind is not None and origin != ORIGIN:
            first, sensor = self.name(kind, origin), MERGES
        blocks: Blocks = tuple(dict.fromkeys((first, *names)))
        _, r, p = used.jacobian_pose.shape
        width, m = used.jacobian_other.shape[2], r * (end - begin)
        h = np.zeros((m, p + width * (len(blocks) - 1)))
        point = np.zeros(h.shape[1])
        h[:, :p], point[:p] = used.jacobian_pose[at].reshape(m, p), used.pose[begin]
        for i, name in enumerate(names):
            to = p + width * (blocks.index(name) - 1)
            h[r * i : r * (i + 1), to : to + width] = used.jacobian_other[begin + i]
            point[to : to + width] = used.landmark[begin + i]
        residual, noise = used.innovation[at].ravel(), _diagonal(used.noise[at])
        numbers = used.number[at].astype(float)
        if (rows := self._single(kind, at)) is not None:
            entries = np.unique(rows % r)
            sensor = self._run.sensor_of(sensor, int(entries[0])) if len(entries) == 1 else sensor
            residual, h, noise = residual[rows], h[rows], noise[np.ix_(rows, rows)]
            numbers = np.repeat(numbers, r)[rows]
        return Update(
            *(*self._next(), sensor, blocks, residual, h, noise),
            used=True,
            correction=None,
            gain=None,
            point=point,
            numbers=numbers,
            weight=float(used.weight[begin]),
        )

    def _single(self, kind: LandmarkKind | None, at: slice) -> Index | None:
        """Return the entries that were used of some rows' measurements; None where all were."""
        entries = self._entries.get(kind)
        return None if entries is None or entries[at].all() else np.flatnonzero(entries[at].ravel())

    def remove(self, kind: LandmarkKind, landmark_index: int) -> Remove:
        """Return the removal of a landmark."""
        return Remove(*self._next(), (self.name(kind, landmark_index),))

    def name(self, kind: LandmarkKind, landmark_index: int) -> str:
        """Return the block of a landmark."""
        if kind == POINT:
            return self._points[landmark_index]
        return f"scan landmark {landmark_index}"

    def _next(self) -> tuple[int, float]:
        self._number += 1
        return self.now

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


def _distinct(landmark_id: Index) -> list[str]:
    """Names of points; of one that was initialised again, with how often."""
    seen: Counter[int] = Counter()
    names = []
    for one in landmark_id.tolist():
        seen[one] += 1
        names.append(f"landmark {one}" + (f" ({seen[one]})" if seen[one] > 1 else ""))
    return names


class _Use(NamedTuple):
    """Rows of records that the filter used together. initialises: they are of new landmarks."""

    order: int
    kind: LandmarkKind | None
    records: MeasurementRecords | RemovalRecords
    rows: range
    initialises: bool


def _uses(trace: TraceArrays) -> dict[int, list[_Use]]:
    """Return what was used by the number of steps made before it, in order."""
    tables: list[tuple[LandmarkKind | None, MeasurementRecords | RemovalRecords, bool]] = [
        (None, trace.positions, False),
        (POSE, trace.merges, False),
        (None, trace.removals, False),
        *((kind, records, False) for kind, records in trace.measurements.items()),
        *((kind, records, True) for kind, records in trace.initialisations.items()),
    ]
    uses: defaultdict[int, list[_Use]] = defaultdict(list)
    for kind, records, initialises in tables:
        order, step = records.order.tolist(), records.step.tolist()
        begins = np.flatnonzero(np.diff(records.order, prepend=-1)).tolist()
        for begin, end in pairwise((*begins, len(order))):
            use = _Use(order[begin], kind, records, range(begin, end), initialises)
            uses[step[begin]].append(use)
    for together in uses.values():
        together.sort(key=attrgetter("order"))
    return uses


def _diagonal(blocks: Array) -> Array:
    """Return (m r, m r) with blocks (m, r, r) on its diagonal."""
    m, r = blocks.shape[:2]
    whole = np.zeros((m, r, m, r))
    at = np.arange(m)
    whole[at, :, at] = blocks
    return whole.reshape(m * r, m * r)
