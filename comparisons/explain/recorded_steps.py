"""Events as a filter recorded them, each with what it moved its estimate by."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.replay import BlockLayout, Fused, Replay
from comparisons.trace.events import (
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
    """

    event: Event
    applied: Array | None
    estimate: Array | None = None


def steps_of(events: Iterable[Event]) -> Iterator[RecordedStep]:
    """Yield events, the prior first, with the filter's corrections: recorded, or by its gain."""
    replay: Replay
    numbers = np.empty(0)
    for event in events:
        if isinstance(event, TracePrior):
            replay = Replay(event)
            numbers = np.zeros(replay.layout.size)
            if event.point is not None and len(event.point) == len(numbers):
                numbers[:] = event.point
            yield RecordedStep(event, None)
            continue
        estimate = None
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
        yield RecordedStep(event, applied, estimate)


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
