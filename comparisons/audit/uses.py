"""What a filter does with its measurements that contradicts what it says of them.

In: each update, with what the recursion made of it. Out: findings of `audit`, each a contradiction
and no matter of chance: a measurement that is fused twice, and one that is used although it lies
beyond the gate that its sensor declares.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.replay import BlockLayout, Fused
from comparisons.innovations import NO_SENSOR, InnovationLog
from comparisons.rounding import SAME_NUMBER
from comparisons.statistics import chi2_quantile
from comparisons.trace.events import TELLING, Event, SensorDescription, Update

_SMALL = 1e-9
"""Sigmas of a residual that tells nothing, as of data without noise."""
_ALIKE = 1e-2
"""Of H's largest entry: the same measurement, linearised again."""
_MOST_WAITING = 64
"""Updates of an instant with which a further one is compared."""
_MARGIN = 1e-6
"""Relative, by which a normalised innovation squared passes a limit for certain."""


class Contradiction(NamedTuple):
    """update: the event. what: a predicate of it. kind: what those alike share."""

    update: Update
    what: str
    kind: str


class _Waiting(NamedTuple):
    """A used update of the instant. left: its residual less what corrections took off since."""

    update: Update
    left: Array


class MeasurementUse:
    """Follows what updates do with measurements, as the events come."""

    def __init__(self, sensors: Mapping[str, SensorDescription]) -> None:
        """Start. sensors: what is known of them, gates among it."""
        self._sensors = sensors
        self._instant: list[_Waiting] = []
        self._fresh = True
        self._time_s: float | None = None
        self._widths: dict[str, InnovationLog] = {}

    def take(
        self, event: Event, fused: Fused | None, layout: BlockLayout, *, sound: bool
    ) -> Iterator[Contradiction]:
        """Yield how an event contradicts what was said.

        Args:
            event: Any.
            fused: What the recursion made of an update; None where nothing is known.
            layout: Of the state.
            sound: The recursion is what the filter holds, so that its S is the filter's.
        """
        if isinstance(event, TELLING):
            return
        if not isinstance(event, Update) or event.time_s != self._time_s:
            self._instant, self._fresh, self._time_s = [], True, event.time_s
        if not isinstance(event, Update) or fused is None:
            return
        if sound and self._fresh and event.used:
            yield from self._beyond_gate(event, fused)
        if event.used:
            yield from self._again(event)
            self._wait(event, fused, layout)
            self._fresh = False

    def _beyond_gate(self, event: Update, fused: Fused) -> Iterator[Contradiction]:
        """Compare with the gate, of an instant's first update alone: of others S may be another.

        A measurement is beyond it where both a gate of the whole and one of each component by
        itself, of the same probability, reject it.
        """
        sensor = self._sensors.get(event.sensor, NO_SENSOR)
        if sensor.gate is None or not 0.0 < sensor.gate < 1.0:
            return
        log = self._widths.setdefault(event.sensor, InnovationLog(event.sensor, sensor))
        width = log.width(len(event.residual))
        limit = float(chi2_quantile(sensor.gate, width))
        alone = float(chi2_quantile(sensor.gate ** (1.0 / width), 1))
        spread = fused.spread + (event.weight - 1.0) * event.noise
        for start in range(0, len(event.residual), width):
            part = slice(start, start + width)
            residual, s = event.residual[part], spread[part, part]
            squared = _normalised(residual, s)
            single = float((residual**2 / np.maximum(s.diagonal(), 1e-300)).max())
            if squared > limit * (1.0 + _MARGIN) and single > alone * (1.0 + _MARGIN):
                what = (
                    f"is used, though it is beyond the declared gate of {100 * sensor.gate:g} %: "
                    f"its NIS is {squared:.3g}, the gate's limit {limit:.3g}"
                )
                yield Contradiction(event, what, "beyond the gate")
                return

    def _again(self, event: Update) -> Iterator[Contradiction]:
        """Compare with the updates of the same instant: the same measurement leaves what it left.

        A second residual of one measurement is the first less H times the corrections since.
        """
        for earlier, left in self._instant:
            if not _comparable(earlier, event):
                continue
            size = np.abs(earlier.residual).max() + np.abs(left).max()
            exact = np.array_equal(earlier.jacobian, event.jacobian)
            if exact and np.abs(event.residual - left).max() <= SAME_NUMBER * size:
                what = f"fuses the measurement of event {earlier.number} again: its residual is "
                what += "that one's less H times the correction"
            elif _is_numbered(earlier, event):
                what = f"fuses the measurement of event {earlier.number} again, by its number"
            else:
                continue
            what += " (where one is fused in parts on purpose, record weights)"
            yield Contradiction(event, what, "fused again")
            return

    def _wait(self, event: Update, fused: Fused, layout: BlockLayout) -> None:
        """Keep an update, and take what it corrects off those that wait."""
        corrected = fused.applied
        waiting = [*self._instant[1 - _MOST_WAITING :], _Waiting(event, event.residual)]
        self._instant = [
            _Waiting(update, left - update.jacobian @ corrected[layout.columns(update.blocks)])
            for update, left in waiting
            if np.abs(update.residual).max() > _SMALL * _size(update)
        ]


def _normalised(residual: Array, s: Array) -> float:
    """NIS; 0 without a valid S."""
    try:
        root = np.linalg.cholesky(s)
    except np.linalg.LinAlgError:
        return 0.0
    return float(np.square(np.linalg.solve(root, residual)).sum())


def _size(update: Update) -> float:
    """About the sigma of a measurement's noise."""
    return float(np.sqrt(np.abs(update.noise.diagonal()).max()))


def _comparable(earlier: Update, event: Update) -> bool:
    """Whether both may be one measurement, which is not fused in parts."""
    if earlier.sensor != event.sensor or earlier.blocks != event.blocks:
        return False
    if earlier.jacobian.shape != event.jacobian.shape:
        return False
    if earlier.weight + event.weight <= 1.0 + _MARGIN:
        return False
    if earlier.numbers is None or event.numbers is None:
        return True
    return np.array_equal(earlier.numbers, event.numbers)


def _is_numbered(earlier: Update, event: Update) -> bool:
    """Whether both are of the same numbers of the log, and of the same components."""
    if earlier.numbers is None or event.numbers is None or not len(event.numbers):
        return False
    off = np.abs(earlier.jacobian - event.jacobian).max()
    return bool(off <= _ALIKE * np.abs(earlier.jacobian).max())
