"""Bugs as they happen in filters, planted in one step or from one step on.

A filter's class is derived from; the derived class asks its `Bug` what becomes of a covariance, a
gain or a correction. What is recorded stays as it is: the matrices that the filter means to use.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.trace.events import Event, Update
from comparisons.trace.reader import TraceReader


@dataclass(frozen=True)
class Planted:
    """Where a trace is wrong.

    event: number of the first event that is wrong. sensor: of that event, if it is an update.
    blocks: whose covariance, correction or noise is wrong; empty where it is a sensor.
    """

    event: int
    sensor: str | None
    blocks: tuple[str, ...]
    what: str


NO_GAIN = np.zeros((0, 0))


class Step(NamedTuple):
    """A filter's step as it should be: covariances (n, n); F and Q or H and R; gain (n, m)."""

    before: Array
    after: Array
    jacobian: Array
    noise: Array
    gain: Array = NO_GAIN


Change = Callable[[Step, list[slice]], Array]
"""Of a step and the entries of the fault's blocks: a covariance or a gain."""


@dataclass(frozen=True)
class Fault:
    """A bug.

    place, nth: which event it is in: the nth from 0 of a kind, or of a sensor's updates. lasting:
    in all of them from there on. covariance, gain, correction: what the bug makes of each.
    noise, bias: what a sensor adds to its measurements, in its own standard deviations: its noise
    is `noise` times what the filter is told. gate: probability of the filter's gate from there on.
    """

    what: str
    place: str
    nth: int
    blocks: tuple[str, ...] = ()
    covariance: Change | None = None
    gain: Change | None = None
    correction: Callable[[Array, list[slice]], Array] | None = None
    noise: float = 1.0
    bias: float = 0.0
    gate: float | None = None
    lasting: bool = False

    @property
    def statistical(self) -> bool:
        """Whether the algebra stays right."""
        return self.covariance is None and self.gain is None and self.correction is None


@dataclass
class Bug:
    """What a fault, or none, does to a filter that passes its steps through here, in order."""

    fault: Fault | None
    blocks: dict[str, int]
    counts: Counter[str] = field(default_factory=Counter)

    def covariance(self, place: str, step: Step) -> Array:
        """Return the covariance after a prediction, a reset, or what else moves no estimate."""
        fault = self._of(place)
        self.counts[place] += 1
        if fault is None or fault.covariance is None:
            return step.after
        return fault.covariance(step, self._entries(fault))

    def update(self, sensor: str, step: Step, residual: Array) -> tuple[Array, Array, Array]:
        """Return gain (n, m), correction (n,) and covariance of an update."""
        fault, gain = self._of(sensor), step.gain
        if fault is not None and fault.gain is not None:
            gain = fault.gain(step, self._entries(fault))
        correction = gain @ residual
        if fault is not None and fault.correction is not None:
            correction = fault.correction(correction, self._entries(fault))
        return gain, correction, self.covariance(sensor, step._replace(gain=gain))

    def noise(self, sensor: str, sigma: float | Array, draw: Array) -> Array:
        """Return a measurement's noise. sigma: what the filter is told; draw: (m,) N(0, 1)."""
        fault = self._of(sensor)
        if fault is None:
            return np.asarray(sigma * draw)
        return np.asarray(sigma * (fault.noise * draw + fault.bias))

    def gate(self, sensor: str, gate: float) -> float:
        """Return the probability of a sensor's gate."""
        fault = self._of(sensor)
        return gate if fault is None or fault.gate is None else fault.gate

    def strikes(self, place: str) -> bool:
        """Return whether the fault is in the next event of a place."""
        return self._of(place) is not None

    def _of(self, place: str) -> Fault | None:
        """The fault, where it is in the next event of a place."""
        fault, nth = self.fault, self.counts[place]
        if fault is None or place != fault.place:
            return None
        return fault if nth == fault.nth or (fault.lasting and nth > fault.nth) else None

    def _entries(self, fault: Fault) -> list[slice]:
        """Where the fault's blocks stand."""
        ends = dict(zip(self.blocks, np.cumsum(list(self.blocks.values())), strict=True))
        return [
            slice(ends[name] - self.blocks[name], ends[name])
            for name in fault.blocks
            if name in ends
        ]


def where(path: Path, fault: Fault | None) -> Planted | None:
    """Return which event of a trace a fault is in."""
    if fault is None:
        return None
    found = [event for event in TraceReader(path) if _place(event) == fault.place]
    event = found[fault.nth]
    sensor = event.sensor if isinstance(event, Update) else None
    return Planted(event.number, sensor, fault.blocks, fault.what)


