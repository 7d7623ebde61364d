"""What the events of a trace say of a filter's consistency.

Innovations, whitened by the covariance recursion over the events; which of their figures a sound
filter leaves rarely, and at which event they begin to; and the filter against the linear smoother
of the same events, run back from the last snapshot over some snapshots on the way.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.special import bdtr, bdtrc, ndtr

from comparisons.arrays import Array, Index
from comparisons.audit.replay import Fused, Layout, Replay
from comparisons.innovations import (
    NO_SENSOR,
    Gating,
    InnovationLog,
    SensorInnovations,
    split_windows,
    whiten_alone,
)
from comparisons.statistics import (
    Averaged,
    Nis,
    Whiteness,
    averaged,
    normalised_difference,
    two_sided,
)
from comparisons.trace.events import Augment, Event, Prior, Sensor, Update
from graphslam.arrays import Marginal
from graphslam.event_smoother import Link

TURNS = {2.0 * np.pi: "2 pi", 360.0: "360"}
"""In which a difference of angles that is not wrapped is off, by whole numbers of them."""
_NEAR, _FAR = 3.0, 5.0
"""Sigmas of an innovation: nearer to a whole turn than that, and farther from zero."""
_MOST_OTHERS, _CHANCE = 0.2, 1e-6
"""Share of the far ones that no turn explains, as outliers do, up to which turns are told from
them; beyond it they are told where chance puts as many so near to whole turns as rarely."""


class _Turned:
    """Innovations of one component that are far off: how many, and how many by whole turns."""

    def __init__(self) -> None:
        self.far = 0
        self.events: dict[float, list[int]] = {turn: [] for turn in TURNS}
        self.near = dict.fromkeys(TURNS, 0.0)

    def add(self, event: int, innovation: float, sigma: float) -> None:
        """Count one that is far off."""
        self.far += 1
        for turn, events in self.events.items():
            off = round(innovation / turn)
            self.near[turn] += min(1.0, 2.0 * _NEAR * sigma / turn)
            if off and abs(innovation - off * turn) <= _NEAR * sigma < 0.25 * turn:
                events.append(event)

    def departure(self, name: str) -> Departure | None:
        """What to say of two or more."""
        for turn, events in self.events.items():
            count, far = len(events), self.far
            if count < 2:
                continue
            chance = float(bdtrc(count - 1, far, self.near[turn] / far))
            if far - count <= _MOST_OTHERS * far or chance < _CHANCE:
                what = (
                    f"{count} innovations of {name} are {TURNS[turn]} off, or a multiple of "
                    "it: wrap the difference before it is gated and used"
                )
                return Departure(what, 0.0, events[0], events[-1], float("inf"))
        return None


class EventInnovations:
    """Innovations of all sensors, as the events come."""

    def __init__(self, sensors: Mapping[str, Sensor]) -> None:
        """Start empty. sensors: what is known of them."""
        self._sensors = sensors
        self._logs: dict[str, InnovationLog] = {}
        self._landmarks: dict[str, int] = {}
        self._initialised: list[int] = []
        self._turned: defaultdict[tuple[str, int], _Turned] = defaultdict(_Turned)

    def begin(self, event: Augment) -> None:
        """Note a new block: a landmark, where a measurement of the log initialised it."""
        if event.numbers is not None and len(event.numbers):
            self._landmarks[event.name] = len(self._initialised)
            self._initialised.append(int(event.numbers[0]))

    def add(self, event: Update, fused: Fused, layout: Layout) -> None:
        """Add a measurement, or several that are one update."""
        log = self._logs.get(event.sensor)
        if log is None:
            log = InnovationLog(event.sensor, self._sensors.get(event.sensor, NO_SENSOR))
            self._logs[event.sensor] = log
        whitened, width = fused.whitened, log.width(len(event.residual))
        count = len(whitened) // width
        sigma, off = np.sqrt(np.maximum(fused.spread.diagonal(), 0.0)), fused.innovation
        for i in np.flatnonzero(np.abs(off) > _FAR * sigma).tolist():
            self._turned[event.sensor, i % width].add(event.number, float(off[i]), float(sigma[i]))
        if event.weight < 1.0:
            every = np.arange(count)
            spread, noise = (
                matrix.reshape(count, width, count, width)[every, :, every]
                for matrix in (fused.spread, event.noise)
            )
            weight = np.full(count, event.weight)
            parts = fused.innovation.reshape(count, width)
            whitened = whiten_alone(parts, spread, noise, weight).ravel()
        numbers = event.numbers
        log.add(
            event.number,
            event.number if event.time_s is None else event.time_s,
            whitened,
            used=event.used,
            number=numbers if numbers is not None and len(numbers) == count else -1,
            landmark=self._seen(event, layout, count) if self._landmarks else -1,
        )

    def figures(self) -> tuple[SensorInnovations, ...]:
        """Judge all sensors."""
        return tuple(log.judge(self._initialised) for log in self._logs.values())

    def turned(self) -> list[tuple[str, Departure]]:
        """Return sensors whose innovations are whole turns off, and what to say of each."""
        found = []
        for (name, i), one in self._turned.items():
            named = self._sensors.get(name, NO_SENSOR).components
            said = one.departure(named[i] if i < len(named) else f"component {i}")
            if said is not None:
                found.append((name, said))
        return found

    def _seen(self, event: Update, layout: Layout, count: int) -> Index:
        """Which landmark each measurement (count,) is of; -1 where it is of none, or of two."""
        index = np.array([self._landmarks.get(name, -1) for name in event.blocks], dtype=np.intp)
        starts = np.cumsum([0, *(layout.dims[name] for name in event.blocks[:-1])])
        rows = event.jacobian.reshape(count, -1, event.jacobian.shape[1]).any(axis=1)
        touched = np.logical_or.reduceat(rows, starts, axis=1) & (index >= 0)
        return np.where(touched.sum(axis=1) == 1, index[touched.argmax(axis=1)], -1)


def event_innovations(
    events: Iterable[Event], sensors: Mapping[str, Sensor]
) -> tuple[SensorInnovations, ...]:
    """Return the innovations of all events, by sensor."""
    found = EventInnovations(sensors)
    replay: Replay
    for event in events:
        if isinstance(event, Prior):
            replay = Replay(event)
            continue
        fused = replay.apply(event)
        if isinstance(event, Augment):
            found.begin(event)
        elif isinstance(event, Update) and fused is not None:
            found.add(event, fused, replay.layout)
    return found.figures()


class Anchors:
    """Filtered marginals at some snapshots, and the links from each to the next."""

    def __init__(self) -> None:
        """Start empty."""
        self._event: list[int] = []
        self._filtered: list[Marginal] = []
        self._links: list[Link] = []

    def add(self, event: int, filtered: Marginal, link: Link | None) -> None:
        """Keep a snapshot's. link: of the one before to this one."""
        self._event.append(event)
        self._filtered.append(filtered)
        if link is not None:
            self._links.append(link)

    def against_smoother(self) -> Averaged | None:
        """Return (x_f - x_s)^T (P_f - P_s)^-1 (x_f - x_s) per clear direction, None of too few."""
        if len(self._filtered) < 2:
            return None
        smoothed, squared, dof = self._filtered[-1], list[float](), list[int]()
        for filtered, link in zip(self._filtered[-2::-1], self._links[::-1], strict=True):
            smoothed = Marginal(
                link.mean_then + link.gain @ (smoothed.mean - link.mean_now),
                link.covariance + link.gain @ smoothed.covariance @ link.gain.T,
            )
            value, clear, _ = normalised_difference(
                (filtered.mean - smoothed.mean)[None],
                filtered.covariance[None],
                smoothed.covariance[None],
            )
            squared.append(value[0])
            dof.append(clear[0])
        events = np.array(self._event[-2::-1])
        return averaged(np.array(squared), np.array(dof), events)


