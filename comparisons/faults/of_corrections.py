"""Gains and corrections that are not Kalman's: what they are of, by the same grammar."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

from comparisons.arrays import Array
from comparisons.faults.formulas import alike
from comparisons.faults.of_events import (
    EventFault,
    gain_faults,
    has_another_gain,
    kalman_gain,
)
from comparisons.faults.recursion import Remembering
from comparisons.trace.events import Update

_MOST_GAINS = 6_000
"""Gains that are compared with one update's, the simplest first."""


def name_gain(event: Update, replay: Remembering) -> EventFault | None:
    """Return the fault that makes a recorded gain, where it is known and not Kalman's.

    replay: as before the update.
    """
    if event.gain is None or not has_another_gain(event, replay):
        return None
    for fault, gain in islice(gain_faults(event, replay), _MOST_GAINS):
        if alike(gain, event.gain):
            return fault
    return None


def name_correction(event: Update, replay: Remembering) -> str | None:
    """Return what a recorded correction is, where it is known and not gain times residual.

    replay: as before the update.
    """
    if event.correction is None:
        return None
    for what, correction in _corrections(event, replay):
        if alike(correction, event.correction):
            return what
    return None


def _corrections(event: Update, replay: Remembering) -> Iterator[tuple[str, Array]]:
    """What may stand where gain times residual should: of other gains, residuals and events."""
    kalman, residual = kalman_gain(replay, event), event.residual
    gain = kalman if event.gain is None else event.gain
    yield "Kalman's gain times residual, not by the gain that it used", kalman @ residual
    for which, name in ((1, "the update before"), (0, "the first update")):
        other = replay.other(event, which)
        if other is None:
            continue
        if other.residual.shape == residual.shape:
            yield f"gain times the residual of {name}", gain @ other.residual
        if other.gain is not None and other.gain.shape == gain.shape:
            yield f"the gain of {name} times residual", other.gain @ residual
        if other.correction is not None:
            yield f"the correction of {name}", other.correction
    for k in range(len(residual) if len(residual) > 1 else 0):
        for words, factor in (("without", 0.0), ("with the other sign of", -1.0)):
            changed = residual.copy()
            changed[k] *= factor
            yield f"gain times residual {words} component {k}", gain @ changed
    if len(residual) > 1:
        yield "gain times residual, its components in the other order", gain @ residual[::-1]
    for fault, other_gain in islice(gain_faults(event, replay), _MOST_GAINS):
        yield f"residual times the gain where {fault.kind}", other_gain @ residual