def _place(event: Event) -> str:
    return event.sensor if isinstance(event, Update) else type(event).__name__.lower()


def not_updated(step: Step, at: list[slice]) -> Array:
    """P stays as it was."""
    return step.before


def stale(step: Step, at: list[slice]) -> Array:
    """The covariance of one block, or the cross-covariance of two, stays as it was."""
    after = step.after.copy()
    after[at[0], at[-1]] = step.before[at[0], at[-1]]
    after[at[-1], at[0]] = step.before[at[-1], at[0]]
    return after


def dropped(step: Step, at: list[slice]) -> Array:
    """The cross-covariance of two blocks is set to zero."""
    after = step.after.copy()
    after[at[0], at[1]] = after[at[1], at[0]] = 0.0
    return after


def isolated(step: Step, at: list[slice]) -> Array:
    """A block is correlated with no other."""
    after = step.after.copy()
    after[at[0]] = after[:, at[0]] = 0.0
    after[at[0], at[0]] = step.after[at[0], at[0]]
    return after


def conditioned(step: Step, at: list[slice]) -> Array:
    """What is removed is taken for known: information, and not covariance, is cut down."""
    gone = ~step.jacobian.any(axis=0)
    p = step.before
    return updated(p, np.eye(len(p))[gone], np.zeros((gone.sum(),) * 2))[np.ix_(~gone, ~gone)]


def last_removed(step: Step, at: list[slice]) -> Array:
    """The last rows and columns are removed, whatever block was to be."""
    n = len(step.jacobian)
    return step.before[:n, :n]


def one_sided(step: Step, at: list[slice]) -> Array:
    """Of the cross-covariance of two blocks only one half is updated: P is not symmetric."""
    after = step.after.copy()
    after[at[1], at[0]] = step.before[at[1], at[0]]
    return after


def twice(step: Step, at: list[slice]) -> Array:
    """P is updated twice by the same measurement."""
    return updated(step.after, step.jacobian, step.noise)


def without_noise(step: Step, at: list[slice]) -> Array:
    """Q is left out, or its rows and columns of some blocks."""
    return np.asarray(step.after - _part(step.noise, at))


def double_noise(step: Step, at: list[slice]) -> Array:
    """Q is added twice, or its rows and columns of some blocks."""
    return np.asarray(step.after + _part(step.noise, at))


def transposed(step: Step, at: list[slice]) -> Array:
    """P = F' P F + Q."""
    return np.asarray(step.jacobian.T @ step.before @ step.jacobian + step.noise)


def without_noise_of_gain(step: Step, at: list[slice]) -> Array:
    """P = (I - K H) P (I - K H)': Joseph's form without K R K'."""
    return np.asarray(step.after - step.gain @ step.noise @ step.gain.T)


def by_sigma(step: Step, at: list[slice]) -> Array:
    """R holds standard deviations where the gain takes it for a covariance, P by the short form."""
    return updated(step.before, step.jacobian, np.diag(np.sqrt(np.diag(step.noise))))


def short_form(step: Step, at: list[slice]) -> Array:
    """P = (I - K H) P, of a gain that is not the Kalman gain; made symmetric."""
    after = step.before - step.gain @ step.jacobian @ step.before
    return np.asarray(0.5 * (after + after.T))


def half(step: Step, at: list[slice]) -> Array:
    """Half the gain."""
    return 0.5 * step.gain


def not_applied(correction: Array, at: list[slice]) -> Array:
    """The correction is not applied to some blocks."""
    return _scaled(correction, at, 0.0)


def wrong_sign(correction: Array, at: list[slice]) -> Array:
    """The correction is applied to some blocks with the wrong sign."""
    return _scaled(correction, at, -1.0)


def kalman_gain(p: Array, h: Array, r: Array) -> Array:
    """Return P H' (H P H' + R)^-1, (n, m)."""
    return np.asarray(np.linalg.solve(h @ p @ h.T + r, h @ p.T).T, dtype=np.float64)


def updated(p: Array, h: Array, r: Array) -> Array:
    """Return P after an update, by the short form."""
    return np.asarray(p - kalman_gain(p, h, r) @ h @ p)


def _scaled(correction: Array, at: list[slice], by: float) -> Array:
    scaled = correction.copy()
    for entries in at:
        scaled[entries] *= by
    return scaled


def _part(noise: Array, at: list[slice]) -> Array:
    """Rows and columns of some blocks, of all where there are none."""
    if not at:
        return noise
    inside = np.zeros(len(noise), dtype=bool)
    for entries in at:
        inside[entries] = True
    return np.where(inside[:, None] | inside[None, :], noise, 0.0)
