"""The states of a trace: which blocks there are, in which chart, and from when to when."""

from __future__ import annotations

from bisect import bisect_right
from typing import NamedTuple

from comparisons.trace.events import ADDITIVE, Augment, Clone, Event, Remove, TracePrior


class BlockState(NamedTuple):
    """A block of the error state.

    Attributes:
        name: Its name.
        dims: Entries of its error.
        chart: How its error stands to its numbers, one of comparisons.trace.events.CHARTS.
        since: Number of the event that began it.
        until: Number of the event that removed it; None where it stays.
    """

    name: str
    dims: int
    chart: str
    since: int
    until: int | None = None


class StateHistory:
    """Goes through all events, the prior first, and keeps blocks and times."""

    def __init__(self) -> None:
        """Start without any."""
        self._blocks: dict[str, BlockState] = {}
        self._numbers: list[int] = []
        self._times_s: list[float] = []

    def take(self, event: Event) -> None:
        """Keep what an event begins and ends, and its time."""
        if event.time_s is not None and self._times_s[-1:] != [event.time_s]:
            self._numbers.append(event.number)
            self._times_s.append(event.time_s)
        match event:
            case TracePrior():
                charts = event.charts or (ADDITIVE,) * len(event.blocks)
                for name, dims, chart in zip(event.blocks, event.dims, charts, strict=True):
                    self._blocks[name] = BlockState(name, dims, chart, event.number)
            case Augment():
                dims = len(event.jacobian)
                self._blocks[event.name] = BlockState(event.name, dims, event.chart, event.number)
            case Clone():
                source = self._blocks[event.source]
                self._blocks[event.name] = BlockState(
                    event.name, source.dims, source.chart, event.number
                )
            case Remove():
                for name in event.blocks:
                    self._blocks[name] = self._blocks[name]._replace(until=event.number)
            case _:
                pass

    @property
    def blocks(self) -> tuple[BlockState, ...]:
        """All blocks that there ever were, as they began; of a name the last one."""
        return tuple(self._blocks.values())

    def time_s(self, number: int | None) -> float | None:
        """Return the time of an event, or of the last one before it that has a time."""
        row = 0 if number is None else bisect_right(self._numbers, number)
        return self._times_s[row - 1] if row else None
