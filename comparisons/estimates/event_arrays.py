"""The events of a planar filter as columns: steps, measurements, new landmarks and positions.

A filter of x, y and heading, whose block comes first, and of points, each a block of its own. A
prediction moves the pose alone. What is fused together is one update, with two rows
for each measurement.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Any, NoReturn

import numpy as np

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


def event_arrays(trace: Trace) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Return a trace's columns by name, as `trace.npz` of 0.2 had them, and the landmarks' blocks.

    A column of landmarks holds the blocks' indices.

    Raises:
        InputError: The file is no trace, or an event is none of such a filter, or lacks its point
            or the numbers of its measurements.
    """
    reading = _Reading(trace)
    for event in trace:
        reading.take(event)
    return reading.arrays(), tuple(reading.blocks)


class _Reading:
    """Columns in the making."""

    def __init__(self, trace: Trace) -> None:
        self.path, self.made = trace.path, 0
        self.prior: events.Prior
        self.rows: defaultdict[str, list[Any]] = defaultdict(list)
        self.blocks: dict[str, int] = {}

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
            case events.Snapshot() | events.Directions():
                pass
            case _:
                kind = type(event).__name__.lower()
                self._refuse(event, f"is a {kind}, which a planar filter has not")

    def arrays(self) -> dict[str, Array]:
        """Return all columns."""
        found = {
            f"{part}_{name}": np.array(self.rows[f"{part}_{name}"], dtype=np.float64).reshape(
                -1, *shape
            )
            for part, columns in COLUMNS.items()
            for name, shape in columns.items()
        }
        point = self._sized(self.prior, "point", self.prior.point, _POSE)
        return {"prior_pose": point, "prior_covariance": self.prior.covariance, **found}

    def _prior(self, event: events.Prior) -> None:
        if event.dims != (_POSE,) or event.charts not in ((), (events.ADDITIVE,), ("se2",)):
            self._refuse(event, "begins with another state than a pose of x, y and heading")
        self.prior = event

    def _predict(self, event: events.Predict) -> None:
        if event.blocks != self.prior.blocks:
            self._refuse(event, "moves more than the pose; expected its block alone")
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

    def _augment(self, event: events.Augment) -> None:
        if len(event.jacobian) != _POINT:
            width = len(event.jacobian)
            self._refuse(event, f"block {quoted(event.name)} has {width} entries, expected a point")
        if event.blocks != self.prior.blocks or event.noise.shape != (_POINT, _POINT):
            self._refuse(event, "begins a landmark by more than the pose and one measurement")
        block = self.blocks.setdefault(event.name, len(self.blocks))
        self._put(
            "initialise",
            step=self.made,
            measurement=self._sized(event, "numbers", event.numbers, 1)[0],
            landmark=block,
            weight=event.weight,
            pose=self._sized(event, "point", event.point, _POSE),
            point=self._sized(event, "after", event.after, _POINT),
            jacobian_pose=event.jacobian,
            jacobian_measurement=event.noise_jacobian,
            noise=event.noise,
        )

    def _position(self, event: events.Update) -> None:
        count = self._count(event)
        numbers = self._sized(event, "numbers", event.numbers, count)
        pose = self._sized(event, "point", event.point, _POSE)
        noise = self._parts(event, count)
        for k, number in enumerate(numbers):
            rows = slice(_POINT * k, _POINT * (k + 1))
            self._put(
                "position",
                step=self.made,
                number=number,
                weight=event.weight,
                pose=pose,
                innovation=event.residual[rows],
                jacobian_pose=event.jacobian[rows],
                noise=noise[k],
            )

    def _update(self, event: events.Update) -> None:
        blocks, count = event.blocks, self._count(event)
        if blocks[:1] != self.prior.blocks or not self.blocks.keys() >= set(blocks[1:]):
            self._refuse(event, "is of other blocks than the pose, first, and landmarks")
        numbers = self._sized(event, "numbers", event.numbers, count)
        size = _POSE + _POINT * (len(blocks) - 1)
        point = self._sized(event, "point", event.point, size)
        noise, h = self._parts(event, count), event.jacobian
        for k, block in enumerate(self._landmarks(event, blocks, count)):
            at = _POSE + _POINT * block
            rows = slice(_POINT * k, _POINT * (k + 1))
            self._put(
                "update",
                step=self.made,
                measurement=numbers[k],
                landmark=self.blocks[blocks[1 + block]],
                weight=event.weight,
                pose=point[:_POSE],
                point=point[at : at + _POINT],
                innovation=event.residual[rows],
                jacobian_pose=h[rows, :_POSE],
                jacobian_landmark=h[rows, at : at + _POINT],
                noise=noise[k],
            )

    def _landmarks(self, event: events.Update, blocks: events.Blocks, count: int) -> list[int]:
        """Which of the landmarks each measurement is of: the one that its rows have columns of."""
        others = len(blocks) - 1
        if others == 1:
            return [0] * count
        parts = event.jacobian[:, _POSE:].reshape(count, _POINT, others, _POINT)
        seen = parts.any(axis=(1, 3))
        if (seen.sum(axis=1) == 1).all():
            return list(seen.argmax(axis=1).tolist())
        if count != others:
            self._refuse(event, "has a measurement that is not of one landmark")
        return list(range(count))

    def _parts(self, event: events.Update, count: int) -> Array:
        """The noise of each measurement (count, 2, 2)."""
        if count == 1:
            return event.noise[None]
        parts = event.noise.reshape(count, _POINT, count, _POINT)
        every = np.arange(count)
        own: Array = parts[every, :, every]
        if np.count_nonzero(event.noise) > np.count_nonzero(own):
            self._refuse(event, "has noise that is correlated between measurements")
        return own

    def _count(self, event: events.Update) -> int:
        if len(event.residual) % _POINT:
            self._refuse(event, "has a residual that is not of two entries for each measurement")
        return len(event.residual) // _POINT

    def _sized(self, event: events.Event, name: str, values: Array | None, size: int) -> Array:
        """What `check` needs beside an event's matrices."""
        if values is None:
            self._refuse(event, f"has no {name}, which a comparison with a log needs")
        if len(values) != size:
            self._refuse(event, f"{name} has {len(values)} numbers, expected {size}")
        return values

    def _put(self, part: str, **values: Any) -> None:
        for name, value in values.items():
            self.rows[f"{part}_{name}"].append(value)

    def _refuse(self, event: events.Event, fault: str) -> NoReturn:
        raise InputError(f"{self.path}, event {event.number}: {fault}")
