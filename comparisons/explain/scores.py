"""Which noises and constants residuals ask for: the likelihood's derivatives by all at once.

One pass forwards and one backwards over the events give the derivative of the residuals' likelihood
by a factor on each stated noise, and by a constant in each place, from any event on (Koopman and
Shephard 1992, exact scores by the disturbance smoother). How far a derivative lies from zero by
chance is measured by the same pass over drawn innovations.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.audit.replay import Columns, Fused, Replay, square
from comparisons.explain.jacobians import JacobianGradient
from comparisons.explain.noises import Factors, NoiseSlot, with_noises
from comparisons.explain.offsets import CONSTANT, OffsetSlot, regressors
from comparisons.explain.recorded_steps import RecordedStep, apply_step
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

_DRAWS = 64
"""Of innovations, by which a derivative's spread is measured."""
_DRAWS_OF_GRADIENTS = 16
"""Of these, those by which a Jacobian's is measured."""
_PLACES = 200
"""Events from one of which on a change may begin, spread over the trace."""
_LEAST_EVENTS = 10
"""Of a slot, from a beginning on: fewer are no evidence of one."""

Slot = NoiseSlot | OffsetSlot


class ScoredSlot(NamedTuple):
    """What a change of a slot gains of the likelihood's logarithm, by its derivatives alone.

    Attributes:
        slot: Which, of the whole trace.
        gained: By a change of all of it.
        since: The event from which on a change gains most.
        gained_since: By that.
    """

    slot: Slot
    gained: float
    since: int
    gained_since: float


class _Passed(NamedTuple):
    """An event as the recursion went through it.

    size: of the state before. at: entries (k,) of the blocks that it reads, or removes. dims:
    theirs. interval_s, moved: as of a recorded step. mean, across: (k,) and (k, n) before it, where
    its Jacobian's derivative is asked for.
    """

    event: Event
    size: int
    at: Columns
    dims: tuple[int, ...]
    fused: Fused | None = None
    interval_s: float = 1.0
    moved: Array | None = None
    mean: Array | None = None
    across: Array | None = None


def likelihood_slopes(
    steps: Sequence[RecordedStep],
    slots: Sequence[Slot],
    factors: Factors,
    with_gradients: Collection[int] = (),
) -> LikelihoodSlopes:
    """Return the derivatives of the likelihood by changes of slots; zeros without a covariance.

    Args:
        steps: Of a trace, from its prior on.
        slots: Of the whole trace.
        factors: On its noises.
        with_gradients: Numbers of events whose Jacobians the likelihood is derived by as well.
    """
    with np.errstate(all="ignore"):
        passed, size = _forwards(steps, factors, with_gradients)
        slopes = LikelihoodSlopes(slots, size)
        places = set(np.linspace(0, len(passed) - 1, _PLACES, dtype=int).tolist())
        for k in range(len(passed) - 1, -1, -1):
            slopes.take(passed[k])
            if k in places:
                slopes.try_beginning(passed[k].event.number)
    return slopes


def _forwards(
    steps: Sequence[RecordedStep], factors: Factors, with_gradients: Collection[int]
) -> tuple[list[_Passed], int]:
    """Kalman's recursion with other noises, beside the filter's corrections; the state's size."""
    passed: list[_Passed] = []
    replay: Replay
    for step in with_noises(steps, factors):
        event = step.event
        match event:
            case TracePrior():
                replay = Replay(event)
                passed.append(_Passed(event, replay.layout.size, slice(None), event.dims))
                continue
            case Update():
                event = event._replace(used=True)
                blocks: Blocks = event.blocks
            case Clone():
                blocks = (event.source,)
            case Predict() | Reset() | Augment() | Remove():
                blocks = event.blocks
            case _:
                continue
        layout = replay.layout
        dims = tuple(layout.dims[name] for name in blocks)
        one = _Passed(
            event, layout.size, layout.columns(blocks), dims, None, step.interval_s, step.moved
        )
        if event.number in with_gradients:
            before = replay.mean[one.at].copy(), replay.covariance[one.at].copy()
            one = one._replace(mean=before[0], across=before[1])
        one = one._replace(fused=apply_step(replay, step._replace(event=event)))
        passed.append(one)
    return passed, replay.layout.size


class _OffsetRows(NamedTuple):
    """Constants of blocks or of a sensor: their rows and kinds (S,), which entries (S, k)."""

    rows: Index
    kinds: Index
    shares: Array


