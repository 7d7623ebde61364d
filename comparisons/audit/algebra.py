"""What of a filter's algebra is wrong: its snapshots beside the recursion over its events.

The recursion goes on from each snapshot that is wrong, so that every fault is found where it
happens. For `audit`, which has a trace, and for `run`, which goes through its filter once more.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.faults import KnownFault, known_faults
from comparisons.audit.replay import Fused, Layout, Replay, apart, check_gain, largest_pair
from comparisons.statistics import ROUNDING, units
from comparisons.trace.events import (
    Augment,
    Blocks,
    Clone,
    Directions,
    Event,
    Predict,
    Prior,
    Remove,
    Reset,
    Snapshot,
    Update,
)

MOST_SEARCHED = 20
"""Faults of the algebra whose cause is sought; more of other causes are counted."""
MOST_KEPT = 5_000
"""Events since the last snapshot that are kept for this."""
MOST_REPLAYED = 100_000
"""Events that are replayed in search of one cause."""
_SHARE = 1e-4
"""Of the difference that a known error must not leave unexplained."""
_LOST = 64 * float(np.finfo(float).eps)
"""Of an estimate's numbers, as rounding."""
_RANK = {"algebra": 0, "covariance": 1, "correction": 0, "gain": 0}


class Finding(NamedTuple):
    """What the audit found.

    check: algebra, covariance, correction, gain, innovations, smoother, nees or spurious.
    fault: false for what is named, not condemned. text: a sentence. event: where it is first seen,
    or None; sensor and blocks: which it is of.
    """

    check: str
    fault: bool
    text: str
    event: int | None
    sensor: str | None
    blocks: Blocks


