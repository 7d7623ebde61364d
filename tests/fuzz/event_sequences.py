"""Sequences of a filter's events, drawn: any order and shape that the format allows.

`python -m tests.fuzz.event_sequences 5000` draws so many, audits each and counts what is said of
them. A sequence is *sound* where every snapshot, gain and correction is that of the events before
it, for whatever matrices; else something is planted at an event, and it is only asked that the
audit comes to an end.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from comparisons.arrays import Array
from comparisons.audit.audit import Audit
from comparisons.checks.of_events import audit_trace
from comparisons.report.audit import AuditReport
from comparisons.rounding import ROUNDING
from comparisons.trace.recorder import Recorder
from tests.fuzz.drawn import Ending, try_all

_OF_CHANCE = ("innovations", "smoother", "nees")
"""Checks that call one in a thousand sound filters faulty."""
_CLEAR = 1e-6
"""Least eigenvalue of a scaled innovation covariance whose inverse no rounding decides."""


@dataclass
class Drawing:
    """A filter whose next event is drawn, with the error that its estimate has.

    gates: the share of right measurements of a sensor that passes its gate; beyond it none is used.
    off: how often a snapshot, gain or correction is made another. planted: how often one was, or
    rounding was made to decide.
    """

    rng: np.random.Generator
    record: Recorder
    gates: dict[str, float]
    off: float = 0.0
    dims: dict[str, int] = field(default_factory=dict)
    count: int = 0
    planted: int = 0
    kinds: Counter[str] = field(default_factory=Counter)

    def run(self) -> None:
        """Draw the prior and what follows."""
        rng = self.rng
        blocks = {self._name(): int(rng.integers(1, 4)) for _ in range(rng.integers(1, 4))}
        self.dims = blocks
        self.unit = {name: self._magnitude() for name in blocks}
        n = sum(blocks.values())
        units = np.concatenate([np.full(d, self.unit[b]) for b, d in blocks.items()])
        self.p = self._covariance(n) * np.outer(units, units)
        self.most = np.sqrt(self.p.diagonal())
        self.error = root(self.p) @ rng.standard_normal(n)
        self.record.prior(blocks, self.p, **self._point(n))
        events = [self.predict, self.update, self.augment, self.clone, self.remove, self.reset]
        chances = np.array([4.0, 6.0, 1.0, 1.0, 1.0, 0.7])
        snapshots = rng.choice((0.1, 0.5, 0.9))
        time_s, clock = 0.0, rng.choice(("none", "rising", "equal", "falling"))
        for _ in range(int(rng.integers(0, 25))):
            if clock != "none":
                self.record.at(time_s)
                time_s += {"rising": 0.5, "equal": 0.0, "falling": -0.1}[clock]
            if rng.random() < 0.8:
                event = events[int(rng.choice(len(events), p=chances / chances.sum()))]
                event()
                self.kinds[event.__name__] += 1
            for _ in range(4):
                if rng.random() > snapshots:
                    break
                self.snapshot()
                self.kinds["snapshot"] += 1
            if rng.random() < 0.02:
                self.directions()

    def predict(self) -> None:
        """Draw a prediction, or a renewal."""
        blocks, at, units = self._some()
        n = len(at)
        f = self._motion(n) * np.divide.outer(units, units)
        q = self._covariance(n) * np.outer(units, units)
        if self.rng.random() < 0.1:
            f = np.zeros_like(f)
        self.record.predict(f, q, blocks, **self._point(n), **self._named("after", n))
        self._move(at, f)
        self.p[np.ix_(at, at)] += q
        self.error[at] += root(q) @ self.rng.standard_normal(n)
        self._grow()

    def reset(self) -> None:
        """Draw a change of coordinates."""
        blocks, at, units = self._some()
        j = self._motion(len(at)) * np.divide.outer(units, units)
        self.record.reset(j, blocks)
        self._move(at, j)
        self._grow()

    def update(self) -> None:
        """Draw a measurement, and what the filter does with it."""
        rng = self.rng
        blocks, at, units = self._some()
        m = int(rng.integers(1, 4))
        h = rng.standard_normal((m, len(at))) * (rng.random((m, len(at))) < 0.7) / units
        size = 10.0 ** rng.uniform(-2, 1)
        r = self._covariance(m) * size**2
        if not self._is_clear(h, r, at):
            r = size**2 * np.eye(m)
        whole = np.zeros((m, len(self.p)))
        whole[:, at] = h
        s = whole @ self.p @ whole.T + r
        residual = whole @ self.error + root(r) @ rng.standard_normal(m)
        sensor = str(rng.choice(("gps", "compass", "camera 1")))
        more: dict[str, Any] = self._point(len(at))
        if rng.random() < 0.1:
            more["weight"] = rng.uniform(0.1, 1.0)
            more["numbers"] = np.array([float(self.count)])
        self.count += 1
        of_all = s - (1.0 - more.get("weight", 1.0)) * r  # a part has R over its weight
        outside = not self._is_clear(h, r, at) or self._is_beyond_gate(sensor, residual, of_all)
        if rng.random() < 0.1 or outside:
            self.record.reject(sensor, residual, h, r, blocks, **more)
            return
        gain = self.p @ whole.T @ np.linalg.pinv(s)
        kind = str(rng.choice(("Kalman's", "Schmidt", "any"), p=(0.8, 0.1, 0.1)))
        if kind == "Schmidt":
            gain[at[: max(1, len(at) // 2)]] = 0.0
        elif kind == "any":
            other = gain * rng.uniform(0.2, 1.0, (len(gain), 1))
            left = np.linalg.eigvals(np.eye(m) - whole @ other)
            gain = other if np.abs(left).max() <= 1.0 else gain
        correction = gain @ residual
        told = ["gain", "correction"] if kind == "any" else ["gain", "correction", "both", "none"]
        what = str(rng.choice(told if kind != "Schmidt" else told[:3]))
        if self._plants():
            gain, correction = self._spoilt(gain), self._spoilt(correction)
        if what in ("gain", "both"):
            more["gain"] = gain
        if what in ("correction", "both"):
            more["correction"] = correction
        self.record.update(sensor, residual, h, r, blocks, **more)
        keep = np.eye(len(self.p)) - gain @ whole
        p = keep @ self.p @ keep.T + gain @ r @ gain.T
        self.p = 0.5 * (p + p.T)
        self.error = self.error - correction
        # Rounding of what there was decides on what is left; neither nothing nor something.
        left = np.abs(self.p.diagonal()) / np.maximum(self.most**2, 1e-300)
        self.planted += bool(((left > 1e-15) & (left < 1e-10)).any())

    def augment(self) -> None:
        """Draw a new block, with a G_z of any shape."""
        blocks, at, units = self._some()
        rng, name = self.rng, self._name()
        if sum(self.dims.values()) > 12:
            return
        d, m = int(rng.integers(1, 4)), int(rng.integers(0, 5))
        self.unit[name] = unit = self._magnitude()
        g_x = rng.standard_normal((d, len(at))) * unit / units
        g_z = rng.standard_normal((d, m)) * unit
        r = self._covariance(m)
        more: dict[str, Any] = self._point(len(at))
        more |= self._named("after", d)
        if rng.random() < 0.3:
            more["numbers"] = np.array([float(self.count)])
        self.record.augment(name, g_x, g_z, r, blocks, **more)
        whole = np.zeros((d, len(self.p)))
        whole[:, at] = g_x
        noise = g_z @ root(r) @ rng.standard_normal(m)
        self._append(name, whole, g_z @ r @ g_z.T, noise)

    def clone(self) -> None:
        """Copy a block."""
        if sum(self.dims.values()) > 12:
            return
        source, name = str(self.rng.choice(list(self.dims))), self._name()
        self.record.clone(source, name)
        self.unit[name] = self.unit[source]
        at, _ = self._entries([source])
        self._append(name, np.eye(len(self.p))[at], np.zeros((len(at), len(at))), np.zeros(len(at)))

    def remove(self) -> None:
        """Marginalise some blocks out."""
        if len(self.dims) == 1:
            return
        count = int(self.rng.integers(1, len(self.dims)))
        gone = [str(one) for one in self.rng.permutation(list(self.dims))[:count]]
        at, _ = self._entries(gone)
        self.record.remove(*gone)
        for name in gone:
            del self.dims[name]
        self.p = np.delete(np.delete(self.p, at, 0), at, 1)
        self.error, self.most = np.delete(self.error, at), np.delete(self.most, at)

    def snapshot(self) -> None:
        """Record what the filter holds, of the whole or of some blocks."""
        rng, blocks = self.rng, list(self.dims)
        at = np.arange(len(self.p))
        if rng.random() < 0.3:
            blocks, at, _ = self._some()
        p = self.p[np.ix_(at, at)]
        if self._plants():
            p = self._spoilt(p)
        more: dict[str, Any] = {}
        if rng.random() < 0.2:
            more["error"] = self.error[at]
        self.record.snapshot(p, blocks, **more)

    def directions(self) -> None:
        """Record directions that a sensor cannot tell."""
        basis = {"shift": self.rng.standard_normal(len(self.p)), "turn": np.ones(len(self.p))}
        self.record.directions(basis, ["gps"])

    def _plants(self) -> bool:
        plants = bool(self.rng.random() < self.off)
        self.planted += plants
        return plants

    def _spoilt(self, matrix: Array) -> Array:
        """Another matrix of the same shape."""
        rng, found = self.rng, matrix.copy()
        match int(rng.integers(8)):
            case 0:
                found *= rng.uniform(0.5, 2.0)
            case 1:
                found += 0.1 * np.abs(matrix).max() * rng.standard_normal(matrix.shape)
            case 2:
                found = -found
            case 3:
                found = np.zeros_like(found)
            case 4:
                found = found + 1.0
            case 5:
                found = found * 10.0 ** rng.uniform(-30, 30)
            case 6 if found.ndim == 2:
                found = np.eye(*found.shape) * found
            case _:
                found = found[::-1].copy()
        return np.clip(found, -1e149, 1e149)

    def _some(self) -> tuple[list[str], np.ndarray, Array]:
        """Some blocks, in any order; their entries and units."""
        names = self.rng.permutation(list(self.dims))
        blocks = [str(one) for one in names[: int(self.rng.integers(1, len(names) + 1))]]
        if self.rng.random() < 0.2:
            blocks = list(self.dims)
        return blocks, *self._entries(blocks)

    def _entries(self, blocks: list[str]) -> tuple[np.ndarray, Array]:
        starts = dict(zip(self.dims, np.cumsum([0, *self.dims.values()])[:-1], strict=True))
        at = np.concatenate([np.arange(starts[b], starts[b] + self.dims[b]) for b in blocks])
        return at, np.concatenate([np.full(self.dims[b], self.unit[b]) for b in blocks])

    def _name(self) -> str:
        self.count += 1
        return f"block {self.count}"

    def _magnitude(self) -> float:
        return float(10.0 ** self.rng.integers(-3, 4)) if self.rng.random() < 0.3 else 1.0

    def _covariance(self, n: int) -> Array:
        """A covariance (n, n) of any rank."""
        rank = int(self.rng.choice((0, max(n - 1, 0), n), p=(0.1, 0.2, 0.7)))
        half = self.rng.standard_normal((n, rank))
        if self.rng.random() < 0.5:
            return np.diag((np.arange(n) < rank) * self.rng.uniform(0.1, 2.0, n))
        return half @ half.T

    def _motion(self, n: int) -> Array:
        """F (n, n): the identity, near it, an integration, or of lower rank."""
        rng = self.rng
        match int(rng.integers(4)):
            case 0:
                return np.eye(n)
            case 1:
                return np.asarray(np.linalg.qr(rng.standard_normal((n, n)))[0])
            case 2:
                return np.eye(n) + 0.1 * np.triu(rng.standard_normal((n, n)), 1)
        return np.diag((rng.random(n) < 0.8).astype(float))

    def _is_clear(self, h: Array, r: Array, at: np.ndarray) -> bool:
        """Whether S has an inverse, beside what there has been to cancel."""
        scale = np.sqrt((np.abs(h) @ self.most[at]) ** 2 + r.diagonal())
        if not (scale > 0.0).all():
            return False
        s = h @ self.p[np.ix_(at, at)] @ h.T + r
        return bool(np.linalg.eigvalsh(s / np.outer(scale, scale))[0] > _CLEAR)

    def _is_beyond_gate(self, sensor: str, residual: Array, s: Array) -> bool:
        """Whether a residual (m,) is farther off than the sensor's gate lets pass."""
        if sensor not in self.gates:
            return False
        distance = float(residual @ np.linalg.solve(s, residual))
        return bool(distance > chi2.ppf(self.gates[sensor], len(residual)))

    def _move(self, at: np.ndarray, f: Array) -> None:
        self.p[at] = f @ self.p[at]
        self.p[:, at] = self.p[:, at] @ f.T
        self.error[at] = f @ self.error[at]

    def _grow(self) -> None:
        self.most = np.maximum(self.most, np.sqrt(np.maximum(self.p.diagonal(), 0.0)))

    def _append(self, name: str, of: Array, noise: Array, error: Array) -> None:
        across = of @ self.p
        own = across @ of.T + noise
        self.p = np.block([[self.p, across.T], [across, own]])
        self.error = np.concatenate((self.error, of @ self.error + error))
        self.dims[name] = len(own)
        self.most = np.concatenate((self.most, np.zeros(len(own))))
        self._grow()

    def _point(self, n: int) -> dict[str, Any]:
        return self._named("point", n)

    def _named(self, name: str, n: int) -> dict[str, Any]:
        """Numbers that are recorded now and then, sometimes of another count."""
        if self.rng.random() < 0.8:
            return {}
        return {name: self.rng.standard_normal(n + int(self.rng.random() < 0.3))}


