"""Whether innovations are as large as the filter says, independent in time, and rejected at a rate.

With S = L L^T, L^-1 nu holds independent standard normal numbers if the filter is consistent. What
a gate lets pass is shorter: where the gate's probability is known, a passed vector is lengthened to
the quantile that its length has among those that pass. Then it is standard normal again, exactly.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr, bdtrc, betaincinv, chdtr, chdtrc, gammainc, gammaincinv, ndtr

from comparisons.arrays import Array, Index
from comparisons.statistics import Band, Nis, Whiteness, average, whiteness
from comparisons.trace.events import Sensor

MOST_WINDOWS = 60
LEAST_IN_WINDOW = 10
_BEYOND = 0.05
"""Bands that are printed leave so many sound runs outside."""


class Departure(NamedTuple):
    """A figure that a sound filter leaves rarely. p_value: two-sided. event: where it begins."""

    sensor: str
    what: str
    p_value: float
    event: int | None = None
    until: int | None = None


class Window(NamedTuple):
    """Mean NIS over a stretch. first, last: events."""

    first: int
    last: int
    mean: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class SensorFigures:
    """One sensor. nis: of the whole vector, and of each component where all have as many.

    rejected, measured: how many. nominal: share that the gate lets pass; None without a gate.
    rejected_band: share of rejections that 95 % of sound runs have. unusable: without a valid S.
    """

    sensor: str
    nis: tuple[Nis, ...]
    whiteness: tuple[Whiteness, ...]
    windows: tuple[Window, ...]
    measured: int
    rejected: int
    nominal: float | None
    rejected_band: tuple[float, float] | None
    unusable: int
    departures: tuple[Departure, ...]


class InnovationLog:
    """Whitened innovations of one sensor as they come, in little memory."""

    def __init__(self) -> None:
        """Start empty."""
        self._values, self._sizes = array("d"), array("q")
        self._events, self._times, self._used = array("q"), array("d"), array("b")

    def add(self, event: int, time_s: float | None, whitened: Array, used: bool) -> None:
        """Keep one. Time is the event's number where there is none."""
        self._values.frombytes(whitened.tobytes())
        self._sizes.append(len(whitened))
        self._events.append(event)
        self._times.append(float(event) if time_s is None else time_s)
        self._used.append(used)

    def figures(self, name: str, sensor: Sensor, level: float) -> SensorFigures:
        """Judge them. level: of this sensor's departures together, of a sound filter."""
        sizes: Index = np.frombuffer(self._sizes, np.int64).astype(np.intp)
        values: Array = np.frombuffer(self._values)
        used = np.frombuffer(self._used, np.int8) > 0
        row = np.repeat(np.arange(len(sizes)), sizes)
        nis = _squared(values, row, len(sizes))
        usable = np.isfinite(nis)
        if sensor.gate is not None:
            values = values * _lengthened(nis, sizes, sensor.gate)[row]
            nis = _squared(values, row, len(sizes))
        kept = usable & used
        events = np.frombuffer(self._events, np.int64).astype(np.intp)
        times = np.frombuffer(self._times)
        series = _Series(name, nis[kept], sizes[kept], events[kept], times[kept])
        rejected = int(np.count_nonzero(usable & ~used))
        measured = int(np.count_nonzero(usable))
        components = _components(values, sizes, kept, row)
        departures, found = list[Departure](), list[Nis]()
        white = list[Whiteness]()
        if len(series.nis):
            found, white, departures = series.judge(components, sensor.components, level)
        band = None
        if sensor.gate is not None and measured:
            departures += _gating(name, events[usable], ~used[usable], 1.0 - sensor.gate, level)
            band = _share_band(measured, 1.0 - sensor.gate)
        return SensorFigures(
            sensor=name,
            nis=tuple(found),
            whiteness=tuple(white),
            windows=series.windows(),
            measured=measured,
            rejected=rejected,
            nominal=sensor.gate,
            rejected_band=band,
            unusable=int(np.count_nonzero(~usable)),
            departures=tuple(departures),
        )