class AlgebraCheck:
    """Goes through events, the prior first, and keeps what it finds.

    replay: the recursion. sound: no snapshot was wrong; optimal: no gain was other than Kalman's.
    gains: how many gains and corrections were compared with Kalman's.
    """

    replay: Replay

    def __init__(self, tolerance: float = ROUNDING) -> None:
        """tolerance: what rounding explains, in standard deviations."""
        self.tolerance = tolerance
        self.sound = self.optimal = True
        self.gains = 0
        self._known: set[str] = set()
        self._searched = 0
        self._broken: set[str] = set()
        self._found: dict[str, tuple[Finding, float | None, int]] = {}
        self._pending: list[Finding] = []
        self._start: Replay | None = None
        self._kept: list[Event] = []
        self._last: Event
        self._numbers: dict[str, Array] = {}

    def take(self, event: Event) -> Fused | None:
        """Do an event, or compare a snapshot; return what an update came to."""
        if isinstance(event, Directions):
            return None
        self._estimate(event)
        if isinstance(event, Snapshot):
            self._snapshot(event)
            return None
        self._last = event
        if isinstance(event, Prior):
            self.replay = Replay(event)
            self._restart()
            return None
        if self._start is not None:
            self._kept.append(event)
            if len(self._kept) > MOST_KEPT:
                self._start = None
        fused = self.replay.apply(event)
        if isinstance(event, Update) and event.used and fused is not None:
            self._gain(event, fused)
        return fused

    def add(self, finding: Finding, kind: str) -> None:
        """Keep the first finding of a kind, and count the others."""
        key = f"{finding.check}|{finding.sensor}|{kind}"
        first, seen_s, count = self._found.get(key, (finding, self._last.time_s, 0))
        self._found[key] = first, seen_s, count + 1

    def end(self) -> None:
        """Accept what was found since the last snapshot."""
        self._confirm(None)

    def findings(self, *, timed: bool = False) -> tuple[Finding, ...]:
        """Return findings, faults first, those of one event's algebra before what follows.

        timed: with the time at which each is first seen, where events have times.
        """
        found = []
        for first, seen_s, count in self._found.values():
            at = f" (at {seen_s:.6g} s)" if timed and seen_s is not None else ""
            more = f"; and {count - 1:,} more" if count > 1 else ""
            found.append(first._replace(text=first.text + at + more))
        never = float("inf")
        return tuple(
            sorted(
                found,
                key=lambda f: (
                    not f.fault,
                    _RANK.get(f.check, 2),
                    never if f.event is None else f.event,
                ),
            )
        )

    def faults(self) -> tuple[str, ...]:
        """Return all faults in words, with their times where events have them."""
        self.end()
        return tuple(one.text for one in self.findings(timed=True) if one.fault)

    def _gain(self, event: Update, fused: Fused) -> None:
        if event.gain is None and event.correction is None:
            return
        self.gains += 1
        sigma: Array = np.sqrt(np.maximum(self.replay.covariance.diagonal(), 0.0))
        layout = self.replay.layout
        for one in check_gain(event, fused, sigma, layout, self.tolerance):
            text = f"{name_of(event)} {one.what}"
            check = "correction" if one.fault else "gain"
            self._pending.append(
                Finding(check, one.fault, text, event.number, event.sensor, one.blocks)
            )

    def _snapshot(self, snapshot: Snapshot) -> None:
        """Compare a snapshot with the recursion, which goes on from it where it is wrong."""
        if not np.isfinite(snapshot.covariance).all():
            text, number = f"{name_of(self._last)} leads to no finite covariance", snapshot.number
            self.add(Finding("covariance", True, text, number, None, ()), "not finite")
            return
        at = self.replay.layout.columns(snapshot.blocks)
        recorded, right = snapshot.covariance, self.replay.covariance[at][:, at]
        self._covariance(snapshot)
        wrong = not float(apart(recorded, right).max()) <= self.tolerance
        whole = len(recorded) == self.replay.layout.size and isinstance(at, slice)
        if wrong and not (not whole and self._broken >= set(snapshot.blocks)):
            self._localise(snapshot)
        else:
            self._confirm(None)
        if wrong:
            self.sound = False
            self._broken = set() if whole else self._broken | set(snapshot.blocks)
            if whole:
                self.replay.covariance = 0.5 * (recorded + recorded.T)
        if whole or self._start is not None:
            self._restart()

    def _restart(self) -> None:
        """Begin an interval between snapshots."""
        self._start, self._kept = self.replay.copy(), []

    def _covariance(self, snapshot: Snapshot) -> None:
        """Symmetry and definiteness; a covariance may be singular, as of a clone."""
        p = snapshot.covariance
        unit = units(p, p)
        scaled = p / np.outer(unit, unit)
        skew = float(np.abs(scaled - scaled.T).max())
        least = _least(0.5 * (scaled + scaled.T), -self.tolerance)
        for bad, what in (
            (skew > self.tolerance, f"is asymmetric, by {skew:.2g} of its sigmas"),
            (least < -self.tolerance, f"is not positive semidefinite (least {least:.2g})"),
        ):
            if bad:
                text = f"the covariance at event {snapshot.number} {what}"
                self.add(Finding("covariance", True, text, snapshot.number, None, ()), what[:12])

    def _estimate(self, event: Event) -> None:
        """Keep the estimate's numbers as events lead to them, and compare a snapshot's."""
        numbers = self._numbers
        match event:
            case Predict():
                self._set(event.blocks, event.after)
            case Prior() if event.point is not None:
                self._numbers = _parts(event.point, Layout(event.blocks, event.dims))
            case Augment():
                self._numbers.pop(event.name, None)
                if event.after is not None and len(event.after) == len(event.jacobian):
                    numbers[event.name] = event.after
            case Update() if event.used:
                self._correct(event.correction)
            case Clone() if event.source in numbers:
                numbers[event.name] = numbers[event.source]
            case Remove():
                self._set(event.blocks, None)
            case Snapshot() if event.mean is not None:
                self._compare_estimate(event, event.mean)

    def _set(self, blocks: Blocks, after: Array | None) -> None:
        """Set the numbers of blocks; None where they are not known any more."""
        if self._numbers:
            for name in blocks:
                self._numbers.pop(name, None)
        if after is not None:
            self._numbers |= _parts(after, self.replay.layout.of(blocks))

    def _correct(self, correction: Array | None) -> None:
        entries, before = self.replay.layout.entries, self._numbers
        self._numbers = (
            {} if correction is None else {b: n + correction[entries(b)] for b, n in before.items()}
        )

    def _compare_estimate(self, snapshot: Snapshot, mean: Array) -> None:
        """Find blocks whose estimate is not what the events lead to."""
        layout = self.replay.layout
        given = _parts(mean, layout.of(snapshot.blocks))
        wrong, largest = [], 0.0
        for name, value in given.items():
            expected = self._numbers.get(name)
            if expected is None:
                continue
            part = layout.entries(name)
            variance = self.replay.covariance.diagonal()[part]
            sigma: Array = np.sqrt(np.where(variance > 0.0, variance, 1.0))
            off = value - expected
            off -= 2.0 * np.pi * np.round(off / (2.0 * np.pi))  # an angle may go round
            allowed = self.tolerance * sigma + _LOST * np.abs(value)
            if not (np.abs(off) <= allowed).all():
                wrong.append(name)
                largest = max(largest, float((np.abs(off) / sigma).max()))
        self._numbers |= given
        if wrong:
            last, names = self._last, ", ".join(wrong)
            text = f"{name_of(last)}: the estimate of {names} is off by {largest:.2g} sigma"
            sensor = last.sensor if isinstance(last, Update) else None
            finding = Finding("correction", True, text, last.number, sensor, tuple(wrong))
            self.add(finding, f"estimate after {type(last).__name__}")

    def _localise(self, snapshot: Snapshot) -> None:
        """Say where and how a snapshot became wrong."""
        if self._start is None or self._searched > MOST_SEARCHED:
            self._pending = []
            text = f"the covariance at event {snapshot.number} is not that of the events before it"
            self.add(Finding("algebra", True, text, snapshot.number, None, ()), "unknown")
            return
        cause = localise(self._start, self._kept, snapshot, self.tolerance, self._known)
        if cause.what not in self._known:
            self._searched += 1
        if cause.known:
            self._known.add(cause.what)
        finding = self._finding(cause, snapshot)
        if cause.event is None and self._pending:
            first = self._pending[0]
            finding = finding._replace(event=first.event, sensor=first.sensor)
        self._confirm(finding.event)
        self.add(finding, cause.what if cause.known else "unknown")

    def _finding(self, cause: Cause, snapshot: Snapshot) -> Finding:
        check = "gain" if cause.sound else "algebra"
        event = cause.event
        if event is None:
            first, last = self._kept[0].number, snapshot.number
            text = f"between events {first} and {last}, {cause.what}"
            return Finding(check, True, text, first, None, cause.blocks)
        sensor = event.sensor if isinstance(event, Update) else None
        tail = ", as at later ones of its kind" if cause.repeated and not cause.sound else ""
        text = f"{name_of(event)}: {cause.what}{tail}"
        return Finding(check, not cause.sound, text, event.number, sensor, cause.blocks)

    def _confirm(self, until: int | None) -> None:
        """Accept what gains were found unlike, up to an event that made the covariance wrong."""
        for finding in self._pending:
            assert finding.event is not None  # noqa: S101 - gains are of updates
            if until is None or finding.event <= until:
                self.optimal = self.optimal and finding.fault
                key = finding.text.split(" ", 2)[2] if finding.sensor else finding.text
                self.add(finding, key)
        self._pending = []