class Departure(NamedTuple):
    """A figure that a sound filter leaves rarely. p_value: two-sided. event: where it begins.

    weight: how far it is off, as the logarithm of a ratio of variances.
    """

    what: str
    p_value: float
    event: int | None = None
    until: int | None = None
    weight: float = 0.0


def departures(one: SensorInnovations, level: float) -> list[Departure]:
    """Return what departs of a sensor.

    Args:
        one: Its figures.
        level: Of all departures together, of a sound filter.
    """
    found = list[Departure]()
    windows = split_windows(len(one.event))
    windows = windows if len(windows) > 1 else []
    share = level / (1 + 3 * len(one.names) + len(windows))
    for nis in one.nis:
        found += _mean(nis, one, share)
    if one.components is not None:
        for name, column in zip(one.names, one.components.T, strict=True):
            found += _bias(column, name, share)
    for series in one.whiteness:
        found += _white(series, share)
    found += _in_windows(one, windows, share)
    return found + _gating(one.gating, level)


def _mean(nis: Nis, one: SensorInnovations, level: float) -> list[Departure]:
    whole = nis is one.nis[0]
    dof = float(one.dof.sum()) if whole else float(nis.count)
    p = two_sided(nis.mean * nis.count, dof)
    if p >= level:
        return []
    right = dof / nis.count
    what = "NIS" if whole else f"NIS of {nis.name}"
    text = f"{what} is {_word(nis.mean, right)}: {nis.mean:.3g}, expected {right:.3g}"
    return [Departure(text, p, weight=far_off(nis.mean, right))]


