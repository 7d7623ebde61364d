"""What the events of a trace say of a filter's consistency.

Innovations, whitened by the covariance recursion over the events; which of their figures a sound
filter leaves rarely, and at which event they begin to; and the filter against the linear smoother
of the same events, run back from the last snapshot over some snapshots on the way.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs
from scipy.special import bdtr, bdtrc, ndtr, rel_entr

from comparisons.arrays import Array, Index
from comparisons.audit.replay import BlockLayout, Fused, Replay
from comparisons.explain.recorded_steps import RecordedStep, apply_step
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
    Band,
    Nis,
    Whiteness,
    averaged,
    chance_of_sum,
    chi2_tail,
    faults,
    likelier_orders,
    normalised_difference,
    onset,
    rarest,
    rarity,
    stretch,
)
from comparisons.trace.events import (
    Augment,
    Event,
    SensorDescription,
    Snapshot,
    TracePrior,
    Update,
)
from graphslam.arrays import Marginal
from graphslam.event_smoother import Link

TURNS = {2.0 * np.pi: "2 pi", 360.0: "360"}
"""In which a difference of angles that is not wrapped is off, by whole numbers of them."""
_NEAR, _FAR = 3.0, 5.0
"""Sigmas of an innovation: nearer to a whole turn than that, and farther from zero."""
_MOST_OTHERS, _CHANCE = 0.2, 1e-6
"""Share of the far ones that no turn explains, as outliers do, up to which turns are told from
them; beyond it they are told where chance puts as many so near to whole turns as rarely."""
_UNDECLARED = 0.5
"""Share of rejections that a gate may have whose probability is not declared."""
_OF_SERIES = 0.1
"""Share of a gate's false alarms that series of rejections have."""
_WHOLE = 0.9
"""A sensor's figure goes behind that of a component which tells nearly as much."""
_MOST_BLOCKS = 50
"""Of the prior, whose errors are judged one by one."""
_MOST_ORDERS = 3
"""Of P0's rows, that are named."""
_MOST_STRETCHES, _IN_STRETCH = 10, 10.0
"""Of a run, of which NEES is judged, and how many independent errors each has at least."""


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

    def departure(self, name: str) -> ConsistencyDeparture | None:
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
                return ConsistencyDeparture(what, 0.0, events[0], events[-1], float("inf"))
        return None


class EventInnovations:
    """Innovations of all sensors, as the events come."""

    def __init__(self, sensors: Mapping[str, SensorDescription]) -> None:
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

    def add(self, event: Update, fused: Fused, layout: BlockLayout) -> None:
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

    def turned(self) -> list[tuple[str, ConsistencyDeparture]]:
        """Return sensors whose innovations are whole turns off, and what to say of each."""
        found = []
        for (name, i), turn in self._turned.items():
            named = self._sensors.get(name, NO_SENSOR).components
            said = turn.departure(named[i] if i < len(named) else f"component {i}")
            if said is not None:
                found.append((name, said))
        return found

    def _seen(self, event: Update, layout: BlockLayout, count: int) -> Index:
        """Which landmark each measurement (count,) is of; -1 where it is of none, or of two."""
        index = np.array([self._landmarks.get(name, -1) for name in event.blocks], dtype=np.intp)
        starts = np.cumsum([0, *(layout.dims[name] for name in event.blocks[:-1])])
        rows = event.jacobian.reshape(count, -1, event.jacobian.shape[1]).any(axis=1)
        touched = np.logical_or.reduceat(rows, starts, axis=1) & (index >= 0)
        return np.where(touched.sum(axis=1) == 1, index[touched.argmax(axis=1)], -1)


def event_innovations(
    events: Iterable[Event], sensors: Mapping[str, SensorDescription]
) -> tuple[SensorInnovations, ...]:
    """Return the innovations of all events, by sensor."""
    return step_innovations((RecordedStep(event, None) for event in events), sensors)


def step_innovations(
    steps: Iterable[RecordedStep], sensors: Mapping[str, SensorDescription]
) -> tuple[SensorInnovations, ...]:
    """Return the innovations of all events, by sensor, with what moves predictions beside them."""
    innovations = EventInnovations(sensors)
    replay: Replay
    for step in steps:
        event = step.event
        if isinstance(event, TracePrior):
            replay = Replay(event)
            continue
        fused = apply_step(replay, step)
        if isinstance(event, Augment):
            innovations.begin(event)
        elif isinstance(event, Update) and fused is not None:
            innovations.add(event, fused, replay.layout)
    return innovations.figures()


