"""The one noise, correlated or not, constant or Jacobian that makes residuals likeliest.

By derivatives of the likelihood first; those that promise most are fitted.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from scipy.special import gammaincc

from comparisons.explain.coloured import ColouredNoise, ColourSlot, coloured_noises
from comparisons.explain.jacobians import (
    JacobianChange,
    JacobianSlot,
    jacobian_groups,
    tried_jacobians,
)
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
from comparisons.explain.scores import ScoredSlot, Slot, likelihood_slopes
from comparisons.trace.events import SensorDescription

LATER = 4.0
"""By how much more the likelihood's logarithm must gain from some event on than of the whole."""
AS_LIKELY = 4.0
"""Difference of logarithms of likelihoods, within which another cause is as good."""
_NOT_TOLD_APART = 7.0
"""The same, within which another cause is named beside: so much may a fitted number bring."""
_MOST_FITTED = 8
"""Slots that are fitted, of those whose derivatives promise most."""
_LEAST_PROMISE, _LEAST_FITTED = 3.0, 5.0
"""Of the likelihood's logarithm, by derivatives and by fits: less is nothing."""
_BEGINNINGS = 24
"""Tried over the whole trace, and half as many between those about the likeliest of them."""
_ROUNDS, _MOST_NARROWED = 3, 3
"""How often this is repeated, and for how many causes."""

Numbered = NoiseFactor | Offset
AnySlot = Slot | JacobianSlot | ColourSlot
Fitted = Numbered | JacobianChange | ColouredNoise


