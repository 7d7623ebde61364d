"""The noises that a filter states beside those that its residuals show, from the events alone.

What a filter's estimate is off by moves linearly from event to event, whatever its gains were: the
residuals are measurements of a linear system with the noises P0, Q and R. A recursion with Kalman's
gain gives their likelihood under other noises. A factor on P0 or Q of a block, or on R of a sensor,
is fitted to it; of those that make the residuals likelier than chance explains, the likeliest is
named, and further ones on top of it.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.replay import BlockLayout, square
from comparisons.explain.recorded_steps import RecordedStep
from comparisons.trace.events import (
    Augment,
    Blocks,
    Clone,
    Event,
    Predict,
    Remove,
    Reset,
    TracePrior,
    Update,
)

_GRID = tuple(float(np.log(x)) for x in (0.01, 0.1, 0.25, 0.5, 2.0, 4.0, 10.0, 100.0))
"""Logarithms of factors, between which the likeliest is sought."""
_STEPS = (0.4, 0.1, 0.03)
"""Of the logarithm, about the likeliest one, by which it is found and its interval measured."""
_LARGEST = 50.0
"""Logarithm at which an interval ends at the latest."""
_MOST_SLOTS, _MOST_COMPONENTS = 100, 6
"""Stated noises that are looked at, and components of a measurement that are looked at by one."""


class NoiseSlot(NamedTuple):
    """A stated noise.

    Attributes:
        matrix: P0, Q or R.
        of: The block, or of R the sensor.
        component: Of a sensor's measurement; -1 of all.
        since: The event from which on it is another.
    """

    matrix: str
    of: str
    component: int = -1
    since: int = 0

    def words(self, components: Sequence[str] = ()) -> str:
        """Return what it is called. components: of the sensor, by name."""
        of = f"sensor `{self.of}`" if self.matrix == "R" else self.of
        if self.component >= 0:
            named = self.component < len(components)
            of = f"{components[self.component] if named else f'component {self.component}'} of {of}"
        return f"{self.matrix} of {of}"

    def is_of(self, matrix: str, of: str, number: int) -> bool:
        """Whether it is what an event's noise is of. number: the event's."""
        return self.matrix == matrix and self.of == of and number >= self.since

    def touches(self, event: Event) -> bool:
        """Whether an event has this noise, whenever it begins."""
        match event:
            case Predict():
                return self.matrix == "Q" and self.of in event.blocks
            case Update():
                return self.matrix == "R" and self.of == event.sensor
        return False


class NoiseFactor(NamedTuple):
    """A noise that residuals show.

    Attributes:
        slot: Which.
        gained: Of the likelihood's logarithm.
        factor: Of the stated one; of a variance, not of a sigma.
        low: Where its 95 % interval begins.
        high: Where it ends.
    """

    slot: NoiseSlot
    gained: float
    factor: float
    low: float
    high: float


Factors = Mapping[NoiseSlot, float]


def with_noises(steps: Iterable[RecordedStep], factors: Factors) -> Iterator[RecordedStep]:
    """Yield events with other noises, by Kalman's gain of them beside the filter's corrections."""
    layout = BlockLayout()
    for step in steps:
        event = step.event
        match event:
            case TracePrior():
                layout = BlockLayout(event.blocks, event.dims)
                root = _roots("P0", event, layout.dims, [factors])[0]
                event = event._replace(covariance=event.covariance * np.outer(root, root))
            case Predict():
                root = _roots("Q", event, layout.dims, [factors])[0]
                event = event._replace(noise=event.noise * np.outer(root, root))
            case Update():
                root = _roots_of_sensor(event, [factors])[0]
                noise = event.noise * np.outer(root, root)
                event = event._replace(noise=noise, gain=None, correction=step.applied)
            case _:
                layout.follow(event)
        yield step._replace(event=event)


def readings(one: NoiseFactor, steps: Sequence[RecordedStep]) -> list[str]:
    """Return what may have been written where a factor was fitted: its interval holds each."""
    factors = {
        "as of degrees where radians should be": float(np.radians(1.0)) ** 2,
        "as of radians that were converted twice": float(np.degrees(1.0)) ** 2,
    }
    stated = set(np.round(np.concatenate([np.empty(0), *_stated(one.slot, steps)]), 12).tolist())
    if len(stated) == 1 and (variance := stated.pop()) > 0.0:
        factors["as of a sigma where its square should be"] = variance
        factors["as of a variance that was squared"] = variance**-0.5
    times = [e.time_s for e, *_ in steps if isinstance(e, Predict) and e.time_s is not None]
    intervals = set(np.round(np.diff(times), 9).tolist())
    if one.slot.matrix == "Q" and len(intervals) == 1 and (interval := intervals.pop()) > 0.0:
        factors["as of a noise that is not multiplied by the interval"] = interval
        factors["as of a noise that is divided by the interval"] = 1.0 / interval
    return [words for words, factor in factors.items() if one.low <= factor <= one.high]


def _stated(slot: NoiseSlot, steps: Sequence[RecordedStep]) -> Iterator[Array]:
    """Yield a noise's variances, of each event."""
    layout = BlockLayout()
    for event, *_ in steps:
        match event:
            case TracePrior():
                layout = BlockLayout(event.blocks, event.dims)
                if slot.matrix == "P0":
                    yield layout.parts(event.blocks, event.covariance.diagonal())[slot.of]
            case Predict():
                if slot.touches(event):
                    yield layout.parts(event.blocks, event.noise.diagonal())[slot.of]
            case Update():
                if slot.touches(event):
                    component = slot.component if slot.component >= 0 else slice(None)
                    yield np.atleast_1d(event.noise.diagonal()[component])
            case _:
                layout.follow(event)