class Smoothed(NamedTuple):
    """averaged: filtered minus smoothed at the snapshots. first: the error at the beginning."""

    averaged: Averaged | None
    first: Marginal | None


class Anchors:
    """Filtered marginals at the beginning and some snapshots, and the links between them."""

    def __init__(self) -> None:
        """Start empty."""
        self._event: list[int] = []
        self._filtered: list[Marginal] = []
        self._links: list[Link] = []
        self._begun = False

    def begin(self, prior: Marginal) -> None:
        """Keep what the filter begins with, before any snapshot."""
        self._begun = True
        self.add(0, prior, None)

    def add(self, event: int, filtered: Marginal, link: Link | None) -> None:
        """Keep a snapshot's. link: of the one before to this one."""
        self._event.append(event)
        self._filtered.append(filtered)
        if link is not None:
            self._links.append(link)

    def smoothed(self) -> Smoothed:
        """Return (x_f - x_s)^T (P_f - P_s)^-1 (x_f - x_s) per clear direction, None of too few."""
        if not self._filtered:
            return Smoothed(None, None)
        smoothed, squared, dof = self._filtered[-1], list[float](), list[int]()
        for filtered, link in zip(self._filtered[-2::-1], self._links[::-1], strict=True):
            smoothed = Marginal(
                link.mean_then + link.gain @ (smoothed.mean - link.mean_now),
                link.covariance + link.gain @ smoothed.covariance @ link.gain.T,
            )
            if not (np.isfinite(smoothed.mean).all() and np.isfinite(smoothed.covariance).all()):
                return Smoothed(None, None)
            value, clear, _ = normalised_difference(
                (filtered.mean - smoothed.mean)[None],
                filtered.covariance[None],
                smoothed.covariance[None],
            )
            squared.append(value[0])
            dof.append(clear[0])
        events = np.array(self._event[-2::-1])
        kept = slice(0, len(squared) - self._begun)  # the beginning is judged by itself
        average = averaged(np.array(squared)[kept], np.array(dof)[kept], events[kept])
        return Smoothed(average, smoothed if self._begun and len(self._links) else None)


