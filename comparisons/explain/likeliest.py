"""The one noise or constant that makes residuals likeliest: by derivatives first, then fitted."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from scipy.special import gammaincc

from comparisons.explain.noises import (
    Factors,
    NoiseFactor,
    NoiseSlot,
    fitted_noises,
    log_likelihoods,
    noise_slots,
)
from comparisons.explain.offsets import Offset, OffsetSlot, fitted_offsets, offset_slots
from comparisons.explain.recorded_steps import RecordedStep
from comparisons.explain.scores import ScoredSlot, Slot, scored_slots

LATER = 4.0
"""By how much more the likelihood's logarithm must gain from some event on than of the whole."""
AS_LIKELY = 4.0
"""Difference of logarithms of likelihoods, within which another cause is as good."""
_MOST_FITTED = 8
"""Slots that are fitted, of those whose derivatives promise most."""
_LEAST_PROMISE, _LEAST_FITTED = 3.0, 5.0
"""Of the likelihood's logarithm, by derivatives and by fits: less is nothing."""
_BEGINNINGS = 24
"""Tried over the whole trace, and half as many between those about the likeliest of them."""
_ROUNDS, _MOST_NARROWED = 3, 3
"""How often this is repeated, and for how many causes."""

Fitted = NoiseFactor | Offset


class InnovationCause(NamedTuple):
    """A noise that is not as stated, or a constant, that residuals show.

    Attributes:
        fitted: Which, and its number.
        p_value: That chance shows as much, of all that were tried.
        others: What explains as much, by itself.
        begun: Events, from one between which it is there.
    """

    fitted: Fitted
    p_value: float
    others: tuple[Fitted, ...] = ()
    begun: tuple[int, int] = (0, 0)

    @property
    def slot(self) -> Slot:
        """Where."""
        return self.fitted.slot


def likeliest_cause(
    steps: Sequence[RecordedStep], factors: Factors, level: float
) -> InnovationCause | None:
    """Return the cause that explains most, if chance does not.

    Args:
        steps: Of a trace, from its prior on.
        factors: On its noises, that are there already.
        level: Share of sound traces for which one may be named.
    """
    known = {_whole(slot) for slot in factors}
    slots: list[Slot] = [
        *(one for one in noise_slots(steps) if one not in known),
        *offset_slots(steps),
    ]
    promising = sorted(scored_slots(steps, slots, factors), key=_promise)[-_MOST_FITTED:]
    if not promising or _promise(promising[-1]) < _LEAST_PROMISE:
        return None
    whole = _fitted(steps, [one.slot for one in promising], factors)
    if not whole:
        return None
    later = _later(steps, promising, whole, factors)
    fits = [*whole, *(one.fitted for one in later)]
    best, begun = _simplest(whole), (0, 0)
    least = best.gained + LATER
    for one in later:
        if one.fitted.gained > max(best.gained, least):
            best, begun = one.fitted, one.begun
    p_value = min(1.0, len(slots) * float(gammaincc(0.5, max(0.0, _rank(best)))))
    if not p_value < level:
        return None
    alike = [one for one in fits if _rank(one) > _rank(best) - AS_LIKELY]
    others = {_whole(one.slot): one for one in sorted(alike, key=_rank)}
    others.pop(_whole(best.slot), None)
    return InnovationCause(best, p_value, tuple(reversed(others.values())), begun)


def _rank(one: Fitted) -> float:
    """What a cause gains, less what one from some event on must gain more."""
    return one.gained - (LATER if one.slot.since else 0.0)


def _whole(slot: Slot) -> Slot:
    return slot._replace(since=0)


def _promise(one: ScoredSlot) -> float:
    return max(one.gained, one.gained_since)


def _fitted(steps: Sequence[RecordedStep], slots: Sequence[Slot], factors: Factors) -> list[Fitted]:
    """Causes of slots, those that are told."""
    noises = [slot for slot in slots if isinstance(slot, NoiseSlot)]
    offsets = [slot for slot in slots if isinstance(slot, OffsetSlot)]
    return [*fitted_noises(steps, noises, factors), *fitted_offsets(steps, offsets, factors)]


def _simplest(fits: Sequence[Fitted]) -> Fitted:
    """The likeliest; of all of a sensor's noise before that of a component, if it is as likely."""
    best = max(fits, key=lambda one: one.gained)
    if isinstance(best.slot, NoiseSlot) and best.slot.component >= 0:
        every = best.slot._replace(component=-1)
        for one in fits:
            if one.slot == every and one.gained > best.gained - AS_LIKELY:
                return one
    return best


class _Later(NamedTuple):
    """A cause from some event on, and the first and last event from which it is as likely."""

    fitted: Fitted
    begun: tuple[int, int]


