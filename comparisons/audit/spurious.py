"""What a filter has learnt of directions that its sensors cannot tell.

Let the error where the directions are recorded be N alpha + c, alpha unknown and c with its prior
given alpha. The Kalman recursion over the recorded F, Q, H, R alone, with U = d error / d alpha,
tells what the blind sensors hold of alpha: T^T S^-1 T of every update, T = H U, for innovations
are independent. At the truth T is zero; where relations are linearised at different estimates it
is not (Huang, Mourikis and Roumeliotis 2010; Li and Mourikis 2013).

Events are gone through in stretches. Within one, only the blocks that it touches are followed; all
others learn of it at its end, as in the compressed filter (Guivant and Nebot 2001).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydantic import ConfigDict, computed_field, with_config
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dpotrf, dtrtrs

from comparisons.arrays import Array, Index
from comparisons.audit.replay import BlockLayout, Replay
from comparisons.figures import Aside, Figure
from comparisons.rounding import UNOBSERVED
from comparisons.shown import brief
from comparisons.trace.events import (
    Augment,
    Blocks,
    Clone,
    Directions,
    Event,
    Predict,
    Remove,
    Reset,
    TracePrior,
    Update,
)
from graphslam.arrays import conditional_covariance

VEHICLE = "pose"
"""The vehicle's block in traces of planar filters."""
HEADING = "heading"
"""The direction of planar SLAM that linearisation errors tell of."""
PARTS = 100
"""Into which the updates are divided to find where most was learnt."""
MOST_POINTS = 400
"""Of the curve, its start apart."""
MOST_BLOCKS = 24
MOST_EVENTS = 1_000
"""Of a stretch. With more blocks each event costs more; with fewer, there are more stretches."""
_LEAST_ROOM = 64
_ANGLES = ("heading", "yaw", "pitch", "roll", "rotation", "turn", "attitude")
_LENGTHS = ("east", "north", "up", "down", "translation", "position", "shift")


class LargestShare(NamedTuple):
    """The update with which the information about a direction grew most.

    blocks: of its measurement that told most, given those before it in the update.
    """

    event: int
    time_s: float | None
    sensor: str
    information: float
    blocks: Blocks

    @property
    def seen(self) -> str:
        """What was measured, in words: the blocks but the vehicle."""
        return " and ".join(name for name in self.blocks if name != VEHICLE)


@with_config(ConfigDict(extra="ignore"))  # what follows from others is computed anew
@dataclass(frozen=True)
class LearntDirection:
    """A direction that sensors cannot tell, and what the filter has learnt of it.

    Attributes:
        name: of the direction.
        unit: of sigma, by the name; empty where that says nothing.
        information: about it, the others unknown; zero where all is rounding.
        by_sensor: shares of the information, the others known.
        largest: the update with the largest share; no part of a result file.
        sigma: with which it seems to be known, in its unit; absent without information.
        event: the update with the largest share.
    """

    name: str
    unit: str
    information: float
    by_sensor: dict[str, float]
    largest: Aside[LargestShare | None] = None

    @computed_field
    @property
    def event(self) -> int | None:
        """Number of the update with the largest share."""
        return None if self.largest is None else self.largest.event

    @computed_field
    @property
    def sigma(self) -> Figure:
        """Infinite without information."""
        if self.information <= 0.0:
            return float("inf")
        return float((180.0 / np.pi if self.unit == "deg" else 1.0) / np.sqrt(self.information))