class InnovationCause(NamedTuple):
    """A noise or Jacobian that is not as stated, or a constant, that residuals show.

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
    def slot(self) -> AnySlot:
        """Where."""
        return self.fitted.slot


class _Candidate(NamedTuple):
    """A cause, with what it gains less what it must gain more, and where it begins."""

    fitted: Fitted
    rank: float
    p_value: float
    begun: tuple[int, int] = (0, 0)


def likeliest_cause(
    steps: Sequence[RecordedStep],
    factors: Factors,
    level: float,
    sensors: Mapping[str, SensorDescription],
    *,
    is_off: bool = True,
    is_first: bool = True,
) -> InnovationCause | None:
    """Return the cause that explains most, if chance does not.

    Args:
        steps: Of a trace, from its prior on.
        factors: On its noises, that are there already.
        level: Share of sound traces for which one may be named.
        sensors: What is known of them.
        is_off: Something is known to be off. Where it is not, Jacobians are tried only if another
            noise or a constant would be named.
        is_first: No other is taken in. Only then, and where something is off, may it be a
            correlated noise, which has a factor of its own.
    """
    candidates = _numbered(steps, factors)
    if is_off or any(candidate.p_value < level for candidate in candidates):
        candidates += _of_jacobians(steps, factors, sensors)
    if is_off and is_first:
        candidates += _coloured(steps)
    if not candidates:
        return None
    best = _simplest(max(candidates, key=lambda candidate: candidate.rank), candidates)
    if not best.p_value < level:
        return None
    alike = [candidate for candidate in candidates if _is_alike(candidate, best)]
    others = {
        _whole(candidate.fitted.slot): candidate.fitted
        for candidate in sorted(alike, key=lambda c: c.rank)
    }
    others.pop(_whole(best.fitted.slot), None)
    return InnovationCause(best.fitted, best.p_value, tuple(reversed(others.values())), best.begun)


def beside_others(
    cause: InnovationCause, steps: Sequence[RecordedStep], factors: Factors
) -> InnovationCause:
    """Return a cause with its number as it is beside others; of all events where that is as likely.

    steps, factors: with all other causes taken in. A Jacobian stays as it is.
    """
    if isinstance(cause.fitted, JacobianChange | ColouredNoise):
        return cause
    slot = cause.fitted.slot
    of_all = slot._replace(since=0)
    fitted = {numbered.slot: numbered for numbered in _fitted(steps, list({slot, of_all}), factors)}
    here, whole = fitted.get(slot), fitted.get(of_all)
    if whole is not None and (here is None or whole.gained >= here.gained - LATER):
        return cause._replace(fitted=whole, begun=(0, 0))
    return cause if here is None else cause._replace(fitted=here)


def _is_alike(candidate: _Candidate, best: _Candidate) -> bool:
    """Whether a cause is as likely as the best, with or without what it must gain more."""
    least, least_gained = best.rank - _NOT_TOLD_APART, best.fitted.gained - _NOT_TOLD_APART
    return candidate.rank >= least or candidate.fitted.gained >= least_gained


def _of_jacobians(
    steps: Sequence[RecordedStep], factors: Factors, sensors: Mapping[str, SensorDescription]
) -> list[_Candidate]:
    """Other Jacobians; of many more there are than of numbers, so each must gain more."""
    groups = jacobian_groups(steps)
    asked = {number for group in groups for number in group.numbers}
    gradients = likelihood_slopes(steps, [], factors, asked).gradients
    tried = tried_jacobians(steps, factors, groups, gradients, sensors)
    log_count = math.log(max(1, tried.total))
    more = max(0.0, log_count - math.log(max(1, len(_slots(steps, factors)))))
    return [
        _Candidate(change, change.gained - more, math.exp(min(0.0, log_count - change.gained)))
        for change in tried.changes
    ]


def _coloured(steps: Sequence[RecordedStep]) -> list[_Candidate]:
    """Correlated noises; of two numbers, so each must gain more."""
    noises = coloured_noises(steps)
    return [
        _Candidate(
            noise, noise.gained - LATER, min(1.0, len(noises) * math.exp(LATER - noise.gained))
        )
        for noise in noises
    ]


def _slots(steps: Sequence[RecordedStep], factors: Factors) -> list[Slot]:
    """Noises and constants of the whole trace, without those that are known."""
    known = {_whole(slot) for slot in factors}
    noises = [slot for slot in noise_slots(steps) if slot not in known]
    return [*noises, *offset_slots(steps)]


def _numbered(steps: Sequence[RecordedStep], factors: Factors) -> list[_Candidate]:
    """The likeliest noises and constants, of the whole trace and from some event on."""
    scored = likelihood_slopes(steps, _slots(steps, factors), factors).scored()
    promising = sorted(scored, key=_promise)[-_MOST_FITTED:]
    if not promising or _promise(promising[-1]) < _LEAST_PROMISE:
        return []
    whole = _fitted(steps, [slot.slot for slot in promising], factors)
    if not whole:
        return []
    later = _later(steps, promising, whole, factors)
    return [
        *(_candidate(numbered, len(scored)) for numbered in whole),
        *(_candidate(candidate.fitted, len(scored), candidate.begun) for candidate in later),
    ]


def _candidate(numbered: Numbered, count: int, begun: tuple[int, int] = (0, 0)) -> _Candidate:
    """A cause with one number, of so many."""
    rank = numbered.gained - (LATER if numbered.slot.since else 0.0)
    p_value = min(1.0, count * float(gammaincc(0.5, max(0.0, rank))))
    return _Candidate(numbered, rank, p_value, begun)


def _whole(slot: AnySlot) -> AnySlot:
    return slot._replace(since=0)


def _promise(slot: ScoredSlot) -> float:
    return max(slot.gained, slot.gained_since)


def _fitted(
    steps: Sequence[RecordedStep], slots: Sequence[Slot], factors: Factors
) -> list[Numbered]:
    """Causes of slots, those that are told."""
    noises = [slot for slot in slots if isinstance(slot, NoiseSlot)]
    offsets = [slot for slot in slots if isinstance(slot, OffsetSlot)]
    return [*fitted_noises(steps, noises, factors), *fitted_offsets(steps, offsets, factors)]


def _simplest(best: _Candidate, candidates: Sequence[_Candidate]) -> _Candidate:
    """Of a simpler cause in the place of the best, if one is as likely.

    All of a sensor's noise is simpler than that of a component, and a change of a Jacobian without
    a number than one with it.
    """
    alike = [candidate for candidate in candidates if candidate.rank >= best.rank - AS_LIKELY]
    fitted, slot = best.fitted, best.fitted.slot
    if isinstance(slot, NoiseSlot) and slot.component >= 0 and not slot.since:
        every = slot._replace(component=-1)
        return next((candidate for candidate in alike if candidate.fitted.slot == every), best)
    if isinstance(fitted, JacobianChange) and fitted.numbers:
        plain = [
            candidate for candidate in alike
            if isinstance(candidate.fitted, JacobianChange) and not candidate.fitted.numbers
        ]  # fmt: skip
        return max(plain, key=lambda candidate: candidate.rank, default=best)
    return best


class _Later(NamedTuple):
    """A cause from some event on, and the first and last event from which it is as likely."""

    fitted: Numbered
    begun: tuple[int, int]


def _later(
    steps: Sequence[RecordedStep],
    promising: Sequence[ScoredSlot],
    whole: Sequence[Numbered],
    factors: Factors,
) -> list[_Later]:
    """The likeliest causes, each from the event on from which it is likeliest."""
    begun = [slot.slot._replace(since=slot.since) for slot in promising if slot.since]
    by_slot: dict[AnySlot, Numbered] = {numbered.slot: numbered for numbered in whole}
    for numbered in _fitted(steps, begun, factors):
        before = by_slot.get(_whole(numbered.slot))
        if before is not None and numbered.gained > before.gained:
            by_slot[_whole(numbered.slot)] = numbered
    likeliest = list(by_slot.values())
    if not max(numbered.gained for numbered in likeliest) > _LEAST_FITTED:
        return []
    promised: dict[AnySlot, int] = {slot.slot: slot.since for slot in promising}
    gained = _gains_by_beginning(steps, likeliest, promised, factors)
    later: dict[Slot, tuple[int, int]] = {}
    for numbered, by in zip(likeliest, gained, strict=True):
        if by and math.isfinite(max(by.values())):
            most = max(by.values())  # of a filter that diverges so much that 4 less is the same
            alike = [since for since in by if by[since] >= most - AS_LIKELY]
            since = max(by, key=lambda since: by[since])
            later[numbered.slot._replace(since=since)] = min(alike), max(alike)
    return [
        _Later(numbered, later[numbered.slot]) for numbered in _fitted(steps, list(later), factors)
    ]


def _gains_by_beginning(
    steps: Sequence[RecordedStep],
    likeliest: Sequence[Numbered],
    promised: Mapping[AnySlot, int],
    factors: Factors,
) -> list[dict[int, float]]:
    """What causes gain from events on: spread over the trace, then narrowed down.

    promised: the event from which on each slot promises most.
    """
    numbers = [
        [e.number for e, *_ in steps if numbered.slot.touches(e)][1:] for numbered in likeliest
    ]
    tried = [
        [*_spread(of, 0, len(of) - 1, _BEGINNINGS), *_nearest(of, promised[_whole(numbered.slot)])]
        for numbered, of in zip(likeliest, numbers, strict=True)
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
    causes: Sequence[Numbered],
    beginnings: Sequence[Sequence[int]],
    factors: Factors,
) -> list[dict[int, float]]:
    """What causes gain from each of some events on; factors as they are, constants fitted."""
    pairs = [
        (k, cause, cause.slot._replace(since=since))
        for k, cause in enumerate(causes)
        for since in beginnings[k]
    ]
    noises = [(k, slot, pair.factor) for k, pair, slot in pairs if isinstance(pair, NoiseFactor)]
    gained: list[dict[int, float]] = [{} for _ in causes]
    if noises:
        logs = log_likelihoods(steps, [factors, *({**factors, s: x} for _, s, x in noises)])
        for (k, slot, _), value in zip(noises, (logs[1:] - logs[0]).tolist(), strict=True):
            gained[k][slot.since] = value
    at = {slot: k for k, _, slot in pairs}
    offsets = [slot for slot in at if isinstance(slot, OffsetSlot)]
    for offset in fitted_offsets(steps, offsets, factors):
        gained[at[offset.slot]][offset.slot.since] = offset.gained
    return gained
