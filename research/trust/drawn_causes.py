"""A linear filter with a noise or Jacobian that is not the right one, or without a constant.

    python -m research.trust.drawn_causes [--faults 100] [--sound 100] [--seed 0] [--list]

A noise is drawn (P0 or Q of a block, R of a sensor or of one component) and a factor between the
true and the stated one, or a constant (of a sensor, of a component, of a predicted entry), and from
when on; or a change of F or H by the grammar, of the covariance alone or of the estimate as well.
A fault counts where the truth makes the residuals likelier by the logarithm 10 and more: less is no
evidence. It is named if the audit's first cause is that one, and its interval not farther from the
truth than it is wide; of a Jacobian, if the first cause makes the right one of the filter's, in
part if all that the causes change is then right, though not all that is wrong is changed. Sound
filters are audited as well; the interval of their share is Clopper and Pearson's, 95 %.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.audit import audit
from comparisons.explain.coloured import ColouredNoise
from comparisons.explain.jacobians import EventKind, JacobianChange, JacobianSlot, with_jacobians
from comparisons.explain.likeliest import Fitted
from comparisons.explain.noises import NoiseSlot, log_likelihoods
from comparisons.explain.offsets import Offset, OffsetSlot, without_offsets
from comparisons.explain.recorded_steps import steps_of
from comparisons.faults.grammar import Composition, Slot, Values
from comparisons.faults.operands import Operand, numbered_of, singles_of
from comparisons.trace.reader import TraceReader
from comparisons.trace.recorder import Recorder
from research.script import options, print_head, print_row
from research.trust.defects import share

BLOCKS = {"place": 2, "speed": 2, "bias": 1}
SENSORS = {"gps": 2, "odometer": 1}
STEPS, SECOND = 300, 0.1
R_OF = {"gps": np.diag([0.25, 0.09]), "odometer": np.array([[0.01]])}
Q = np.diag([1e-4, 1e-4, 4e-3, 4e-3, 1e-5])
F = np.eye(5)
F[0, 2] = F[1, 3] = SECOND
H_OF = {"gps": np.eye(2, 5), "odometer": np.array([[0.0, 0.0, 1.0, 0.4, 1.0]])}
FACTORS = (0.01, 0.1, 0.25, 4.0, 10.0, 100.0)
SIGMAS = (-4.0, -2.0, -1.0, 0.5, 1.0, 2.0, 4.0)
SHIFTS = (-0.5, -0.2, -0.1, 0.1, 0.2, 0.5)
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

    def is_named(self, cause: Fitted) -> bool:
        """Whether a cause is this one, with its number."""
        if isinstance(cause, JacobianChange | ColouredNoise):
            return False
        if cause.slot._replace(since=0) != self.slot:
            return False
        if isinstance(cause, Offset):
            return abs(cause.value - self.value) < 6.0 * cause.sigma
        width = cause.high / max(cause.low, 1e-300)
        return cause.low / width <= self.value <= cause.high * width


class JacobianFault(NamedTuple):
    """Another F, or H, than the right one.

    Attributes:
        of: The sensor; empty of F.
        wrong: (r, c) the filter's.
        moves_estimate: The filter computes its estimate by it as well, or what it expects.
        change: Its change by the grammar.
    """

    of: str
    wrong: Array
    moves_estimate: bool
    change: str

    @property
    def kind(self) -> str:
        """What it is of."""
        return f"{'H' if self.of else 'F'}{' and the estimate' if self.moves_estimate else ''}"

    @property
    def right(self) -> Array:
        """(r, c) the right one."""
        return H_OF[self.of] if self.of else F

    def _off(self, cause: Fitted) -> Array | None:
        """(r, c) what a cause leaves wrong beyond its interval; None if it is of something else."""
        if not isinstance(cause, JacobianChange):
            return None
        of = self.of or ", ".join(BLOCKS)
        if (cause.slot.of, cause.slot.moves_estimate) != (of, self.moves_estimate):
            return None
        made = [cause._replace(numbers=(end,)) for end in cause.interval] if cause.numbers else []
        low, high = (one.of(self.wrong[None])[0] for one in made or (cause, cause))
        middle = cause.of(self.wrong[None])[0]
        off = np.abs(middle - self.right) - np.abs(high - low)
        return np.where(off > 1e-12, off, 0.0)

    def is_named(self, cause: Fitted) -> bool:
        """Whether a cause makes the right Jacobian of the filter's."""
        off = self._off(cause)
        return off is not None and not off.any()

    def is_part(self, cause: Fitted) -> bool:
        """Whether all that a cause changes is right then, though something else is not."""
        off = self._off(cause)
        if off is None or not isinstance(cause, JacobianChange):
            return False
        changed = cause.of(self.wrong[None])[0] != self.wrong
        return bool(changed.any()) and not off[changed].any()

    def as_cause(self) -> JacobianChange:
        """Return the truth as what residuals may ask for."""
        dims = tuple(BLOCKS.values())
        of = self.of or ", ".join(BLOCKS)
        matrix, measured = ("H", len(self.right)) if self.of else ("F", 0)
        slot = JacobianSlot(matrix, of, "", self.moves_estimate)
        names = tuple(str(k) for k in range(len(self.right))), tuple(map(str, range(5)))
        right = Composition(
            Slot(name=matrix, rows=names[0], columns=names[1]), "", "",
            lambda values: np.broadcast_to(self.right, values.sound.shape),
        )  # fmt: skip
        return JacobianChange(slot, 0.0, EventKind(matrix, of, dims, measured), right)


