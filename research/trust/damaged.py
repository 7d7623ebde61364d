"""Is what is said of a damaged log what was done to it?

    python -m research.trust.damaged [--quick] [--list] [--logs 200] [--seed 0]

A drive with labels, one of three kinds of odometry, and absolute positions is damaged by two of
more than twenty kinds of fault, drawn. `logs` and `run`, with the positions, then say what they
say. A sentence that names a change of the log, a noise or a motion of the positions as what makes
it fit is a statement of fact; it is right if one of the changes that it names was made. A symptom
states nothing. --quick takes a few logs. The exit code is 1 where a statement is not right.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.checks.diagnosis.log_doctor import examine
from comparisons.config import EkfConfig, RunConfig
from comparisons.errors import InputError
from comparisons.jobs.run import compare
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.transforms.calibration import Line, controlled, delayed, driven, sensed
from graphslam.marginals import SingularProblemError
from research.script import options
from research.trust.odometry_drives import drive
from research.trust.row import PromiseRow, print_table

LOGS, QUICK = 200, 4
_SAMPLES = 80
_KINDS = ("velocity", "steering", "poses")
_FIXES = 6
_DEGREE = np.pi / 180.0
STATED = re.compile(r"(?<!single change )(?<!not )\b(fits? (if|with|an? )|falls from|times too)")
"""What makes a sentence a statement of fact; a symptom says that nothing fits."""

Change = Callable[[Log, np.random.Generator], Log]


class Damage(NamedTuple):
    """A fault of a log. named: pattern of the words that name it."""

    name: str
    change: Change
    named: str = "^$"


class DamageOutcome(NamedTuple):
    """Statements about a damaged log, those that name what was done, and the others."""

    name: str
    right: list[str]
    wrong: list[str]


def scaled(what: str, line: Line) -> Change:
    """Speeds, turns, ranges or bearings on a line."""
    change = driven if what in ("speed", "turn") else sensed
    name = {"range": "range_"}.get(what, what)
    return lambda log, _: change(log, **{name: line})


def stated(name: str, change: Callable[[Array], Array]) -> Change:
    """Other sigmas of measurements than they have."""

    def changed(log: Log, _: np.random.Generator) -> Log:
        seen = log.measurements
        return replace(log, measurements=replace(seen, **{name: change(getattr(seen, name))}))  # type: ignore[arg-type]

    return changed


def noisier(log: Log, rng: np.random.Generator) -> Log:
    """Bearings of three times the stated noise."""
    more = np.sqrt(8.0) * log.measurements.sigma_bearing_rad * rng.standard_normal(len(_times(log)))
    return _measured(log, bearing_rad=log.measurements.bearing_rad + more)


def unsteady(log: Log, rng: np.random.Generator) -> Log:
    """Odometry of much more noise than stated."""

    def more(values: Array) -> Array:
        return values + 4.0 * np.std(np.diff(values, axis=0)) * rng.standard_normal(values.shape)

    return controlled(log, more, more)


def exchanged_labels(log: Log, rng: np.random.Generator) -> Log:
    """Two landmarks take each other's label half way on."""
    seen = log.measurements
    one, other = rng.choice(np.unique(seen.landmark), 2, replace=False)
    late = seen.time_s > np.median(seen.time_s)
    label = seen.landmark.copy()
    label[late & (seen.landmark == one)] = other
    label[late & (seen.landmark == other)] = one
    return _measured(log, landmark=label)


def wrong_rows(log: Log, rng: np.random.Generator) -> Log:
    """Two measurements in a hundred are anywhere."""
    rows = rng.random(len(_times(log))) < 0.02
    return _measured(
        log,
        range_m=np.where(rows, rng.uniform(1.0, 8.0, len(rows)), log.measurements.range_m),
        bearing_rad=np.where(rows, rng.uniform(-3.0, 3.0, len(rows)), log.measurements.bearing_rad),
    )


