"""Events as evidence: which fault of an event gives the covariance that a filter recorded.

The events since the last sound snapshot are done again with a fault in one of them, or in all that
are like it. A fault is named only where it gives the whole snapshot to rounding; the simplest goes
first, one without a number before those whose number is fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import groupby, islice
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.covariances import (
    covariance_gap,
    entry_differences,
    largest_pair,
    units,
)
from comparisons.faults.formulas import alike
from comparisons.faults.of_events import (
    LEVELS,
    NUMBERED_LEVELS,
    EventFault,
    EventFaults,
    adapted,
    afters,
)
from comparisons.faults.recursion import Remembering
from comparisons.faults.substitutions import Substitution, continued
from comparisons.rounding import SINGULAR
from comparisons.trace.events import (
    TELLING,
    Blocks,
    Event,
    Predict,
    Reset,
    Snapshot,
    TracePrior,
    Update,
)

MOST_REPLAYED = 600_000
"""Events that are replayed in search of one cause, where the state is small."""
_SMALL = 20
"""Entries of a state, above which an event counts by the square of their number."""
_MOST_ENTRIES = 4_000_000
"""Of covariances that are computed at once."""
PLAIN, _PLAINLY = 2, 1e-6
"""Digits of a number that somebody has written, and within which share it is that number."""
_STEPS, _CLOSE = 14, 1e-10
"""Of a number's fit: how many at most, and relative to the number, where it ends."""
_FACTORS = (-1.0, 0.0, 0.1, 0.5, 2.0, 3.0, 10.0, float(np.radians(1.0)), float(np.degrees(1.0)))
"""Where the fit of a factor begins that none near one leads to."""
_LESS, _LINEARLY = 0.9, 0.98
"""Of what is left, what the first steps of a number's fit must have come to, and the first alone.
"""
_SHARE = 1e-4
"""Of the difference that a known error must not leave unexplained."""
_PART = 0.01
"""Likewise, of one that only shows along a direction of which the filter is certain."""
_MOST_TIED = 3
"""Errors that explain a snapshot alike, and are named."""


class KnownFault(NamedTuple):
    """An error that explained a snapshot, and an event that it was in."""

    fault: EventFault
    event: Event


class EventCause(NamedTuple):
    """Of a snapshot that is wrong.

    Attributes:
        event: Which; None where it is one of several.
        what: The error, as a sentence on the event.
        blocks: Which it is of.
        kind: Of an error that gives the recorded covariance to rounding, empty where none does.
        sound: It is none, but a choice that is consistent.
        repeated: All like it, from there on.
        known: The error itself.
    """

    event: Event | None
    what: str
    blocks: Blocks
    kind: str = ""
    sound: bool = False
    repeated: bool = False
    known: KnownFault | None = None


def localise(
    start: Remembering,
    events: Sequence[Event],
    snapshot: Snapshot,
    tolerance: float,
    before: Sequence[KnownFault] = (),
    least: Array | None = None,
    *,
    most_replayed: int = MOST_REPLAYED,
) -> EventCause:
    """Return the cause of a snapshot that is not as the events before it say.

    Args:
        start: As after the last snapshot that was right.
        events: Those between the two.
        snapshot: The wrong one.
        tolerance: What rounding explains, in sigmas.
        before: Errors that explained earlier ones; they are tried first.
        least: (n,) variances that are rounding.
        most_replayed: Events that are replayed in search of the cause.
    """
    changing = [e for e in events if not isinstance(e, (TracePrior, *TELLING))]
    plain = start.copy()
    for event in changing:
        plain.apply(event)
    at = plain.layout.columns(snapshot.blocks)
    right = plain.covariance[at][:, at]
    scaled = np.abs(entry_differences(snapshot.covariance, right, least))
    dims = tuple(plain.layout.dims[b] for b in snapshot.blocks)
    largest = float(scaled.max())
    allowed = max(tolerance, _SHARE * min(largest, 1.0)) if largest > tolerance else _PART * largest
    wrong = _wrong(scaled, snapshot.blocks, dims, allowed) if len(changing) == 1 else None
    unit = units(snapshot.covariance, snapshot.covariance, least)
    search = _Search(start, changing, snapshot, (allowed, wrong, unit))
    cause = search.of_known(before) or search.of_all(most_replayed)
    if cause is not None:
        return cause
    pair = largest_pair(np.where(np.isfinite(scaled), scaled, np.inf), snapshot.blocks, dims)
    of = f"block {pair[0]}" if pair[0] == pair[1] else f"block {pair[0]} with {pair[1]}"
    what = f"the covariance of {of} is off by {scaled.max():.2g} of its sigmas"
    if largest <= tolerance:
        worst = covariance_gap(snapshot.covariance, right, units(right, right), SINGULAR).largest
        what += f", by {worst:.2g} along the direction that it is most certain of"
    blocks = tuple(dict.fromkeys(pair))
    return EventCause(changing[0] if len(changing) == 1 else None, what, blocks)


