"""Faults of logs, drawn as a slot and a change, and what the examination says of them.

    python -m research.trust.composed_logs [--faults 150] [--sound 60] [--seed 0] [--list]

A column of a stream, or a stream's time, place or sigma, and a change of it are drawn, with a
number; the fault is planted in a sound drive of one of three kinds of odometry, with absolute
positions or without. `examine` (what `slamcheck logs` and `new-log` say) does not know it. A fault
counts where the log tells it: chi-square leaves its band, a part of the residuals does, or the
sound log's chi-square is less by EVIDENCE. It is named if one of the changes that are said to fit
is that one, with its number; as another if changes are said to fit and it is none of them. Sound
drives are examined as well; the interval of their share is Clopper and Pearson's, 95 %.
"""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from comparisons import plane
from comparisons.arrays import Array
from comparisons.checks.diagnosis.log_doctor import examine, solver_by_labels
from comparisons.errors import InputError
from comparisons.faults.of_logs import sigmas_of
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import RelativePoses, SteeringOdometry, VelocityOdometry
from graphslam.goodness_of_fit import Goodness
from graphslam.increments import dead_reckoned
from research.script import options, print_head, print_row
from research.trust.defects import share
from research.trust.odometry_drives import drive

KINDS = ("velocity", "steering", "poses")
SAMPLES, FIXES = 400, 10
EVIDENCE = 30.0
NEAR = 0.03
"""Relative distance of a number that may lie outside the interval that is said."""
DEGREE = np.pi / 180.0
OUTCOMES = "named", "named alone", "another named", "not named"

Plant = Callable[[Log], Log]


