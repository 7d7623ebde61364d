"""A dense covariance recursion over a trace: what a filter's covariance should be, by textbook."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.trace.events import (
    Augment,
    Clone,
    Event,
    Predict,
    Prior,
    Remove,
    Reset,
    Snapshot,
    Update,
)
from comparisons.trace.reader import Trace


@dataclass
class Replay:
    """Covariance by the recorded matrices alone."""

    dims: dict[str, int] = field(default_factory=dict)
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def step(self, event: Event) -> float:
        """Follow an event; return how far what the filter did is from it, relatively."""
        match event:
            case Prior():
                self.dims = dict(zip(event.blocks, event.dims, strict=True))
                self.covariance = event.covariance
            case Predict():
                f, q = self._square(event.blocks, event.jacobian, event.noise)
                self.covariance = f @ self.covariance @ f.T + q
            case Reset():
                f, _ = self._square(event.blocks, event.jacobian, 0.0 * event.jacobian)
                self.covariance = f @ self.covariance @ f.T
            case Update():
                return self._update(event)
            case Clone():
                at = self._at((event.source,))
                self._grow(event.name, np.eye(len(self.covariance))[at], np.zeros((len(at),) * 2))
            case Augment():
                g = np.zeros((len(event.jacobian), len(self.covariance)))
                g[:, self._at(event.blocks)] = event.jacobian
                noise = event.noise_jacobian @ event.noise @ event.noise_jacobian.T
                self._grow(event.name, g, noise)
            case Remove():
                kept = np.setdiff1d(np.arange(len(self.covariance)), self._at(event.blocks))
                self.covariance = self.covariance[np.ix_(kept, kept)]
                for name in event.blocks:
                    del self.dims[name]
            case Snapshot():
                at = self._at(event.blocks)
                return self._apart(event.covariance, self.covariance[np.ix_(at, at)], at, at)
        return 0.0

    def _update(self, event: Update) -> float:
        if not event.used:
            return 0.0
        h = np.zeros((len(event.residual), len(self.covariance)))
        h[:, self._at(event.blocks)] = event.jacobian
        s = h @ self.covariance @ h.T + event.noise
        gain = np.linalg.solve(s, h @ self.covariance).T
        sigmas = np.sqrt(np.diag(self.covariance))
        left = np.eye(len(h.T)) - gain @ h
        self.covariance = left @ self.covariance @ left.T + gain @ event.noise @ gain.T
        if event.correction is None:
            return 0.0
        return float(np.abs((event.correction - gain @ event.residual) / sigmas).max())

    def _apart(self, filters: Array, own: Array, rows: Index, columns: Index) -> float:
        sigmas = np.sqrt(np.diag(self.covariance))
        return float(np.abs((filters - own) / sigmas[rows][:, None] / sigmas[columns]).max())

    def _square(self, blocks: tuple[str, ...], f: Array, q: Array) -> tuple[Array, Array]:
        at = self._at(blocks)
        whole, noise = np.eye(len(self.covariance)), np.zeros_like(self.covariance)
        whole[np.ix_(at, at)], noise[np.ix_(at, at)] = f, q
        return whole, noise

    def _grow(self, name: str, g: Array, noise: Array) -> None:
        p = self.covariance
        self.covariance = np.block([[p, p @ g.T], [g @ p, g @ p @ g.T + noise]])
        self.dims[name] = len(g)

    def _at(self, blocks: tuple[str, ...]) -> Index:
        ends = np.cumsum(list(self.dims.values()))
        starts = dict(zip(self.dims, ends, strict=True))
        found = [np.arange(starts[b] - self.dims[b], starts[b]) for b in blocks]
        return np.concatenate(found) if found else np.zeros(0, dtype=np.intp)


def departures(path: Path) -> Iterator[tuple[int, float]]:
    """Yield the last event that is no snapshot and how far the filter is from the recursion."""
    replay, number = Replay(), 0
    for event in Trace(path):
        if not isinstance(event, Snapshot):
            number = event.number
        yield number, replay.step(event)
