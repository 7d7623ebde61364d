"""The events of a planar filter as columns: steps, measurements, new landmarks and positions.

A filter of x, y and heading, and of points, each a block of its own. A prediction
moves the pose alone; copies of it (clones) are the pose of their instant. What is fused together is
one update: two rows for each measurement, or any of its entries where each row has a number.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import Any, NamedTuple, NoReturn

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError, quoted
from comparisons.trace import events
from comparisons.trace.reader import TraceReader

_POSE, _POINT = 3, 2
_NOT_OF_ONE = "has a measurement that is not of one landmark"
_CORRELATED = "has noise that is correlated between measurements"
COLUMNS: dict[str, dict[str, tuple[int, ...]]] = {
    "step": {
        "time_s": (), "departed": (_POSE,), "arrived": (_POSE,),
        "f": (_POSE, _POSE), "q": (_POSE, _POSE),
    },
    "update": {
        "step": (), "measurement": (), "landmark": (), "weight": (),
        "pose": (_POSE,), "point": (_POINT,), "innovation": (_POINT,),
        "jacobian_pose": (_POINT, _POSE), "jacobian_landmark": (_POINT, _POINT),
        "noise": (_POINT, _POINT),
    },
    "initialise": {
        "step": (), "measurement": (), "landmark": (), "weight": (),
        "pose": (_POSE,), "point": (_POINT,), "jacobian_pose": (_POINT, _POSE),
        "jacobian_measurement": (_POINT, _POINT), "noise": (_POINT, _POINT),
    },
    "position": {
        "step": (), "number": (), "weight": (), "pose": (_POSE,), "innovation": (_POINT,),
        "jacobian_pose": (_POINT, _POSE), "noise": (_POINT, _POINT),
    },
}  # fmt: skip
"""By part and name, the shapes of the columns' rows."""


class PlanarEvents(NamedTuple):
    """A trace's columns, and the landmarks' blocks.

    arrays: the prior's pose and covariance, and COLUMNS by part and name; a row whose Jacobian is
    zero is of an entry that was not used. A column of landmarks holds the blocks' indices. blocks:
    (B,) names, by index, of all blocks that have been. removed: indices of those that the filter
    has removed.
    """

    arrays: dict[str, Array]
    blocks: tuple[str, ...]
    removed: tuple[int, ...] = ()


def event_arrays(trace: TraceReader) -> PlanarEvents:
    """Return a trace's columns.

    Raises:
        InputError: The file is no trace, or an event is none of such a filter, or lacks its point
            or the numbers of its measurements.
    """
    reading = _Reading(trace)
    for event in trace:
        reading.take(event)
    return reading.columns()


class _Measured(NamedTuple):
    """One measurement of an update: residual (2,), jacobian (2, n), noise (2, 2).

    landmark: which of the update's it is of.
    """

    number: float
    landmark: int
    residual: Array
    jacobian: Array
    noise: Array


