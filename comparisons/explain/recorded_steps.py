"""Events as a filter recorded them, each with what it moved its estimate by."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from comparisons.arrays import Array
from comparisons.audit.replay import Replay
from comparisons.trace.events import Event, TracePrior


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
