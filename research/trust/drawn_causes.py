"""A linear filter with another noise than it states, or a constant that it lacks, and its audit.

    python -m research.trust.drawn_causes [--faults 100] [--sound 100] [--seed 0] [--list]

A noise is drawn (P0 or Q of a block, R of a sensor or of one component) and a factor between the
true and the stated one, or a constant (of a sensor, of a component, of a predicted entry); and from
when on. A fault counts where the truth makes the residuals likelier by the logarithm 10 and more:
less is no evidence. It is named if the audit's first cause is that one, and its interval not
farther from the truth than it is wide. Sound filters are audited as well; the interval of their
share is Clopper and Pearson's, 95 %.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.audit import audit
from comparisons.explain.noises import NoiseFactor, NoiseSlot, log_likelihoods
from comparisons.explain.offsets import Offset, OffsetSlot, without_offsets
from comparisons.explain.recorded_steps import steps_of
from comparisons.trace.reader import TraceReader
from comparisons.trace.recorder import Recorder
from research.script import options, print_head, print_row
from research.trust.defects import share

BLOCKS = {"place": 2, "speed": 2, "bias": 1}
SENSORS = {"gps": 2, "odometer": 1}
STEPS, SECOND = 300, 0.1
R_OF = {"gps": np.diag([0.25, 0.09]), "odometer": np.array([[0.01]])}
Q = np.diag([1e-4, 1e-4, 4e-3, 4e-3, 1e-5])
FACTORS = (0.01, 0.1, 0.25, 4.0, 10.0, 100.0)
SIGMAS = (-4.0, -2.0, -1.0, 0.5, 1.0, 2.0, 4.0)
EVIDENCE = 10.0


class LinearFault(NamedTuple):
    """The true noise or constant beside the stated one, or none.

    Attributes:
        slot: What it is of.
        value: The factor, or the constant.
        since: The step from which on it is another.
    """

    slot: NoiseSlot | OffsetSlot
    value: float
    since: int

    @property
    def kind(self) -> str:
        """What it is of, without the number."""
        later = ", from some time on" if self.since else ""
        if isinstance(self.slot, OffsetSlot):
            return f"constant of a {'prediction' if self.slot.is_predicted else 'sensor'}{later}"
        component = " of a component" if self.slot.component >= 0 else ""
        return f"{self.slot.matrix}{component}{later}"

    def is_named(self, cause: NoiseFactor | Offset) -> bool:
        """Whether a cause is this one, with its number."""
        if cause.slot._replace(since=0) != self.slot:
            return False
        if isinstance(cause, Offset):
            return abs(cause.value - self.value) < 6.0 * cause.sigma
        width = cause.high / cause.low
        return cause.low / width <= self.value <= cause.high * width


class LinearDrive:
    """A filter of place, speed and the odometer's bias, whose noises may not be as stated."""

    def __init__(self, seed: int, fault: LinearFault | None, *, has_truth: bool = False) -> None:
        """fault: of the noises; None if they are as stated. has_truth: errors are recorded."""
        self.rng, self.fault, self.has_truth = np.random.default_rng(seed), fault, has_truth
        self.covariance = np.diag([1.0, 1.0, 0.25, 0.25, 0.04])
        self.truth_is_off = np.zeros(5)

    def record(self, path: Path) -> None:
        """Drive and record."""
        f = np.eye(5)
        f[0, 2] = f[1, 3] = SECOND
        with Recorder(path) as record:
            record.prior(BLOCKS, self.covariance)
            error = self._drawn("P0", tuple(BLOCKS), self.covariance, 0)
            for step in range(STEPS):
                record.at(SECOND * (step + 1))
                error = f @ error + self._drawn("Q", tuple(BLOCKS), Q, step)
                self.covariance = f @ self.covariance @ f.T + Q
                record.predict(f, Q)
                for sensor, every in (("odometer", 1), ("gps", 5)):
                    if step % every == 0:
                        error = self._measure(record, sensor, error, step)
                truth = error + self.truth_is_off if self.has_truth else None
                record.snapshot(self.covariance, error=truth)

    def _measure(self, record: Recorder, sensor: str, error: Array, step: int) -> Array:
        """Fuse a measurement; return what the estimate is off by then."""
        h, r = np.eye(2, 5), R_OF[sensor]
        if sensor == "odometer":
            h = np.array([[0.0, 0.0, 1.0, 0.4, 1.0]])
        residual = h @ error + self._drawn("R", (sensor,), r, step)
        p = self.covariance
        gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
        left = np.eye(5) - gain @ h
        self.covariance = left @ p @ left.T + gain @ r @ gain.T
        record.update(sensor, residual, h, r)
        return np.asarray(error - gain @ residual)

    def _drawn(self, matrix: str, of: tuple[str, ...], stated: Array, step: int) -> Array:
        """Draw a noise, with the true variances and constants."""
        sigma = np.sqrt(stated.diagonal())
        mean = np.zeros(len(sigma))
        if self.fault is not None and step >= self.fault.since and self.fault.slot.of in of:
            slot, value, _ = self.fault
            if isinstance(slot, OffsetSlot):
                if matrix == ("Q" if slot.is_predicted else "R"):
                    mean[_entries(slot, of, len(sigma))] = value
                    mean *= SECOND if slot.is_predicted else 1.0
            elif slot.matrix == matrix:
                sigma *= np.sqrt(np.where(_entries(slot, of, len(sigma)), value, 1.0))
        return np.asarray(mean + sigma * self.rng.standard_normal(len(sigma)))