class _Reading:
    """Columns in the making. copies: steps made when each clone of the pose was."""

    def __init__(self, trace: TraceReader) -> None:
        self.path, self.made = trace.path, 0
        self.prior: events.TracePrior
        self.rows: defaultdict[str, list[Any]] = defaultdict(list)
        self.names: list[str] = []
        self.blocks: dict[str, int] = {}
        self.removed: list[int] = []
        self.copies: dict[str, int] = {}

    def take(self, event: events.Event) -> None:
        """Add an event."""
        match event:
            case events.TracePrior():
                self._prior(event)
            case events.Predict():
                self._predict(event)
            case events.Augment():
                self._augment(event)
            case events.Update() if not event.used:
                pass
            case events.Update() if event.blocks == self.prior.blocks:
                self._position(event)
            case events.Update():
                self._update(event)
            case events.Clone():
                self._clone(event)
            case events.Remove():
                self._remove(event)
            case events.Snapshot() | events.Directions():
                pass
            case _:
                kind = type(event).__name__.lower()
                self._refuse(event, f"is a {kind}, which a planar filter has not")

    def columns(self) -> PlanarEvents:
        """Return all columns, in the order of the steps made before them."""
        found = {
            f"{part}_{name}": np.array(self.rows[f"{part}_{name}"], dtype=np.float64).reshape(
                -1, *shape
            )
            for part, columns in COLUMNS.items()
            for name, shape in columns.items()
        }
        for part in ("update", "initialise"):
            step = found[f"{part}_step"]
            if (np.diff(step) < 0.0).any():
                order = np.argsort(step, kind="stable")
                names = [f"{part}_{name}" for name in COLUMNS[part]]
                found |= {name: found[name][order] for name in names}
        point = self._sized(self.prior, "point", self.prior.point, _POSE)
        arrays = {"prior_pose": point, "prior_covariance": self.prior.covariance, **found}
        return PlanarEvents(arrays, tuple(self.names), tuple(self.removed))

    def _prior(self, event: events.TracePrior) -> None:
        if event.dims != (_POSE,) or event.charts not in ((), (events.ADDITIVE,), ("se2",)):
            self._refuse(event, "the prior is not of a pose of x, y and heading alone")
        self.prior = event

    def _predict(self, event: events.Predict) -> None:
        if event.blocks != self.prior.blocks:
            self._refuse(event, "predicts more than the pose; expected its block alone")
        if event.time_s is None:
            self._refuse(event, "has no time; set it with at(time_s)")
        self._put(
            "step",
            time_s=event.time_s,
            departed=self._sized(event, "point", event.point, _POSE),
            arrived=self._sized(event, "after", event.after, _POSE),
            f=event.jacobian,
            q=event.noise,
        )
        self.made += 1

    def _clone(self, event: events.Clone) -> None:
        """Note a copy of the pose, which is the pose of its instant."""
        if event.source in self.copies:
            self.copies[event.name] = self.copies[event.source]
        elif event.source in self.prior.blocks:
            self.copies[event.name] = self.made
        else:
            self._refuse(event, f"copies {quoted(event.source)}; expected a copy of the pose")

    def _remove(self, event: events.Remove) -> None:
        """Forget copies of the pose; note landmarks, which the estimate does not hold."""
        for name in event.blocks:
            if name in self.prior.blocks:
                self._refuse(event, "removes the pose")
            if self.copies.pop(name, None) is None:
                self.removed.append(self.blocks.pop(name))

    def _augment(self, event: events.Augment) -> None:
        if len(event.jacobian) != _POINT:
            width = len(event.jacobian)
            self._refuse(event, f"block {quoted(event.name)} has {width} entries, expected a point")
        (source, *others) = event.blocks
        if others or not self._is_pose(source) or event.noise.shape != (_POINT, _POINT):
            self._refuse(event, "initialises a landmark by more than the pose and one measurement")
        self.blocks[event.name] = len(self.names)
        self.names.append(event.name)
        self._put(
            "initialise",
            step=self.copies.get(source, self.made),
            measurement=self._sized(event, "numbers", event.numbers, 1)[0],
            landmark=self.blocks[event.name],
            weight=event.weight,
            pose=self._sized(event, "point", event.point, _POSE),
            point=self._sized(event, "after", event.after, _POINT),
            jacobian_pose=event.jacobian,
            jacobian_measurement=event.noise_jacobian,
            noise=event.noise,
        )

    def _position(self, event: events.Update) -> None:
        pose = self._sized(event, "point", event.point, _POSE)
        for one in self._measured(event, pose, 0):
            self._put(
                "position",
                step=self.made,
                number=one.number,
                weight=event.weight,
                pose=pose,
                innovation=one.residual,
                jacobian_pose=one.jacobian,
                noise=one.noise,
            )

    def _update(self, event: events.Update) -> None:
        event, others = self._pose_first(event)
        step = self.copies.get(event.blocks[0], self.made)
        point = self._sized(event, "point", event.point, _POSE + _POINT * len(others))
        for one in self._measured(event, point, len(others)):
            at = _POSE + _POINT * one.landmark
            self._put(
                "update",
                step=step,
                measurement=one.number,
                landmark=self.blocks[others[one.landmark]],
                weight=event.weight,
                pose=point[:_POSE],
                point=point[at : at + _POINT],
                innovation=one.residual,
                jacobian_pose=one.jacobian[:, :_POSE],
                jacobian_landmark=one.jacobian[:, at : at + _POINT],
                noise=one.noise,
            )

    def _pose_first(self, event: events.Update) -> tuple[events.Update, events.Blocks]:
        """Return an update of a pose, first, and landmarks, and the blocks of these."""
        blocks = event.blocks
        where = [k for k, block in enumerate(blocks) if block not in self.blocks]
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
        return block in self.prior.blocks or block in self.copies

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

    def _put(self, part: str, **values: Any) -> None:
        for name, value in values.items():
            self.rows[f"{part}_{name}"].append(value)

    def _refuse(self, event: events.Event, fault: str) -> NoReturn:
        raise InputError(f"{self.path}, event {event.number}: {fault}")


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