class BlockErrors:
    """Errors of the estimate by the recorded truth: of the state, and of each of its first blocks.

    layout: of the prior. before: the error before any event but snapshots, if it was recorded.
    """

    def __init__(self, layout: BlockLayout) -> None:
        """Start empty."""
        names = list(layout.dims)[:_MOST_BLOCKS]
        self._names = names if len(layout.dims) > 1 else []
        self._blocks = tuple(layout.dims)
        self._rows: dict[str, list[tuple[int, float, float, int]]] = defaultdict(list)
        self.before: Array | None = None

    def add(
        self, snapshot: Snapshot, error: Array, layout: BlockLayout, *, is_first: bool = False
    ) -> None:
        """Add a snapshot's error (n,). layout: of its state. is_first: no event was before it."""
        if is_first and snapshot.blocks == self._blocks:
            self.before = error
        if faults(snapshot.covariance[None])[0] == "":
            self._add("", snapshot, error, slice(None))
        start = 0
        for name in snapshot.blocks:
            part = slice(start, start := start + layout.dims[name])
            if name in self._names:
                self._add(name, snapshot, error, part)

    def _add(self, name: str, snapshot: Snapshot, error: Array, part: slice) -> None:
        """Add the error squared of a part of the state, in units of the recorded covariance."""
        root, fault = dpotrf(snapshot.covariance[part, part], lower=1)
        if fault or not np.isfinite(root).all():
            return
        whitened = dtrtrs(root, error[part], lower=1)[0]
        time_s = float(snapshot.number) if snapshot.time_s is None else snapshot.time_s
        row = snapshot.number, time_s, float(whitened @ whitened), len(whitened)
        self._rows[name].append(row)

    def averages(self) -> dict[str, Averaged]:
        """Return NEES of the state as a whole, by the name "", and of blocks."""
        found = {}
        for name, rows in sorted(self._rows.items()):
            event, _, squared, dof = (np.array(column) for column in zip(*rows, strict=True))
            average = averaged(squared, dof, event)
            if average is not None:
                found[name] = average
        return found

    def departures(
        self, averages: Mapping[str, Averaged], level: float
    ) -> list[ConsistencyDeparture]:
        """Return what departs: the state and the block that is off most, or else a stretch.

        Args:
            averages: As `averages` returns them.
            level: Of all together, of a sound filter.
        """
        blocks = {name: average for name, average in averages.items() if name}
        shares = {name: 0.5 * level / (len(blocks) if name else 2) for name in averages}
        out = {n: average for n, average in averages.items() if average.p_value < shares[n]}
        worst = rarest({n: average for n, average in out.items() if n}) or ""
        if "" in out:
            return [self._departure("NEES", averages[""], worst, blocks.get(worst))]
        if worst:
            return [self._departure(f"NEES of block `{worst}`", blocks[worst], worst, None)]
        return [] if "" not in averages else self._stretch(averages[""], 0.25 * level)

    def _departure(
        self, what: str, one: Averaged, begins: str, of: Averaged | None
    ) -> ConsistencyDeparture:
        """Say that an average is off. begins: the block whose errors tell since when. of: its."""
        (low, high), rows = one.band, self._rows[begins]
        average = of or one
        per = np.array([squared / dof for _, _, squared, dof in rows])
        first, last = stretch(per, average.mean, 1.0)
        since = f"from {_named(*rows[first][:2])}" if first else "from the start"
        since += " on" if last == len(per) - 1 else f" to {_named(*rows[last][:2])}"
        more = f"; of block `{begins}` {of.mean:.3g}" if of is not None else ""
        text = f"{what} per degree of freedom is {one.mean:.3g}, expected {low:.3g} to {high:.3g}"
        event = rows[first][0]
        return ConsistencyDeparture(
            f"{text}{more}, {since}", one.p_value, event, None, rarity(one.mean, one.dof)
        )

    def _stretch(self, whole: Averaged, level: float) -> list[ConsistencyDeparture]:
        """The first stretch of the run that leaves its band, which all of it hides."""
        rows = self._rows[""]
        each = whole.dof / (_IN_STRETCH * rows[0][3])
        if not each >= 2.0:  # too few, or a number that overflows
            return []
        count = int(min(_MOST_STRETCHES, each))
        for part in np.array_split(np.arange(len(rows)), count):
            some = [rows[i] for i in part]
            mean = sum(row[2] for row in some) / sum(row[3] for row in some)
            dof = whole.dof / count
            p = chance_of_sum(mean * dof, dof)
            if mean > 1.0 and p < level / count:
                first, last = (_named(*row[:2]) for row in (some[0], some[-1]))
                text = (
                    f"NEES per degree of freedom is {mean:.3g} from {first} to {last}, expected 1"
                )
                event, until = some[0][0], some[-1][0]
                return [ConsistencyDeparture(text, p, event, until, rarity(mean, dof))]
        return []


def first_error(
    layout: BlockLayout, prior: Array, error: Array, left: Array, level: float
) -> ConsistencyDeparture | None:
    """Return the block whose first error is farthest beyond P0, where chance hardly makes it.

    Args:
        layout: Of the prior.
        prior: (n, n) P0.
        error: (n,) the first error, by the truth or as all measurements together tell it.
        left: (n, n) its own covariance, by the truth zero: Cov(error) = P0 - left.
        level: Of all blocks together, of a sound filter.
    """
    names = list(layout.dims)[:_MOST_BLOCKS]
    layout = layout.of(names)
    some = slice(layout.size)
    prior, error, left = prior[some, some], error[some], left[some, some]
    departure: ConsistencyDeparture | None = None
    row = 0
    for name in names:
        part = layout.entries(name)
        with np.errstate(divide="ignore"):  # by the truth nothing is left
            squared, dof, _ = normalised_difference(
                error[None, part], prior[None, part, part], left[None, part, part]
            )
        p = chi2_tail(float(squared[0]), int(dof[0])) if dof[0] else 1.0
        weight = rarity(float(squared[0]) / max(int(dof[0]), 1), int(dof[0]))
        if p >= level / len(names) or (departure is not None and departure.weight >= weight):
            continue
        gained = np.sqrt(np.maximum((prior - left).diagonal()[part], 0.0))
        sigmas = np.abs(error[part]) / np.where(gained > 0.0, gained, np.inf)
        row = part.start + int(np.argmax(sigmas))
        departure = ConsistencyDeparture("", p, 0, None, weight)
    if departure is None:
        return None
    text = (
        f"the first error of {_entry(layout, row)} is {error[row]:.3g}, its sigma in P0 is "
        f"{np.sqrt(prior[row, row]):.3g}: "
    )
    orders = likelier_orders(error, prior, left, _exchanges(layout, row))
    if not orders:
        return departure._replace(
            what=f"{text}P0 is too small there, or its rows are in another order"
        )
    listed = ", or ".join(
        f"{_exchanged(layout, order.order)} (p = {order.p_value:.2g})"
        for order in orders[:_MOST_ORDERS]
    )
    return departure._replace(
        what=f"{text}P0 is too small there, or its rows are exchanged; in this order the error is "
        f"probable: {listed}"
    )


