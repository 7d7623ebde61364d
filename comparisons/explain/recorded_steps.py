"""Events as a filter recorded them, each with what it moved its estimate by."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from comparisons.arrays import Array
from comparisons.audit.replay import Fused, Replay
from comparisons.trace.events import Event, Predict, TracePrior


class RecordedStep(NamedTuple):
    """An event, and what the estimate was moved by that the event does not say: (n,), or None.

    Of an update it is the filter's correction; of a prediction, a constant that it lacks.
    """

    event: Event
    applied: Array | None


def steps_of(events: Iterable[Event]) -> Iterator[RecordedStep]:
    """Yield events, the prior first, with the filter's corrections: recorded, or by its gain."""
    replay: Replay
    for event in events:
        if isinstance(event, TracePrior):
            replay = Replay(event)
            yield RecordedStep(event, None)
            continue
        done = replay.apply(event)
        yield RecordedStep(event, None if done is None else done.applied)


def apply_step(replay: Replay, step: RecordedStep) -> Fused | None:
    """Let a recursion do an event, and take off what moves a prediction beside it.

    Returns:
        What an update came to.
    """
    fused = replay.apply(step.event)
    if isinstance(step.event, Predict) and step.applied is not None:
        replay.mean -= step.applied
    return fused
