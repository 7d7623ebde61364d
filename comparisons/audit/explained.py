"""What is off in the innovations, explained by noises that are not as stated and by constants."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import islice
from typing import NamedTuple

from comparisons.audit.consistency import departures, step_innovations
from comparisons.explain.noises import (
    MOST_EVENTS,
    Factors,
    NoiseFactor,
    NoiseSlot,
    RecordedStep,
    fitted_noise,
    readings,
    steps_of,
    with_noises,
)
from comparisons.explain.offsets import Offset, fitted_offset, without_offsets
from comparisons.innovations import NO_SENSOR
from comparisons.trace.events import Event, Predict, SensorDescription

_MOST_CAUSES = 3

Sensors = Mapping[str, SensorDescription]


class ExplainedInnovations(NamedTuple):
    """Noises and constants that the residuals ask for.

    Attributes:
        what: In words.
        fits: With them nothing is off in the innovations of any sensor.
        causes: Those that say most first.
    """

    what: str
    fits: bool
    causes: tuple[NoiseFactor | Offset, ...]

    @property
    def name(self) -> str:
        """What the first cause is of."""
        return self.causes[0].slot.words()

    @property
    def sensor(self) -> str | None:
        """The sensor that the first cause is of, if it is of one."""
        slot = self.causes[0].slot
        is_of_sensor = slot.matrix == "R" if isinstance(slot, NoiseSlot) else not slot.is_predicted
        return slot.of if is_of_sensor else None


def explained_innovations(
    events: Iterable[Event], sensors: Sensors, level: float
) -> ExplainedInnovations | None:
    """Return what explains the innovations best; None if nothing is likelier than chance.

    Causes are joined, each on top of those before it, until nothing is off or no more is told.

    Args:
        events: Of a trace whose algebra is sound; of a long one gone through several times.
        sensors: What is known of them.
        level: Share of sound traces for which a cause may be named.
    """
    steps = list(islice(steps_of(events), MOST_EVENTS))
    is_whole = len(steps) < MOST_EVENTS
    causes: list[NoiseFactor | Offset] = []
    left: list[str] = []
    while len(causes) < _MOST_CAUSES and (left or not causes):
        factors, offsets = _of_kind(causes)
        shifted = list(without_offsets(steps, offsets))
        fitted = fitted_noise(shifted, factors, level), fitted_offset(shifted, factors, level)
        better = [one for one in fitted if one is not None]
        if not better:
            break
        causes.append(max(better, key=lambda one: one.gained))
        factors, offsets = _of_kind(causes)
        every = steps if is_whole else steps_of(events)
        after = step_innovations(with_noises(without_offsets(every, offsets), factors), sensors)
        left = [
            f"sensor `{one.sensor}`: {each.what}"
            for one in after
            for each in departures(one, level)
            if each.fault
        ]
    if not causes:
        return None
    what = " and ".join(_said(one, steps, sensors) for one in causes)
    if left:
        what = f"residuals are likelier with {what}, but that leaves {left[0]}"
    else:
        what += ": with that nothing is off in the innovations"
    return ExplainedInnovations(what, not left, tuple(causes))


def _of_kind(causes: Iterable[NoiseFactor | Offset]) -> tuple[Factors, list[Offset]]:
    """Causes as factors on noises, and as constants."""
    every = list(causes)
    factors = {one.slot: one.factor for one in every if isinstance(one, NoiseFactor)}
    return factors, [one for one in every if isinstance(one, Offset)]


def _said(one: NoiseFactor | Offset, steps: list[RecordedStep], sensors: Sensors) -> str:
    """A cause with its interval, what else explains as much, and what may have been written."""
    slots = [
        slot.words(sensors.get(slot.of, NO_SENSOR).components) for slot in (one.slot, *one.others)
    ]
    since = ""
    if one.slot.since:
        first, last = one.begun
        between = f" ({first:,} to {last:,})" if first != last else ""
        since = f" from event {one.slot.since:,}{between} on"
    others = "".join(f"; or another {other}" for other in dict.fromkeys(slots[1:]))
    rare = f"p = {one.p_value:.1g}{others}"
    if isinstance(one, Offset):
        low, high = one.value - 1.96 * one.sigma, one.value + 1.96 * one.sigma
        unit = ""
        if one.slot.is_predicted:
            timed = all(e.time_s is not None for e, _ in steps if isinstance(e, Predict))
            unit = " per second" if timed else " each time"
        text = f"a constant {one.value:+.3g}{unit} in {slots[0]}"
        return f"{text}{since} ({low:.3g} to {high:.3g}, {rare})"
    text = f"{slots[0]} {one.factor:.3g} times the stated one{since}"
    written = readings(one, steps)
    text += f" ({one.low:.3g} to {one.high:.3g}, {rare})"
    return text + (f", {' or '.join(written)}" if written else "")