class LinearDrive:
    """A filter of place, speed and the odometer's bias, whose models may not be the right ones."""

    def __init__(
        self, seed: int, fault: LinearFault | JacobianFault | None, *, has_truth: bool = False
    ) -> None:
        """fault: None if models are right. has_truth: errors are recorded."""
        self.rng, self.has_truth = np.random.default_rng(seed), has_truth
        self.fault = fault if isinstance(fault, LinearFault) else None
        self.of_jacobian = fault if isinstance(fault, JacobianFault) else None
        self.covariance = np.diag([1.0, 1.0, 0.25, 0.25, 0.04])
        self.estimate, self.truth_is_off = np.zeros(5), np.zeros(5)

    def _used(self, of: str) -> tuple[Array, Array]:
        """The filter's Jacobian, and what its estimate is moved by, or expected by it."""
        right = H_OF[of] if of else F
        if self.of_jacobian is None or self.of_jacobian.of != of:
            return right, right
        wrong = self.of_jacobian.wrong
        return wrong, wrong if self.of_jacobian.moves_estimate else right

    def record(self, path: Path) -> None:
        """Drive and record."""
        f, moving = self._used("")
        with Recorder(path) as record:
            record.prior(BLOCKS, self.covariance)
            error = self._drawn("P0", tuple(BLOCKS), self.covariance, 0)
            for step in range(STEPS):
                record.at(SECOND * (step + 1))
                error = F @ error + (F - moving) @ self.estimate
                error += self._drawn("Q", tuple(BLOCKS), Q, step)
                self.estimate = moving @ self.estimate
                self.covariance = f @ self.covariance @ f.T + Q
                record.predict(f, Q)
                for sensor, every in (("odometer", 1), ("gps", 5)):
                    if step % every == 0:
                        error = self._measure(record, sensor, error, step)
                truth = error + self.truth_is_off if self.has_truth else None
                record.snapshot(self.covariance, error=truth)

    def _measure(self, record: Recorder, sensor: str, error: Array, step: int) -> Array:
        """Fuse a measurement; return what the estimate is off by then."""
        (h, expecting), r = self._used(sensor), R_OF[sensor]
        residual = H_OF[sensor] @ error + (H_OF[sensor] - expecting) @ self.estimate
        residual = residual + self._drawn("R", (sensor,), r, step)
        p = self.covariance
        gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
        left = np.eye(5) - gain @ h
        self.covariance = left @ p @ left.T + gain @ r @ gain.T
        record.update(sensor, residual, h, r)
        self.estimate = self.estimate + gain @ residual
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


def drawn(rng: np.random.Generator) -> LinearFault | JacobianFault:
    """Draw a fault: of a Jacobian as often as of a noise or a constant."""
    return drawn_jacobian(rng) if rng.random() < 0.5 else drawn_number(rng)


def drawn_jacobian(rng: np.random.Generator) -> JacobianFault:
    """Draw a change of F or of an H that leaves the others as they are.

    A number is added to one term alone.
    """
    inner = tuple(BLOCKS.items())
    while True:
        of = str(rng.choice(["", *SENSORS]))
        right = H_OF[of] if of else F
        operand = Operand("H" if of else "F", right.shape, inner, "", inner, tuple(BLOCKS))
        values = Values(sound=right[None])
        plain = singles_of(operand, values)
        every = [*plain.values(), *numbered_of(operand).values()]
        change = every[int(rng.integers(len(every)))]
        if change.change == "plus" and (change.mask is None or change.mask.sum() > 1):
            continue
        number = [start + float(rng.choice(SHIFTS)) for start in change.start]
        wrong = change.values(values, *number)[0]
        if np.isfinite(wrong).all() and np.abs(wrong - right).max() > 1e-3:
            return JacobianFault(of, wrong, bool(rng.random() < 0.5), change.said(*number))


def drawn_number(rng: np.random.Generator) -> LinearFault:
    """Draw another noise, or a constant."""
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


def tells(path: Path, fault: LinearFault | JacobianFault) -> bool:
    """Return whether the truth is likelier by far than what the filter states."""
    steps = list(steps_of(TraceReader(path)))
    if isinstance(fault, JacobianFault):
        logs = [log_likelihoods(one, [{}])[0]
                for one in (steps, list(with_jacobians(steps, [fault.as_cause()])))]  # fmt: skip
        return bool(logs[1] > logs[0] + EVIDENCE)
    begin_s = SECOND * (fault.since + 1) - 1e-9
    times = [e.number for e, *_ in steps if e.time_s is not None and e.time_s >= begin_s]
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
    parts: Counter[str] = Counter()
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
            in_part = (
                explained is not None
                and isinstance(fault, JacobianFault)
                and all(fault.is_part(one.fitted) for one in explained.causes)
            )
            beside = first is not None and any(fault.is_named(one) for one in first.others)
            tried[fault.kind] += 1
            named[fault.kind] += right
            alike[fault.kind] += beside and not right
            parts[fault.kind] += in_part and not (right or beside)
            others[fault.kind] += first is not None and not (right or beside or in_part)
            if given.list and not right:
                print(fault, "" if explained is None else explained.what)
        heads = ("fault", "faults", "named first", "named as likely", "in part", "another named")
        print_head(*heads)
        for key in sorted(tried):
            print_row(key, tried[key], *(one[key] for one in (named, alike, parts, others)))
        print_row("all", *(one.total() for one in (tried, named, alike, parts, others)))
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