def root(covariance: Array) -> Array:
    """A (n, n) with A A^T = P, of any rank."""
    values, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(values, 0.0)))


@dataclass(frozen=True)
class Outcome:
    """What an audit says of a drawn sequence. planted: how much was made another."""

    seed: int
    planted: int
    audit: Audit
    printed: str

    @property
    def is_accused(self) -> bool:
        """Nothing was planted, and a fault was named that chance does not make."""
        faults = [one for one in self.audit.findings if one.fault]
        return not self.planted and any(one.check not in _OF_CHANCE for one in faults)


def tried(seed: int, folder: Path) -> Outcome:
    """Draw a sequence, record it, audit it and render what is said; may raise anything."""
    rng = np.random.default_rng(seed)
    path = folder / f"{seed}.trace"
    gates = {"gps": 0.99} if rng.random() < 0.2 else {}
    with Recorder(path, gates=gates, synced=False) as record:
        drawing = Drawing(rng, record, gates, 0.15 if seed % 5 < 2 else 0.0)
        drawing.run()
    audit = audit_trace(path, ROUNDING)
    report = AuditReport.of(audit)
    summary = report.summary()
    report.page()
    path.unlink()
    said = [summary.headline, *summary.reasons, *summary.remarks]
    said += [f"{name}: {text}" for name, text in summary.lines]
    return Outcome(seed, drawing.planted, audit, "\n".join(said))


def ending(seed: int, folder: Path) -> Ending:
    """What is counted of a sequence, and said of a sound one that is accused."""
    outcome = tried(seed, folder)
    kind = f"{'planted' if outcome.planted else 'sound'}: {outcome.audit.verdict}"
    return Ending(kind, f"accused\n{outcome.printed}\n" if outcome.is_accused else "")


if __name__ == "__main__":
    sys.exit(try_all(ending, 5000))