def fitted_noises(
    steps: Sequence[RecordedStep], slots: Sequence[NoiseSlot], known: Factors
) -> list[NoiseFactor]:
    """Return the likeliest factor of each slot by itself; none where residuals have no density.

    Args:
        steps: Of a trace, from its prior on.
        slots: Which noises, from when on.
        known: Factors that are there already.
    """
    if not slots:
        return []
    tried = [(slot, log) for slot in slots for log in _GRID]
    logs = log_likelihoods(steps, [known, *({**known, s: float(np.exp(x))} for s, x in tried)])
    neutral, by_slot = float(logs[0]), logs[1:].reshape(len(slots), -1)
    if not np.isfinite(neutral):
        return []
    peaks = np.array(_GRID)[by_slot.argmax(axis=1)]
    values, bends = by_slot.max(axis=1), np.zeros(len(slots))
    for step in _STEPS:
        around = [(s, x + k * step) for s, x in zip(slots, peaks, strict=True) for k in (-1, 0, 1)]
        made = log_likelihoods(steps, [{**known, s: float(np.exp(x))} for s, x in around])
        low, middle, high = made.reshape(-1, 3).T
        with np.errstate(all="ignore"):
            bends = (low - 2.0 * middle + high) / step**2
            slope = (high - low) / (2.0 * step)
            moves = np.where(bends < 0.0, -slope / bends, np.sign(slope) * step)
        peaks = peaks + np.nan_to_num(np.clip(moves, -2.0 * step, 2.0 * step))
        values = made.reshape(-1, 3).max(axis=1)
    widths = 1.96 / np.sqrt(np.maximum(-np.nan_to_num(bends), 1e-12))
    ends = np.exp((peaks, peaks - widths, np.minimum(peaks + widths, _LARGEST)))
    gained = np.maximum(values - neutral, 0.0)
    columns = zip(slots, gained.tolist(), *ends.tolist(), strict=True)
    return [NoiseFactor(slot, *row) for slot, *row in columns]


def noise_slots(steps: Sequence[RecordedStep]) -> list[NoiseSlot]:
    """Return the stated noises of a trace that are not zero."""
    slots: dict[NoiseSlot, None] = {}
    layout = BlockLayout()
    widths: dict[str, set[int]] = {}
    for event, *_ in steps:
        match event:
            case TracePrior():
                layout = BlockLayout(event.blocks, event.dims)
                slots |= _not_zero("P0", layout.parts(event.blocks, event.covariance.diagonal()))
            case Predict():
                slots |= _not_zero("Q", layout.parts(event.blocks, event.noise.diagonal()))
            case Update():
                widths.setdefault(event.sensor, set()).add(len(event.residual))
            case _:
                layout.follow(event)
    for sensor, width in widths.items():
        slots[NoiseSlot("R", sensor)] = None
        if len(width) == 1 and 1 < (count := max(width)) <= _MOST_COMPONENTS:
            slots |= {NoiseSlot("R", sensor, k): None for k in range(count)}
    return list(slots)[:_MOST_SLOTS]


def _not_zero(matrix: str, variances: Mapping[str, Array]) -> dict[NoiseSlot, None]:
    """Those of blocks whose noise is not zero."""
    return {NoiseSlot(matrix, block): None for block, part in variances.items() if part.any()}


def log_likelihoods(steps: Iterable[RecordedStep], noises: Sequence[Factors]) -> Array:
    """Return (N,) logarithms of the residuals' likelihoods, by N choices of noises.

    Of an event F and H may be (N, r, c), residuals and what is applied (N, r): one of each choice.
    """
    recursions = _Recursions(noises)
    with np.errstate(all="ignore"):
        for step in steps:
            recursions.take(step)
    return np.where(np.isfinite(recursions.likelihood), recursions.likelihood, -np.inf)


def _roots(
    matrix: str, event: TracePrior | Predict, dims: Mapping[str, int], noises: Sequence[Factors]
) -> Array:
    """(N, m) square roots of factors on P0 or Q, of the entries of an event's blocks."""
    factors = np.ones((len(noises), len(event.blocks)))
    for row, one in zip(factors, noises, strict=True):
        for slot, factor in one.items():
            row[[slot.is_of(matrix, block, event.number) for block in event.blocks]] *= factor
    return np.repeat(np.sqrt(factors), [dims[block] for block in event.blocks], axis=1)