def _exchanges(layout: BlockLayout, row: int) -> Iterator[Index]:
    """Yield orders of the entries: a row exchanged with each other, its block with its likes."""
    rows = np.arange(layout.size)
    own = layout.entries(layout.holder(row))
    pairs = [(slice(row, row + 1), slice(other, other + 1)) for other in rows[rows != row]]
    likes = (layout.entries(name) for name, width in layout.dims.items() if width > 1)
    pairs += [(own, one) for one in likes if one != own and len(rows[one]) == len(rows[own])]
    for first, second in pairs:
        order = rows.copy()
        order[first], order[second] = rows[second], rows[first]
        yield order


def _exchanged(layout: BlockLayout, order: Index) -> str:
    """Name the two rows, or blocks, that an order exchanges."""
    moved = np.flatnonzero(order != np.arange(len(order)))
    names = dict.fromkeys(
        _entry(layout, int(row)) if len(moved) == 2 else f"block `{layout.holder(int(row))}`"
        for row in moved
    )
    return " and ".join(names)


def _entry(layout: BlockLayout, row: int) -> str:
    """Name an entry of the state."""
    name = layout.holder(row)
    of = f"block `{name}`"
    return of if layout.dims[name] == 1 else f"entry {row - layout.start[name]} of {of}"


class ConsistencyDeparture(NamedTuple):
    """A figure that a sound filter leaves rarely. p_value: two-sided. event: where it begins.

    weight: how rare it is, as `rarity` has it; p-values of what is far off are all zero. fault: it
    is one by itself.
    """

    what: str
    p_value: float
    event: int | None = None
    until: int | None = None
    weight: float = 0.0
    fault: bool = True


def departures(sensor: SensorInnovations, level: float) -> list[ConsistencyDeparture]:
    """Return what departs of a sensor, the rarest first.

    Where all its innovations depart, they do so from the first stretch on that does.

    Args:
        sensor: Its figures.
        level: Of all departures together, of a sound filter.
    """
    windows = split_windows(len(sensor.event))
    windows = windows if len(windows) > 1 else []
    share = level / (1 + 3 * len(sensor.names) + len(windows))
    stretches = _in_windows(sensor, windows, share)
    since = stretches[0].event if stretches else None
    found = [
        each._replace(event=since) for nis in sensor.nis[:1] for each in _mean(nis, sensor, share)
    ]
    for nis in sensor.nis[1:]:
        found += _mean(nis, sensor, share)
    if sensor.components is not None:
        for name, column in zip(sensor.names, sensor.components.T, strict=True):
            found += _bias(column, name, share)
    for series in sensor.whiteness:
        found += _white(series, share)
    found += stretches
    found += _gating(sensor.gating, level)
    return sorted(found, key=lambda each: -each.weight)


def _mean(nis: Nis, sensor: SensorInnovations, level: float) -> list[ConsistencyDeparture]:
    whole, right = nis is sensor.nis[0], nis.expected
    p = nis.chance(sensor.least)
    if p >= level:
        return []
    what = "NIS" if whole else f"NIS of {nis.name}"
    text = f"{what} is {Band(right, right).reading(nis.mean)}: {nis.mean:.3g}, expected {right:.3g}"
    weight = rarity(nis.mean / right, nis.total_dof)
    return [ConsistencyDeparture(text, p, weight=_WHOLE * weight if whole else weight)]


def _bias(column: Array, label: str, level: float) -> list[ConsistencyDeparture]:
    z = float(column.sum() / np.sqrt(len(column)))
    p = float(2.0 * ndtr(-abs(z)))
    if p >= level:
        return []
    text = f"mean of {label} is {column.mean():+.3g} sigma, expected 0"
    return [ConsistencyDeparture(text, p, weight=0.5 * z**2)]


def _white(series: Whiteness, level: float) -> list[ConsistencyDeparture]:
    if series.order != "time" or series.p_value >= level:
        return []
    first = float(np.clip(series.autocorrelation[0], -1.0, 1.0))  # of few pairs it may be beyond
    text = f"{series.component} is correlated in time: {first:+.2f} at lag 1"
    squared = [(2.0 * c / b) ** 2 for c, b in zip(series.autocorrelation, series.band, strict=True)]
    weight = rarity(sum(squared) / len(squared), len(squared))
    return [ConsistencyDeparture(text, series.p_value, weight=weight)]


