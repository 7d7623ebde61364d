"""Constants that residuals show: of a sensor's component, or of a prediction of an entry.

A constant may also be a share of how the estimate moves: predictions of a block are too long by it,
or a sensor's measurements are late; and it may be one in the axes of the motion, as of a sensor
that is ahead of the place that the filter takes it to measure.

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
_MANY = 4
"""Entries of a block; from so many on its axes are three."""
CONSTANT, MOVES, AHEAD, LEFT = range(4)
"""Kinds: a number, a share of the moves, a number along these or to their left."""


class OffsetSlot(NamedTuple):
    """Where a constant may be.

    Attributes:
        of: A sensor, or a block of the state that predictions are of.
        entry: Of its measurement, or of the block; -1 of all of a measurement alike.
        is_predicted: It is of a block.
        since: The event from which on it is there.
        kind: What it goes with: one of the kinds above.
        entries: Those of a block whose moves it is a share of.
    """

    of: str
    entry: int
    is_predicted: bool
    since: int = 0
    kind: int = CONSTANT
    entries: tuple[int, ...] = ()

    def words(self, components: Sequence[str] = ()) -> str:
        """Return what it is of. components: of the sensor, by name."""
        if self.entries:
            last = f" to {self.of}[{self.entries[-1]}]" if len(self.entries) > 1 else ""
            return f"the predicted moves of {self.of}[{self.entries[0]}]{last}"
        if self.kind != CONSTANT:
            return f"the {'clock' if self.kind == MOVES else 'place'} of sensor `{self.of}`"
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

    def share(self, size: int) -> Array:
        """Return (size,) which entries of a block or measurement it is of, as ones."""
        if self.entry < 0 and not self.entries:
            return np.ones(size)
        return np.isin(np.arange(size), self.entries or (self.entry,)).astype(float)


def regressors(each: float, moved: Array | None, size: int) -> Array:
    """Return what a number of each kind comes to at an event, (4, size).

    Args:
        each: Of a constant.
        moved: (size,) as of a recorded step: of a block, or of what a sensor measures.
        size: Of the block or measurement.
    """
    made = np.zeros((4, size))
    made[CONSTANT] = each
    if moved is not None:
        made[MOVES] = moved
        far = float(np.linalg.norm(moved))
        if size == 2 and far > 0.0:
            made[AHEAD], made[LEFT] = moved / far, np.array((-moved[1], moved[0])) / far
    return made


class Offset(NamedTuple):
    """A constant that residuals show.

    Attributes:
        slot: Where.
        gained: Of the likelihood's logarithm.
        value: What measurements are too large by; or predictions too small, in a second where
            events have times, else at each. Of what goes with moves, as a share of these.
        sigma: Of the value.
    """

    slot: OffsetSlot
    gained: float
    value: float
    sigma: float

    def said(self, words: str, unit: str) -> tuple[str, str]:
        """Return it with its number, and the interval of that.

        words: of its slot. unit: of a constant of predictions.
        """
        slot, ends = self.slot, self.value + 1.96 * self.sigma * np.array((-1.0, 1.0))
        if slot.kind == CONSTANT:
            said = f"a constant {self.value:+.3g}{unit} in {words}"
        elif not slot.is_predicted:
            is_positive = self.value > 0.0
            said = f"measurements of sensor `{slot.of}` {abs(self.value):.3g}"
            said += _SIDES[slot.kind][is_positive]
            ends = ends if is_positive else -ends[::-1]
        elif ends[0] > -1.0:
            said = f"{words} {1.0 / (1.0 + self.value):.3g} times what residuals ask for"
            ends = 1.0 / (1.0 + ends[::-1])
        else:
            said = f"{1.0 + self.value:.3g} times {words} in their place"
            ends = 1.0 + ends
        return said, f"{ends[0]:.3g} to {ends[1]:.3g}"


_SIDES = {
    MOVES: (" s late", " s early"),
    AHEAD: (
        " behind where it is said to be, by its moves",
        " ahead of where it is said to be, by its moves",
    ),
    LEFT: (" to the right of its moves", " to the left of its moves"),
}
"""Of a negative and a positive number."""


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
    moving: dict[OffsetSlot, None] = {}
    layout = BlockLayout()
    for step in steps:
        event, moved = step.event, step.moved
        match event:
            case TracePrior():
                layout = BlockLayout(event.blocks, event.dims)
            case Predict():
                for block in event.blocks:
                    slots |= dict.fromkeys(_of_block(block, layout.dims[block]))
                    if moved is not None:
                        moving |= dict.fromkeys(_moving_slots(block, layout.dims[block]))
            case Update():
                slots |= dict.fromkeys(_of_sensor(event.sensor, len(event.residual)))
                if moved is not None:
                    kinds = (MOVES, AHEAD, LEFT) if len(event.residual) == 2 else (MOVES,)
                    moving |= {OffsetSlot(event.sensor, -1, False, kind=k): None for k in kinds}
            case _:
                layout.follow(event)
    return [*slots, *moving][:_MOST_SLOTS]


def _of_block(block: str, dim: int) -> list[OffsetSlot]:
    return [OffsetSlot(block, entry, True) for entry in range(dim)]


def _of_sensor(sensor: str, size: int) -> list[OffsetSlot]:
    return [OffsetSlot(sensor, entry, False) for entry in range(-1 if size > 1 else 0, size)]


def _moving_slots(block: str, dim: int) -> list[OffsetSlot]:
    """Return factors on the moves of a block's entries: of each, of axes together, of all."""
    together = 2 if dim < _MANY else 3
    runs: list[tuple[int, ...]] = [(k,) for k in range(dim)]
    runs += [tuple(range(k, k + together)) for k in range(0, dim - together + 1, together)]
    runs += [tuple(range(dim))]
    return [OffsetSlot(block, -1, True, 0, MOVES, run) for run in dict.fromkeys(runs)]


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
        self.slots = slots
        self.since = np.array([slot.since for slot in slots])
        self.kind = np.array([slot.kind for slot in slots], dtype=np.intp)
        self.shares: dict[tuple[str, bool, int], tuple[Index, Array]] = {}

    def _shown(
        self, of: str, step: RecordedStep, moved: Array | None, size: int
    ) -> tuple[Index, Array]:
        """Which constants are of a block or sensor, and (K, s) what each makes of it.

        moved: (s,) by which its estimate moved. size: its own.
        """
        key = of, isinstance(step.event, Predict), size
        if key not in self.shares:
            slots = enumerate(self.slots)
            of_these = [k for k, slot in slots if (slot.of, slot.is_predicted) == key[:2]]
            which = np.reshape([self.slots[k].share(size) for k in of_these], (-1, size))
            self.shares[key] = np.array(of_these, dtype=np.intp), which
        members, shares = self.shares[key]
        kinds, there = self.kind[members], self.since[members] <= step.event.number
        each = step.interval_s
        by_kind = regressors(each, moved, size)[kinds] if kinds.any() else each
        return members, shares * by_kind * there[:, None]

    def take(self, step: RecordedStep) -> None:
        """Do an event."""
        event = step.event
        match event:
            case TracePrior():
                self.replay = Replay(event)
                self.off = np.zeros((len(self.since), self.replay.layout.size))
                return
            case Update():
                self._update(event, step)
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
            self._begin(event, step)

    def _begin(self, event: Predict, step: RecordedStep) -> None:
        """Add the constants of a prediction, times its interval where that is known."""
        layout = self.replay.layout
        parts = {} if step.moved is None else layout.parts(event.blocks, step.moved)
        for block in event.blocks:
            which, by = self._shown(block, step, parts.get(block), layout.dims[block])
            self.off[which, layout.entries(block)] += by

    def _update(self, event: Update, step: RecordedStep) -> None:
        """Add an update's innovations; all are fused, as in their likelihood."""
        at = self.replay.layout.columns(event.blocks)
        shown = self.off[:, at] @ event.jacobian.T
        which, by = self._shown(event.sensor, step, step.moved, len(event.residual))
        shown[which] += by
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
    layout = BlockLayout()
    for step in steps:
        event = step.event
        there = [offset for offset in offsets if offset.slot.since <= event.number]
        match event:
            case TracePrior():
                layout = BlockLayout(event.blocks, event.dims)
            case Predict():
                lacking = _lacking(event, there, layout, step)
                if step.applied is not None:
                    lacking = lacking - step.applied
                step = step._replace(applied=-lacking)
            case Update():
                step = step._replace(event=_without(event, there, step.moved))
            case _:
                layout.follow(event)
        yield step


def _lacking(
    event: Predict, offsets: Sequence[Offset], layout: BlockLayout, step: RecordedStep
) -> Array:
    """(n,) what a prediction lacks. step: it, as recorded."""
    lacking = np.zeros(layout.size)
    parts = {} if step.moved is None else layout.parts(event.blocks, step.moved)
    for slot, _, value, _ in offsets:
        if slot.is_predicted and slot.of in event.blocks:
            size = layout.dims[slot.of]
            along = regressors(step.interval_s, parts.get(slot.of), size)[slot.kind]
            lacking[layout.entries(slot.of)] += value * along * slot.share(size)
    return lacking


def _without(event: Update, offsets: Sequence[Offset], moved: Array | None) -> Update:
    """A measurement without constants. moved: (m,) by which it changes in a second."""
    residual = event.residual.copy()
    by_kind = regressors(1.0, moved, len(residual))
    for slot, _, value, _ in offsets:
        if not slot.is_predicted and slot.of == event.sensor:
            residual -= value * by_kind[slot.kind] * slot.share(len(residual))
    return event._replace(residual=residual)
