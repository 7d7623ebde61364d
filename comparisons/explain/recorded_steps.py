"""Events as a filter recorded them, each with what it moved its estimate by."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.replay import BlockLayout, Fused, Replay
from comparisons.trace.events import (
    ADDITIVE,
    Augment,
    Clone,
    Event,
    Predict,
    Remove,
    Reset,
    TracePrior,
    Update,
)


class RecordedStep(NamedTuple):
    """An event, and what a trace tells of the estimate.

    Attributes:
        event: What was done.
        applied: (n,) what the estimate was moved by that the event does not say, or None: of an
            update the filter's correction; of a prediction, less what it lacks.
        estimate: (k,) of the event's blocks before it, as recorded, or as a linear filter has it
            that begins at zero; None of other events than predictions and updates.
        moved: (k,) by which a prediction moved the numbers of its blocks; (m,) of an update, what
            the last moves change of the expected measurement in a second, or each time. None where
            predictions do not say where they lead, or the numbers are not those of the error.
        interval_s: Of a prediction, since the one before; 1 where there is none, so that what is of
            it is of each.
    """

    event: Event
    applied: Array | None
    estimate: Array | None = None
    moved: Array | None = None
    interval_s: float = 1.0


def steps_of(events: Iterable[Event]) -> Iterator[RecordedStep]:
    """Yield events, the prior first, with the filter's corrections: recorded, or by its gain."""
    replay: Replay
    numbers, moves = np.empty(0), _Moves()
    last_s: float | None = None
    for event in events:
        if isinstance(event, TracePrior):
            replay = Replay(event)
            moves.by(event, 1.0, replay.layout)
            numbers = np.zeros(replay.layout.size)
            if event.point is not None and len(event.point) == len(numbers):
                numbers[:] = event.point
            yield RecordedStep(event, None)
            continue
        estimate, interval_s = None, 1.0
        if isinstance(event, Predict):
            interval_s, last_s = _interval_s(last_s, event.time_s), event.time_s
        moved = moves.by(event, interval_s, replay.layout)
        if isinstance(event, Predict | Update):
            at = replay.layout.columns(event.blocks)
            if event.point is not None and len(event.point) == len(numbers[at]):
                numbers[at] = event.point
            estimate = numbers[at].copy()
        numbers = _moved(numbers, event, replay.layout)
        done = replay.apply(event)
        applied = None if done is None else done.applied
        if applied is not None:
            numbers = numbers + applied
        yield RecordedStep(event, applied, estimate, moved, interval_s)


class _Moves:
    """What the last predictions moved each block by, in a second where events have times."""

    def __init__(self) -> None:
        self.turning: dict[str, bool] = {}
        self.rate: dict[str, Array] = {}

    def by(self, event: Event, interval_s: float, layout: BlockLayout) -> Array | None:
        """Take in an event; what `moved` of a recorded step says of it. layout: before it."""
        match event:
            case TracePrior():
                charts = event.charts or (ADDITIVE,) * len(event.blocks)
                for name, chart in zip(event.blocks, charts, strict=True):
                    self._begin(name, chart)
            case Augment():
                self._begin(event.name, event.chart)
            case Predict():
                return self._predicted(event, interval_s, layout)
            case Update() if any(name in self.rate for name in event.blocks):
                still = {name: np.zeros(layout.dims[name]) for name in event.blocks}
                rates = [self.rate.get(name, still[name]) for name in event.blocks]
                changed: Array = event.jacobian @ np.concatenate(rates)
                return changed
        return None

    def _begin(self, name: str, chart: str) -> None:
        self.rate.pop(name, None)
        self.turning.pop(name, None)
        if chart in (ADDITIVE, "se2"):
            self.turning[name] = chart == "se2"

    def _predicted(self, event: Predict, interval_s: float, layout: BlockLayout) -> Array | None:
        before, after = event.point, event.after
        known = all(name in self.turning for name in event.blocks)
        if before is None or after is None or not known:
            return None
        if not len(before) == len(after) == len(event.jacobian):
            return None
        moved: Array = after - before
        for name, part in layout.parts(event.blocks, moved).items():
            if self.turning[name]:
                part[2] = np.angle(np.exp(1j * part[2]))
            self.rate[name] = part / interval_s
        return moved


def _interval_s(before_s: float | None, time_s: float | None) -> float:
    if before_s is None or time_s is None or not time_s > before_s:
        return 1.0
    return time_s - before_s


def _moved(numbers: Array, event: Event, layout: BlockLayout) -> Array:
    """The estimate (n,) after an event that is linear. layout: before it."""
    match event:
        case Predict() | Reset():
            at, moved = layout.columns(event.blocks), numbers.copy()
            moved[at] = event.jacobian @ numbers[at]
            return moved
        case Augment():
            return np.concatenate((numbers, event.jacobian @ numbers[layout.columns(event.blocks)]))
        case Clone():
            return np.concatenate((numbers, numbers[layout.entries(event.source)]))
        case Remove():
            return np.delete(numbers, np.arange(layout.size)[layout.columns(event.blocks)])
    return numbers


def apply_step(replay: Replay, step: RecordedStep) -> Fused | None:
    """Let a recursion do an event, and take off what moves a prediction beside it.

    Returns:
        What an update came to.
    """
    fused = replay.apply(step.event)
    if isinstance(step.event, Predict) and step.applied is not None:
        replay.mean -= step.applied
    return fused
