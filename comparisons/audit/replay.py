"""The covariance recursion of the recorded events: what a filter should hold after each of them.

In covariance form, with the gain that the filter says it used, so that it is right for suboptimal
gains, too. graphslam's event smoother solves the same events by least squares, independently.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from comparisons.arrays import Array, Index
from comparisons.audit.events import (
    Augment,
    Blocks,
    Clone,
    Directions,
    Event,
    Predict,
    Prior,
    Remove,
    Reset,
    Snapshot,
    Update,
)

Columns = slice | Index


class Layout:
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
            index = np.concatenate([np.asarray(one, dtype=np.intp) for one in entries])
            found = index
            if (np.diff(index) == 1).all():
                found = slice(int(index[0]), int(index[-1]) + 1)
            self._columns[blocks] = found
        return found

    def entries(self, name: str) -> slice:
        """Return the entries of one block."""
        return slice(self.start[name], self.start[name] + self.dims[name])

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

    def copy(self) -> Layout:
        """Return the same blocks."""
        return Layout(tuple(self.dims), tuple(self.dims.values()))


class Fused(NamedTuple):
    """What an update came to.

    whitened: (m,) L^-1 nu, S = L L^T, nu the residual without the estimate's known error; NaN where
    S is not positive definite. gain: (n, m) Kalman's. applied: (n,) the correction, as recorded or
    by the gain; zero for a rejected measurement. inverse_root: (m, m) L^-1.
    """

    whitened: Array
    gain: Array
    applied: Array
    inverse_root: Array


class Replay:
    """Mean (n,) and covariance (n, n) of the error of the filter's estimate.

    The mean is zero as long as the filter corrects its estimate as its gains say.
    """

    def __init__(self, prior: Prior) -> None:
        """Start where the filter did."""
        self.layout = Layout(prior.blocks, prior.dims)
        self.covariance = prior.covariance.copy()
        self.mean = np.zeros(len(self.covariance))

    def copy(self) -> Replay:
        """Return one that goes its own way."""
        other = object.__new__(Replay)
        other.layout = self.layout.copy()
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
            case Snapshot() | Directions() | Prior():
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
            p[(at, at) if isinstance(at, slice) else np.ix_(at, at)] += noise
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
        root, fault = dpotrf(s, lower=1, clean=1)
        if fault:
            nothing = np.zeros_like(across)
            applied = np.zeros(len(p)) if event.correction is None else event.correction
            nan = np.full_like(s, np.nan)
            return Fused(np.full(len(s), np.nan), nothing, applied, nan)
        inverse_root: Array = dtrtrs(root, np.eye(len(s)), lower=1)[0]
        gain = across @ inverse_root.T @ inverse_root
        innovation = event.residual - h @ self.mean[at]
        fused = Fused(inverse_root @ innovation, gain, np.zeros(len(p)), inverse_root)
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
