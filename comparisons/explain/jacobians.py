"""Jacobians other than the filter's that residuals ask for: the grammar's changes of F and of H.

A filter that uses a wrong F or H consistently has sound algebra, but its residuals follow the right
one. It may use it for the covariance alone, or, as a linear filter does, for the estimate as well:
then the residuals tell it by the estimate, too. The derivative of their likelihood by each entry,
at each event, tells which change promises most; these are tried by the likelihood itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.replay import BlockLayout, Columns
from comparisons.explain.noises import Factors, log_likelihoods
from comparisons.explain.recorded_steps import RecordedStep
from comparisons.faults.grammar import (
    Composition,
    Part,
    Slot,
    Values,
    parts,
    plus_number,
    single_changes,
    times_number,
)
from comparisons.faults.operands import Operand, slot_of
from comparisons.innovations import NO_SENSOR
from comparisons.trace.events import Event, Predict, SensorDescription, TracePrior, Update

_MOST_WORK = 5e7
"""Changes without a number that are tried, times events, times entries of a covariance."""
_MOST_FITTED = 30
"""Changes with a number that are fitted, of those that promise most."""
_MOST_AT_ONCE = 100
"""Changes whose likelihoods are computed together."""
_SHARES = (10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, -0.3, -1.0, -3.0)
"""Of the way to where derivatives alone place a number, at which its fit may begin.

Also the other way: about a term that is zero the likelihood is all but even.
"""
_LEAST_GAINED = 3.0
"""Of the likelihood's logarithm, by derivatives or a try: less is nothing."""
_MOST_ENTRIES = 50_000
"""Of Jacobians whose derivatives are kept: of more, events are left out evenly."""
_MOST_TERMS = 400
"""Of a Jacobian: a larger one is of many blocks, and not gone through."""
_ROUNDS = 4
"""Of Newton's steps to a number."""


class EventKind(NamedTuple):
    """Events whose Jacobians stand for the same.

    Attributes:
        matrix: F or H.
        of: The blocks that predictions are of, or the sensor.
        dims: Of the blocks.
        measured: Components of the measurement; 0 of a prediction.
    """

    matrix: str
    of: str
    dims: tuple[int, ...]
    measured: int


class JacobianSlot(NamedTuple):
    """A Jacobian of a filter that is another, in all events.

    Attributes:
        matrix: F or H.
        of: The blocks that predictions are of, or the sensor.
        change: What the right one is beside it, in words, whatever the number.
        moves_estimate: The filter computes its estimate by it as well, or what it expects.
        since: The first event: of all of them.
    """

    matrix: str
    of: str
    change: str
    moves_estimate: bool = False
    since: int = 0

    def words(self, components: Sequence[str] = ()) -> str:
        """Return what it is called. components: of the sensor, which change no word of it."""
        del components
        if self.matrix == "H":
            more = ", in what it expects as well" if self.moves_estimate else ""
            return f"H of sensor `{self.of}`{more}"
        return f"F of {self.of}{', in their estimate as well' if self.moves_estimate else ''}"


class JacobianChange(NamedTuple):
    """What a right Jacobian is beside the filter's.

    Attributes:
        slot: Which.
        gained: Of the likelihood's logarithm, less what a number of its size must gain more.
        events: Of which it is.
        composition: What makes the right one of the filter's.
        numbers: Of the composition: none, or one.
        interval: Of the number, 95 %.
    """

    slot: JacobianSlot
    gained: float
    events: EventKind
    composition: Composition
    numbers: tuple[float, ...] = ()
    interval: tuple[float, float] = (0.0, 0.0)

    def of(self, jacobians: Array) -> Array:
        """Return (N, r, c) the right Jacobians for the filter's."""
        return self.composition.values(Values(sound=jacobians), *self.numbers)

    def said(self) -> str:
        """Return it in words, with its number."""
        return f"another {self.slot.words()}: {self.composition.said(*self.numbers)}"


