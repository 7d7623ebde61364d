"""Which event made a covariance wrong, and by which known error."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.faults import KnownFault, known_faults
from comparisons.audit.replay import Replay, apart, largest_pair
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

MOST_REPLAYED = 100_000
"""Events that are replayed in search of one cause."""
_SHARE = 1e-4
"""Of the difference that a known error must not leave unexplained."""


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