def _bias(column: Array, label: str, level: float) -> list[Departure]:
    z = float(column.sum() / np.sqrt(len(column)))
    p = float(2.0 * ndtr(-abs(z)))
    if p >= level:
        return []
    mean = float(column.mean())
    weight = far_off(1.0 + mean**2, 1.0)
    return [Departure(f"mean of {label} is {mean:+.3g} sigma, expected 0", p, weight=weight)]


def _white(series: Whiteness, level: float) -> list[Departure]:
    if series.order != "time" or series.p_value >= level:
        return []
    text = f"{series.component} is correlated in time: {series.autocorrelation[0]:+.2f} at lag 1"
    return [Departure(text, series.p_value, weight=abs(series.autocorrelation[0]))]


def _in_windows(one: SensorInnovations, windows: list[Index], level: float) -> list[Departure]:
    """The first stretch that leaves its band, with the event at which it begins to."""
    out = []
    for part in windows:
        p = two_sided(float(one.squared[part].sum()), float(one.dof[part].sum()))
        if p < level:
            out.append((part, p))
    if not out:
        return []
    (part, p), last = out[0], out[-1][0]
    mean, right = float(one.squared[part].mean()), float(one.dof[part].mean())
    first = max(0, int(part[0]) - len(part))  # it may have begun in the window before
    start = first + _onset(one.squared[first : part[-1] + 1], mean, right)
    text = (
        f"NIS is {_word(mean, right)} from {one.time_s[start]:.6g} to {one.time_s[last[-1]]:.6g}: "
        f"{mean:.3g}, expected {right:.3g}"
    )
    until = int(one.event[last[-1]])
    return [Departure(text, p, int(one.event[start]), until, far_off(mean, right))]


def _gating(gating: Gating, level: float) -> list[Departure]:
    """The rate of rejections against its nominal, by the binomial distribution."""
    n, rejected = len(gating.event), gating.count
    if gating.passes is None or not n:
        return []
    nominal = 1.0 - gating.passes
    upper = 1.0 if rejected == 0 else float(bdtrc(rejected - 1, n, nominal))
    p = min(1.0, 2.0 * min(float(bdtr(rejected, n, nominal)), upper))
    if p >= level:
        return []
    rate = rejected / n
    start = int(gating.event[_onset(gating.rejected.astype(float), rate, nominal)])
    text = f"rejects {rejected:,} of {n:,} ({100.0 * rate:.2g} %, nominal {100.0 * nominal:.2g} %)"
    return [Departure(text, p, start, weight=far_off(rate, nominal))]


def far_off(value: float, right: float) -> float:
    """The logarithm of how many times a variance is too large or too small."""
    return abs(float(np.log(max(value, 1e-300) / right)))


def _word(mean: float, right: float) -> str:
    return "too high" if mean > right else "too low"


def _onset(values: Array, mean: float, right: float) -> int:
    """Return where a series most likely changes from one mean to another.

    The least cumulative sum of the differences from halfway between the two.
    """
    apart = values - 0.5 * (mean + right)
    total = np.concatenate(([0.0], np.cumsum(apart if mean > right else -apart)))
    return int(np.argmin(total[:-1]))