class LikelihoodSlopes:
    """The smoother's recursion: r (n, 1 + D) of the residuals and of drawn ones, and N (n, n).

    r is the derivative of the likelihood's logarithm by the state after an event, N the spread of
    r; u and D are the same of a measurement's noise (Durbin and Koopman 2012, section 4.5).

    Attributes:
        slots: Of the whole trace.
        total: (S + 1, 1 + D) derivatives by logarithms of factors and by constants, of all events
            that were passed; of the residuals and of drawn ones. The last row is of no slot.
        gradients: Derivatives by Jacobians, by the numbers of events that they were asked for.
    """

    def __init__(self, slots: Sequence[Slot], size: int) -> None:
        """Begin after the last event. size: of the state there."""
        self.slots = list(slots)
        self.row = {slot: k for k, slot in enumerate(slots)}
        self.total = np.zeros((len(slots) + 1, 1 + _DRAWS))
        self.count = np.zeros(len(slots) + 1, dtype=np.intp)
        self.best = np.zeros(len(slots))
        self.since = np.zeros(len(slots), dtype=np.intp)
        self.rng = np.random.default_rng(0)
        self.gradients: dict[int, JacobianGradient] = {}
        self.r, self.n = np.zeros((size, 1 + _DRAWS)), np.zeros((size, size))
        self._noise_rows: dict[tuple[str, Blocks, int], Index] = {}
        self._offset_rows: dict[tuple[Blocks, tuple[int, ...], bool], _OffsetRows] = {}

    def take(self, passed: _Passed) -> None:
        """Go back over an event."""
        event, size, at = passed.event, passed.size, passed.at
        match event:
            case TracePrior():
                self._add_noise("P0", event.blocks, event.covariance, passed)
            case Predict():
                self._add_noise("Q", event.blocks, event.noise, passed)
                self._add_offsets(event.blocks, passed, self.r[at])
                spread = self.n[at].copy()
                spread[:, at] = spread[:, at] @ event.jacobian
                after = self.r[at].copy()
                self._move(event.jacobian, at)
                self._derive(passed, after, spread)
            case Reset():
                self._move(event.jacobian, at)
            case Update() if passed.fused is not None:
                self._update(event, passed, passed.fused)
            case Augment():
                self._merge(event.jacobian, at, size)
            case Clone():
                self._merge(np.eye(len(self.r) - size), at, size)
            case Remove():
                kept = np.delete(np.arange(size), np.arange(size)[at])
                r, n = self.r, self.n
                self.r, self.n = np.zeros((size, r.shape[1])), np.zeros((size, size))
                self.r[kept], self.n[square(kept)] = r, n

    def _move(self, f: Array, at: Columns) -> None:
        """Go back over e = F e."""
        n = self.n
        self.r[at] = f.T @ self.r[at]
        n[at] = f.T @ n[at]
        n[:, at] = n[:, at] @ f

    def _merge(self, g: Array, at: Columns, size: int) -> None:
        """Give the share of a new block, G e, to those that it was made of."""
        r, n = self.r, self.n
        across, inner = g.T @ n[size:, :size], g.T @ n[size:, size:] @ g
        self.r, self.n = r[:size].copy(), n[:size, :size].copy()
        self.r[at] += g.T @ r[size:]
        self.n[at] += across
        self.n[:, at] += across.T
        self.n[square(at)] += inner

    def _derive(self, passed: _Passed, noise: Array, spread: Array) -> None:
        """Add the derivative by a Jacobian: of noise times the smoothed error, less what is meant.

        Args:
            passed: The event, the recursion being before it.
            noise: (r, 1 + D) derivatives by what the Jacobian leads to.
            spread: (r, n) their covariance with r before the event.
        """
        if passed.mean is None or passed.across is None:
            return
        smoothed = passed.across @ self.r[:, : 1 + _DRAWS_OF_GRADIENTS]
        smoothed[:, 0] += passed.mean
        noise = noise[:, : 1 + _DRAWS_OF_GRADIENTS]
        meant = spread @ passed.across.T
        slope = noise[:, None, :] * smoothed[None, :, :] - meant[:, :, None]
        self.gradients[passed.event.number] = JacobianGradient(slope, noise)

    def _update(self, event: Update, passed: _Passed, fused: Fused) -> None:
        """Add what a measurement's noise and constants gain, and go back over it."""
        at, h, gain, root = passed.at, event.jacobian, fused.gain, fused.inverse_root
        drawn = self.rng.standard_normal((len(root), _DRAWS))
        spread = self.n @ gain
        u = root.T @ np.column_stack((fused.whitened, drawn)) - gain.T @ self.r
        d = root.T @ root + gain.T @ spread
        values = _noise_shares(event.noise, u, d)
        self._add(
            self._of_noises(event.sensor, (), len(u)),
            np.vstack((values.sum(axis=0, keepdims=True), values)),
        )
        self._add_offsets((event.sensor,), passed, u)
        self.r[at] += h.T @ u
        across = spread @ h
        self.n[:, at] -= across
        self.n[at] -= across.T
        self.n[square(at)] += h.T @ d @ h
        self.n = 0.5 * (self.n + self.n.T)  # what rounding makes unlike would grow
        of_noise = -spread.T
        of_noise[:, at] += d @ h
        self._derive(passed, u, of_noise)

    def _add_noise(self, matrix: str, blocks: Blocks, noise: Array, passed: _Passed) -> None:
        """Add what a noise of the state gains, by block."""
        at, dims = passed.at, passed.dims
        rows = self._of_noises(matrix, blocks, 0)
        shares = _noise_shares(noise, self.r[at], self.n[square(at)])
        self._add(rows, np.add.reduceat(shares, np.cumsum((0, *dims[:-1])), axis=0))

    def _add_offsets(self, of: Blocks, passed: _Passed, values: Array) -> None:
        """Add what constants gain. of: blocks or a sensor; values: derivatives by their entries."""
        is_predicted = isinstance(passed.event, Predict)
        key = of, passed.dims if is_predicted else (len(values),), is_predicted
        if key not in self._offset_rows:
            self._offset_rows[key] = self._of_offsets(*key)
        rows, kinds, shares = self._offset_rows[key]
        there = (kinds == CONSTANT) | (passed.moved is not None)
        by_kind = regressors(passed.interval_s, passed.moved, len(values))
        self._add(rows[there], (shares * by_kind[kinds])[there] @ values)

    def _of_offsets(self, of: Blocks, dims: tuple[int, ...], is_predicted: bool) -> _OffsetRows:
        """Those of blocks or of a sensor."""
        rows, kinds, shares = list[int](), list[int](), list[Array]()
        first = 0
        for name, size in zip(of, dims, strict=True):
            for slot, row in self.row.items():
                if not isinstance(slot, OffsetSlot) or slot.of != name:
                    continue
                share = slot.share(size)
                if slot.is_predicted == is_predicted and share.any():
                    rows.append(row)
                    kinds.append(slot.kind)
                    shares.append(np.zeros(sum(dims)))
                    shares[-1][first : first + size] = share
            first += size
        every = np.array(rows, dtype=np.intp), np.array(kinds, dtype=np.intp)
        return _OffsetRows(*every, np.reshape(shares, (-1, sum(dims))))

    def _add(self, rows: Index, values: Array) -> None:
        self.total[rows] += values
        self.count[rows] += 1

    def _of_noises(self, of: str, blocks: Blocks, size: int) -> Index:
        """Rows of P0's or Q's noises, of blocks; or of a sensor's of some size, all and each."""
        key = of, blocks, size
        if key not in self._noise_rows:
            noises = [NoiseSlot(of, name) for name in blocks]
            noises = noises or [NoiseSlot("R", of, k) for k in range(-1, size)]
            self._noise_rows[key] = self._index(noises)
        return self._noise_rows[key]

    def _index(self, slots: Sequence[Slot]) -> Index:
        """Rows of some slots, once each; the last one for what is none."""
        rows = [self.row.get(slot, -1) for slot in slots]
        return np.array([row if row not in rows[:k] else -1 for k, row in enumerate(rows)])

    def try_beginning(self, number: int) -> None:
        """See whether changes gain more from an event on than from those after it."""
        gained = np.where(self.count[:-1] >= _LEAST_EVENTS, self._gained(), 0.0)
        better = gained > self.best
        self.best[better], self.since[better] = gained[better], number

    def _gained(self) -> Array:
        """(S,) halves of squares of derivatives, by what chance makes of these."""
        total = self.total[:-1]
        spread = np.mean(total[:, 1:] ** 2, axis=1)
        gained: Array = np.nan_to_num(0.5 * total[:, 0] ** 2 / spread, nan=0.0, posinf=0.0)
        return gained

    def scored(self) -> list[ScoredSlot]:
        """Return all slots with what they gain."""
        columns = self._gained().tolist(), self.since.tolist(), self.best.tolist()
        return [ScoredSlot(*score) for score in zip(self.slots, *columns, strict=True)]


def _noise_shares(noise: Array, r: Array, n: Array) -> Array:
    """(m, 1 + D) halves of diag(V (r r^T - N)): derivatives by logarithms of factors on V."""
    shares: Array = 0.5 * ((noise @ r) * r - np.sum(noise * n, axis=1)[:, None])
    return shares
