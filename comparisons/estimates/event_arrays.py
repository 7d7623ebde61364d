"""The events of a planar filter as columns: steps, measurements, new landmarks and positions.

A filter of x, y and heading, and of points, each a block of its own. A prediction
moves the pose alone; copies of it (clones) are the pose of their instant. What is fused together is
one update: two rows for each measurement, or any of its entries where each row has a number.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError, quoted
from comparisons.trace import events
from comparisons.trace.reader import Trace

_POSE, _POINT = 3, 2
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

    arrays: by name, as `trace.npz` of 0.2 had them; a row whose Jacobian is zero is of an entry
    that was not used. A column of landmarks holds the blocks' indices. blocks: (B,) names, by
    index, of all blocks that have been. removed: indices of those that the filter has removed.
    """

    arrays: dict[str, Array]
    blocks: tuple[str, ...]
    removed: tuple[int, ...] = ()


def event_arrays(trace: Trace) -> PlanarEvents:
    """Return a trace's columns.

    Raises:
        InputError: The file is no trace, or an event is none of such a filter, or lacks its point
            or the numbers of its measurements.
    """
    reading = _Reading(trace)
    for event in trace:
        reading.take(event)
    return reading.columns()


class _Group(NamedTuple):
    """Rows of an update that are of one measurement. entries: which of its two they are."""

    number: float
    rows: list[int]
    entries: list[int]


class _Reading:
    """Columns in the making. copies: steps made when each clone of the pose was."""

    def __init__(self, trace: Trace) -> None:
        self.path, self.made = trace.path, 0
        self.prior: events.Prior
        self.rows: defaultdict[str, list[Any]] = defaultdict(list)
        self.names: list[str] = []
        self.blocks: dict[str, int] = {}
        self.removed: list[int] = []
        self.copies: dict[str, int] = {}

    def take(self, event: events.Event) -> None:
        """Add an event."""
        match event:
            case events.Prior():
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

    def _prior(self, event: events.Prior) -> None:
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
            step=self._made_at(source),
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
        for group, residual, noise, h in self._measured(event, lambda rows: np.eye(_POINT, _POSE)):
            self._put(
                "position",
                step=self.made,
                number=group.number,
                weight=event.weight,
                pose=pose,
                innovation=residual,
                jacobian_pose=h,
                noise=noise,
            )

    def _update(self, event: events.Update) -> None:
        blocks = event.blocks
        poses = [block for block in blocks if self._is_pose(block)]
        others = [block for block in blocks if block in self.blocks]
        if len(poses) != 1 or len(poses) + len(others) != len(blocks):
            self._refuse(event, "is of other blocks than one pose and landmarks")
        size = _POSE + _POINT * len(others)
        point = self._sized(event, "point", event.point, size)
        if blocks[0] != poses[0]:
            order = _pose_first(blocks.index(poses[0]), len(others))
            point, event = point[order], event._replace(jacobian=event.jacobian[:, order])
        step = self._made_at(poses[0])
        landmarks = self._landmarks(event, len(others))

        def expected(rows: list[int]) -> Array:
            at = _POSE + _POINT * landmarks[rows[0]]
            jacobian = np.zeros((_POINT, size))
            entries = [*range(_POSE), at, at + 1]
            jacobian[:, entries] = _range_and_bearing(point[:_POSE], point[at : at + _POINT])
            return jacobian

        for group, residual, noise, h in self._measured(event, expected):
            landmark = landmarks[group.rows[0]]
            at, name = _POSE + _POINT * landmark, others[landmark]
            self._put(
                "update",
                step=step,
                measurement=group.number,
                landmark=self.blocks[name],
                weight=event.weight,
                pose=point[:_POSE],
                point=point[at : at + _POINT],
                innovation=residual,
                jacobian_pose=h[:, :_POSE],
                jacobian_landmark=h[:, at : at + _POINT],
                noise=noise,
            )

    def _is_pose(self, block: str) -> bool:
        return block in self.prior.blocks or block in self.copies

    def _made_at(self, block: str) -> int:
        """Steps made when the pose was what a block says."""
        return self.copies.get(block, self.made)

    def _groups(self, event: events.Update) -> list[list[int]]:
        """Rows of each measurement: two in turn, or those whose own numbers are the same."""
        count, numbers = len(event.residual), event.numbers
        if numbers is not None and len(numbers) == count:
            rows: defaultdict[float, list[int]] = defaultdict(list)
            for row, number in enumerate(numbers.tolist()):
                rows[number].append(row)
            if max(map(len, rows.values())) > _POINT:
                self._refuse(event, "has more than two entries of one measurement")
            return list(rows.values())
        if count % _POINT:
            self._refuse(
                event,
                "has a residual that is not of two entries for each measurement; expected so, or "
                "numbers with one for each entry",
            )
        self._sized(event, "numbers", numbers, count // _POINT)
        return [[row, row + 1] for row in range(0, count, _POINT)]

    def _landmarks(self, event: events.Update, count: int) -> dict[int, int]:
        """Which landmark each row is of: the one that its measurement's rows have columns of."""
        groups = self._groups(event)
        parts: NDArray[np.bool_] = np.any(
            event.jacobian[:, _POSE:].reshape(len(event.residual), count, _POINT), axis=2
        )
        found = dict[int, int]()
        for k, rows in enumerate(groups):
            touched = parts[rows].any(axis=0)
            landmark = 0 if count == 1 else int(touched.argmax())
            if count > 1 and touched.sum() != 1:
                if len(groups) != count or (len(rows) == 1 and touched.any()):
                    self._refuse(event, "has a measurement that is not of one landmark")
                landmark = k
            found |= dict.fromkeys(rows, landmark)
        return found

    def _measured(
        self, event: events.Update, expected: Callable[[list[int]], Array]
    ) -> Iterator[tuple[_Group, Array, Array, Array]]:
        """Yield each measurement with residual (2,), noise (2, 2) and Jacobian (2, n).

        An entry that was not used has zeros, and a noise of one. expected: Jacobian of some rows'
        measurement, which tells single entries.
        """
        groups, r = self._groups(event), event.noise
        numbers = self._needed(event, "numbers", event.numbers)
        single = len(numbers) == len(event.residual)
        apart = np.ones_like(r, dtype=bool)
        for rows in groups:
            apart[np.ix_(rows, rows)] = False
        if r[apart].any():
            self._refuse(event, "has noise that is correlated between measurements")
        for k, rows in enumerate(groups):
            entries = [0, 1]
            if single:
                entries = _entries(event.jacobian[rows], expected(rows))
            residual, noise = np.zeros(_POINT), np.eye(_POINT)
            h = np.zeros((_POINT, event.jacobian.shape[1]))
            residual[entries], h[entries] = event.residual[rows], event.jacobian[rows]
            noise[np.ix_(entries, entries)] = r[np.ix_(rows, rows)]
            yield _Group(numbers[rows[0] if single else k], rows, entries), residual, noise, h

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


def _pose_first(before: int, landmarks: int) -> list[int]:
    """Columns of the pose, behind so many landmarks, and then of these."""
    first = _POINT * before
    rest = [*range(first), *range(first + _POSE, _POSE + _POINT * landmarks)]
    return [*range(first, first + _POSE), *rest]


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
