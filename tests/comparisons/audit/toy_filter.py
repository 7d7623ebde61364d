"""A small filter of our own writing that records what it does, and can be made to do it wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.trace.recorder import Recorder

BLOCKS = {"position": 2, "velocity": 2, "bias": 2}
_DT = 0.5
F = np.block(
    [
        [np.eye(2), _DT * np.eye(2), np.zeros((2, 2))],
        [np.zeros((2, 2)), np.eye(2), -_DT * np.eye(2)],
        [np.zeros((2, 4)), np.eye(2)],
    ]
)
Q = np.diag([1e-4, 1e-4, 0.04, 0.04, 1e-4, 1e-4])
SENSORS = {
    "gps": (("position",), np.eye(2), np.diag([1.0, 1.0])),
    "doppler": (("velocity",), np.eye(2), np.diag([0.04, 0.09])),
}
GATE = {"gps": 0.99}
_GATE_GPS = 9.210340371976182
"""The 99 % quantile of chi-square with two degrees of freedom."""

Alter = Callable[["Toy", int, str, Array], Array]
"""Given the filter, the event's number, its name and P before it: P as the filter then holds it."""


def as_it_is(toy: Toy, number: int, what: str, before: Array) -> Array:
    """Alter nothing."""
    del number, what, before
    return toy.covariance


@dataclass
class Toy:
    """A linear filter of position, velocity and a bias, with clones of the position.

    alter: what P becomes after an event. noise: what R is in the filter, by sensor. gain: what the
    gain becomes. correction: what is added to the estimate. bias: by sensor, from an event on.
    """

    seed: int
    steps: int = 120
    every: int = 1
    alter: Alter = as_it_is
    gain: Callable[[int, str, Array], Array] = lambda number, sensor, k: k
    correction: Callable[[int, str, Array], Array] = lambda number, sensor, c: c
    bias: Callable[[int, str], float] = lambda number, sensor: 0.0
    gains: bool = True
    clones: bool = True
    covariance: Array = field(default_factory=lambda: np.diag([4.0, 4.0, 1.0, 1.0, 0.01, 0.01]))

    def record(self, path: Path) -> None:
        """Drive, filter, and record it."""
        rng = np.random.default_rng(self.seed)
        self.error = np.linalg.cholesky(self.covariance) @ rng.standard_normal(6)
        self.number, self._since = 0, 0
        with Recorder(path, gates=GATE, components={"gps": ["east", "north"]}) as record:
            record.prior(BLOCKS, self.covariance)
            record.snapshot(self.covariance, error=self.error)
            self.number = 2
            for step in range(self.steps):
                record.at(step * _DT)
                self._predict(record, rng)
                self._measure(record, rng, "doppler")
                if step % 4 == 3:
                    self._measure(record, rng, "gps")
                if self.clones and step % 10 == 5:
                    self._clone(record)
                if self.clones and step % 10 == 9:
                    self._look_back(record, rng)

    def _done(self, record: Recorder, what: str, before: Array) -> None:
        """Count an event and let P be altered; record a snapshot, where one is due."""
        self.covariance = self.alter(self, self.number, what, before)
        self.number += 1
        self._since += 1
        if self._since >= self.every:
            record.snapshot(self.covariance, error=self.error)
            self.number += 1
            self._since = 0

    def _predict(self, record: Recorder, rng: np.random.Generator) -> None:
        before, n = self.covariance, len(self.covariance)
        f, q = np.eye(n), np.zeros((n, n))
        f[:6, :6], q[:6, :6] = F, Q
        self.error = f @ self.error
        self.error[:6] += np.sqrt(np.diag(Q)) * rng.standard_normal(6)
        record.predict(F, Q, BLOCKS)
        self.covariance = f @ before @ f.T + q
        self._done(record, "predict", before)

    def _measure(self, record: Recorder, rng: np.random.Generator, sensor: str) -> None:
        blocks, h, r = SENSORS[sensor]
        whole = np.zeros((2, len(self.covariance)))
        start = {"position": 0, "velocity": 2}[blocks[0]]
        whole[:, start : start + 2] = h
        self._fuse(record, rng, sensor, (blocks, h, whole, r))

    def _look_back(self, record: Recorder, rng: np.random.Generator) -> None:
        """Measure the way since the clone, which then leaves the state."""
        h = np.hstack((np.eye(2), -np.eye(2)))
        whole = np.zeros((2, 8))
        whole[:, :2], whole[:, 6:] = np.eye(2), -np.eye(2)
        self._fuse(record, rng, "way", (("position", "clone"), h, whole, 0.01 * np.eye(2)))
        before = self.covariance
        record.remove("clone")
        self.covariance, self.error = before[:6, :6], self.error[:6]
        self._done(record, "remove", before)

    def _clone(self, record: Recorder) -> None:
        before = self.covariance
        record.clone("position", "clone")
        copy = np.vstack((np.eye(6), np.eye(6)[:2]))
        self.covariance, self.error = copy @ before @ copy.T, copy @ self.error
        self._done(record, "clone", before)

    def _fuse(
        self,
        record: Recorder,
        rng: np.random.Generator,
        sensor: str,
        model: tuple[tuple[str, ...], Array, Array, Array],
    ) -> None:
        blocks, h, whole, r = model
        noise = np.linalg.cholesky(r) @ rng.standard_normal(2)
        residual = whole @ self.error + noise + self.bias(self.number, sensor)
        before = self.covariance
        s = whole @ before @ whole.T + r
        if sensor == "gps" and residual @ np.linalg.solve(s, residual) > _GATE_GPS:
            record.reject(sensor, residual, h, r, blocks)
            self._done(record, "reject", before)
            return
        kalman = before @ whole.T @ np.linalg.inv(s)
        k = self.gain(self.number, sensor, kalman)
        a = np.eye(len(before)) - k @ whole
        change = self.correction(self.number, sensor, k @ residual)
        extra: dict[str, Any] = {"gain": k, "correction": change} if self.gains else {}
        record.update(sensor, residual, h, r, blocks, **extra)
        self.error = self.error - change
        self.covariance = a @ before @ a.T + k @ r @ k.T
        self._done(record, sensor, before)