@dataclass(kw_only=True)
class JacobianGroup:
    """The Jacobians of a kind of events.

    Attributes:
        kind: Of the events.
        names: Of their blocks; of those that are not the same in all, what they are called.
        numbers: Of the events.
        jacobians: Theirs, (r, c) each.
        estimates: (c,) each, of the blocks before the event.
        stride: One of so many events is taken.
    """

    kind: EventKind
    names: list[str]
    numbers: list[int] = field(default_factory=list)
    jacobians: list[Array] = field(default_factory=list)
    estimates: list[Array] = field(default_factory=list)
    stride: int = 1

    def take(self, event: Predict | Update, estimate: Array | None) -> None:
        """Add an event's."""
        self.numbers.append(event.number)
        self.jacobians.append(event.jacobian)
        nothing = np.zeros(event.jacobian.shape[1])
        self.estimates.append(nothing if estimate is None else estimate)
        for k, name in enumerate(event.blocks):
            if self.names[k] != name:
                self.names[k] = f"its block {k + 1}"

    def thinned(self, most: int) -> JacobianGroup:
        """Return events spread over all, with at most so many entries of Jacobians."""
        stride = -(-len(self.numbers) * self.jacobians[0].size // most)
        return JacobianGroup(
            kind=self.kind,
            names=self.names,
            numbers=self.numbers[::stride],
            jacobians=self.jacobians[::stride],
            estimates=self.estimates[::stride],
            stride=stride,
        )

    def operand(self, components: Sequence[str]) -> Operand:
        """Return what the grammar makes changes of. components: of the sensor, by name."""
        inner = tuple(zip(self.names, self.kind.dims, strict=True))
        measured = tuple(components) if len(components) == self.kind.measured else ()
        shape = self.jacobians[0].shape
        return Operand(self.kind.matrix, shape, inner, "", inner, tuple(self.names), measured)


def _kind_of(event: Event, layout: BlockLayout) -> EventKind | None:
    """Of which Jacobians an event has one, if any. layout: before it."""
    match event:
        case Predict():
            matrix, of, measured = "F", ", ".join(event.blocks), 0
        case Update():
            matrix, of, measured = "H", event.sensor, len(event.residual)
        case _:
            return None
    return EventKind(matrix, of, tuple(layout.dims[name] for name in event.blocks), measured)


class _Kept(NamedTuple):
    """A step with a Jacobian. kind: of its event. at: entries (c,) of its blocks, of (n,)."""

    event: Predict | Update
    kind: EventKind
    at: Columns
    size: int


def _with_kinds(steps: Iterable[RecordedStep]) -> Iterator[tuple[RecordedStep, _Kept | None]]:
    """Yield steps, and of those with a Jacobian of which kind it is."""
    layout = BlockLayout()
    for step in steps:
        event, kind = step.event, _kind_of(step.event, layout)
        if isinstance(event, Predict | Update) and kind is not None:
            yield step, _Kept(event, kind, layout.columns(event.blocks), layout.size)
            continue
        if isinstance(event, TracePrior):
            layout = BlockLayout(event.blocks, event.dims)
        layout.follow(event)
        yield step, None


def jacobian_groups(steps: Iterable[RecordedStep]) -> list[JacobianGroup]:
    """Return the Jacobians of a trace by kind, so many that their derivatives can be kept."""
    groups: dict[EventKind, JacobianGroup] = {}
    for step, kept in _with_kinds(steps):
        if kept is not None and kept.event.jacobian.size <= _MOST_TERMS:
            new = JacobianGroup(kind=kept.kind, names=list(kept.event.blocks))
            groups.setdefault(kept.kind, new).take(kept.event, step.estimate)
    return [group.thinned(_MOST_ENTRIES // len(groups)) for group in groups.values()]


def with_jacobians(
    steps: Iterable[RecordedStep], changes: Sequence[JacobianChange]
) -> Iterator[RecordedStep]:
    """Yield events with other Jacobians, beside the filter's own corrections."""
    if not changes:
        yield from steps
        return
    for step, kept in _with_kinds(steps):
        if kept is not None:
            for change in changes:
                step = _changed(step, kept, change)
        yield step


def _changed(step: RecordedStep, kept: _Kept, change: JacobianChange) -> RecordedStep:
    """A step with another Jacobian, and what follows for a filter that moves its estimate by it."""
    event = step.event
    if change.events != kept.kind or not isinstance(event, Predict | Update):
        return step
    right = change.of(event.jacobian[None])[0]
    if change.slot.moves_estimate and step.estimate is not None:
        lacking = (right - event.jacobian) @ step.estimate
        if isinstance(event, Update):
            event = event._replace(residual=event.residual - lacking)
        else:
            applied = np.zeros(kept.size) if step.applied is None else step.applied.copy()
            applied[kept.at] -= lacking
            step = step._replace(applied=applied)
    return step._replace(event=event._replace(jacobian=right))


def _stacked(
    steps: Iterable[RecordedStep], changes: Sequence[JacobianChange]
) -> Iterator[RecordedStep]:
    """Yield events as they are, and by each change, one after the other (1 + N, ...)."""
    rows_of: dict[EventKind, list[int]] = {}
    for k, change in enumerate(changes):
        rows_of.setdefault(change.events, []).append(k)
    moves = np.array([False, *(change.slot.moves_estimate for change in changes)])
    for step, kept in _with_kinds(steps):
        if kept is None or kept.kind not in rows_of:
            yield step
            continue
        event, rows = kept.event, rows_of[kept.kind]
        right = np.repeat(event.jacobian[None], 1 + len(changes), axis=0)
        right[[1 + k for k in rows]] = [changes[k].of(event.jacobian[None])[0] for k in rows]
        if step.estimate is not None and moves.any():
            lacking = (right - event.jacobian) @ step.estimate * moves[:, None]
            if isinstance(event, Update):
                event = event._replace(residual=event.residual - lacking)
            else:
                applied = np.zeros((1 + len(changes), kept.size))
                applied += 0.0 if step.applied is None else step.applied
                applied[:, kept.at] -= lacking
                step = step._replace(applied=applied)
        yield step._replace(event=event._replace(jacobian=right))


def _gains(
    steps: Sequence[RecordedStep], factors: Factors, changes: Sequence[JacobianChange]
) -> Array:
    """(N,) what changes add to the likelihood's logarithm; some of them at once."""
    gained = []
    for first in range(0, len(changes), _MOST_AT_ONCE):
        some = changes[first : first + _MOST_AT_ONCE]
        logs = log_likelihoods(_stacked(steps, some), [factors] * (1 + len(some)))
        gained.append(np.nan_to_num(logs[1:] - logs[0], nan=-np.inf))
    return np.concatenate(gained) if gained else np.empty(0)


class JacobianGradient(NamedTuple):
    """Derivatives of the likelihood's logarithm, of the residuals and of drawn ones.

    Attributes:
        slope: (r, c, 1 + D) by the entries of a Jacobian.
        noise: (r, 1 + D) by what it leads to.
    """

    slope: Array
    noise: Array

    def with_estimate(self, estimate: Array) -> Array:
        """Return (r, c, 1 + D) those of a Jacobian that an estimate (c,) is moved by as well."""
        slope: Array = self.slope + self.noise[:, None, :] * estimate[:, None]
        return slope


class _Promise(NamedTuple):
    """A change that derivatives alone speak for.

    Attributes:
        change: With its number where they place it.
        gained: Of the likelihood's logarithm, by them.
        scale: The largest entry of its Jacobians: what is added to one is of this size or less.
    """

    change: JacobianChange
    gained: float
    scale: float

    def must_gain(self, number: float) -> float:
        """Return how much more a number must gain than one of no size, being normal about none."""
        if self.change.composition.change != "plus":
            return 0.0
        return 0.5 * (number / self.scale) ** 2


class TriedJacobians(NamedTuple):
    """changes: those that were tried. total: how many there are."""

    changes: list[JacobianChange]
    total: int


def tried_jacobians(
    steps: Sequence[RecordedStep],
    factors: Factors,
    groups: Sequence[JacobianGroup],
    gradients: Mapping[int, JacobianGradient],
    sensors: Mapping[str, SensorDescription],
) -> TriedJacobians:
    """Return changes of Jacobians that promise most, with what they gain.

    Args:
        steps: Of a trace, from its prior on.
        factors: On its noises.
        groups: Its Jacobians, by kind.
        gradients: Derivatives of the likelihood's logarithm by them, by the events' numbers.
        sensors: What is known of them.
    """
    promised: list[_Promise] = []
    for group in groups:
        operand = group.operand(sensors.get(group.kind.of, NO_SENSOR).components)
        promised += _promises(group, [gradients[number] for number in group.numbers], operand)
    most = _most_tried(steps) // 2
    plain = _tried(
        steps, factors, [promise for promise in promised if not promise.change.numbers], most
    )
    numbered = _selected(
        [promise for promise in promised if promise.change.numbers], most // len(_SHARES)
    )
    tried = [*plain, *_fitted(steps, factors, numbered)]
    likely = [change for change in tried if change.gained > _LEAST_GAINED]
    return TriedJacobians(likely, len(promised))


def _most_tried(steps: Sequence[RecordedStep]) -> int:
    """How many changes are tried, by what each costs."""
    work = sum(kept.size**2 for _, kept in _with_kinds(steps) if kept is not None)
    return int(_MOST_WORK / max(1, work))


def _selected(promised: Sequence[_Promise], most: int) -> list[_Promise]:
    """So many changes, if there are more: half the simplest, half those that promise most.

    Derivatives tell little of a change that is large, as an exchange is.
    """
    if len(promised) <= most:
        return list(promised)
    likeliest = sorted(promised, key=lambda promise: -promise.gained)[: most // 2]
    by_slot = {promise.change.slot: promise for promise in (*likeliest, *promised)}
    return list(by_slot.values())[:most]


def _tried(
    steps: Sequence[RecordedStep], factors: Factors, promised: Sequence[_Promise], most: int
) -> list[JacobianChange]:
    """Changes without a number, with what they gain."""
    changes = [promise.change for promise in _selected(promised, most)]
    gained = _gains(steps, factors, changes).tolist()
    return [change._replace(gained=x) for change, x in zip(changes, gained, strict=True)]


def _promises(
    group: JacobianGroup, gradients: Sequence[JacobianGradient], operand: Operand
) -> Iterator[_Promise]:
    """Yield the changes of a group, those that come to the same once, the simplest first."""
    sound = np.stack(group.jacobians)
    of_entries = [np.stack([gradient.slope for gradient in gradients], axis=2)]
    if any(estimate.any() for estimate in group.estimates):
        pairs = zip(gradients, group.estimates, strict=True)
        of_entries.append(np.stack([pair.with_estimate(x) for pair, x in pairs], axis=2))
    known: set[bytes] = set()
    scale = float(np.abs(sound).max()) or 1.0
    for composition, direction in _changes(operand, sound):
        changed = direction.any(axis=0)
        for slopes, moves_estimate in zip(of_entries, (False, True), strict=False):
            slope = np.einsum("nk,knd->d", direction[:, changed], slopes[changed])
            information = float(np.mean(slope[1:] ** 2))
            if not (information > 0.0 and np.isfinite(slope).all()) or slope.tobytes() in known:
                continue
            known.add(slope.tobytes())
            toward = float(slope[0]) / information
            information *= group.stride
            numbers = tuple(start + toward for start in composition.start)
            gained = (0.5 * toward * toward if numbers else toward - 0.5) * information
            if not math.isfinite(gained):  # of numbers that overflow
                continue
            words = composition.said(*composition.start)
            slot = JacobianSlot(group.kind.matrix, group.kind.of, words, moves_estimate)
            yield _Promise(
                JacobianChange(slot, 0.0, group.kind, composition, numbers), gained, scale
            )


def _changes(operand: Operand, sound: Array) -> Iterator[tuple[Composition, Array]]:
    """Yield changes, and what they add to Jacobians (N, r, c), those with a number for each 1."""
    slot, values = slot_of(operand), Values(sound=sound)
    for composition in single_changes(slot, values):
        direction = composition.values(values) - sound
        if np.isfinite(direction).all():
            yield composition, direction
    for part in parts(slot):
        said = f"{part.words} is {{0:.4g}} times the filter's"
        yield Composition(slot, "times", said, times_number(part.mask), (1.0,)), sound * part.mask
    single = [part for part in parts(slot) if np.count_nonzero(part.mask) == 1]
    for part in (*single, *_diagonals(slot)):
        said = f"{part.words} is the filter's {{0:+.4g}}"
        direction = np.broadcast_to(part.mask.astype(float), sound.shape)
        yield Composition(slot, "plus", said, plus_number(part.mask), (0.0,)), direction


def _diagonals(slot: Slot) -> Iterator[Part]:
    """Yield the diagonals of square blocks: what lacks a multiple of the identity, as dt I."""
    for of, rows in slot.movable_rows.items():
        for by, columns in slot.movable_columns.items():
            if len(rows) == len(columns) > 1:
                mask = np.zeros(slot.shape, dtype=bool)
                mask[rows, columns] = True
                yield Part(f"the diagonal of {of} by {by} in {slot.name}", mask)


def _fitted(
    steps: Sequence[RecordedStep], factors: Factors, promised: Sequence[_Promise]
) -> list[JacobianChange]:
    """Changes with a number, where it is likeliest: those that gain most by some number."""
    if not promised:
        return []
    starts = np.array([promise.change.composition.start[0] for promise in promised])
    toward = np.array([promise.change.numbers[0] for promise in promised]) - starts
    tried = starts[:, None] + np.multiply.outer(toward, _SHARES)
    by_number = _gains_by_number(steps, factors, promised, tried)
    best = np.argsort(-by_number.max(axis=1), kind="stable")[:_MOST_FITTED]
    best = best[by_number[best].max(axis=1) > _LEAST_GAINED]
    promised = [promised[k] for k in best]
    starts, tried, by_number = starts[best], tried[best], by_number[best]
    numbers = tried[np.arange(len(best)), by_number.argmax(axis=1)]

    def gains(numbers: Array) -> Array:
        return _gains_by_number(steps, factors, promised, numbers)

    curve = _curve(gains, numbers, np.maximum(0.1 * np.abs(numbers - starts), 1e-9))
    for _ in range(_ROUNDS):
        curve = _curve(gains, curve.toward, curve.width)
    fitted = []
    for promise, *row in zip(promised, *(column.tolist() for column in curve), strict=True):
        number, gained, bend, *_ = row
        if bend < 0.0:
            half = 1.96 / np.sqrt(-bend)
            more = promise.must_gain(number)
            change = promise.change._replace(gained=gained - more, numbers=(number,))
            fitted.append(change._replace(interval=(number - half, number + half)))
    return fitted


def _gains_by_number(
    steps: Sequence[RecordedStep], factors: Factors, promised: Sequence[_Promise], numbers: Array
) -> Array:
    """(N, k) what changes gain by k numbers (N, k) each."""
    tried = [
        promise.change._replace(numbers=(number,))
        for promise, row in zip(promised, numbers.tolist(), strict=True)
        for number in row
    ]
    return _gains(steps, factors, tried).reshape(numbers.shape)


class _Curve(NamedTuple):
    """The likelihood about N numbers, (N,) each.

    Attributes:
        numbers: Where.
        gained: There, of the likelihood's logarithm.
        bend: Its second derivative.
        toward: Where it is likelier, by Newton's step.
        width: By how much to go there next, for derivatives.
    """

    numbers: Array
    gained: Array
    bend: Array
    toward: Array
    width: Array


def _curve(gains: Callable[[Array], Array], numbers: Array, width: Array) -> _Curve:
    """The likelihood about numbers (N,), by differences. gains: of (N, 3). width: (N,)."""
    low, gained, high = gains(numbers[:, None] + np.multiply.outer(width, (-1.0, 0.0, 1.0))).T
    with np.errstate(all="ignore"):
        bend = np.nan_to_num((low - 2.0 * gained + high) / width**2, nan=0.0, posinf=0.0)
        slope = np.nan_to_num((high - low) / (2.0 * width))
        bent = bend < 0.0
        move = np.where(bent, -slope / bend, np.sign(slope) * width)
        sigma = np.where(bent, 1.0 / np.sqrt(-bend), width)
    toward = numbers + np.clip(np.nan_to_num(move), -4.0 * width, 4.0 * width)
    return _Curve(numbers, gained, bend, toward, np.clip(sigma, 0.1 * width, width))