class Learnt(NamedTuple):
    """What was learnt of all d directions.

    information: (d, d). event: (C + 1,) of the curve, from the one that records the directions.
    time_s: (C + 1,), NaN where unknown. growth: (C + 1, d) information about each direction, the
    others unknown, gathered until then, from zero.
    """

    directions: tuple[LearntDirection, ...]
    information: Array
    event: Index
    time_s: Array
    growth: Array

    def __repr__(self) -> str:
        """Return the fields in one line."""
        return brief("Learnt", self._asdict())

    def of(self, name: str) -> LearntDirection:
        """Return a direction by its name."""
        return self.directions[self._place(name)]

    def curve(self, name: str) -> tuple[Array, Array]:
        """Return time_s (P + 1,) and information (P + 1,), after each of at most PARTS parts."""
        rows = np.unique(np.linspace(0, len(self.event) - 1, PARTS + 1).astype(np.intp))
        return self.time_s[rows], self.growth[rows, self._place(name)]

    def fastest(self, name: str) -> tuple[float, float, float]:
        """Return begin and end of the part in which most was learnt, and how much that was."""
        time_s, information = self.curve(name)
        if len(time_s) < 2:
            return float(time_s[0]), float(time_s[0]), 0.0
        gained = np.diff(information)
        row = int(gained.argmax())
        return float(time_s[row]), float(time_s[row + 1]), float(gained[row])

    def _place(self, name: str) -> int:
        return [direction.name for direction in self.directions].index(name)


