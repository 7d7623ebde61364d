"""What a filter has learnt of directions that its sensors cannot tell.

Let the error where the directions are recorded be N alpha + c, alpha unknown and c with its prior
given alpha. The Kalman recursion over the recorded F, Q, H, R alone, with U = d error / d alpha,
tells what the blind sensors hold of alpha: T^T S^-1 T of every update, T = H U, for innovations
are independent. At the truth T is zero; where relations are linearised at different estimates it
is not (Huang, Mourikis and Roumeliotis 2010; Li and Mourikis 2013).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.audit.replay import Replay
from comparisons.trace.events import (
    Augment,
    Blocks,
    Clone,
    Directions,
    Event,
    Predict,
    Prior,
    Remove,
    Reset,
    Update,
)
from graphslam.arrays import conditional_covariance

MOST_POINTS = 400
"""Of the curve."""
ROUNDING = 1e-18
"""Of what the sensors could tell if they were not blind: information below it is rounding."""
_ANGLES = ("heading", "yaw", "pitch", "roll", "rotation", "turn", "attitude")
_LENGTHS = ("east", "north", "up", "down", "translation", "position", "shift")


class LargestShare(NamedTuple):
    """The update with which the information about a direction grew most."""

    event: int
    time_s: float | None
    sensor: str
    information: float


class LearntDirection(NamedTuple):
    """One direction. information: of it alone, the others unknown; zero where all is rounding.

    by_sensor: shares in the information with the others known. largest: None where there is none.
    unit: of sigma, by the direction's name; empty where that says nothing.
    """

    name: str
    unit: str
    information: float
    by_sensor: dict[str, float]
    largest: LargestShare | None

    @property
    def sigma(self) -> float:
        """With which the direction seems to be known, in its unit; infinite without information."""
        if self.information <= 0.0:
            return float("inf")
        return float((180.0 / np.pi if self.unit == "deg" else 1.0) / np.sqrt(self.information))


class Learnt(NamedTuple):
    """What was learnt of all d directions.

    information: (d, d). event: (C,) of the curve, time_s: (C,), NaN where unknown. growth: (C, d)
    information about each direction, the others unknown, gathered until then.
    """

    directions: tuple[LearntDirection, ...]
    information: Array
    event: Index
    time_s: Array
    growth: Array


class SpuriousInformation:
    """Takes the events one after the other, from the one that records the directions."""

    def __init__(self, directions: Directions, replay: Replay) -> None:
        """Begin.

        Args:
            directions: The event.
            replay: What the filter holds before it; it is not changed.
        """
        self._names, self._blind = directions.names, frozenset(directions.blind)
        self._replay = replay.copy()
        self._replay.mean[:] = 0.0
        self._u = np.zeros((replay.layout.size, len(self._names)))
        self._u[replay.layout.columns(directions.blocks)] = directions.basis
        self._replay.covariance = conditional_covariance(replay.covariance, self._u)
        count = len(self._names)
        self._by_sensor: dict[str, Array] = defaultdict(lambda: np.zeros((count, count)))
        self._information = np.zeros((count, count))
        self._gross = np.zeros(count)
        self._largest: list[LargestShare | None] = [None] * count
        self._most = np.zeros(count)
        self._curve: list[tuple[int, float | None, Array]] = []
        self._stride, self._updates = 1, 0

    def take(self, event: Event) -> None:
        """Follow one event."""
        replay, u = self._replay, self._u
        match event:
            case Update():
                if event.used and event.sensor in self._blind:
                    self._update(event)
                return
            case Predict() | Reset():
                at = replay.layout.columns(event.blocks)
                u[at] = event.jacobian @ u[at]
            case Augment():
                at = replay.layout.columns(event.blocks)
                self._u = np.vstack((u, event.jacobian @ u[at]))
            case Clone():
                self._u = np.vstack((u, u[replay.layout.entries(event.source)]))
            case Remove():
                self._u = u[_kept(replay, event.blocks)]
            case _:
                return
        replay.apply(event)

    def _update(self, event: Update) -> None:
        at, u = self._replay.layout.columns(event.blocks), self._u
        fused = self._replay.update(event._replace(correction=None, gain=None))
        sensed = event.jacobian @ u[at]
        whitened = fused.inverse_root @ sensed
        share = whitened.T @ whitened
        if not np.isfinite(share).all():
            return
        self._u = u - fused.gain @ sensed
        self._information += share
        self._by_sensor[event.sensor] += share
        gross = np.abs(fused.inverse_root) @ (np.abs(event.jacobian) @ np.abs(u[at]))
        self._gross += np.square(gross).sum(axis=0)
        own = np.diag(share)
        for i in np.flatnonzero(own > self._most).tolist():
            self._most[i] = own[i]
            self._largest[i] = LargestShare(event.number, event.time_s, event.sensor, float(own[i]))
        self._updates += 1
        if self._updates % self._stride == 0:
            self._curve.append((event.number, event.time_s, self._information.copy()))
            if len(self._curve) >= 2 * MOST_POINTS:
                self._curve, self._stride = self._curve[1::2], 2 * self._stride
        self._last = event.number, event.time_s

    def result(self) -> Learnt:
        """Return what was learnt so far."""
        curve = list(self._curve)
        if self._updates and self._updates % self._stride:
            curve.append((*self._last, self._information.copy()))
        curve = curve[:: -(-len(curve) // MOST_POINTS)][:-1] + curve[-1:] if curve else []
        growth = np.array([self._marginal(one) for _, _, one in curve])
        time_s = [np.nan if at is None else at for _, at, _ in curve]
        alone = self._marginal(self._information)
        return Learnt(
            tuple(self._direction(i, float(alone[i])) for i in range(len(self._names))),
            self._information.copy(),
            np.array([number for number, _, _ in curve], dtype=np.intp),
            np.array(time_s, dtype=float),
            growth.reshape(len(curve), len(self._names)),
        )

    def _direction(self, i: int, information: float) -> LearntDirection:
        name = self._names[i]
        shares = {sensor: float(one[i, i]) for sensor, one in self._by_sensor.items()}
        largest = self._largest[i] if information > 0.0 else None
        return LearntDirection(name, unit_of(name), information, shares, largest)

    def _marginal(self, information: Array) -> Array:
        """Information (d,) about each direction where the others are unknown.

        A direction of which all is rounding is left out: known to nobody, it explains nothing.
        """
        found = np.zeros(len(information))
        some = np.flatnonzero(np.diag(information) > ROUNDING * self._gross)
        for i in some.tolist():
            others = some[some != i]
            across = information[i, others]
            scale = np.sqrt(np.diag(information)[others])
            inner = np.linalg.pinv(information[np.ix_(others, others)] / np.outer(scale, scale))
            explained = (across / scale) @ inner @ (across / scale)
            found[i] = max(float(information[i, i] - explained), 0.0)
        return found


def learnt(events: Iterable[Event]) -> Learnt | None:
    """Return what a whole trace has learnt; None where it records no directions."""
    replay: Replay | None = None
    found: SpuriousInformation | None = None
    for event in events:
        if isinstance(event, Prior):
            replay = Replay(event)
        elif isinstance(event, Directions) and replay is not None:
            found = SpuriousInformation(event, replay)
        elif found is not None:
            found.take(event)
        elif replay is not None:
            replay.apply(event)
    return None if found is None else found.result()


def unit_of(name: str) -> str:
    """Return the unit in which a direction's sigma is said: deg of angles, m of lengths."""
    words = name.lower().replace("_", " ").split()
    if any(word in _ANGLES for word in words):
        return "deg"
    if any(word in (*_LENGTHS, "x", "y", "z") for word in words):
        return "m"
    return ""


def _kept(replay: Replay, gone: Blocks) -> Index:
    """Entries of the blocks that stay."""
    stays = np.ones(replay.layout.size, dtype=bool)
    for name in gone:
        stays[replay.layout.entries(name)] = False
    return np.flatnonzero(stays)