def moving_landmark(log: Log, rng: np.random.Generator) -> Log:
    """A landmark's ranges are longer from half way on."""
    seen = log.measurements
    moved = (seen.landmark == rng.choice(seen.landmark)) & (seen.time_s > np.median(seen.time_s))
    return _measured(log, range_m=seen.range_m + 1.0 * moved)


def sensor_ahead(log: Log, _: np.random.Generator) -> Log:
    """Ranges and bearings of a sensor half a metre ahead of the pose."""
    seen = log.measurements
    place = seen.range_m * np.exp(1j * seen.bearing_rad) - 0.5
    return _measured(log, range_m=np.maximum(np.abs(place), 1e-3), bearing_rad=np.angle(place))


def late_clock(log: Log, _: np.random.Generator) -> Log:
    """Measurements 0.3 s late."""
    inside = _times(log) + 0.3 <= log.odometry.time_s[-1]
    return delayed(replace(log, measurements=log.measurements.chosen(inside)), 0.3)


def drifting_clock(log: Log, _: np.random.Generator) -> Log:
    """A clock of the measurements that runs 5 % slow."""
    return _measured(log, time_s=log.prior.time_s + 0.95 * (_times(log) - log.prior.time_s))


def slipping(log: Log, _: np.random.Generator) -> Log:
    """A stretch in which the vehicle goes twice as far as its wheels say."""

    def half(values: Array) -> Array:
        slipped: Array = values.copy()
        slipped[len(values) // 3 : len(values) // 2] *= 0.5
        return slipped

    return controlled(log, half, lambda turn: turn)


def arriving_frame(log: Log, _: np.random.Generator) -> Log:
    """Motions in the frame of the arriving pose; the controls of the sample before, of others."""
    moved = log.odometry
    if isinstance(moved, RelativePoses):
        steps = np.array([
            [*(_turn(-d[2]) @ d[:2]), d[2]] for d in moved.displacement
        ])  # fmt: skip
        return replace(log, odometry=replace(moved, displacement=steps))
    return controlled(log, lambda v: v, lambda w: np.append(w[:5], w[:-5]))


def positioned(change: Callable[[Positions], Positions]) -> Change:
    """Other positions."""
    return lambda log, _: replace(log, positions=log.positions and change(log.positions))


def turned_positions(fixes: Positions) -> Positions:
    """Positions about the origin by 8 degrees."""
    return replace(fixes, position_m=fixes.position_m @ _turn(8.0 * _DEGREE).T)


DAMAGES = (
    Damage("clockwise bearings", scaled("bearing", (-1.0, 0.0)),
           r"bearings (grow clockwise|-\S+ times)"),
    Damage("clockwise turns", scaled("turn", (-1.0, 0.0)),
           r"grows clockwise|(turns|angles|rates)\D* -\S+ times"),
    Damage("bearings in degrees", scaled("bearing", (_DEGREE, 0.0)),
           r"bearings (are rad|\S+ times)"),
    Damage("ranges in cm", scaled("range", (100.0, 0.0)),
           r"ranges (are cm|.* times)|speeds .* times"),
    Damage("speed 1.15 times", scaled("speed", (1.15, 0.0)), r"(speeds|ways\D*|ranges) \S+ times"),
    Damage("turn 1.15 times", scaled("turn", (1.15, 0.0)), r"(angles|rates|turns\D*) \S+ times"),
    Damage("ranges 0.4 m long", scaled("range", (1.0, 0.4)), r"offset .* on the ranges"),
    Damage("bearings off by 0.1", scaled("bearing", (1.0, 0.1)), r"offset .* on the bearings"),
    Damage("measurements 0.3 s late", late_clock, r"later than the log says"),
    Damage("the range's variance", stated("sigma_range_m", np.square),
           r"sigmas? of ranges|noise of the range"),
    Damage("the bearing's variance", stated("sigma_bearing_rad", np.square),
           r"sigmas? of (bearings|ranges and bearings)|noise of the bearing"),
    Damage("noisier bearings", noisier, r"noise of the bearing"),
    Damage("noisier odometry", unsteady, r"noise of the (odometry|speed|turns?|moves)"),
    Damage("exchanged labels", exchanged_labels, r"labels of landmarks .* exchanged"),
    Damage("wrong rows", wrong_rows),
    Damage("a landmark that moves", moving_landmark),
    Damage("a sensor ahead of the pose", sensor_ahead, r"the sensor of the measurements"),
    Damage("a slow clock", drifting_clock, r"times of the (measurements|odometry) \S+ times"),
    Damage("a stretch of slip", slipping),
    Damage("motions of another frame or sample", arriving_frame),
    Damage("late positions", positioned(lambda p: replace(p, time_s=p.time_s + 0.5)),
           r"time stamps \S+ s too late"),
    Damage("turned positions", positioned(turned_positions), r"a frame turned by"),
    Damage("an antenna ahead of the pose",
           positioned(lambda p: replace(p, antenna_m=(-1.2, 0.4))), r"an antenna at"),
)  # fmt: skip
"""Kinds of fault."""


def outcomes(count: int, seed: int) -> Iterator[DamageOutcome]:
    """Of logs that two kinds of damage each were done to, drawn from a seed."""
    for number in range(count):
        rng = np.random.default_rng((seed, number))
        chosen = [DAMAGES[k] for k in rng.choice(len(DAMAGES), 2, replace=False)]
        log = drive(number, _KINDS[number % 3], _SAMPLES, _FIXES)
        for one in chosen:
            log = one.change(log, rng)
        name = f"{log.name}: {' and '.join(one.name for one in chosen)}"
        yield judged(name, statements(log), [one.named for one in chosen])


def judged(name: str, said: list[str], named: list[str]) -> DamageOutcome:
    """Sort statements by whether they name one of the things that were done."""
    right = [one for one in said if any(re.search(pattern, one) for pattern in named)]
    return DamageOutcome(name, right, [one for one in said if one not in right])


def statements(log: Log) -> list[str]:
    """Return the sentences of `logs` and `run` that state what is wrong with a log."""
    examined = examine(log)
    said = [examined.words] if examined.findings else []
    try:
        verdict = compare(log, RunConfig(ekf=EkfConfig.of(gps="on"))).verdict
    except (InputError, SingularProblemError):  # the filter may break down, or use nothing
        return said
    said += [one.evidence for one in verdict.causes if one.gap in ("log", "noise")]
    beside = [one.hint for one in verdict.causes] + [
        one.evidence for one in verdict.causes if one.gap not in ("log", "noise")
    ]
    said += [one for one in (*beside, *verdict.remarks) if STATED.search(one)]
    return list(dict.fromkeys(said))


def rows(
    quick: bool = False, *, listed: bool = False, logs: int = LOGS, seed: int = 0
) -> Iterator[PromiseRow]:
    """No statement that is not so; how often the damage is named is said."""
    found = []
    for one in outcomes(QUICK if quick else logs, seed):
        found.append(one)
        if listed or one.wrong:
            print(f"{one.name}: right {one.right}, wrong {one.wrong}", flush=True)
    wrong, right = (sum(len(getattr(one, name)) for one in found) for name in ("wrong", "right"))
    named = sum(bool(one.right) for one in found)
    yield PromiseRow(
        "A statement about a damaged log is what was done to it",
        "none that is not",
        f"{wrong} of {wrong + right} statements about {len(found)} logs; {named} logs with a right "
        "one",
        not wrong,
    )


def _turn(angle_rad: float) -> Array:
    """(2, 2) that turns points."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.array(((cos, -sin), (sin, cos)))


def _times(log: Log) -> Array:
    return log.measurements.time_s


def _measured(log: Log, **columns: Array | Index) -> Log:
    return replace(log, measurements=replace(log.measurements, **columns))  # type: ignore[arg-type]


if __name__ == "__main__":
    asked = options(__doc__, quick=False, list=False, logs=LOGS, seed=0)
    sys.exit(print_table(rows(asked.quick, listed=asked.list, logs=asked.logs, seed=asked.seed)))