def faults_of(events: Iterable[Event], tolerance: float) -> tuple[str, ...]:
    """Return what is wrong with the algebra of events, in words.

    tolerance: what rounding explains, in standard deviations.
    """
    check = AlgebraCheck(tolerance)
    for event in events:
        check.take(event)
    return check.faults()


def _least(scaled: Array, allowed: float) -> float:
    """Return the least eigenvalue of a symmetric matrix, or what is allowed if it is above that."""
    try:
        np.linalg.cholesky(scaled - allowed * np.eye(len(scaled)))
    except np.linalg.LinAlgError:
        return float(np.linalg.eigvalsh(scaled)[0])
    return allowed


def _parts(numbers: Array, layout: Layout) -> dict[str, Array]:
    """Return the numbers of each block; none where there are not as many as its errors have."""
    if len(numbers) != layout.size:
        return {}
    return {name: numbers[layout.entries(name)] for name in layout.dims}


class Cause(NamedTuple):
    """event: which; None where it is one of several. what: the error, as a predicate of the event.

    blocks: which it is of. known: an error that gives the recorded covariance to rounding. sound:
    it is none, but a choice that is consistent. repeated: all like it, from there on.
    """

    event: Event | None
    what: str
    blocks: Blocks
    known: bool
    sound: bool = False
    repeated: bool = False


def name_of(event: Event) -> str:
    """Return what an event is called: "update 12 of sensor `gps`"."""
    match event:
        case Update():
            return f"update {event.number} of sensor `{event.sensor}`"
        case Augment():
            return f"augmentation {event.number} by block `{event.name}`"
        case Clone():
            return f"clone {event.number} of block `{event.source}`"
        case Predict():
            return f"prediction {event.number}"
        case Remove():
            return f"removal {event.number} of {', '.join(f'`{b}`' for b in event.blocks)}"
        case Reset():
            return f"reset {event.number}"
        case Prior():
            return "the prior"
        case Snapshot() | Directions():
            return f"event {event.number}"


