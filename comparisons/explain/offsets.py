"""Constants that residuals show: of a sensor's component, or of a prediction of an entry.

An unknown constant enters the innovations linearly, through a recursion of its own beside the
covariance: constants of many sensors and entries, each from some event on, are fitted by weighted
least squares in one pass (Willsky and Jones 1976, generalised likelihood ratio), each by itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.audit.replay import BlockLayout, Replay
from comparisons.explain.noises import Factors, with_noises
from comparisons.explain.recorded_steps import RecordedStep, apply_step
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

_MOST_SLOTS = 150


class OffsetSlot(NamedTuple):
    """Where a constant may be.

    Attributes:
        of: A sensor, or a block of the state that predictions are of.
        entry: Of its measurement, or of the block; -1 of all of a measurement alike.
        is_predicted: It is of a block.
        since: The event from which on it is there.
    """

    of: str
    entry: int
    is_predicted: bool
    since: int = 0

    def words(self, components: Sequence[str] = ()) -> str:
        """Return what it is of. components: of the sensor, by name."""
        if self.is_predicted:
            return f"the prediction of {self.of}[{self.entry}]"
        if self.entry < 0:
            return f"sensor `{self.of}`"
        named = self.entry < len(components)
        which = components[self.entry] if named else f"component {self.entry}"
        return f"{which} of sensor `{self.of}`"

    def touches(self, event: Event) -> bool:
        """Whether an event may show this constant, whenever it begins."""
        match event:
            case Predict():
                return self.is_predicted and self.of in event.blocks
            case Update():
                return not self.is_predicted and self.of == event.sensor
        return False


class Offset(NamedTuple):
    """A constant that residuals show.

    Attributes:
        slot: Where.
        gained: Of the likelihood's logarithm.
        value: What measurements are too large by; or predictions too small, in a second where
            events have times, else at each.
        sigma: Of the value.
    """

    slot: OffsetSlot
    gained: float
    value: float
    sigma: float


def fitted_offsets(
    steps: Sequence[RecordedStep], slots: Sequence[OffsetSlot], factors: Factors
) -> list[Offset]:
    """Return the likeliest constant of each slot by itself, of those that residuals tell.

    Args:
        steps: Of a trace, from its prior on.
        slots: Where, from when on.
        factors: On its noises.
    """
    information, weighted = _normal_equations(steps, slots, factors) if slots else ([], [])
    return [
        Offset(slot, 0.5 * w**2 / i, w / i, i**-0.5)
        for slot, i, w in zip(slots, information, weighted, strict=True)
        if i > 0.0 and np.isfinite(w**2 / i)
    ]


def offset_slots(steps: Sequence[RecordedStep]) -> list[OffsetSlot]:
    """Return all places for a constant that is there from the beginning."""
    slots: dict[OffsetSlot, None] = {}
    layout = BlockLayout()
    for event, *_ in steps:
        match event:
            case TracePrior():
                layout = BlockLayout(event.blocks, event.dims)
            case Predict():
                for block in event.blocks:
                    for entry in range(layout.dims[block]):
                        slots[OffsetSlot(block, entry, True)] = None
            case Update():
                size = len(event.residual)
                for entry in range(-1 if size > 1 else 0, size):
                    slots[OffsetSlot(event.sensor, entry, False)] = None
            case _:
                layout.follow(event)
    return list(slots)[:_MOST_SLOTS]


def _normal_equations(
    steps: Sequence[RecordedStep], slots: Sequence[OffsetSlot], factors: Factors
) -> tuple[list[float], list[float]]:
    """Sums of g^T S^-1 g and g^T S^-1 nu, of what N constants of one make of innovations."""
    passed = _Sensitivities(slots)
    with np.errstate(all="ignore"):
        for step in with_noises(steps, factors):
            passed.take(step)
    return passed.information.tolist(), passed.weighted.tolist()


class _Sensitivities:
    """What constants of one make of the error of an estimate, (N, n), by Kalman's gain."""

    def __init__(self, slots: Sequence[OffsetSlot]) -> None:
        count = len(slots)
        self.information, self.weighted = np.zeros(count), np.zeros(count)
        self.replay: Replay
        self.off = np.zeros((count, 0))
        self.last_s: float | None = None
        self.since = np.array([slot.since for slot in slots])
        self.entry = np.array([slot.entry for slot in slots])
        self.by_of: dict[tuple[str, bool], Index] = {}
        for of in {(slot.of, slot.is_predicted) for slot in slots}:
            members = [k for k, one in enumerate(slots) if (one.of, one.is_predicted) == of]
            self.by_of[of] = np.array(members, dtype=np.intp)

    def _there(self, of: str, event: Event, *, is_predicted: bool) -> Index:
        """Which constants are of a sensor or block, and there at an event."""
        members = self.by_of.get((of, is_predicted), np.empty(0, dtype=np.intp))
        there: Index = members[self.since[members] <= event.number]
        return there

    def take(self, step: RecordedStep) -> None:
        """Do an event."""
        event = step.event
        match event:
            case TracePrior():
                self.replay = Replay(event)
                self.off = np.zeros((len(self.since), self.replay.layout.size))
                return
            case Update():
                self._update(event)
                return
            case Predict() | Reset():
                at = self.replay.layout.columns(event.blocks)
                self.off[:, at] = self.off[:, at] @ event.jacobian.T
            case Augment():
                at = self.replay.layout.columns(event.blocks)
                self.off = np.hstack((self.off, self.off[:, at] @ event.jacobian.T))
            case Clone():
                at = self.replay.layout.columns((event.source,))
                self.off = np.hstack((self.off, self.off[:, at]))
            case Remove():
                gone = self.replay.layout.columns(event.blocks)
                self.off = np.delete(self.off, np.arange(self.off.shape[1])[gone], axis=1)
        apply_step(self.replay, step)
        if isinstance(event, Predict):
            self._begin(event)

    def _begin(self, event: Predict) -> None:
        """Add the constants of a prediction, times its interval where that is known."""
        interval = interval_s(self.last_s, event.time_s)
        self.last_s = event.time_s
        for block in event.blocks:
            there = self._there(block, event, is_predicted=True)
            self.off[there, self.replay.layout.start[block] + self.entry[there]] += interval

    def _update(self, event: Update) -> None:
        """Add an update's innovations; all are fused, as in their likelihood."""
        at = self.replay.layout.columns(event.blocks)
        shown = self.off[:, at] @ event.jacobian.T
        there = self._there(event.sensor, event, is_predicted=False)
        there = there[self.entry[there] < len(event.residual)]
        every = self.entry[there] < 0
        shown[there[every]] += 1.0
        shown[there[~every], self.entry[there[~every]]] += 1.0
        fused = self.replay.update(event._replace(used=True))
        whitened = shown @ fused.inverse_root.T
        self.information += np.sum(whitened**2, axis=1)
        self.weighted += whitened @ fused.whitened
        self.off -= shown @ fused.gain.T


