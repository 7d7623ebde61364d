"""What is off in the innovations, explained by other noises, by constants, by other Jacobians."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import NamedTuple

from comparisons.audit.consistency import departures, step_innovations
from comparisons.explain.coloured import ColouredNoise, ColourSlot, with_colour
from comparisons.explain.jacobians import JacobianChange, JacobianSlot, with_jacobians
from comparisons.explain.likeliest import (
    AnySlot,
    Fitted,
    InnovationCause,
    beside_others,
    likeliest_cause,
)
from comparisons.explain.noises import Factors, NoiseFactor, NoiseSlot, readings, with_noises
from comparisons.explain.offsets import Offset, without_offsets
from comparisons.explain.recorded_steps import RecordedStep, steps_of
from comparisons.innovations import NO_SENSOR
from comparisons.trace.events import Event, Predict, SensorDescription

_MOST_CAUSES = 3
_MOST_EVENTS = 20_000
"""Of a trace, from its beginning, in which causes are sought."""
_MOST_UNASKED = 2_000
"""The same where nothing is off."""
_MOST_SAID = 3
"""Causes that are as likely, beside the first."""
_NAMED = 1e-3
"""Share of sound traces of which a cause may be named."""

Sensors = Mapping[str, SensorDescription]


class ExplainedInnovations(NamedTuple):
    """Noises, constants and Jacobians that the residuals ask for.

    Attributes:
        what: In words.
        name: What the first cause is of, in words.
        fits: With them nothing is off in the innovations of any sensor.
        causes: Those that say most first.
    """

    what: str
    name: str
    fits: bool
    causes: tuple[InnovationCause, ...]

    def taken_in(self, steps: Iterable[RecordedStep]) -> Iterator[RecordedStep]:
        """Return the events as they are with the causes taken in."""
        return _taken_in(self.causes, steps)

    @property
    def sensor(self) -> str | None:
        """The sensor that the first cause is of, if it is of one."""
        slot = self.causes[0].slot
        match slot:
            case NoiseSlot() | JacobianSlot() | ColourSlot():
                is_of_sensor = slot.matrix in ("R", "H")
            case _:
                is_of_sensor = not slot.is_predicted
        return slot.of if is_of_sensor else None


def explained_innovations(
    events: Iterable[Event], sensors: Sensors, level: float, *, is_off: bool
) -> ExplainedInnovations | None:
    """Return what explains the innovations best; None if nothing is likelier than chance.

    Causes are joined, each on top of those before it, until no more is told.

    Args:
        events: Of a trace whose algebra is sound; of a long one gone through several times.
        sensors: What is known of them.
        level: Share of sound traces of which a figure may leave its band.
        is_off: Whether a figure of theirs has left its band.
    """
    most = _MOST_EVENTS if is_off else _MOST_UNASKED
    steps = list(islice(steps_of(events), most))
    causes: list[InnovationCause] = []
    left: list[str] = []
    still_off = is_off
    while len(causes) < _MOST_CAUSES and not (_are_apart(causes) or _colours(causes)):
        before = list(_without_noises(causes, steps))
        cause = likeliest_cause(
            before, _factors(causes), _NAMED, sensors, is_off=still_off, is_first=not causes
        )
        if cause is None:
            break
        causes.append(cause)
        every = steps if len(steps) < most else steps_of(events)
        after = step_innovations(_taken_in(causes, every), sensors)
        left = [
            f"sensor `{sensor.sensor}`: {each.what}"
            for sensor in after
            for each in departures(sensor, level)
            if each.fault
        ]
        still_off = bool(left)
    if not causes:
        return None
    causes = _refitted(causes, steps)
    what = " and ".join(_said(one, steps, sensors) for one in causes)
    apart = _are_apart(causes)
    if apart:
        what = f"residuals are likelier with {what}, but no one of these by itself explains them"
    elif left:
        what = f"residuals are likelier with {what}, but that leaves {left[0]}"
    elif is_off:
        what += ": with that nothing is off in the innovations"
    else:
        what = f"residuals are likelier with {what}, though no figure of theirs leaves its band"
    name = _words(causes[0].slot, sensors)
    return ExplainedInnovations(what, name, not (left or apart), tuple(causes))


def _refitted(
    causes: Sequence[InnovationCause], steps: Sequence[RecordedStep]
) -> list[InnovationCause]:
    """The causes, each number and interval as it is beside the others."""
    if len(causes) < 2:
        return list(causes)
    refitted = list[InnovationCause]()
    for k, cause in enumerate(causes):
        others = [one for j, one in enumerate(causes) if j != k]
        before = list(_without_noises(others, steps))
        refitted.append(beside_others(cause, before, _factors(others)))
    return refitted


def _are_apart(causes: Iterable[InnovationCause]) -> bool:
    """Whether another Jacobian is among causes that are not all numbers of one Jacobian.

    A Jacobian that comes near what is wrong leaves the rest to other causes: none of them is so.
    """
    fitted = [cause.fitted for cause in causes]
    changes = [change for change in fitted if isinstance(change, JacobianChange)]
    whole = {change.slot._replace(change="") for change in changes}
    is_of_one = len(whole) == 1 and len(changes) == len(fitted) and all(c.numbers for c in changes)
    return len(fitted) > 1 and bool(changes) and not is_of_one


def _colours(causes: Iterable[InnovationCause]) -> list[ColouredNoise]:
    """Those causes that are correlated noises."""
    return [cause.fitted for cause in causes if isinstance(cause.fitted, ColouredNoise)]


def _factors(causes: Iterable[InnovationCause]) -> Factors:
    """Of those causes that are of noises."""
    fitted = [cause.fitted for cause in causes]
    return {factor.slot: factor.factor for factor in fitted if isinstance(factor, NoiseFactor)}


def _without_noises(
    causes: Iterable[InnovationCause], steps: Iterable[RecordedStep]
) -> Iterator[RecordedStep]:
    """Events with other Jacobians, and without constants."""
    fitted = [cause.fitted for cause in causes]
    offsets = [offset for offset in fitted if isinstance(offset, Offset)]
    jacobians = [change for change in fitted if isinstance(change, JacobianChange)]
    return without_offsets(with_jacobians(steps, jacobians), offsets)


def _taken_in(
    causes: Iterable[InnovationCause], steps: Iterable[RecordedStep]
) -> Iterator[RecordedStep]:
    """Events with other noises and Jacobians, and without constants."""
    causes = list(causes)
    taken = _without_noises(causes, steps)
    for noise in _colours(causes):
        taken = with_colour(taken, noise)
    return with_noises(taken, _factors(causes))


def _said(cause: InnovationCause, steps: list[RecordedStep], sensors: Sensors) -> str:
    """A cause with its interval, what may have been written, and what else explains as much."""
    fitted, since = cause.fitted, ""
    if fitted.slot.since:
        first, last = cause.begun
        between = f" ({first:,} to {last:,})" if first != last else ""
        since = f" from event {fitted.slot.since:,}{between} on"
    text, interval = _with_number(fitted, steps, sensors)
    text += f"{since} ({interval and f'{interval}, '}p = {cause.p_value:.1g})"
    if isinstance(fitted, NoiseFactor) and (written := readings(fitted, steps)):
        text += f", {' or '.join(written)}"
    others = [_with_number(other, steps, sensors)[0] for other in cause.others]
    if len(others) > _MOST_SAID:
        others[_MOST_SAID - 1 :] = [f"one of {len(others) - _MOST_SAID + 1} others"]
    return text + "".join(f", or {other}" for other in others)


def _words(slot: AnySlot, sensors: Sensors) -> str:
    return slot.words(sensors.get(slot.of, NO_SENSOR).components)


def _with_number(fitted: Fitted, steps: list[RecordedStep], sensors: Sensors) -> tuple[str, str]:
    """A cause with its number, and the interval of that; empty without one."""
    if isinstance(fitted, JacobianChange | ColouredNoise):
        low, high = fitted.interval
        numbered = isinstance(fitted, ColouredNoise) or bool(fitted.numbers)
        return fitted.said(), f"{low:.3g} to {high:.3g}" if numbered else ""
    words = _words(fitted.slot, sensors)
    if isinstance(fitted, NoiseFactor):
        text = f"{words} {fitted.factor:.3g} times the stated one"
        return text, f"{fitted.low:.3g} to {fitted.high:.3g}"
    unit = ""
    if fitted.slot.is_predicted:
        timed = all(e.time_s is not None for e, *_ in steps if isinstance(e, Predict))
        unit = " per second" if timed else " each time"
    return fitted.said(words, unit)