def _in_windows(
    sensor: SensorInnovations, windows: list[Index], level: float
) -> list[ConsistencyDeparture]:
    """The first stretch that leaves its band, with the event at which it begins to."""
    out = []
    for part in windows:
        p = chance_of_sum(
            float(sensor.squared[part].sum()), float(sensor.dof[part].sum()), sensor.least
        )
        if p < level:
            out.append((part, p))
    if not out:
        return []
    (part, p), last = out[0], out[-1][0]
    mean, right = float(sensor.squared[part].mean()), float(sensor.dof[part].mean())
    first = max(0, int(part[0]) - len(part))  # it may have begun in the window before
    start = first + onset(sensor.squared[first : part[-1] + 1], mean, right)
    text = (
        f"NIS is {Band(right, right).reading(mean)} from {sensor.time_s[start]:.6g} to "
        f"{sensor.time_s[last[-1]]:.6g}: {mean:.3g}, expected {right:.3g}"
    )
    until, weight = int(sensor.event[last[-1]]), rarity(mean / right, float(sensor.dof[part].sum()))
    return [ConsistencyDeparture(text, p, int(sensor.event[start]), until, weight)]


def _gating(gating: Gating, level: float) -> list[ConsistencyDeparture]:
    """How often the gate rejects, and its longest series of rejections; one where both depart."""
    rate = None if gating.passes is None else _rate(gating, 1.0 - gating.passes, level)
    series = _series(gating, _OF_SERIES * level)
    if rate is not None and series is not None:
        what = f"{rate.what}: {series.what.removeprefix('rejects ')}"
        weight = max(rate.weight, series.weight)
        return [rate._replace(what=what, event=series.event, until=series.until, weight=weight)]
    return [departure for departure in (rate, series) if departure is not None]


def _rate(gating: Gating, nominal: float, level: float) -> ConsistencyDeparture | None:
    """The rate of rejections against its nominal, by the binomial distribution.

    Where instants have several measurements, also by how these are rejected together.
    """
    n, rejected = len(gating.event), gating.count
    if not n:
        return None
    upper = 1.0 if rejected == 0 else float(bdtrc(rejected - 1, n, nominal))
    p = min(1.0, 2.0 * min(float(bdtr(rejected, n, nominal)), upper))
    _, measured, found = gating.instants
    if len(measured) < n:
        spread = float(np.sqrt(np.sum((found - nominal * measured) ** 2)))
        p = max(p, float(2.0 * ndtr(-abs(rejected - nominal * n) / spread)))
    if p >= level:
        return None
    rate = rejected / n
    start = int(gating.event[onset(gating.rejected.astype(float), rate, nominal)])
    text = f"rejects {rejected:,} of {n:,} ({100.0 * rate:.2g} %, nominal {100.0 * nominal:.2g} %)"
    weight = n * float(rel_entr(rate, nominal) + rel_entr(1.0 - rate, 1.0 - nominal))
    return ConsistencyDeparture(text, p, start, weight=weight)


def _series(gating: Gating, level: float) -> ConsistencyDeparture | None:
    """The longest unbroken series of rejections, where chance hardly makes it: a lock-out.

    Of a gate that is not declared one that lasts to the end, which is no fault by itself.
    """
    (start, end, instants), declared = gating.longest(), gating.passes is not None
    nominal = _UNDECLARED if gating.passes is None else 1.0 - gating.passes
    n, lasts = len(gating.event), end == len(gating.event)
    p = n * nominal**instants
    if instants < 2 or p >= level or not (declared or lasts):
        return None
    first, last = (_named(int(gating.event[k]), float(gating.time_s[k])) for k in (start, end - 1))
    text = f"rejects {end - start:,} in a row, from {first} to {last}"
    if lasts:
        text = f"rejects everything from {first} on, {end - start:,} in a row"
    begins, until = int(gating.event[start]), int(gating.event[end - 1])
    weight = -float(np.log(n) + instants * np.log(nominal))
    return ConsistencyDeparture(text, p, begins, until, weight, declared)


def _named(event: int, time_s: float) -> str:
    """The time of an event, or its number where events have no times."""
    return f"event {event:,}" if time_s == event else f"{time_s:.6g} s"