@dataclass(frozen=True)
class _Series:
    """NIS (n,) of `dof` (n,) numbers each, at events (n,) and times (n,)."""

    name: str
    nis: Array
    dof: Index
    event: Index
    time_s: Array

    def judge(
        self, components: Array | None, names: Sequence[str], level: float
    ) -> tuple[list[Nis], list[Whiteness], list[Departure]]:
        """Judge NIS, components, whiteness and windows, at a level that they share."""
        white = list[Whiteness]()
        d = 0 if components is None else components.shape[1]
        windows = self._windows()
        tests = 1 + 2 * d + d + len(windows)
        share = level / tests
        departures = self._mean(self.nis, self.dof, "NIS", share)
        if components is None:
            total = float(self.dof.mean())
            found = [
                Nis(self.name, round(total), len(self.nis), float(self.nis.mean()), _band(self.dof))
            ]
        else:
            found = [average(self.name, components**2)]
        for i in range(d):
            label = names[i] if len(names) == d else f"component {i}"
            assert components is not None  # noqa: S101 - d is zero otherwise
            column = components[:, i]
            if d > 1:
                found.append(average(label, column[:, None] ** 2))
                departures += self._mean(
                    column**2, np.ones(len(column), dtype=np.intp), f"NIS of {label}", share
                )
            departures += self._bias(column, label, share)
            series = whiteness(label, "time", column)
            if series is not None:
                white.append(series)
                departures += self._white(series, share)
        departures += self._window_departures(windows, share)
        return found, white, departures

    def windows(self) -> tuple[Window, ...]:
        """Return means over stretches, with bands that 95 % of sound ones keep."""
        return tuple(
            Window(
                int(self.event[part[0]]),
                int(self.event[part[-1]]),
                float(self.nis[part].mean()),
                *_band(self.dof[part]),
            )
            for part in self._windows()
        )

    def _windows(self) -> list[Index]:
        n = len(self.nis)
        count = min(MOST_WINDOWS, n // LEAST_IN_WINDOW)
        return list(np.array_split(np.arange(n), count)) if count > 1 else []

    def _mean(self, nis: Array, dof: Index, what: str, level: float) -> list[Departure]:
        p = _two_sided(float(nis.sum()), float(dof.sum()))
        if p >= level:
            return []
        mean, right = float(nis.mean()), float(dof.mean())
        word = "too high" if mean > right else "too low"
        return [Departure(self.name, f"{what} is {word}: {mean:.3g}, expected {right:.3g}", p)]

    def _bias(self, column: Array, label: str, level: float) -> list[Departure]:
        z = float(column.sum() / np.sqrt(len(column)))
        p = float(2.0 * ndtr(-abs(z)))
        if p >= level:
            return []
        text = f"mean of {label} is {column.mean():+.3g} sigma, expected 0"
        return [Departure(self.name, text, p)]

    def _white(self, series: Whiteness, level: float) -> list[Departure]:
        if series.p_value >= level:
            return []
        text = f"{series.component} is correlated in time: {series.coefficient[0]:+.2f} at lag 1"
        return [Departure(self.name, text, series.p_value)]

    def _window_departures(self, windows: list[Index], level: float) -> list[Departure]:
        """The first stretch that leaves its band, with the event at which it begins to."""
        out = []
        for part in windows:
            p = _two_sided(float(self.nis[part].sum()), float(self.dof[part].sum()))
            if p < level:
                out.append((part, p))
        if not out:
            return []
        (part, p), last = out[0], out[-1][0]
        mean, right = float(self.nis[part].mean()), float(self.dof[part].mean())
        first = max(0, int(part[0]) - len(part))  # it may have begun in the window before
        start = first + _onset(self.nis[first : part[-1] + 1], mean, right)
        high = "too high" if mean > right else "too low"
        text = (
            f"NIS is {high} from {self.time_s[start]:.6g} to {self.time_s[last[-1]]:.6g}: "
            f"{mean:.3g}, expected {right:.3g}"
        )
        return [Departure(self.name, text, p, int(self.event[start]), int(self.event[last[-1]]))]


def _squared(values: Array, row: Index, count: int) -> Array:
    """Sums (count,) of squares by row."""
    total: Array = np.zeros(count)
    np.add.at(total, row, values**2)
    return total


def _lengthened(nis: Array, dof: Index, gate: float) -> Array:
    """Factors (n,) by which vectors that passed a gate are standard normal again."""
    passed = gammainc(0.5 * dof, 0.5 * nis) / gate
    found: Array = np.ones(len(nis))
    some = (nis > 0.0) & (passed < 1.0)
    found[some] = np.sqrt(2.0 * gammaincinv(0.5 * dof[some], passed[some]) / nis[some])
    return found


def _components(values: Array, sizes: Index, kept: NDArray[np.bool_], row: Index) -> Array | None:
    """Values of the kept vectors (n, d), None where they differ in size."""
    if not kept.any() or len(np.unique(sizes[kept])) != 1:
        return None
    return values[kept[row]].reshape(-1, int(sizes[kept][0]))


def _two_sided(value: float, dof: float) -> float:
    """Probability that a chi-square variable is as far out as this, on either side."""
    return float(min(1.0, 2.0 * min(chdtr(dof, value), chdtrc(dof, value))))


def _band(dof: Index) -> Band:
    """Of the mean of chi-square variables, what 95 % of sound runs keep."""
    half, n = 0.5 * float(dof.sum()), len(dof)
    low, high = (2.0 * gammaincinv(half, q) / n for q in (0.5 * _BEYOND, 1.0 - 0.5 * _BEYOND))
    return Band(float(low), float(high))


def _gating(
    name: str, event: Index, out: NDArray[np.bool_], nominal: float, level: float
) -> list[Departure]:
    """The rate of rejections (n,) against its nominal, by the binomial distribution."""
    n, rejected = len(out), int(np.count_nonzero(out))
    upper = 1.0 if rejected == 0 else float(bdtrc(rejected - 1, n, nominal))
    p = min(1.0, 2.0 * min(float(bdtr(rejected, n, nominal)), upper))
    if p >= level:
        return []
    rate = rejected / n
    start = int(event[_onset(out.astype(float), rate, nominal)])
    text = f"rejects {rejected:,} of {n:,} ({100.0 * rate:.2g} %, nominal {100.0 * nominal:.2g} %)"
    return [Departure(name, text, p, start)]


def _onset(values: Array, mean: float, right: float) -> int:
    """Return where a series most likely changes from one mean to another.

    The least cumulative sum of the differences from halfway between the two.
    """
    apart = values - 0.5 * (mean + right)
    total = np.concatenate(([0.0], np.cumsum(apart if mean > right else -apart)))
    return int(np.argmin(total[:-1]))


def _share_band(n: int, nominal: float) -> tuple[float, float]:
    """Shares of rejections that 95 % of sound runs have, about, by the beta distribution."""
    mean = n * nominal
    low = float(betaincinv(mean + 0.5, n - mean + 0.5, 0.5 * _BEYOND))
    high = float(betaincinv(mean + 0.5, n - mean + 0.5, 1.0 - 0.5 * _BEYOND))
    return low, high
