"""The covariance recursion of the recorded events: what a filter should hold after each of them.

In covariance form, with the gain that the filter says it used, so that it is right for suboptimal
gains, too. graphslam's event smoother solves the same events by least squares, independently.
Gains and corrections that are not Kalman's are named, not condemned: a filter may use any gain, if
its covariance is that of this gain and its estimate moves by it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from comparisons.arrays import Array, Index
from comparisons.trace.events import (
    Augment,
    Blocks,
    Clone,
    Directions,
    Evaluation,
    Event,
    Predict,
    Remove,
    Reset,
    Snapshot,
    TracePrior,
    Update,
)

Columns = slice | Index

_ALIKE = 1e-4
"""Relative to the largest entry, within which a shape of a gain is recognised."""
_NAMED = 3
"""Blocks that are named even where they are all."""


def square(at: Columns) -> tuple[Any, Any]:
    """Return the index of rows and columns alike."""
    if isinstance(at, slice):
        return at, at
    rows, columns = np.ix_(at, at)
    return rows, columns


class BlockLayout:
    """Which entries of the error state every block has; new blocks come last."""

    def __init__(self, blocks: Blocks = (), dims: Sequence[int] = ()) -> None:
        """Start with some blocks."""
        self.dims = dict(zip(blocks, dims, strict=True))
        self._find()

    def _find(self) -> None:
        self._columns: dict[Blocks, Columns] = {}
        self.start: dict[str, int] = {}
        self.size = 0
        for name, dim in self.dims.items():
            self.start[name] = self.size
            self.size += dim

    def columns(self, blocks: Blocks) -> Columns:
        """Return the entries of some blocks, in their order."""
        found = self._columns.get(blocks)
        if found is None:
            entries = [range(self.start[b], self.start[b] + self.dims[b]) for b in blocks]
            index = np.concatenate([np.asarray(entry, dtype=np.intp) for entry in entries])
            found = index
            if (np.diff(index) == 1).all():
                found = slice(int(index[0]), int(index[-1]) + 1)
            self._columns[blocks] = found
        return found

    def entries(self, name: str) -> slice:
        """Return the entries of one block."""
        return slice(self.start[name], self.start[name] + self.dims[name])

    def parts(self, blocks: Blocks, values: Array) -> dict[str, Array]:
        """Return by block what (k, ...) values of some blocks are, one after the other."""
        ends = np.cumsum([self.dims[name] for name in blocks])
        return dict(zip(blocks, np.split(values, ends[:-1]), strict=True))

    def holder(self, row: int) -> str:
        """Return the block of an entry."""
        return next(name for name, first in reversed(self.start.items()) if first <= row)

    def add(self, name: str, dim: int) -> None:
        """Append a block."""
        self.dims[name] = dim
        self._find()

    def remove(self, blocks: Blocks) -> Index:
        """Remove blocks; return the entries (k,) that stay."""
        gone = np.zeros(self.size, dtype=bool)
        for name in blocks:
            gone[self.columns((name,))] = True
            del self.dims[name]
        self._find()
        return np.flatnonzero(~gone)

    def follow(self, event: Event) -> None:
        """Begin or remove the blocks that an event does."""
        match event:
            case Augment():
                self.add(event.name, len(event.jacobian))
            case Clone():
                self.add(event.name, self.dims[event.source])
            case Remove():
                self.remove(event.blocks)
            case _:
                pass

    def of(self, blocks: Iterable[str]) -> BlockLayout:
        """Return the layout of some blocks alone, in their order."""
        names = tuple(blocks)
        return BlockLayout(names, [self.dims[name] for name in names])


class Fused(NamedTuple):
    """What an update came to.

    innovation: (m,) nu, the residual without the estimate's known error. spread: (m, m) S = L L^T.
    inverse_root: (m, m) L^-1; NaN where S is not positive definite. gain: (n, m) Kalman's. applied:
    (n,) the correction, as recorded or by the gain; zero for a rejected measurement. root: (m, m)
    L, NaN likewise.
    """

    innovation: Array
    spread: Array
    gain: Array
    applied: Array
    inverse_root: Array
    root: Array

    @property
    def whitened(self) -> Array:
        """(m,) L^-1 nu."""
        return self.inverse_root @ self.innovation


class Replay:
    """Mean (n,) and covariance (n, n) of the error of the filter's estimate.

    The mean is zero as long as the filter corrects its estimate as its gains say.
    """

    def __init__(self, prior: TracePrior) -> None:
        """Start where the filter did."""
        self.layout = BlockLayout(prior.blocks, prior.dims)
        self.covariance = prior.covariance.copy()
        self.mean = np.zeros(len(self.covariance))

    def copy(self) -> Replay:
        """Return one that goes its own way."""
        other = object.__new__(Replay)
        other.layout = self.layout.of(self.layout.dims)
        other.covariance, other.mean = self.covariance.copy(), self.mean.copy()
        return other

    def apply(self, event: Event) -> Fused | None:
        """Do what an event says; return what an update came to."""
        match event:
            case Predict():
                self.predict(event.blocks, event.jacobian, event.noise)
            case Update():
                return self.update(event)
            case Augment():
                self.augment(event)
            case Clone():
                self.clone(event.source, event.name)
            case Remove():
                self.remove(event.blocks)
            case Reset():
                self.predict(event.blocks, event.jacobian, None)
            case Snapshot() | Directions() | Evaluation() | TracePrior():
                pass
        return None

    def predict(self, blocks: Blocks, f: Array, noise: Array | None) -> None:
        """Let P become F P F^T + Q on some blocks. noise: None for a reset."""
        at, p, mean = self.layout.columns(blocks), self.covariance, self.mean
        if len(f) == self.layout.size and isinstance(at, slice):
            self.covariance = p = f @ p @ f.T
            self.mean = f @ mean
            if noise is not None:
                p += noise
            return
        p[at] = f @ p[at]
        p[:, at] = p[:, at] @ f.T
        if noise is not None:
            p[square(at)] += noise
        mean[at] = f @ mean[at]

    def update(self, event: Update) -> Fused:
        """Fuse a measurement, by the recorded gain where there is one, else by Kalman's.

        The covariance is Joseph's form, P - K H P - ((P - K H P) H^T - K R) K^T.
        """
        at, h, r, p = (
            self.layout.columns(event.blocks),
            event.jacobian,
            event.noise,
            self.covariance,
        )
        across = p[:, at] @ h.T
        s = h @ across[at] + r
        innovation = event.residual - h @ self.mean[at]
        root, fault = dpotrf(s, lower=1, clean=1)
        if fault:
            nothing = np.zeros_like(across)
            applied = np.zeros(len(p)) if event.correction is None else event.correction
            return Fused(
                innovation, s, nothing, applied, np.full_like(s, np.nan), np.full_like(s, np.nan)
            )
        inverse_root: Array = dtrtrs(root, np.eye(len(s)), lower=1)[0]
        gain = across @ inverse_root.T @ inverse_root
        fused = Fused(innovation, s, gain, np.zeros(len(p)), inverse_root, root)
        if not event.used:
            return fused
        used = gain if event.gain is None else event.gain
        applied = used @ event.residual if event.correction is None else event.correction
        self.fuse(event, used)
        self.mean += used @ innovation - applied
        return fused._replace(applied=applied)

    def fuse(self, event: Update, gain: Array) -> None:
        """Update the covariance alone, with any gain (n, m)."""
        at, h = self.layout.columns(event.blocks), event.jacobian
        p = self.covariance
        p = p - gain @ (h @ p[at])
        p -= (p[:, at] @ h.T - gain @ event.noise) @ gain.T
        self.covariance = 0.5 * (p + p.T)

    def shorten(self, event: Update, gain: Array) -> None:
        """P - K H P, which is symmetric, and right, for Kalman's gain alone."""
        p = self.covariance
        self.covariance = p - gain @ (event.jacobian @ p[self.layout.columns(event.blocks)])

    def augment(self, event: Augment) -> None:
        """Append a block initialised from others."""
        at = self.layout.columns(event.blocks)
        across = event.jacobian @ self.covariance[at]
        g = event.noise_jacobian
        own = across[:, at] @ event.jacobian.T + g @ event.noise @ g.T
        mean = event.jacobian @ self.mean[at]
        self._append(event.name, across, own, mean)

    def clone(self, source: str, name: str) -> None:
        """Append a copy of a block."""
        at = self.layout.columns((source,))
        across = self.covariance[at]
        self._append(name, across, across[:, at], self.mean[at])

    def remove(self, blocks: Blocks) -> None:
        """Marginalise blocks out."""
        kept = self.layout.remove(blocks)
        self.covariance = self.covariance[np.ix_(kept, kept)]
        self.mean = self.mean[kept]

    def _append(self, name: str, across: Array, own: Array, mean: Array) -> None:
        self.layout.add(name, len(own))
        self.covariance = np.block([[self.covariance, across.T], [across, own]])
        self.mean = np.concatenate((self.mean, mean))