class _Try(NamedTuple):
    """An error at an event, before which a recursion is; in all that are like it from there on."""

    before: Remembering
    at: int
    fault: EventFault
    repeated: bool


class _Fit(NamedTuple):
    """An error that explains the snapshot. digits: of its number; 0 where it has none."""

    digits: int
    one: _Try
    cause: EventCause


class _Search:
    """Tries errors at events, and at all like one from there on; the first that fits.

    An error at a single event goes before the same at several, and one without a number before
    those that are fitted. Errors as simple as each other, at one event, are tried together.
    """

    def __init__(
        self,
        start: Remembering,
        events: Sequence[Event],
        snapshot: Snapshot,
        limits: tuple[float, Blocks | None, Array],
    ) -> None:
        """limits: what may differ; blocks that a single event has left wrong; (n,) units."""
        self.allowed, self.wrong, unit = limits
        self.scale = np.outer(unit, unit)
        self.start, self.events, self.snapshot = start, events, snapshot
        self.recorded = snapshot.covariance / self.scale
        self.left = float(MOST_REPLAYED)
        self.untold: set[str] = set()

    def of_known(self, known: Sequence[KnownFault]) -> EventCause | None:
        """Return which of some errors explains the snapshot."""
        with np.errstate(all="ignore"):
            for i, before in enumerate(self._before_each()):
                for fault, example in known:
                    if not _same(self.events[i], example):
                        continue
                    like = adapted(fault, self.events[i], before)
                    for repeated in (False, True):
                        fits = self._fits([_Try(before, i, like, repeated)])
                        if fits:
                            return fits[0].cause
        return None

    def of_all(self, most_replayed: int) -> EventCause | None:
        """Return what explains the snapshot, if that is told by so many replayed events.

        From simple errors to rare ones, each level at all events, and in several that are alike.
        """
        composed = list(self._composed()) if most_replayed else []
        with np.errstate(all="ignore"):  # an error that is not the filter's may overflow
            for fitted, levels in ((False, LEVELS), (True, NUMBERED_LEVELS)):
                for level in levels:
                    self.left = most_replayed / len(LEVELS)
                    by_event = [
                        (before, faults.numbered(level) if fitted else faults.at(level))
                        for before, faults in composed
                    ]
                    for from_first in (False, True):
                        cause = self._first(self._tries(by_event, from_first=from_first))
                        if cause is not None:
                            return cause
        return None

    def _composed(self) -> Iterator[tuple[Remembering, EventFaults]]:
        """Yield the recursion before each event, and the event's errors."""
        for i, before in enumerate(self._before_each()):
            event = self.events[i]
            yield before, EventFaults(event, before, self.wrong, after_snapshot=i == 0)

    def _before_each(self) -> Iterator[Remembering]:
        """Yield the recursion before each event."""
        before = self.start.copy()
        for event in self.events:
            yield before
            before = before.copy()
            before.step(event)

    def _first(self, tries: Iterator[_Try]) -> EventCause | None:
        """Return the first error that explains the snapshot, within what may be replayed.

        Of those with a number the simplest at the first event with any.
        """
        for _, some in groupby(tries, _simplicity):
            fits = [fit for few in self._at_once(some) for fit in self._fits(few)]
            if fits and not fits[0].one.fault.start:
                smallest = sorted(fits, key=lambda fit: fit.one.fault.terms)
                return _tied([fit.cause for fit in self._distinct(smallest)])
            if fits:
                simplest = min(fits, key=lambda fit: fit.digits)
                # Any number explains what others explain as well: it is told by being plain.
                self.untold |= {fit.cause.kind for fit in fits}
                if simplest.digits <= PLAIN or len(self.untold) == 1:
                    return simplest.cause
            if self.left < 0:
                break
        return None

    def _at_once(self, tries: Iterator[_Try]) -> Iterator[list[_Try]]:
        """Yield as many at a time as fit into memory, while there is something left to replay."""
        count = max(1, _MOST_ENTRIES // self.start.covariance.size)
        while self.left >= 0 and (few := list(islice(tries, count))):
            yield few

    def _distinct(self, fits: Sequence[_Fit]) -> list[_Fit]:
        """Of errors that put the same matrix in the same places, the first alone."""
        distinct: list[_Fit] = []
        matrices: list[tuple[Substitution | None, Array]] = []
        for fit in fits:
            place, substitution = fit.one.fault.place, fit.one.fault.substitution
            if substitution is not None and substitution.composition is not None:
                made = substitution.matrix(fit.one.before, self.events[fit.one.at])
                if any(place == there and alike(made, other) for there, other in matrices):
                    continue
                matrices.append((place, made))
            distinct.append(fit)
        return distinct

    def _tries(
        self, by_event: Sequence[tuple[Remembering, Sequence[EventFault]]], *, from_first: bool
    ) -> Iterator[_Try]:
        """Yield errors, where they may be, and whether all like it have it.

        from_first: at the first event of its kind, and all like it; else at single ones, and the
        rest.
        """
        for i, (before, faults) in enumerate(by_event):
            event = self.events[i]
            first = not any(_same(earlier, event) for earlier in self.events[:i])
            like = any(_same(event, later) for later in self.events[i + 1 :])
            if from_first:
                ways = [True] if first and like else []
            else:
                ways = [False, True] if like and not first else [False]
            for repeated in ways:
                for fault in sorted(faults, key=_tier):
                    if fault.whole or not repeated:
                        yield _Try(before, i, fault, repeated)

    def _fits(self, tries: Sequence[_Try]) -> list[_Fit]:
        """Return which errors give the snapshot."""
        fits = self._reproducing(tries, self._numbers(tries, self._neutral(tries)))
        named = {id(fit.one.fault) for fit in fits}
        factors = [attempt for attempt in tries if attempt.fault.start == (1.0,)]
        factors = [factor for factor in factors if id(factor.fault) not in named]
        if not factors:
            return fits
        fits += self._reproducing(factors, self._numbers(factors, self._nearest(factors)))
        order = {id(attempt.fault): k for k, attempt in enumerate(tries)}
        return sorted(fits, key=lambda fit: order[id(fit.one.fault)])

    def _reproducing(
        self, tries: Sequence[_Try], numbers: Sequence[tuple[float, ...]]
    ) -> list[_Fit]:
        return [
            self._fit(attempt, values)
            for attempt, values, apart in zip(
                tries, numbers, self._off(tries, numbers), strict=True
            )
            if float(np.abs(apart).max()) <= self.allowed
        ]

    def _neutral(self, tries: Sequence[_Try]) -> Array:
        """(T,) numbers of no fault; NaN of errors that have none."""
        return np.array(
            [attempt.fault.start[0] if attempt.fault.start else np.nan for attempt in tries]
        )

    def _nearest(self, tries: Sequence[_Try]) -> Array:
        """(T,) of some factors the one that leaves least."""
        left = [
            np.linalg.norm(self._off_at(tries, np.full(len(tries), factor)), axis=1)
            for factor in _FACTORS
        ]
        best = np.argmin(np.nan_to_num(np.array(left), nan=np.inf), axis=0)
        nearest: Array = np.array(_FACTORS)[best]
        return nearest

    def _fit(self, attempt: _Try, numbers: tuple[float, ...]) -> _Fit:
        fault, event = attempt.fault, self.events[attempt.at]
        repeated = attempt.repeated
        if repeated:
            (once,) = self._off([attempt._replace(repeated=False)], [numbers])
            repeated = not float(np.abs(once).max()) <= self.allowed
        cause = EventCause(
            event, fault.said(*numbers), fault.blocks, fault.kind, fault.sound, repeated,
            KnownFault(fault, event),
        )  # fmt: skip
        count = digits(numbers[0], fault.start[0]) if numbers else 0
        return _Fit(count, attempt, cause)

    def _numbers(self, tries: Sequence[_Try], start: Array) -> list[tuple[float, ...]]:
        """Fit the numbers of errors by secants, all at once; NaN where one explains nothing.

        start: (T,) where to begin; NaN of errors without a number.
        """
        numbers: list[tuple[float, ...]] = [attempt.fault.start for attempt in tries]
        active = np.flatnonzero(np.isfinite(start)).tolist()
        if not active:
            return numbers
        x, neutral = start[active], self._neutral(tries)[active]
        y = 0.9 * x + 1e-6 * (x == 0.0)
        old, now = (self._off_at([tries[k] for k in active], z) for z in (x, y))
        begin = np.linalg.norm(self._off_at([tries[k] for k in active], neutral), axis=1)
        for step in range(_STEPS):
            slope = (now - old) / (y - x)[:, None]
            size = (slope**2).sum(axis=1)
            move = np.where(size > 0.0, (slope * now).sum(axis=1) / size, np.nan)
            linear = np.linalg.norm(now - move[:, None] * slope, axis=1)
            done = np.abs(move) <= _CLOSE * np.abs(y - move)
            x, y = np.where(done, x, y), y - np.where(done, 0.0, move)
            left = np.linalg.norm(now, axis=1) / begin
            hopeless = ~np.isfinite(y) | ((step > 1) & ~(left <= _LESS))
            hopeless |= (step == 0) & ~(linear <= _LINEARLY * begin)
            for k in np.flatnonzero(done | hopeless).tolist():
                numbers[active[k]] = (float(y[k]) if done[k] and not hopeless[k] else np.nan,)
            stay = np.flatnonzero(~(done | hopeless))
            active = [active[k] for k in stay.tolist()]
            if not active:
                break
            x, y, begin, old = x[stay], y[stay], begin[stay], now[stay]
            now = self._off_at([tries[k] for k in active], y)
        for place, k in enumerate(active):
            numbers[k] = (float(y[place]),)
        return numbers

    def _off_at(self, tries: Sequence[_Try], numbers: Array) -> Array:
        """(T, n n) how the snapshot differs by errors with numbers (T,)."""
        off = self._off(tries, [(float(number),) for number in numbers])
        return off.reshape(len(tries), self.recorded.size)

    def _off(self, tries: Sequence[_Try], numbers: Sequence[tuple[float, ...]]) -> Array:
        """Return (T, n, n) how the snapshot differs, in sigmas, by errors at one event.

        NaN where an error leads to no finite covariance, as without an inverse that it needs.
        """
        right = np.full((len(tries), *self.recorded.shape), np.nan)
        for k, covariance in enumerate(self._expected(tries, numbers)):
            if covariance is not None:
                right[k] = covariance
        right /= self.scale
        off = self.recorded - right
        skew = np.abs(off - off.mT).max(axis=(1, 2)) > self.allowed
        even = _halves(self.recorded)
        if skew.any():
            halved = np.stack([even - half(right[skew]) for half in _HALVES])
            least = np.argmin(np.abs(halved).max(axis=(2, 3)), axis=0)
            off[skew] = halved[least, np.arange(len(least))]
        return off

    def _expected(
        self, tries: Sequence[_Try], numbers: Sequence[tuple[float, ...]]
    ) -> list[Array | None]:
        """Return the snapshot's covariance by errors at one event, and in those like it."""
        first, event = tries[0], self.events[tries[0].at]
        later = self.events[first.at + 1 :]
        size = max(1.0, first.before.layout.size / _SMALL)
        self.left -= len(tries) * (1 + len(later)) * size**2
        faults = [attempt.fault for attempt in tries]
        made = afters(faults, numbers, first.before, event)
        possible = [k for k, p in enumerate(made) if p is not None]
        covariances: list[Array | None] = [None] * len(tries)
        if not possible:
            return covariances
        stack = np.stack([p for p in made if p is not None])
        repeated = [faults[k] for k in possible] if first.repeated else []
        replay = first.before.copy()
        replay.step(event)
        for after in later:
            if repeated and _same(event, after):
                stack = self._again(repeated, [numbers[k] for k in possible], replay, after, stack)
            else:
                stack = continued(stack, replay, after)
            replay.step(after)
        columns = replay.layout.columns(self.snapshot.blocks)
        for k, p in zip(possible, stack, strict=True):
            covariances[k] = p[columns][:, columns]
        return covariances

    def _again(
        self,
        faults: Sequence[EventFault],
        numbers: Sequence[tuple[float, ...]],
        replay: Remembering,
        event: Event,
        stack: Array,
    ) -> Array:
        """Return what an event like the first makes of covariances (N, n, n), with the errors.

        Of those whose blocks are still in the state; the others are done without.
        """
        result, dims = continued(stack, replay, event).copy(), replay.layout.dims
        there = [k for k, fault in enumerate(faults) if all(b in dims for b in fault.blocks)]
        some = [faults[k] for k in there]
        made = afters(some, [numbers[k] for k in there], replay, event, stack[there])
        for k, wrong in zip(there, made, strict=True):
            if wrong is not None and wrong.shape == result[k].shape:
                result[k] = wrong
        return result


def _tier(fault: EventFault) -> int:
    return fault.tier


def _simplicity(attempt: _Try) -> tuple[int, bool, int]:
    return attempt.at, attempt.repeated, attempt.fault.tier


def _halves(p: Array) -> Array:
    """The even part of unsymmetric covariances, as it is when nothing else is done to them."""
    return 0.5 * (p + p.mT)


def _lower(p: Array) -> Array:
    return np.tril(p) + np.tril(p, -1).mT


def _upper(p: Array) -> Array:
    return np.triu(p) + np.triu(p, 1).mT


_HALVES: tuple[Callable[[Array], Array], ...] = (_halves, _lower, _upper)
"""What filters make of a covariance that is not symmetric."""


def digits(number: float, neutral: float) -> int:
    """Return how many digits an error's number has, its inverse, or what it is more than neutral.

    More than PLAIN count as one more.
    """
    off = _PLAINLY * abs(number - neutral)
    forms = [(number, off), (number - neutral, off)]
    if number:
        forms.append((1.0 / number, off / number**2))
    for count in range(1, PLAIN + 1):
        if any(abs(x - float(f"{x:.{count}g}")) <= allowed for x, allowed in forms):
            return count
    return PLAIN + 1


def _wrong(scaled: Array, blocks: Blocks, dims: tuple[int, ...], allowed: float) -> Blocks:
    """Blocks with a covariance that is off by more than allowed."""
    entries = ~(scaled.max(axis=1) <= allowed) | ~(scaled.max(axis=0) <= allowed)
    parts = np.split(entries, np.cumsum(dims)[:-1])
    return tuple(name for name, off in zip(blocks, parts, strict=True) if off.any())


def _tied(causes: Sequence[EventCause]) -> EventCause:
    """Return the first of causes that all explain a snapshot, with the others in its words."""
    first = causes[0]
    others = [cause.what for cause in causes[1:] if cause.repeated == first.repeated]
    others = [what for what in dict.fromkeys(others) if what != first.what][: _MOST_TIED - 1]
    return first._replace(what=", or ".join((first.what, *others)))


def _same(event: Event, other: Event) -> bool:
    if type(event) is not type(other):
        return False
    if isinstance(event, Update) and isinstance(other, Update):
        return event.sensor == other.sensor
    if isinstance(event, Predict | Reset) and isinstance(other, Predict | Reset):
        return event.blocks == other.blocks
    return False