def localise(
    start: Replay,
    events: Sequence[Event],
    snapshot: Snapshot,
    tolerance: float,
    before: Collection[str] = (),
) -> Cause:
    """Return the cause of a snapshot that is not as the events before it say.

    Args:
        start: As after the last snapshot that was right.
        events: Those between the two.
        snapshot: The wrong one.
        tolerance: What rounding explains, in sigmas.
        before: Errors that explained earlier ones; they are tried first.
    """
    changing = [e for e in events if not isinstance(e, Snapshot | Directions | Prior)]
    plain = start.copy()
    for event in changing:
        plain.apply(event)
    at = plain.layout.columns(snapshot.blocks)
    expected = plain.covariance[at][:, at]
    scaled = apart(snapshot.covariance, expected)
    dims = tuple(plain.layout.dims[b] for b in snapshot.blocks)
    allowed = max(tolerance, _SHARE * float(scaled.max()))
    wrong = _wrong(scaled, snapshot.blocks, dims, allowed) if len(changing) == 1 else None
    tries: list[Collection[str] | None] = [before, None] if before else [None]
    for only in tries:
        found = _search(start, changing, snapshot, allowed, only, wrong)
        if found is not None:
            return found
    pair = largest_pair(np.where(np.isfinite(scaled), scaled, np.inf), snapshot.blocks, dims)
    of = f"block {pair[0]}" if pair[0] == pair[1] else f"block {pair[0]} with {pair[1]}"
    what = f"the covariance of {of} is off by {scaled.max():.2g} of its sigmas"
    blocks = tuple(dict.fromkeys(pair))
    return Cause(changing[0] if len(changing) == 1 else None, what, blocks, known=False)


def _search(
    start: Replay,
    events: Sequence[Event],
    snapshot: Snapshot,
    allowed: float,
    only: Collection[str] | None,
    wrong: Blocks | None,
) -> Cause | None:
    """Try every known error at every event, and at all like it from there on; the first that fits.

    An error at a single event goes before the same at several. only: none but these.
    wrong: blocks that a single event has left wrong.
    """
    replayed, before = 0, start.copy()
    several: Cause | None = None
    for i, event in enumerate(events):
        like = _like(event, events[i + 1 :])
        for fault in known_faults(event, before, wrong):
            if only is not None and fault.what not in only:
                continue
            for repeated in (False, True) if like else (False,):
                if repeated and several is not None:
                    continue
                replayed += len(events) - i
                if replayed > MOST_REPLAYED:
                    return several
                if _gives(before, events[i:], fault, repeated, snapshot, allowed):
                    found = Cause(event, fault.what, fault.blocks, True, fault.sound, repeated)
                    if not repeated:
                        return found
                    several = found
        before.apply(event)
    return several


def _wrong(scaled: Array, blocks: Blocks, dims: tuple[int, ...], allowed: float) -> Blocks:
    """Blocks with a covariance that is off by more than allowed."""
    entries = ~(scaled.max(axis=1) <= allowed) | ~(scaled.max(axis=0) <= allowed)
    parts = np.split(entries, np.cumsum(dims)[:-1])
    return tuple(name for name, off in zip(blocks, parts, strict=True) if off.any())


def _like(event: Event, later: Sequence[Event]) -> bool:
    """Whether later events are of the same kind, sensor and blocks."""
    return any(_same(event, other) for other in later)


def _same(event: Event, other: Event) -> bool:
    if type(event) is not type(other):
        return False
    if isinstance(event, Update) and isinstance(other, Update):
        return (event.sensor, event.blocks) == (other.sensor, other.blocks)
    if isinstance(event, Predict | Reset) and isinstance(other, Predict | Reset):
        return event.blocks == other.blocks
    return False


def _gives(
    before: Replay,
    events: Sequence[Event],
    fault: KnownFault,
    repeated: bool,
    snapshot: Snapshot,
    allowed: float,
) -> bool:
    """Whether events with an error in the first, and in those like it, lead to a snapshot."""
    replay = before.copy()
    try:
        fault.apply(replay, events[0])
        for event in events[1:]:
            if repeated and _same(events[0], event):
                again = next(
                    (one for one in known_faults(event, replay) if one.what == fault.what), None
                )
                if again is None:
                    return False
                again.apply(replay, event)
            else:
                replay.apply(event)
    except np.linalg.LinAlgError:
        return False
    at = replay.layout.columns(snapshot.blocks)
    expected = replay.covariance[at][:, at]
    off = float(apart(snapshot.covariance, expected).max())
    return off <= allowed