def _roots_of_sensor(event: Update, noises: Sequence[Factors]) -> Array:
    """(N, m) square roots of factors on R, of the components of a measurement."""
    factors = np.ones((len(noises), len(event.noise)))
    for row, one in zip(factors, noises, strict=True):
        for slot, factor in one.items():
            if slot.is_of("R", event.sensor, event.number):
                row[slot.component if slot.component >= 0 else slice(None)] *= factor
    return np.sqrt(factors)


class _Recursions:
    """N recursions over the same events, each by Kalman's gain of its own noises.

    covariance: (N, n, n). mean: (N, n) of the error of the filter's estimate. likelihood: (N,) the
    logarithm of that of all residuals so far, but for a constant.
    """

    def __init__(self, noises: Sequence[Factors]) -> None:
        self.noises, self.layout = noises, BlockLayout()
        count = len(noises)
        self.covariance, self.mean = np.zeros((count, 0, 0)), np.zeros((count, 0))
        self.likelihood = np.zeros(count)
        self._beginnings = sorted({slot.since for noise in noises for slot in noise})
        self._known_roots: dict[tuple[Blocks, int], Array] = {}
        self._known_of_sensor: dict[tuple[str, int, int], Array] = {}

    def take(self, step: RecordedStep) -> None:
        """Do an event."""
        event = step.event
        match event:
            case TracePrior():
                self.layout = BlockLayout(event.blocks, event.dims)
                root = _roots("P0", event, self.layout.dims, self.noises)
                self.covariance = event.covariance * root[:, :, None] * root[:, None, :]
                self.mean = np.zeros((len(self.noises), self.layout.size))
            case Predict():
                self._move(event.blocks, event.jacobian)
                root = self._roots(event)
                inner = (slice(None), *square(self.layout.columns(event.blocks)))
                self.covariance[inner] += event.noise * root[:, :, None] * root[:, None, :]
                if step.applied is not None:
                    self.mean -= step.applied
            case Reset():
                self._move(event.blocks, event.jacobian)
            case Update():
                self._update(event, step.applied)
            case Augment():
                noise = event.noise_jacobian @ event.noise @ event.noise_jacobian.T
                self._append(event.name, event.blocks, event.jacobian, noise)
            case Clone():
                size = self.layout.dims[event.source]
                self._append(event.name, (event.source,), np.eye(size), np.zeros((size, size)))
            case Remove():
                kept = self.layout.remove(event.blocks)
                self.covariance = self.covariance[:, kept][:, :, kept]
                self.mean = self.mean[:, kept]

    def _roots(self, event: Predict) -> Array:
        key = event.blocks, bisect_right(self._beginnings, event.number)
        if key not in self._known_roots:
            self._known_roots[key] = _roots("Q", event, self.layout.dims, self.noises)
        return self._known_roots[key]

    def _roots_of(self, event: Update) -> Array:
        begun = bisect_right(self._beginnings, event.number)
        key = event.sensor, len(event.noise), begun
        if key not in self._known_of_sensor:
            self._known_of_sensor[key] = _roots_of_sensor(event, self.noises)
        return self._known_of_sensor[key]

    def _move(self, blocks: tuple[str, ...], f: Array) -> None:
        at, p = self.layout.columns(blocks), self.covariance
        p[:, at] = f @ p[:, at]
        p[:, :, at] = p[:, :, at] @ f.mT
        self.mean[:, at] = (f @ self.mean[:, at, None])[:, :, 0]

    def _update(self, event: Update, applied: Array | None) -> None:
        at, h, p = self.layout.columns(event.blocks), event.jacobian, self.covariance
        root = self._roots_of(event)
        across = p[:, :, at] @ h.mT
        s = h @ across[:, at] + event.noise * root[:, :, None] * root[:, None, :]
        innovation = event.residual - (h @ self.mean[:, at, None])[:, :, 0]
        right = np.concatenate((across.mT, innovation[:, :, None]), axis=2)
        try:
            solved = np.linalg.solve(s, right)
        except np.linalg.LinAlgError:
            solved = np.full_like(right, np.nan)
        gain, weighted = solved[:, :, :-1].mT, solved[:, :, -1]
        sign, log_det = np.linalg.slogdet(s)
        log_det = np.where(sign > 0.0, log_det, np.nan)
        self.likelihood -= 0.5 * (np.sum(innovation * weighted, axis=1) + log_det)
        p = p - gain @ across.mT
        self.covariance = 0.5 * (p + p.mT)
        self.mean = self.mean + np.sum(gain * innovation[:, None, :], axis=2)
        if applied is not None:
            self.mean -= applied

    def _append(self, name: str, blocks: tuple[str, ...], g: Array, noise: Array) -> None:
        at, p = self.layout.columns(blocks), self.covariance
        across = g @ p[:, at]
        inner = across[:, :, at] @ g.T + noise
        self.covariance = np.block([[p, across.mT], [across, inner]])
        self.mean = np.concatenate((self.mean, self.mean[:, at] @ g.T), axis=1)
        self.layout.add(name, len(g))
