"""A planar filter's trace on disk as that of the reference filter would be, for its gaps.

Read for `check`, from what `slamcheck.Recorder` wrote. A planar filter has x, y and heading, and
points, each a block of its own. A prediction moves the pose alone; copies of it (clones) are the
pose of their instant. What is fused together is one update: two rows for each measurement, or any
of its entries where each row has a number.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.errors import InputError, outdated_format, quoted
from comparisons.estimates.landmark_names import LandmarkNames
from comparisons.logs.validation import LARGEST_ID
from comparisons.rounding import stored_rounding
from comparisons.trace import events
from comparisons.trace.reader import TraceReader
from ekf_reference.core.landmark_types import POINT, POSE, LandmarkKind
from ekf_reference.core.trace import (
    MeasurementRecord,
    MeasurementRecords,
    PlacedRecord,
    StepRecord,
    TraceArrays,
    removal_records,
    stack_records,
    stack_steps,
)

TRACE, OUTDATED_TRACE = "filter.trace", "trace.npz"
"""In an estimate folder; the latter is refused."""
_POSE, _POINT = POSE.width, POINT.width
_LEAST_WEIGHT = 1e-9
"""Of a part of a measurement that is fused; one that begins a landmark may have none."""
OF_STEPS = ("prior_pose", "prior_covariance", "departed", "arrived", "f", "q")
OF_RECORDS = ("pose", "landmark", "innovation", "jacobian_pose", "jacobian_other", "noise")
"""What a planar filter computes, of its trace and of each of its records."""
_NOT_OF_ONE = "has a measurement that is not of one landmark"
_CORRELATED = "has noise that is correlated between measurements"


@dataclass(frozen=True, kw_only=True)
class TraceFile:
    """A filter's trace with the time (N,) at which each step ends, and where it was read.

    Landmark indices are those of blocks, the landmarks' names in the file, and once they are
    `placed`, when there are no blocks, places in the estimate's list of landmarks. Headings are
    unwrapped along the trace; `spread` and `whitened` are zero, for no gap needs them. rounding:
    what storing has done to the numbers, relative to them: 2^-24 where all are of single precision,
    else nothing.
    remarks: on the file. unsound: which noise, or prior, is no covariance, in words. removed: which
    blocks the filter has removed; once placed, their landmarks have the places behind the
    estimate's list, and the numbers removed_id.
    """

    path: Path
    step_time_s: Array
    trace: TraceArrays
    remarks: tuple[str, ...]
    unsound: str = ""
    rounding: float = 0.0
    blocks: tuple[str, ...] = ()
    removed: tuple[int, ...] = ()
    removed_id: tuple[int, ...] = ()

    @property
    def measurements_used(self) -> int:
        """How many measurements of the log it used, each counted once."""
        uses = self.trace.measurements[POINT], self.trace.initialisations[POINT]
        number = np.concatenate([use.number for use in uses])
        return len(np.unique(number[number >= 0]))

    def placed(self, names: LandmarkNames) -> TraceFile:
        """Return the trace with the places of its blocks' landmarks in the estimate's list.

        names: of the estimate's landmarks, in their order. Raises InputError unless each of them is
        initialised once.
        """
        if not self.blocks:
            return self
        place_of = {number: place for place, number in enumerate(names.numbers)}
        held = [k for k in range(len(self.blocks)) if k not in set(self.removed)]
        numbers = names.of_blocks([self.blocks[k] for k in held])
        if None in numbers:
            block = quoted(self.blocks[held[numbers.index(None)]])
            raise InputError(
                f"{self.path}: block {block} must end in the number or label of a landmark in "
                "landmarks.csv, or be recorded as removed"
            )
        places = np.empty(len(self.blocks), dtype=np.intp)
        places[held] = [place_of[number] for number in numbers if number is not None]
        places[list(self.removed)] = len(place_of) + np.arange(len(self.removed))
        begun = places[self.trace.initialisations[POINT].landmark_index]
        times = np.bincount(begun, minlength=len(place_of))[: len(place_of)]
        if (wrong := np.flatnonzero(times != 1)).size:
            name = names.called(int(wrong[0]))
            raise InputError(
                f"{self.path}: landmark {name} is initialised {times[wrong[0]]} times, expected "
                "once"
            )
        removed_id = names.of_removed([self.blocks[k] for k in self.removed])
        trace = _at_places(self.trace, places)
        return replace(self, blocks=(), removed=(), removed_id=removed_id, trace=trace)


def _at_places(trace: TraceArrays, places: Index) -> TraceArrays:
    """A trace with places (B,) in the place of blocks' indices."""
    moved = [
        {
            **records,
            POINT: replace(records[POINT], landmark_index=places[records[POINT].landmark_index]),
        }
        for records in (trace.measurements, trace.initialisations)
    ]
    return replace(trace, measurements=moved[0], initialisations=moved[1])