def without_offsets(
    steps: Iterable[RecordedStep], offsets: Sequence[Offset]
) -> Iterator[RecordedStep]:
    """Yield events without constants: of residuals taken off, of predictions added."""
    if not offsets:
        yield from steps
        return
    layout, last_s = BlockLayout(), None
    for step in steps:
        event = step.event
        there = [one for one in offsets if one.slot.since <= event.number]
        match event:
            case TracePrior():
                layout = BlockLayout(event.blocks, event.dims)
            case Predict():
                lacking = _lacking(event, there, layout) * interval_s(last_s, event.time_s)
                if step.applied is not None:
                    lacking = lacking - step.applied
                step, last_s = step._replace(applied=-lacking), event.time_s
            case Update():
                step = step._replace(event=_without(event, there))
            case _:
                layout.follow(event)
        yield step


def _lacking(event: Predict, offsets: Sequence[Offset], layout: BlockLayout) -> Array:
    """(n,) what a prediction lacks in a second."""
    lacking = np.zeros(layout.size)
    for slot, _, value, _ in offsets:
        if slot.is_predicted and slot.of in event.blocks:
            lacking[layout.start[slot.of] + slot.entry] += value
    return lacking


def _without(event: Update, offsets: Sequence[Offset]) -> Update:
    """A measurement without constants."""
    residual = event.residual.copy()
    for slot, _, value, _ in offsets:
        if not slot.is_predicted and slot.of == event.sensor:
            residual[slot.entry if slot.entry >= 0 else slice(None)] -= value
    return event._replace(residual=residual)


def interval_s(before_s: float | None, time_s: float | None) -> float:
    """Return a prediction's interval; 1 where there is none, so that what is of it is of each."""
    if before_s is None or time_s is None or not time_s > before_s:
        return 1.0
    return time_s - before_s