class ShortFormReplay(Replay):
    """The same by the short form, P - K H P, as most filters have it.

    Equal to Joseph's by algebra for Kalman's gain; it shows what rounding does to a filter.
    """

    def fuse(self, event: Update, gain: Array) -> None:
        """Update the covariance alone."""
        self.shorten(event, gain)
        self.covariance = 0.5 * (self.covariance + self.covariance.T)


class LongFormReplay(Replay):
    """The same by (I - K H) P (I - K H)^T + K R K^T: what differs from the other is rounding."""

    @classmethod
    def of(cls, other: Replay) -> LongFormReplay:
        """Return one that goes on from another."""
        dims = other.layout.dims
        prior = TracePrior(0, None, tuple(dims), tuple(dims.values()), other.covariance)
        return cls(prior)

    def fuse(self, event: Update, gain: Array) -> None:
        """Update the covariance alone, with any gain (n, m)."""
        less = np.eye(len(gain))
        less[:, self.layout.columns(event.blocks)] -= gain @ event.jacobian
        p = less @ self.covariance @ less.T + gain @ event.noise @ gain.T
        self.covariance = 0.5 * (p + p.T)


class Unlike(NamedTuple):
    """A gain, or a correction, that is another. what: a predicate of the update. blocks: where.

    fault: of a correction that is not gain times residual. kind: of what may have another name,
    which says more; empty where what it says is all.
    """

    what: str
    blocks: Blocks
    fault: bool
    kind: str = ""