def records_of(trace: TraceArrays) -> tuple[MeasurementRecords, ...]:
    """Return a planar filter's records: of measurements, of new landmarks, of positions."""
    return trace.measurements[POINT], trace.initialisations[POINT], trace.positions


def figures_of(trace: TraceArrays) -> list[Array]:
    """Return all that a planar filter computes: OF_STEPS, then OF_RECORDS of each of its records.

    Args:
        trace: Of x, y, heading and points.

    Returns:
        Arrays of any shapes.
    """
    figures = [getattr(trace, name) for name in OF_STEPS]
    return figures + [getattr(r, name) for r in records_of(trace) for name in OF_RECORDS]


def read_trace(path: Path) -> TraceFile:
    """Read a trace. Raises InputError naming the event."""
    if path.suffix == Path(OUTDATED_TRACE).suffix:
        mend = "record the filter anew with slamcheck.Recorder"
        raise outdated_format(path, "a trace in arrays", mend)
    reader = TraceReader(path)
    planar = _PlanarEvents(path)
    for event in reader:
        planar.take(event)
    trace = planar.trace()
    unsound = ""
    if faults := reader.unsound | reader.singular:  # its equations have an inverse of every R
        first, what = min(faults.items())
        others = len(faults) - 1
        unsound = f"{what} at event {first}" + (f", and so at {others:,} more" if others else "")
    return TraceFile(
        path=path,
        step_time_s=np.array(planar.step_time_s),
        trace=_tidy(trace),
        remarks=reader.remarks,
        unsound=unsound,
        rounding=stored_rounding(*figures_of(trace)),
        blocks=tuple(planar.names),
        removed=tuple(planar.removed),
    )


class _Measured(NamedTuple):
    """One measurement of an update: residual (2,), jacobian (2, n), noise (2, 2).

    landmark: which of the update's it is of.
    """

    number: float
    landmark: int
    residual: Array
    jacobian: Array
    noise: Array