class SpuriousInformation:
    """Takes the events one after the other, from the one that records the directions."""

    def __init__(self, directions: Directions, replay: Replay) -> None:
        """Begin.

        Args:
            directions: The event.
            replay: What the filter holds before it; it is not changed.
        """
        self._names, self._blind = directions.names, frozenset(directions.blind)
        count = len(self._names)
        u = np.zeros((replay.layout.size, count))
        u[replay.layout.columns(directions.blocks)] = directions.basis
        self._whole = _Whole(replay.layout, conditional_covariance(replay.covariance, u), u)
        self._waiting: list[Event] = []
        self._touched: dict[str, None] = {}
        self._by_sensor: dict[str, Array] = defaultdict(lambda: np.zeros((count, count)))
        self._information = np.zeros((count, count))
        self._gross = np.zeros(count)
        self._largest: list[LargestShare | None] = [None] * count
        self._most = np.zeros(count)
        self._last = directions.number, directions.time_s
        self._curve = [(*self._last, self._information)]
        self._stride, self._updates = 1, 0

    def take(self, event: Event) -> None:
        """Follow one event."""
        match event:
            case Update():
                if not event.used or event.sensor not in self._blind:
                    return
                named = event.blocks
            case Clone():
                named = (event.source,)
            case Predict() | Reset() | Augment() | Remove():
                named = event.blocks
            case _:
                return
        self._waiting.append(event)
        self._touched.update(dict.fromkeys(named))
        if len(self._touched) >= MOST_BLOCKS or len(self._waiting) >= MOST_EVENTS:
            self._follow()

    def _follow(self) -> None:
        """Go through the events that wait."""
        stretch = self._whole.stretch(self._touched)
        for event in self._waiting:
            if isinstance(event, Update):
                self._update(stretch, event)
            else:
                stretch.move(event)
        self._whole.take_over(stretch)
        self._waiting, self._touched = [], {}

    def _update(self, stretch: _Stretch, event: Update) -> None:
        fused = stretch.fuse(event)
        if fused is None:
            return
        told, gross = fused
        share = told.T @ told
        self._information = self._information + share
        self._by_sensor[event.sensor] += share
        self._gross += np.square(gross).sum(axis=0)
        own = share.diagonal()
        for i in np.flatnonzero(own > self._most).tolist():
            self._most[i] = own[i]
            blocks = _telling(event, told[:, i], stretch.layout)
            named = event.number, event.time_s, event.sensor, float(own[i])
            self._largest[i] = LargestShare(*named, blocks)
        self._updates += 1
        self._last = event.number, event.time_s
        if self._updates % self._stride == 0:
            self._curve.append((*self._last, self._information))
            if len(self._curve) > 2 * MOST_POINTS:
                self._curve, self._stride = self._curve[::2], 2 * self._stride

    def result(self) -> Learnt:
        """Return what was learnt so far."""
        self._follow()
        curve = list(self._curve)
        if self._updates % self._stride:
            curve.append((*self._last, self._information))
        start, *rest = curve
        rest = [*rest[:: -(-len(rest) // MOST_POINTS)][:-1], rest[-1]] if rest else []
        curve = [start, *rest]
        time_s = [np.nan if at is None else at for _, at, _ in curve]
        alone = self._marginal(self._information)
        return Learnt(
            tuple(self._direction(i, float(alone[i])) for i in range(len(self._names))),
            self._information.copy(),
            np.array([number for number, _, _ in curve], dtype=np.intp),
            np.array(time_s, dtype=float),
            np.array([self._marginal(one) for _, _, one in curve]),
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
        some = np.flatnonzero(np.diag(information) > UNOBSERVED * self._gross)
        for i in some.tolist():
            others = some[some != i]
            across = information[i, others]
            scale = np.sqrt(np.diag(information)[others])
            inner = np.linalg.pinv(information[np.ix_(others, others)] / np.outer(scale, scale))
            explained = (across / scale) @ inner @ (across / scale)
            found[i] = max(float(information[i, i] - explained), 0.0)
        return found


class _Stretch:
    """The blocks that some events touch, followed from what they were before these events.

    rows: (n, a + d + n) of each entry its derivatives by the a entries before, by alpha (d,), and
    its covariances. told: of each update, L^-1 H of the first a + d columns.
    """

    def __init__(self, layout: BlockLayout, covariance: Array, u: Array) -> None:
        self.before, self.layout = tuple(layout.dims), layout
        self.size = layout.size
        self.fixed = layout.size + u.shape[1]
        self.rows = np.hstack((np.eye(layout.size), u, covariance))
        self.told: list[Array] = []

    def move(self, event: Event) -> None:
        """Do what an event says that is no measurement."""
        match event:
            case Predict() | Reset():
                at, p, f = self._at(event.blocks), self.rows[:, self.fixed :], event.jacobian
                self.rows[at] = f @ self.rows[at]
                p[:, at] = p[:, at] @ f.T
                if isinstance(event, Predict):
                    p[(at, at) if isinstance(at, slice) else np.ix_(at, at)] += event.noise
            case Augment():
                at, g = self._at(event.blocks), event.noise_jacobian
                rows = event.jacobian @ self.rows[at]
                own = rows[:, self.fixed :][:, at] @ event.jacobian.T + g @ event.noise @ g.T
                self._append(event.name, rows, own)
            case Clone():
                at = self._at((event.source,))
                rows = self.rows[at]
                self._append(event.name, rows, rows[:, self.fixed :][:, at])
            case Remove():
                kept = self.layout.remove(event.blocks)
                columns = np.concatenate((np.arange(self.fixed), self.fixed + kept))
                self.rows = self.rows[np.ix_(kept, columns)]

    def _at(self, blocks: Blocks) -> slice | Index:
        return self.layout.columns(blocks)

    def _append(self, name: str, rows: Array, own: Array) -> None:
        self.layout.add(name, len(own))
        across = rows[:, self.fixed :].T
        self.rows = np.block([[self.rows, across], [rows, own]])

    def fuse(self, event: Update) -> tuple[Array, Array] | None:
        """Fuse a measurement; return T (m, d), whitened, and the sum of its terms without signs.

        The covariance is Joseph's form. None where S is not positive definite, or T has no bounds.
        """
        at, h, fixed = self._at(event.blocks), event.jacobian, self.fixed
        p, used = self.rows[:, fixed:], self.rows[at]
        seen = h @ used
        root, fault = dpotrf(seen[:, fixed:][:, at] @ h.T + event.noise, lower=1, clean=1)
        inverse_root = dtrtrs(root, np.eye(len(h)), lower=1)[0]
        whitened: Array = inverse_root @ seen
        told = whitened[:, self.size : fixed]
        if fault or not np.isfinite(told).all():
            return None
        gross = np.abs(inverse_root) @ (np.abs(h) @ np.abs(used[:, self.size : fixed]))
        gain = whitened[:, fixed:].T @ inverse_root
        self.told.append(whitened[:, :fixed])
        self.rows -= gain @ seen
        p -= (p[:, at] @ h.T - gain @ event.noise) @ gain.T
        return told, gross


class _Whole:
    """Covariance (N, N) and U (N, d) of all blocks, each in places of its own; free ones are zero.

    Where a block that is gone was is room for another, so that N is about the most there ever was.
    """

    def __init__(self, layout: BlockLayout, covariance: Array, u: Array) -> None:
        self._covariance, self._u = covariance, u
        self._places = {name: np.arange(layout.size)[layout.entries(name)] for name in layout.dims}
        self._free: list[int] = []

    def stretch(self, named: Iterable[str]) -> _Stretch:
        """Return a stretch of those of the named blocks that there are."""
        blocks = tuple(name for name in named if name in self._places)
        at = self._entries(blocks)
        layout = BlockLayout(blocks, [len(self._places[name]) for name in blocks])
        return _Stretch(layout, self._covariance[np.ix_(at, at)], self._u[at])

    def take_over(self, stretch: _Stretch) -> None:
        """Let all blocks learn what a stretch has told."""
        before, dims = self._entries(stretch.before), stretch.layout.dims
        for name in stretch.before:
            if len(self._places[name]) != dims.get(name):
                self._free += self._places.pop(name).tolist()
        self._place({name: dim for name, dim in dims.items() if name not in self._places})
        p, a = self._covariance, stretch.size
        across = p[before]
        if stretch.told and a < len(p) - len(self._free):
            told = np.concatenate(stretch.told)
            if len(told) > stretch.fixed:
                told = np.asarray(np.linalg.qr(told, mode="r"))
            learnt = told[:, :a] @ across
            self._u -= learnt.T @ told[:, a:]
            dgemm(-1.0, learnt.T, learnt.T, 1.0, p.T, trans_b=1, overwrite_c=1)
        now = self._entries(tuple(dims))
        moved = stretch.rows[:, :a] @ across
        p[now], p[:, now] = moved, moved.T
        p[self._free] = p[:, self._free] = self._u[self._free] = 0.0
        own = stretch.rows[:, stretch.fixed :]
        p[np.ix_(now, now)] = 0.5 * (own + own.T)
        self._u[now] = stretch.rows[:, a : stretch.fixed]

    def _entries(self, blocks: Blocks) -> Index:
        return np.concatenate([np.zeros(0, dtype=np.intp), *(self._places[b] for b in blocks)])

    def _place(self, dims: dict[str, int]) -> None:
        """Give places to new blocks."""
        count, size = sum(dims.values()), len(self._u)
        if count > len(self._free):
            more = max(count, _LEAST_ROOM, size // 4)
            self._free += range(size, size + more)
            self._covariance = np.pad(self._covariance, (0, more))
            self._u = np.pad(self._u, ((0, more), (0, 0)))
        for name, dim in dims.items():
            self._places[name] = np.array(self._free[:dim], dtype=np.intp)
            del self._free[:dim]


def _telling(event: Update, told: Array, layout: BlockLayout) -> Blocks:
    """Return the blocks of the measurement that told (m,) most, in rows that are of the same."""
    starts = np.cumsum([0, *(layout.dims[name] for name in event.blocks[:-1])])
    of = np.logical_or.reduceat(event.jacobian != 0.0, starts, axis=1)
    kinds, kind = np.unique(of, axis=0, return_inverse=True)
    most = kinds[np.bincount(kind.ravel(), np.square(told)).argmax()]
    return tuple(name for name, some in zip(event.blocks, most, strict=True) if some)


def learnt(events: Iterable[Event]) -> Learnt | None:
    """Return what a whole trace has learnt; None where it records no directions."""
    replay: Replay | None = None
    information: SpuriousInformation | None = None
    for event in events:
        if isinstance(event, TracePrior):
            replay = Replay(event)
        elif isinstance(event, Directions) and replay is not None:
            information = SpuriousInformation(event, replay)
        elif information is not None:
            information.take(event)
        elif replay is not None:
            replay.apply(event)
    return None if information is None else information.result()


def unit_of(name: str) -> str:
    """Return the unit in which a direction's sigma is said: deg of angles, m of lengths."""
    words = name.lower().replace("_", " ").split()
    if any(word in _ANGLES for word in words):
        return "deg"
    if any(word in (*_LENGTHS, "x", "y", "z") for word in words):
        return "m"
    return ""