def _entries(slot: NoiseSlot | OffsetSlot, of: tuple[str, ...], size: int) -> Array:
    """(n,) which entries of a noise a slot is of."""
    entry = slot.entry if isinstance(slot, OffsetSlot) else slot.component
    if of[0] in SENSORS:
        return np.arange(size) == entry if entry >= 0 else np.ones(size, bool)
    inner = np.repeat([block == slot.of for block in of], [BLOCKS[block] for block in of])
    if entry >= 0:
        inner &= np.arange(size) == np.flatnonzero(inner)[0] + entry
    return np.asarray(inner)


def drawn(rng: np.random.Generator) -> LinearFault:
    """Draw a fault."""
    noises = [NoiseSlot(matrix, block) for matrix in ("P0", "Q") for block in BLOCKS]
    noises += [NoiseSlot("R", sensor) for sensor in SENSORS]
    noises += [NoiseSlot("R", "gps", k) for k in range(2)]
    constants = [OffsetSlot(block, k, True) for block, size in BLOCKS.items() for k in range(size)]
    constants += [OffsetSlot("gps", k, False) for k in (-1, 0, 1)]
    constants += [OffsetSlot("odometer", 0, False)]
    slots: list[NoiseSlot | OffsetSlot] = [*noises, *constants]
    slot = slots[int(rng.integers(len(slots)))]
    at_start = isinstance(slot, NoiseSlot) and slot.matrix == "P0"
    since = 0 if at_start or rng.random() < 0.5 else int(rng.integers(60, 240))
    if isinstance(slot, NoiseSlot):
        return LinearFault(slot, float(rng.choice(FACTORS)), since)
    stated = Q if slot.is_predicted else R_OF[slot.of]
    of = tuple(BLOCKS) if slot.is_predicted else (slot.of,)
    sigma = float(np.sqrt(stated.diagonal()[_entries(slot, of, len(stated))][0]))
    unit = sigma / np.sqrt(SECOND) if slot.is_predicted else sigma
    return LinearFault(slot, float(rng.choice(SIGMAS)) * unit, since)


def tells(path: Path, fault: LinearFault) -> bool:
    """Return whether the truth is likelier by far than what the filter states."""
    steps = list(steps_of(TraceReader(path)))
    begin_s = SECOND * (fault.since + 1) - 1e-9
    times = [e.number for e, _ in steps if e.time_s is not None and e.time_s >= begin_s]
    since = min(times) if fault.since else 0
    neutral = log_likelihoods(steps, [{}])[0]
    if isinstance(fault.slot, NoiseSlot):
        true = log_likelihoods(steps, [{fault.slot._replace(since=since): fault.value}])[0]
    else:
        constant = Offset(fault.slot._replace(since=since), 0.0, fault.value, 0.0)
        true = log_likelihoods(list(without_offsets(steps, [constant])), [{}])[0]
    return bool(true > neutral + EVIDENCE)


def main() -> None:
    """Print the table."""
    given = options(__doc__, faults=100, sound=100, seed=0, list=False)
    rng = np.random.default_rng(given.seed)
    named: Counter[str] = Counter()
    tried: Counter[str] = Counter()
    alike: Counter[str] = Counter()
    others: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        while tried.total() < given.faults:
            fault, seed = drawn(rng), int(rng.integers(2**31))
            path = Path(folder) / f"{seed}.trace"
            LinearDrive(seed, fault).record(path)
            if not tells(path, fault):
                continue
            explained = audit(path).explained
            first = None if explained is None or not explained.fits else explained.causes[0]
            right = first is not None and fault.is_named(first.fitted)
            beside = first is not None and any(fault.is_named(one) for one in first.others)
            tried[fault.kind] += 1
            named[fault.kind] += right
            alike[fault.kind] += beside and not right
            others[fault.kind] += first is not None and not (right or beside)
            if given.list and not right:
                print(fault, "" if explained is None else explained.what)
        print_head("fault", "faults", "named first", "named as likely", "another named")
        for key in sorted(tried):
            print_row(key, tried[key], named[key], alike[key], others[key])
        print_row("all", tried.total(), named.total(), alike.total(), others.total())
        accused = said = 0
        for seed in range(given.sound):
            path = Path(folder) / f"sound {seed}.trace"
            LinearDrive(seed, None).record(path)
            result = audit(path)
            accused += not result.sound
            said += result.explained is not None
    print(f"\n{share(accused, given.sound, 'sound filters accused')}")
    print(share(said, given.sound, "sound filters of which a cause is named, though no fault"))


if __name__ == "__main__":
    main()