def check_gain(
    event: Update, fused: Fused, sigma: Array, layout: BlockLayout, tolerance: float
) -> list[Unlike]:
    """Return what is unlike Kalman in an update that was used.

    Args:
        event: With gain or correction.
        fused: What the replay made of it.
        sigma: (n,) standard deviations after the update, as units.
        layout: Of the state.
        tolerance: Relative to what a measurement of one sigma corrects.
    """
    mismatches = []
    unit = np.where(sigma > 0.0, sigma, 1.0)
    if event.gain is not None:
        mismatches += _gain(event, fused, unit, layout, tolerance)
    if event.correction is not None:
        gain = fused.gain if event.gain is None else event.gain
        mismatches += _correction(event, gain @ event.residual, unit, layout, tolerance)
    return mismatches


def _gain(
    event: Update, fused: Fused, unit: Array, layout: BlockLayout, tolerance: float
) -> list[Unlike]:
    """The columns are compared times the innovation's root, in sigmas of the state."""
    assert event.gain is not None  # noqa: S101 - asked for above
    root = fused.root
    given, right = ((k @ root) / unit[:, None] for k in (event.gain, fused.gain))
    if not np.abs(given - right).max() > tolerance:
        return []
    scale = float(np.abs(right).max())
    wrong = _blocks(np.abs(given - right).max(axis=1), layout, max(tolerance, _ALIKE * scale))
    if not wrong:
        wrong = tuple(layout.dims)
    silent = tuple(b for b in wrong if not event.gain[layout.entries(b)].any())
    if silent and set(silent) == set(wrong):
        names = ", ".join(silent)
        return [Unlike(f"does not correct {names} (Schmidt)", silent, False)]
    weight = float(np.vdot(given, right) / np.vdot(right, right)) if scale else 0.0
    plain = f"{weight:.4g}"
    if plain != "1" and np.abs(given - weight * right).max() <= _ALIKE * scale:
        return [Unlike(f"uses {plain} times Kalman's gain", wrong, False, "times Kalman's")]
    s = root @ root.T
    factor = noise_factor(event.gain, fused.gain @ s, s - event.noise, event.noise)
    if factor is not None and f"{factor:.4g}" != "1":
        return [Unlike(f"uses the gain of {factor:.4g} R", wrong, False, "times R")]
    off = float(np.abs(given - right).max() / (scale or 1.0))
    text = f"has a gain that is not Kalman's on {', '.join(wrong)} (by {100 * off:.2g} %)"
    return [Unlike(text, wrong, False, "not Kalman's")]


def noise_factor(gain: Array, across: Array, spread: Array, noise: Array) -> float | None:
    """The number c with a gain of c R, P H^T (H P H^T + c R)^-1, if there is one.

    across: (n, m) P H^T. spread: (m, m) H P H^T.
    """
    # K (H P H^T + c R) = P H^T is linear in c.
    left, right = gain @ noise, across - gain @ spread
    c = float(np.vdot(left, right) / np.vdot(left, left)) if left.any() else 0.0
    if c <= 0.0 or np.abs(right - c * left).max() > _ALIKE * float(np.abs(across).max()):
        return None
    return c


def _correction(
    event: Update, right: Array, unit: Array, layout: BlockLayout, tolerance: float
) -> list[Unlike]:
    assert event.correction is not None  # noqa: S101 - asked for above
    off = np.abs(event.correction - right) / unit
    if not off.max() > tolerance:
        return []
    wrong = _blocks(off, layout, max(tolerance, _ALIKE * float(np.abs(right / unit).max())))
    if not wrong:
        return []
    everywhere = len(wrong) == len(layout.dims) > _NAMED
    given = np.concatenate([event.correction[layout.entries(b)] for b in wrong])
    meant = np.concatenate([right[layout.entries(b)] for b in wrong])
    names = "all blocks" if everywhere else ", ".join(wrong)
    near = _ALIKE * float(np.abs(meant).max())
    if not given.any():
        text = f"does not correct the estimate of {names}, though its gain does"
    elif np.abs(given + meant).max() <= near:
        text = f"corrects the estimate of {names} with the wrong sign"
    elif np.abs(given - 2.0 * meant).max() <= near:
        text = f"corrects the estimate of {names} twice"
    else:
        text = f"applies a correction of {names} that is not gain x residual"
        return [Unlike(text, wrong, True, "other correction")]
    return [Unlike(text, wrong, True)]


def _blocks(off: Array, layout: BlockLayout, allowed: float) -> Blocks:
    """Blocks with an entry that is off by more than allowed."""
    return tuple(b for b in layout.dims if off[layout.entries(b)].max() > allowed)