class _PlanarEvents:
    """Records of the reference filter, made of events one after the other.

    step_time_s: when each step ends. names: of all blocks of landmarks that have been, by index.
    removed: indices of those that the filter has removed.
    """

    def __init__(self, path: Path) -> None:
        self.step_time_s: list[float] = []
        self.names: list[str] = []
        self.removed: list[int] = []
        self._path = path
        self._prior: events.TracePrior
        self._steps: list[StepRecord] = []
        self._updates: list[PlacedRecord[MeasurementRecord]] = []
        self._beginnings: list[PlacedRecord[MeasurementRecord]] = []
        self._positions: list[PlacedRecord[MeasurementRecord]] = []
        self._blocks: dict[str, int] = {}
        self._copies: dict[str, int] = {}  # steps made when each clone of the pose was

    def take(self, event: events.Event) -> None:
        """Add an event. Raises InputError for one that a planar filter has not."""
        match event:
            case events.TracePrior():
                self._begin(event)
            case events.Predict():
                self._predict(event)
            case events.Augment():
                self._augment(event)
            case events.Update() if not event.used:
                pass
            case events.Update() if event.blocks == self._prior.blocks:
                self._position(event)
            case events.Update():
                self._update(event)
            case events.Clone():
                self._clone(event)
            case events.Remove():
                self._remove(event)
            case events.Snapshot() | events.Directions() | events.Evaluation():
                pass
            case _:
                kind = type(event).__name__.lower()
                self._refuse(event, f"is a {kind}, which a planar filter has not")

    def trace(self) -> TraceArrays:
        """Return all records, in the order of the steps made before them. Raises InputError."""
        if not self._steps:
            raise InputError(f"{self._path}: holds no steps")
        point = self._sized(self._prior, "point", self._prior.point, _POSE)
        steps = stack_steps(self._steps, _POSE)
        none_of_poses = stack_records([], _POSE, POSE)
        return TraceArrays(
            prior_pose=point,
            prior_covariance=self._prior.covariance,
            departed=steps.departed,
            arrived=steps.arrived,
            f=steps.f,
            q=steps.q,
            measurements={POINT: _in_order(self._updates, POINT), POSE: none_of_poses},
            initialisations={POINT: _in_order(self._beginnings, POINT), POSE: none_of_poses},
            positions=_in_order(self._positions, None),
            merges=none_of_poses,
            removals=removal_records([]),
        )

    def _begin(self, event: events.TracePrior) -> None:
        if event.dims != (_POSE,) or event.charts not in ((), (events.ADDITIVE,), ("se2",)):
            self._refuse(event, "the prior is not of a pose of x, y and heading alone")
        self._prior = event

    def _predict(self, event: events.Predict) -> None:
        if event.blocks != self._prior.blocks:
            self._refuse(event, "predicts more than the pose; expected its block alone")
        if event.time_s is None:
            self._refuse(event, "has no time; set it with at(time_s)")
        if self.step_time_s and event.time_s <= self.step_time_s[-1]:
            before = f"{self.step_time_s[-1]:.6g} s of the step before it"
            self._refuse(event, f"is at {event.time_s:.6g} s, expected a time after {before}")
        departed = self._sized(event, "point", event.point, _POSE)
        arrived = self._sized(event, "after", event.after, _POSE)
        self.step_time_s.append(event.time_s)
        self._steps.append(StepRecord(departed, arrived, event.jacobian, event.noise))

    def _clone(self, event: events.Clone) -> None:
        """Note a copy of the pose, which is the pose of its instant."""
        if event.source in self._copies:
            self._copies[event.name] = self._copies[event.source]
        elif event.source in self._prior.blocks:
            self._copies[event.name] = len(self._steps)
        else:
            self._refuse(event, f"copies {quoted(event.source)}; expected a copy of the pose")

    def _remove(self, event: events.Remove) -> None:
        """Forget copies of the pose; note landmarks, which the estimate does not hold."""
        for name in event.blocks:
            if name in self._prior.blocks:
                self._refuse(event, "removes the pose")
            if self._copies.pop(name, None) is None:
                self.removed.append(self._blocks.pop(name))

    def _augment(self, event: events.Augment) -> None:
        if len(event.jacobian) != _POINT:
            width = len(event.jacobian)
            self._refuse(event, f"block {quoted(event.name)} has {width} entries, expected a point")
        (source, *others) = event.blocks
        if others or not self._is_pose(source) or event.noise.shape != (_POINT, _POINT):
            self._refuse(event, "initialises a landmark by more than the pose and one measurement")
        (number,) = self._whole(event, self._sized(event, "numbers", event.numbers, 1))
        index = self._blocks[event.name] = len(self.names)
        self.names.append(event.name)
        zero = np.zeros((1, _POINT))
        record = MeasurementRecord(
            kind=POINT,
            number=np.array([number]),
            landmark_index=np.array([index]),
            pose=self._sized(event, "point", event.point, _POSE),
            landmark=self._sized(event, "after", event.after, _POINT)[None],
            jacobian_pose=event.jacobian[None],
            jacobian_other=event.noise_jacobian[None],
            noise=event.noise[None],
            innovation=zero,
            whitened=zero,
            spread=np.zeros((1, _POINT, _POINT)),
            weight=event.weight,
        )
        self._beginnings.append(PlacedRecord(self._step_of(source), event.number, record))

    def _position(self, event: events.Update) -> None:
        pose = self._sized(event, "point", event.point, _POSE)
        measured = list(self._measured(event, pose, 0))
        record = self._record(event, pose, measured, None)
        self._positions.append(PlacedRecord(len(self._steps), event.number, record))

    def _update(self, event: events.Update) -> None:
        event, others = self._pose_first(event)
        point = self._sized(event, "point", event.point, _POSE + _POINT * len(others))
        measured = list(self._measured(event, point, len(others)))
        index = np.array([self._blocks[others[each.landmark]] for each in measured])
        record = self._record(event, point, measured, POINT)._replace(landmark_index=index)
        step = self._step_of(event.blocks[0])
        self._updates.append(PlacedRecord(step, event.number, record))

    def _record(
        self,
        event: events.Update,
        point: Array,
        measured: list[_Measured],
        kind: LandmarkKind | None,
    ) -> MeasurementRecord:
        """Return what was measured as the filter's record; without indices of landmarks.

        point: of the pose and the landmarks. kind: None for positions, which have no landmark.
        """
        if not _LEAST_WEIGHT <= event.weight <= 1.0:
            self._refuse(event, f"weight is {event.weight:g}, expected {_LEAST_WEIGHT:g} to 1")
        width, count = (0 if kind is None else kind.width), len(measured)
        jacobian = np.array([each.jacobian for each in measured])
        begins = [_POSE + _POINT * each.landmark for each in measured]
        of_landmark = [jacobian[k, :, at : at + width] for k, at in enumerate(begins)]
        return MeasurementRecord(
            kind=kind,
            number=self._whole(event, np.array([each.number for each in measured])),
            landmark_index=np.full(count, -1),
            pose=point[:_POSE],
            landmark=np.array([point[at : at + width] for at in begins]),
            jacobian_pose=jacobian[:, :, :_POSE],
            jacobian_other=np.array(of_landmark),
            noise=np.array([each.noise for each in measured]),
            innovation=np.array([each.residual for each in measured]),
            whitened=np.zeros((count, _POINT)),
            spread=np.zeros((count, _POINT, _POINT)),
            weight=event.weight,
        )

    def _pose_first(self, event: events.Update) -> tuple[events.Update, events.Blocks]:
        """Return an update of a pose, first, and landmarks, and the blocks of these."""
        blocks = event.blocks
        where = [k for k, block in enumerate(blocks) if block not in self._blocks]
        if len(where) != 1 or not self._is_pose(blocks[where[0]]):
            self._refuse(event, "is of other blocks than one pose and landmarks")
        (before,) = where
        others = (*blocks[:before], *blocks[before + 1 :])
        if not before:
            return event, others
        first, size = _POINT * before, _POSE + _POINT * len(others)
        order = [*range(first, first + _POSE), *range(first), *range(first + _POSE, size)]
        if event.point is not None:
            event = event._replace(point=self._sized(event, "point", event.point, size)[order])
        return event._replace(
            blocks=(blocks[before], *others), jacobian=event.jacobian[:, order]
        ), others

    def _is_pose(self, block: str) -> bool:
        return block in self._prior.blocks or block in self._copies

    def _step_of(self, pose: str) -> int:
        """How many steps were made when the vehicle was at a pose, or a copy of it."""
        return self._copies.get(pose, len(self._steps))

    def _measured(self, event: events.Update, point: Array, landmarks: int) -> Iterator[_Measured]:
        """Yield what an update is of: two rows for each measurement, or a row for each number.

        point: of the pose and so many landmarks.
        """
        numbers, count = event.numbers, len(event.residual)
        if numbers is not None and len(numbers) == count:
            yield from self._of_entries(event, numbers, point, landmarks)
            return
        if count % _POINT:
            self._refuse(
                event,
                "has a residual that is not of two entries for each measurement; expected so, or "
                "numbers with one for each entry",
            )
        numbers, noise = self._sized(event, "numbers", numbers, count // _POINT), self._parts(event)
        for k, landmark in enumerate(self._landmarks(event, landmarks)):
            rows = slice(_POINT * k, _POINT * (k + 1))
            residual, jacobian = event.residual[rows], event.jacobian[rows]
            yield _Measured(numbers[k], landmark, residual, jacobian, noise[k])

    def _landmarks(self, event: events.Update, landmarks: int) -> list[int]:
        """Which of the landmarks each measurement is of: the one that its rows have columns of."""
        count = len(event.residual) // _POINT
        if landmarks < 2:
            return [0] * count
        parts = event.jacobian[:, _POSE:].reshape(count, _POINT, landmarks, _POINT)
        touched = parts.any(axis=(1, 3))
        if (touched.sum(axis=1) == 1).all():
            return list(touched.argmax(axis=1).tolist())
        if count != landmarks:
            self._refuse(event, _NOT_OF_ONE)
        return list(range(count))

    def _parts(self, event: events.Update) -> Array:
        """The noise of each measurement (count, 2, 2)."""
        count = len(event.residual) // _POINT
        if count == 1:
            return event.noise[None]
        parts = event.noise.reshape(count, _POINT, count, _POINT)
        every = np.arange(count)
        own: Array = parts[every, :, every]
        if np.count_nonzero(event.noise) > np.count_nonzero(own):
            self._refuse(event, _CORRELATED)
        return own

    def _of_entries(
        self, event: events.Update, numbers: Array, point: Array, landmarks: int
    ) -> Iterator[_Measured]:
        """Yield measurements of some entries each; one that was not used has zeros, and noise 1."""
        rows_of: defaultdict[float, list[int]] = defaultdict(list)
        for row, number in enumerate(numbers.tolist()):
            rows_of[number].append(row)
        h, r = event.jacobian, event.noise
        own = np.zeros(r.shape, dtype=bool)
        for number, rows in rows_of.items():
            own[np.ix_(rows, rows)] = True
            if len(rows) > _POINT:
                self._refuse(event, "has more than two entries of one measurement")
            landmark = self._landmark_of(event, rows, landmarks)
            entries = _entries(h[rows], _expected(point, landmark, landmarks))
            residual, noise, jacobian = np.zeros(_POINT), np.eye(_POINT), np.zeros((2, h.shape[1]))
            residual[entries], jacobian[entries] = event.residual[rows], h[rows]
            noise[np.ix_(entries, entries)] = r[np.ix_(rows, rows)]
            yield _Measured(number, landmark, residual, jacobian, noise)
        if r[~own].any():
            self._refuse(event, _CORRELATED)

    def _landmark_of(self, event: events.Update, rows: list[int], landmarks: int) -> int:
        """Which landmark some rows of one measurement are of."""
        if landmarks < 2:
            return 0
        parts = event.jacobian[rows, _POSE:].reshape(len(rows), landmarks, _POINT)
        touched = parts.any(axis=(0, 2))
        if touched.sum() != 1:
            self._refuse(event, _NOT_OF_ONE)
        return int(touched.argmax())

    def _sized(self, event: events.Event, name: str, values: Array | None, size: int) -> Array:
        """What `check` needs beside an event's matrices."""
        values = self._needed(event, name, values)
        if len(values) != size:
            self._refuse(event, f"{name} has {len(values)} numbers, expected {size}")
        return values

    def _needed(self, event: events.Event, name: str, values: Array | None) -> Array:
        if values is None:
            self._refuse(event, f"has no {name}, which a comparison with a log needs")
        return values

    def _whole(self, event: events.Event, numbers: Array) -> Index:
        """Numbers of measurements, as indices."""
        if (numbers != np.round(numbers)).any() or not (np.abs(numbers) < LARGEST_ID).all():
            self._refuse(event, "numbers holds a value that is not a whole number")
        return numbers.astype(np.intp)

    def _refuse(self, event: events.Event, fault: str) -> NoReturn:
        raise InputError(f"{self._path}, event {event.number}: {fault}")


def _in_order(
    records: list[PlacedRecord[MeasurementRecord]], kind: LandmarkKind | None
) -> MeasurementRecords:
    """Return records as arrays: what was measured from copies of the pose stands at its instant."""
    return stack_records(sorted(records, key=lambda record: record.step), _POSE, kind)


def _tidy(trace: TraceArrays) -> TraceArrays:
    """Return a trace with symmetric noises, and headings without jumps along it.

    They are those of its filter but for rounding, and for whole turns, wherever it wraps.
    """
    departed, arrived = trace.departed.copy(), trace.arrived.copy()
    steps = np.column_stack((departed[:, 2], arrived[:, 2])).ravel()
    along = np.unwrap(np.concatenate((trace.prior_pose[2:], steps)))
    departed[:, 2], arrived[:, 2] = along[1::2], along[2::2]
    reached = along[0::2]

    def tidied(records: MeasurementRecords) -> MeasurementRecords:
        pose = records.pose.copy()
        turns = np.round((reached[records.step] - pose[:, 2]) / (2.0 * np.pi))
        pose[:, 2] += 2.0 * np.pi * turns
        return replace(records, pose=pose, noise=_symmetric(records.noise))

    return replace(
        trace,
        prior_covariance=_symmetric(trace.prior_covariance),
        departed=departed,
        arrived=arrived,
        q=_symmetric(trace.q),
        measurements={**trace.measurements, POINT: tidied(trace.measurements[POINT])},
        initialisations={**trace.initialisations, POINT: tidied(trace.initialisations[POINT])},
        positions=tidied(trace.positions),
    )


def _symmetric(matrices: Array) -> Array:
    """Return the symmetric part of matrices (..., n, n)."""
    return 0.5 * (matrices + np.swapaxes(matrices, -1, -2))


def _expected(point: Array, landmark: int, landmarks: int) -> Array:
    """Jacobian (2, n) of a measurement at a point of pose and landmarks; of a position of none."""
    if not landmarks:
        return np.eye(_POINT, _POSE)
    at = _POSE + _POINT * landmark
    jacobian = np.zeros((_POINT, len(point)))
    own = _range_and_bearing(point[:_POSE], point[at : at + _POINT])
    jacobian[:, :_POSE], jacobian[:, at : at + _POINT] = own[:, :_POSE], own[:, _POSE:]
    return jacobian


def _range_and_bearing(pose: Array, point: Array) -> Array:
    """Jacobian (2, 5) of range and bearing by pose and point; of no point at the pose."""
    dx, dy = point - pose[:2]
    squared = max(dx * dx + dy * dy, np.finfo(float).tiny)
    along = np.array([dx, dy]) / np.sqrt(squared)
    across = np.array([-dy, dx]) / squared
    return np.array([[*-along, 0.0, *along], [*-across, -1.0, *across]])


def _entries(rows: Array, expected: Array) -> list[int]:
    """Which entries of a measurement rows (k, n) of a Jacobian are: those that they are most like.

    expected: (2, n) its whole Jacobian. Signs do not count, for they may be the fault.
    """
    size = np.linalg.norm(rows, axis=1)[:, None] * np.linalg.norm(expected, axis=1)
    like = np.abs(rows @ expected.T) / np.where(size > 0.0, size, 1.0)
    if len(rows) == 1:
        return [int(like[0].argmax())]
    return [0, 1] if like[0, 0] + like[1, 1] >= like[0, 1] + like[1, 0] else [1, 0]