class DrawnLogFault(NamedTuple):
    """A fault of a log.

    Attributes:
        slot: What it is of.
        change: What stands there instead.
        plant: Makes the log with it.
        named: Pattern of the words that name it.
        number: What corrects it, the first number that the words have; None for a pattern alone.
    """

    slot: str
    change: str
    plant: Plant
    named: str
    number: float | None = None

    def is_named(self, said: str) -> bool:
        """Return whether a change that is said to fit is this one, with its number."""
        match = re.search(self.named, said)
        if match is None:
            return False
        numbers = [float(one) for one in re.findall(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?", said)]
        if self.number is None or not numbers:
            return True
        if abs(numbers[0] - self.number) <= NEAR * abs(self.number) + 1e-3:
            return True
        interval = re.search(r"\((\S+) to (\S+)\)", said)
        if interval is None:
            return False
        low, high = (float(one) for one in interval.groups())
        return low <= self.number <= high


def _wheels(log: Log) -> str:
    return "steering_rad" if isinstance(log.odometry, SteeringOdometry) else "yaw_rate_radps"


def _odometry(log: Log, **columns: Any) -> Log:
    return replace(log, odometry=replace(log.odometry, **columns))


def _measured(log: Log, **columns: Any) -> Log:
    return replace(log, measurements=replace(log.measurements, **columns))


def _fixes(log: Log, **columns: Any) -> Log:
    assert log.positions is not None
    return replace(log, positions=replace(log.positions, **columns))


def _range(change: Callable[[Array], Array]) -> Plant:
    return lambda log: _measured(log, range_m=np.maximum(change(log.measurements.range_m), 1e-3))


def _bearing(change: Callable[[Array], Array]) -> Plant:
    return lambda log: _measured(
        log, bearing_rad=np.angle(np.exp(1j * change(log.measurements.bearing_rad)))
    )


def _speed(change: Callable[[Array], Array]) -> Plant:
    def planted(log: Log) -> Log:
        if isinstance(log.odometry, RelativePoses):
            moved = log.odometry.displacement.copy()
            moved[:, :2] = change(moved[:, :2])
            return _odometry(log, displacement=moved)
        return _odometry(log, speed_mps=change(log.odometry.speed_mps))

    return planted


def _turn(change: Callable[[Array], Array]) -> Plant:
    def planted(log: Log) -> Log:
        if isinstance(log.odometry, RelativePoses):
            moved = log.odometry.displacement.copy()
            moved[:, 2] = change(moved[:, 2])
            return _odometry(log, displacement=moved)
        name = _wheels(log)
        return _odometry(log, **{name: change(getattr(log.odometry, name))})

    return planted


def _moves(change: Callable[[Array], Array]) -> Plant:
    """Of dx, dy, dheading (N, 3)."""
    return lambda log: _odometry(log, displacement=change(log.odometry.displacement))  # type: ignore[union-attr]


def _place(change: Callable[[Array], Array]) -> Plant:
    """Of east, north (N, 2)."""
    return lambda log: _fixes(log, position_m=change(_present(log.positions).position_m))


def _present(positions: Positions | None) -> Positions:
    assert positions is not None
    return positions


def _shifted(stream: str, delay_s: float) -> Plant:
    """Stamps of a stream that are later; what would leave the odometry's time is missing."""

    def planted(log: Log) -> Log:
        rows = getattr(log, stream)
        time_s = rows.time_s + delay_s
        inside = (time_s >= log.odometry.time_s[0]) & (time_s <= log.odometry.time_s[-1])
        return replace(log, **{stream: replace(rows, time_s=time_s).chosen(inside)})

    return planted


def _lagged(column: Callable[[Callable[[Array], Array]], Plant], samples: int) -> Plant:
    def lag(values: Array) -> Array:
        where = np.clip(np.arange(len(values)) - samples, 0, len(values) - 1)
        return np.asarray(values[where])

    return column(lag)


def _by_angles(displacement: Array, angle_rad: Array) -> Array:
    """Displacements whose x and y are turned by an angle each."""
    return np.column_stack((plane.turned(displacement[:, :2], angle_rad), displacement[:, 2]))


def _in_map(displacement: Array) -> Array:
    heading = np.append(0.0, np.cumsum(displacement[:-1, 2]))
    return _by_angles(displacement, heading)


def _poses_in(x: Array, y: Array, turned: float) -> Callable[[Array], Array]:
    """Displacements of poses whose axes are others. x, y: what they are of x, y (2,)."""

    def changed(displacement: Array) -> Array:
        pose = dead_reckoned(np.zeros(3), displacement)
        place = np.column_stack((pose[:, :2] @ x, pose[:, :2] @ y))
        heading = turned * pose[:, 2]
        step = plane.turned(np.diff(place, axis=0), -heading[:-1])
        return np.column_stack((step, np.diff(heading)))

    return changed


def _sigma(name: str, change: Callable[[Any], Any]) -> Plant:
    """Of a column of measurements, of wheels (`speed`, `turn`), or of positions."""

    def planted(log: Log) -> Log:
        if name == "position":
            sigma = np.sqrt(_present(log.positions).covariance[0, 0, 0])
            return replace(log, positions=_present(log.positions).with_sigma(float(change(sigma))))
        if name in ("range", "bearing"):
            column = {"range": "sigma_range_m", "bearing": "sigma_bearing_rad"}[name]
            return _measured(log, **{column: change(getattr(log.measurements, column))})
        assert not isinstance(log.odometry, RelativePoses)
        column = {"speed": "sigma_speed_mps", "turn": "sigma_turn"}[name]
        noise = log.odometry.noise
        return _odometry(log, noise=replace(noise, **{column: change(getattr(noise, column))}))

    return planted


def _sensor_ahead(ahead_m: float, left_m: float) -> Plant:
    def planted(log: Log) -> Log:
        seen = log.measurements
        place = seen.range_m * np.exp(1j * seen.bearing_rad) - (ahead_m + 1j * left_m)
        return _measured(log, range_m=np.maximum(np.abs(place), 1e-3), bearing_rad=np.angle(place))

    return planted


def _exchanged(log: Log) -> Log:
    seen = log.measurements
    return _measured(
        log,
        range_m=np.maximum(np.abs(seen.bearing_rad), 1e-3),
        bearing_rad=np.angle(np.exp(1j * seen.range_m)),
    )


def _labels_exchanged(log: Log) -> Log:
    """The two landmarks that are measured most take each other's label half way on."""
    seen = log.measurements
    labels, count = np.unique(seen.landmark, return_counts=True)
    one, other = labels[np.argsort(count)[-2:]]
    late = seen.time_s > np.median(seen.time_s)
    label = seen.landmark.copy()
    label[late & (seen.landmark == one)] = other
    label[late & (seen.landmark == other)] = one
    return _measured(log, landmark=label)


def _of_measurements(rng: np.random.Generator) -> Iterator[DrawnLogFault]:
    scale = float(rng.choice((0.8, 0.93, 1.1, 1.5)))
    angle = float(rng.choice((0.9, 0.97, 1.05, 1.2)))
    yield DrawnLogFault("range", "times a number", _range(lambda r: scale * r),
                        r"ranges \S+ times", 1.0 / scale)  # fmt: skip
    for unit, factor in (("cm", 100.0), ("mm", 1000.0)):
        yield DrawnLogFault("range", "other unit", _range(partial(np.multiply, factor)),
                            f"ranges are {unit}")  # fmt: skip
    more = float(rng.choice((-0.3, 0.15, 0.4, 1.0)))
    yield DrawnLogFault("range", "plus a number", _range(lambda r: r + more),
                        r"on the ranges", -more)  # fmt: skip
    yield DrawnLogFault(
        "range", "square", _range(np.square), r"squares? of (the )?ranges|ranges are squared"
    )
    yield DrawnLogFault("range", "exchanged", _exchanged, r"ranges and bearings are exchanged")
    yield DrawnLogFault("bearing", "negated", _bearing(np.negative),
                        r"bearings grow clockwise|bearings -\S+ times")  # fmt: skip
    yield DrawnLogFault("bearing", "times a number", _bearing(lambda b: angle * b),
                        r"bearings \S+ times", 1.0 / angle)  # fmt: skip
    yield DrawnLogFault("bearing", "other unit", _bearing(lambda b: b * DEGREE),
                        r"bearings are radians")  # fmt: skip
    off = float(rng.choice((-0.2, -0.05, 0.03, 0.1, 0.4)))
    yield DrawnLogFault("bearing", "plus a number", _bearing(lambda b: b + off),
                        r"on the bearings", -off)  # fmt: skip
    for quarter, words in ((0.5, "left"), (-0.5, "right"), (1.0, "behind|astern|back")):
        yield DrawnLogFault("bearing", "other axis", _bearing(partial(np.add, quarter * np.pi)),
                            f"bearings are from ({words})")  # fmt: skip
    ahead, left = float(rng.choice((-0.8, 0.5, 1.5))), float(rng.choice((-0.4, 0.0, 0.6)))
    yield DrawnLogFault("sensor's place", "plus a number", _sensor_ahead(ahead, left),
                        r"sensor at|measurements' sensor|sensor of the measurements")  # fmt: skip
    yield DrawnLogFault("labels", "exchanged from some time on", _labels_exchanged,
                        r"labels? .* exchanged")  # fmt: skip


def _of_clocks(rng: np.random.Generator, log: Log) -> Iterator[DrawnLogFault]:
    delay = float(rng.choice((-1.0, -0.5, 0.5, 1.0) if isinstance(log.odometry, RelativePoses)
                             else (-0.7, -0.3, 0.2, 0.5, 1.0)))  # fmt: skip
    yield DrawnLogFault("time of measurements", "plus a number", _shifted("measurements", delay),
                        r"measurements \S+ s later", -delay)  # fmt: skip
    if not isinstance(log.odometry, RelativePoses):
        rate = float(rng.choice((0.95, 0.98, 1.02)))

        def drifting(log: Log) -> Log:
            time_s = log.prior.time_s + rate * (log.measurements.time_s - log.prior.time_s)
            inside = time_s <= log.odometry.time_s[-1]
            changed = replace(log.measurements, time_s=time_s)
            return replace(log, measurements=changed.chosen(inside))

        yield DrawnLogFault("time of measurements", "times a number", drifting,
                            r"times of the measurements \S+ times", 1.0 / rate)  # fmt: skip
    if log.positions is not None:
        yield DrawnLogFault("time of positions", "plus a number", _shifted("positions", delay),
                            r"of the positions \S+ s too (late|early)", abs(delay))  # fmt: skip


def _of_odometry(rng: np.random.Generator, log: Log) -> Iterator[DrawnLogFault]:
    poses = isinstance(log.odometry, RelativePoses)
    turn = {RelativePoses: "heading", SteeringOdometry: "steering"}.get(
        type(log.odometry), "yaw_rate"
    )
    turns = {"heading": "turns between poses", "steering": "steering angles"}.get(
        turn, "turn rates"
    )
    ways = "ways between poses" if poses else "speeds"
    scale, bend = (float(one) for one in rng.choice((0.8, 0.9, 1.1, 1.25, 2.0), 2))
    speed = "way" if poses else "speed"
    yield DrawnLogFault(speed, "times a number", _speed(lambda v: scale * v),
                        rf"{ways} \S+ times", 1.0 / scale)  # fmt: skip
    yield DrawnLogFault(speed, "negated", _speed(np.negative),
                        rf"{ways} -\S+ times|{ways} .*opposite|speeds? .*backwards")  # fmt: skip
    yield DrawnLogFault(speed, "other unit", _speed(lambda v: 100.0 * v),
                        r"(is|are) (in )?cm")  # fmt: skip
    yield DrawnLogFault(turn, "times a number", _turn(lambda w: bend * w),
                        rf"{turns} \S+ times", 1.0 / bend)  # fmt: skip
    yield DrawnLogFault(turn, "negated", _turn(np.negative),
                        rf"{turn} grows clockwise|{turns} -\S+ times")  # fmt: skip
    if turn != "steering":
        yield DrawnLogFault(turn, "other unit", _turn(lambda w: w / DEGREE),
                            rf"{turn} is in degrees")  # fmt: skip
    yield DrawnLogFault(turn, "other unit", _turn(lambda w: w * DEGREE), rf"{turn} is in radians")
    off = float(rng.choice((-0.1, -0.03, 0.02, 0.05)))
    yield DrawnLogFault(turn, "plus a number", _turn(lambda w: w + off),
                        rf"on the {turns}", -off)  # fmt: skip
    if poses:
        yield from _of_moves(rng)
        return
    more = float(rng.choice((-0.2, 0.1, 0.3)))
    yield DrawnLogFault("speed", "plus a number", _speed(lambda v: v + more),
                        r"on the speeds", -more)  # fmt: skip
    if turn == "yaw_rate":
        yield DrawnLogFault("speed", "other unit", _speed(lambda v: 3.6 * v), r"speeds are km/h")

        def exchanged(log: Log) -> Log:
            assert isinstance(log.odometry, VelocityOdometry)
            v, w = log.odometry.speed_mps, log.odometry.yaw_rate_radps
            return _odometry(log, speed_mps=w, yaw_rate_radps=v)

        yield DrawnLogFault("speed", "exchanged", exchanged, r"speed and yaw_rate are exchanged")
        yield DrawnLogFault("speed and turn", "other unit",
                            lambda log: _turn(lambda w: 1e3 * w)(_speed(lambda v: 1e3 * v)(log)),
                            r"milliseconds")  # fmt: skip
    else:

        def longer(log: Log) -> Log:
            assert isinstance(log.odometry, SteeringOdometry)
            car = log.odometry.vehicle
            return _odometry(log, vehicle=replace(car, wheelbase_m=bend * car.wheelbase_m))

        yield DrawnLogFault(
            "wheelbase", "times a number", longer, r"wheelbase \S+ times", 1.0 / bend
        )
    lag = int(rng.choice((-8, -4, 4, 8)))
    yield DrawnLogFault(
        turn, "lag", _lagged(_turn, lag), rf"{turns} .*(later|earlier|before|after)"
    )
    yield DrawnLogFault(
        "speed", "lag", _lagged(_speed, 3 * lag), r"speeds .*(later|earlier|before|after)"
    )


def _of_moves(rng: np.random.Generator) -> Iterator[DrawnLogFault]:
    """Of dx, dy and dheading."""
    for column, name in enumerate("xy"):

        def negated(d: Array, k: int = column) -> Array:
            return d * np.where(np.arange(3) == k, -1.0, 1.0)

        yield DrawnLogFault(name, "negated", _moves(negated),
                            rf"{name} of the (displacements|moves).*opposite")  # fmt: skip
        more = float(rng.choice((-0.05, 0.02, 0.1)))

        def offset(d: Array, k: int = column, more: float = more) -> Array:
            return d + np.where(np.arange(3) == k, more, 0.0)

        yield DrawnLogFault(name, "plus a number", _moves(offset),
                            rf"on {name} of the (displacements|moves)", -more)  # fmt: skip
    yield DrawnLogFault("x", "exchanged", _moves(lambda d: d[:, [1, 0, 2]]),
                        r"x and y of the (displacements|moves) are exchanged")  # fmt: skip
    yield DrawnLogFault("x", "times a number", _moves(lambda d: d * (1.3, 1.0, 1.0)),
                        r"(x of the displacements|ways between poses) \S+ times",
                        1.0 / 1.3)  # fmt: skip
    yield DrawnLogFault("x and y", "other frame", _moves(lambda d: _by_angles(d, -d[:, 2])),
                        r"in the frame of the arriving pose")  # fmt: skip
    yield DrawnLogFault("x and y", "other frame", _moves(_in_map),
                        r"(axes|frame) of the map|map's axes")  # fmt: skip
    angle = float(rng.choice((-0.5, -0.1, 0.05, 0.3)))
    yield DrawnLogFault("x and y", "turned",
                        _moves(lambda d: _by_angles(d, np.full(len(d), angle))),
                        r"(displacements|moves).*turned by", -angle)  # fmt: skip
    for x, y, turned, words in (
        ((1.0, 0.0), (0.0, -1.0), 1.0, "y of the poses grows to the right"),
        ((0.0, 1.0), (1.0, 0.0), 1.0, "x and y of the poses are exchanged"),
        ((-1.0, 0.0), (0.0, 1.0), 1.0, "poses.* x"),
        ((0.0, 1.0), (1.0, 0.0), -1.0, "north, east and clockwise headings"),
        ((1.0, 0.0), (0.0, 1.0), -1.0, "poses.* headings?"),
    ):
        yield DrawnLogFault("poses", "other axes",
                            _moves(_poses_in(np.array(x), np.array(y), turned)), words)  # fmt: skip


def _of_positions(rng: np.random.Generator) -> Iterator[DrawnLogFault]:
    signs = {"east": (-1.0, 1.0), "north": (1.0, -1.0)}
    for name, sign in signs.items():
        yield DrawnLogFault(name, "negated", _place(partial(np.multiply, sign)),
                            rf"{name} of the positions has the opposite sign")  # fmt: skip
    yield DrawnLogFault("east", "exchanged", _place(lambda p: p[:, ::-1]),
                        r"east and north .*exchanged|north and east")  # fmt: skip
    scale = float(rng.choice((0.9, 1.05, 1.2)))
    yield DrawnLogFault("positions", "times a number", _place(lambda p: scale * p),
                        r"positions \S+ times", 1.0 / scale)  # fmt: skip
    which = int(rng.integers(2))
    name = ("east", "north")[which]
    yield DrawnLogFault(name, "times a number",
                        _place(lambda p: p * np.where(np.arange(2) == which, scale, 1.0)),
                        rf"{name} of the positions \S+ times", 1.0 / scale)  # fmt: skip
    yield DrawnLogFault("positions", "other unit", _place(lambda p: 100.0 * p),
                        r"positions are (in )?cm")  # fmt: skip
    more = rng.choice((-2.0, 0.5, 3.0), 2)
    yield DrawnLogFault("positions", "plus a number", _place(lambda p: p + more),
                        r"offset .* m east")  # fmt: skip
    angle = float(rng.choice((-0.3, -0.05, 0.1, 1.0)))
    yield DrawnLogFault("positions", "turned", _place(lambda p: plane.turned(p, angle)),
                        r"frame turned by")  # fmt: skip
    arm = (float(rng.choice((-1.2, 0.8, 2.0))), float(rng.choice((-0.5, 0.0, 0.4))))
    yield DrawnLogFault("antenna", "plus a number", lambda log: _fixes(log, antenna_m=arm),
                        r"an antenna at")  # fmt: skip


def _of_sigmas(rng: np.random.Generator, log: Log) -> Iterator[DrawnLogFault]:
    factor = float(rng.choice((0.2, 0.33, 0.5)))
    for sigma in sigmas_of(log):
        if isinstance(log.odometry, RelativePoses) and sigma.component == "odometry":
            continue
        slot, column = f"sigma of {sigma.name}", sigma.name.removesuffix("s")
        yield DrawnLogFault(slot, "square", _sigma(column, np.square),
                            rf"sigma of {sigma.plural}, \S+, is a variance",
                            sigma.value**2)  # fmt: skip
        yield DrawnLogFault(slot, "times a number", _sigma(column, lambda s: factor * s),
                            rf"noise of the {sigma.name} \S+ times the stated",
                            1.0 / factor)  # fmt: skip
        if sigma.is_angle:
            yield DrawnLogFault(slot, "other unit", _sigma(column, lambda s: DEGREE * s),
                                rf"sigma of {sigma.plural} is in radians")  # fmt: skip


def drawn(rng: np.random.Generator, log: Log) -> DrawnLogFault:
    """A fault at random: each slot, then each change of it, is as likely as any other."""
    every = [*_of_measurements(rng), *_of_clocks(rng, log), *_of_odometry(rng, log)]
    every += [*_of_sigmas(rng, log), *([] if log.positions is None else _of_positions(rng))]
    slots = sorted({one.slot for one in every})
    slot = slots[rng.integers(len(slots))]
    changes = sorted({one.change for one in every if one.slot == slot})
    change = changes[rng.integers(len(changes))]
    some = [one for one in every if (one.slot, one.change) == (slot, change)]
    return some[rng.integers(len(some))]


def tells(sound: Log, faulty: Log) -> bool:
    """Return whether a log tells that something is wrong with it."""
    before, after = (solved(one) for one in (sound, faulty))
    if before is None or not before.sound:
        return False
    if after is None or not after.sound:
        return True
    return bool(after.test.chi2 > before.test.chi2 + EVIDENCE)


def main() -> None:
    """Draw, plant, examine and count."""
    given = options(__doc__, faults=150, sound=60, seed=0, list=False)
    counts: Counter[tuple[str, str, str]] = Counter()
    silent, seconds, number, said_count = 0, 0.0, 0, 0
    while sum(counts.values()) < given.faults:
        rng = np.random.default_rng((given.seed, number))
        log = _drive(given.seed, number)
        number += 1
        fault = drawn(rng, log)
        try:
            faulty = fault.plant(log)
        except InputError:
            continue
        if not tells(log, faulty):
            silent += 1
            continue
        begin = time.process_time()
        said = statements(faulty)
        seconds += time.process_time() - begin
        said_count += len(said)
        right = any(fault.is_named(one) for one in said)
        outcome = "not named" if not said else "named" if right else "another named"
        if right and len(said) == 1:
            outcome = "named alone"
        counts[fault.slot, fault.change, outcome] += 1
        if given.list:
            print(f"{outcome:14} {log.name}, {fault.slot}, {fault.change}: {said}", flush=True)
    _print(counts)
    accused = sum(bool(examine(_drive(given.seed + 1, k)).words) for k in range(given.sound))
    print(f"\n{silent} drawn faults that the log does not tell; {seconds / given.faults:.2f} s of "
          f"processor time each; {said_count} statements")  # fmt: skip
    print(share(accused, given.sound, "sound logs accused"))


def solved(log: Log) -> Goodness | None:
    """Return the optimum of a log by its labels; None where there is none."""
    try:
        return solver_by_labels(log).solved(log).goodness
    except (InputError, RuntimeError, ValueError):
        return None


def statements(log: Log) -> list[str]:
    """Return the changes that are said to make a log fit."""
    return [one.said for one in examine(log).findings]


def _drive(seed: int, number: int) -> Log:
    """A sound drive, every second one with positions."""
    kind = KINDS[number % len(KINDS)]
    return drive(100_000 * seed + number, kind, SAMPLES, FIXES if number // 3 % 2 else 0)


def _print(counts: Counter[tuple[str, str, str]]) -> None:
    print_head("slot", "change", "drawn", *OUTCOMES)
    for slot, change in sorted({key[:2] for key in counts}):
        each = [counts[slot, change, outcome] for outcome in OUTCOMES]
        print_row(slot, change, sum(each), *_joined(each))
    total = [sum(n for key, n in counts.items() if key[2] == one) for one in OUTCOMES]
    print_row("all", "", sum(total), *_joined(total))


def _joined(each: list[int]) -> list[int]:
    """Counts in which what is named alone is named as well."""
    return [each[0] + each[1], *each[1:]]


if __name__ == "__main__":
    main()