def _later(
    steps: Sequence[RecordedStep],
    promising: Sequence[ScoredSlot],
    whole: Sequence[Fitted],
    factors: Factors,
) -> list[_Later]:
    """The likeliest causes, each from the event on from which it is likeliest."""
    begun = [one.slot._replace(since=one.since) for one in promising if one.since]
    by_slot = {one.slot: one for one in whole}
    for one in _fitted(steps, begun, factors):
        before = by_slot.get(_whole(one.slot))
        if before is not None and one.gained > before.gained:
            by_slot[_whole(one.slot)] = one
    likeliest = list(by_slot.values())
    if not max(one.gained for one in likeliest) > _LEAST_FITTED:
        return []
    promised = {one.slot: one.since for one in promising}
    gained = _gains_by_beginning(steps, likeliest, promised, factors)
    later: dict[Slot, tuple[int, int]] = {}
    for one, by in zip(likeliest, gained, strict=True):
        if by:
            alike = [since for since in by if by[since] > max(by.values()) - AS_LIKELY]
            since = max(by, key=lambda since: by[since])
            later[one.slot._replace(since=since)] = min(alike), max(alike)
    return [_Later(one, later[one.slot]) for one in _fitted(steps, list(later), factors)]


def _gains_by_beginning(
    steps: Sequence[RecordedStep],
    likeliest: Sequence[Fitted],
    promised: Mapping[Slot, int],
    factors: Factors,
) -> list[dict[int, float]]:
    """What causes gain from events on: spread over the trace, then narrowed down.

    promised: the event from which on each slot promises most.
    """
    numbers = [[e.number for e, _ in steps if one.slot.touches(e)][1:] for one in likeliest]
    tried = [
        [*_spread(of, 0, len(of) - 1, _BEGINNINGS), *_nearest(of, promised[_whole(one.slot)])]
        for one, of in zip(likeliest, numbers, strict=True)
    ]
    gained = _gains(steps, likeliest, tried, factors)
    for _ in range(_ROUNDS):
        most = sorted((max(by.values(), default=0.0) for by in gained), reverse=True)
        least = most[:_MOST_NARROWED][-1]
        pairs = zip(numbers, gained, strict=True)
        tried = [_about(of, by) if max(by.values(), default=0.0) >= least else []
                 for of, by in pairs]  # fmt: skip
        narrowed = _gains(steps, likeliest, tried, factors)
        gained = [by | other for by, other in zip(gained, narrowed, strict=True)]
    return gained


def _spread(numbers: Sequence[int], low: int, high: int, count: int) -> list[int]:
    """So many of some numbers, from one to another; none of none."""
    rows = {low + (high - low) * k // (count - 1) for k in range(count)} if numbers else set()
    return [numbers[row] for row in sorted(rows)]


def _nearest(numbers: Sequence[int], since: int) -> Sequence[int]:
    """Some numbers about one."""
    at = bisect_left(numbers, since)
    return numbers[max(0, at - _BEGINNINGS // 4) : at + _BEGINNINGS // 4]


def _about(numbers: Sequence[int], gained: Mapping[int, float]) -> list[int]:
    """Numbers between the two beside the one that gains most."""
    if not gained:
        return []
    tried = sorted(gained)
    at = tried.index(max(tried, key=lambda since: gained[since]))
    low, high = (numbers.index(tried[min(max(k, 0), len(tried) - 1)]) for k in (at - 1, at + 1))
    return [since for since in _spread(numbers, low, high, _BEGINNINGS // 2) if since not in gained]


def _gains(
    steps: Sequence[RecordedStep],
    causes: Sequence[Fitted],
    beginnings: Sequence[Sequence[int]],
    factors: Factors,
) -> list[dict[int, float]]:
    """What causes gain from each of some events on; factors as they are, constants fitted."""
    pairs = [
        (k, cause, cause.slot._replace(since=since))
        for k, cause in enumerate(causes)
        for since in beginnings[k]
    ]
    noises = [(k, slot, one.factor) for k, one, slot in pairs if isinstance(one, NoiseFactor)]
    gained: list[dict[int, float]] = [{} for _ in causes]
    if noises:
        logs = log_likelihoods(steps, [factors, *({**factors, s: x} for _, s, x in noises)])
        for (k, slot, _), value in zip(noises, (logs[1:] - logs[0]).tolist(), strict=True):
            gained[k][slot.since] = value
    at = {slot: k for k, _, slot in pairs}
    offsets = [slot for slot in at if isinstance(slot, OffsetSlot)]
    for one in fitted_offsets(steps, offsets, factors):
        gained[at[one.slot]][one.slot.since] = one.gained
    return gained
