"""A grammar of what is wrong with a log: a slot, a change of it, and sometimes numbers.

A slot is a column of a stream, or two columns that belong together; a stream's time; the place of a
sensor on the vehicle; a frame. A change is a sign, two columns exchanged, a factor, an offset, a
lag, other axes, a root. Here each is given by what corrects it, with words and advice made from
slot and change. A number that has a name, as that of a unit, is said by its name.
`checks.diagnosis.log_fit` tries them on a log, `checks.position_fit` those of positions on a path.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.faults.columns import (
    LogColumn,
    columns_of,
    moves_of,
    odometry_columns,
    pair_words,
    positions_of,
    with_moves,
)
from comparisons.faults.grammar import number_text
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import Ackermann, RelativePoses, SteeringOdometry
from comparisons.logs.schema import OPTIONS, UNITS
from comparisons.plane import turned
from graphslam.increments import dead_reckoned
from graphslam.sensor_frame import in_words

_OTHER_UNITS = {
    "m": {"feet": 0.3048},
    "mps": {"cm/s": 1e-2, "mm/s": 1e-3, "knots": 0.514444, "miles per hour": 0.44704},
}  # fmt: skip
"""By dimension, units that no option names, in SI."""
_SPELT = {"deg": "degrees", "degps": "degrees", "rad": "radians", "radps": "radians", "mps": "m/s"}
_ASIDE = (
    (-np.pi / 2, "left", "subtract 90 degrees from them"),
    (np.pi / 2, "right", "add 90 degrees to them"),
    (np.pi, "behind", "add 180 degrees to them"),
    (-np.pi, "behind", "add 180 degrees to them"),
)
_DELAYS_S = (-2.0, -1.0, -0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5, 1.0, 2.0)
_RATES = (0.9, 0.95, 0.98, 0.99, 1.0, 1.01, 1.02, 1.05, 1.1)
_LAGS = (1, 2, 3, 4, 5, 6, 8, 12, 16, 24)
_ROOT = "give its square root"


class NamedNumber(NamedTuple):
    """A number that has a name.

    Attributes:
        number: Of a correction.
        what: What is wrong with the log, in words.
        mend: What corrects it.
        is_unit: It is about a unit.
        keeps_size: Of all residuals, as a sign does.
    """

    number: float
    what: str
    mend: str
    is_unit: bool = False
    keeps_size: bool = False


class LogCorrection(NamedTuple):
    """A fault of a log by what corrects it.

    Attributes:
        slot: What is wrong.
        change: The name of the change.
        what: Makes words of the numbers.
        correct: Makes of the log, and of the numbers, what it should be.
        mend: What the user may do.
        neutral: The numbers of a right log.
        steps: About what noise hides of each.
        names: Numbers that have a name; of a single number.
        grid: Numbers in order between which chi-square is no smooth function, as of a delay, that
            moves measurements from sample to sample.
        keeps_size: It keeps the size of all residuals.
        sensors: Components whose noise it changes; its number is a factor of it.
        contains: Slot and change of simpler corrections that it can be.
        shown: Makes of its number the one that the words have.
    """

    slot: str
    change: str
    what: Callable[..., str]
    correct: Callable[..., Log]
    mend: str = "correct the calibration or the clock"
    neutral: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()
    names: tuple[NamedNumber, ...] = ()
    grid: tuple[float, ...] = ()
    keeps_size: bool = False
    sensors: tuple[str, ...] = ()
    contains: tuple[tuple[str, str], ...] = ()
    shown: Callable[[float], float] = float


def corrections(log: Log) -> Iterator[LogCorrection]:
    """Yield every change of every slot of values that a log has, each by what corrects it."""
    columns = columns_of(log)
    for column in columns:
        yield from _of_column(column)
    for first, second in combinations(columns, 2):
        if first.stream == second.stream and "way" not in (first.name, second.name):
            yield from _exchanged(first, second)
    yield from _of_pairs(columns)
    yield from _of_clocks(log)
    yield from _of_places(log)
    yield from _of_motions(log)
    if log.positions is not None:
        yield from of_positions(log.positions)


# Changes of a column


def _of_column(column: LogColumn) -> Iterator[LogCorrection]:
    """Sign and units are numbers of one change: times."""
    slot = f"{column.stream}: {column.name}"
    yield LogCorrection(
        slot, "times", lambda k: f"{column.words} {number_text(float(f'{k:.4g}'), 1.0)} times the "
        "log's",
        lambda log, k: column.changed(log, lambda v: k * v), neutral=(1.0,), steps=(1e-3,),
        names=tuple(_factors(column)),
    )  # fmt: skip
    if column.name != "way":
        unit = column.spelt_unit
        of = column.words if " of " in column.words else f"the {column.words}"
        yield LogCorrection(
            slot, "plus", lambda b: f"an offset of {b:+.4g} {unit} on {of}",
            lambda log, b: column.changed(log, lambda v: v + b), neutral=(0.0,),
            steps=(column.step,),
            names=tuple(_zeros(column)) if column.name == "bearing" else (),
        )  # fmt: skip
    if column.name == "range":
        for change, words, power in (("square", "squares", 0.5), ("root", "square roots", 2.0)):
            yield LogCorrection(
                slot, change, lambda words=words: f"ranges are {words} of the ranges",
                lambda log, power=power: column.changed(log, lambda v: v**power),
                "give the ranges themselves",
            )  # fmt: skip


def _factors(column: LogColumn) -> Iterator[NamedNumber]:
    """Signs and units, with the option of `new-log` where it has one."""
    units = UNITS[column.unit]
    first = next(iter(units))
    degrees = first.replace("rad", "deg")
    if column.name == "bearing":
        yield NamedNumber(-1.0, "bearings grow clockwise", "give --unit bearing=-rad (or -deg)",
                          keeps_size=True)  # fmt: skip
    elif column.is_angle:
        mend = f"give --unit {column.name}=-{first} (or -{degrees})"
        yield NamedNumber(-1.0, f"{column.name} grows clockwise", mend, keeps_size=True)
    elif column.name != "range":
        what = f"{column.words} {'has' if ' of ' in column.words else 'have'} the opposite sign"
        yield NamedNumber(-1.0, what, "negate these columns", keeps_size=True)
    option = (
        f"--unit {column.name}=" if column.name not in ("way", "x", "y", "east", "north") else ""
    )
    sizes: dict[float, str] = {}
    for unit, size in (units | _OTHER_UNITS.get(column.unit, {})).items():
        if size != 1.0 and (size not in sizes or unit == "km/h"):
            sizes[size] = unit
    for size, unit in sizes.items():
        spelt = unit.replace("/", "") if unit == "km/h" else unit
        named = option and unit in units
        for sign, also in ((1.0, ""), (-1.0, " and grow clockwise")):
            if sign < 0.0 and not column.is_angle:
                continue
            mend = (
                f"give {option}{'-' if sign < 0.0 else ''}{spelt}"
                if named
                else (f"divide by {1.0 / size:.4g}")
            )
            what = f"{column.subject} {_SPELT.get(unit, unit)}{also}"
            yield NamedNumber(sign * size, what, mend, is_unit=True)
        back = f"give {option}{first}" if named else f"multiply by {1.0 / size:.4g}"
        what = f"{column.subject} {_SPELT.get(first, first)}"
        taken = "" if column.is_angle else f", and were taken for {unit}"
        yield NamedNumber(1.0 / size, f"{what}{taken}", back, is_unit=True)


def _zeros(column: LogColumn) -> Iterator[NamedNumber]:
    """Where straight ahead is."""
    for number, side, mend in _ASIDE:
        what = (
            f"{column.subject} from {'' if side == 'behind' else 'the '}{side}, not from straight "
        )
        yield NamedNumber(number, f"{what}ahead", mend, keeps_size=True)


def _exchanged(first: LogColumn, second: LogColumn) -> Iterator[LogCorrection]:
    """Two columns of a stream in each other's place, and of some the opposite sign."""
    pair = pair_words(first, second)
    same_unit = first.unit == second.unit
    for signs in product((1.0, -1.0), repeat=2) if same_unit else [(1.0, 1.0)]:
        negative = [
            column.short for column, sign in zip((first, second), signs, strict=True) if sign < 0
        ]
        also = f", and of {' and '.join(negative)} the sign" if negative else ""

        def correct(log: Log, signs: tuple[float, ...] = signs) -> Log:
            left, right = first.read(log), second.read(log)
            if first.name == "range" and right.min(initial=1.0) <= 0.0:
                raise InputError("bearings are negative")
            return second.write(first.write(log, signs[0] * right), signs[1] * left)

        yield LogCorrection(
            f"{first.stream}: {first.name}, {second.name}", "exchanged",
            lambda said=f"{pair}{also}": said, correct,
            "exchange the names of these two columns", keeps_size=True,
        )  # fmt: skip


def _of_pairs(columns: list[LogColumn]) -> Iterator[LogCorrection]:
    """One unit of columns in two streams, or of both controls: angles are degrees, times ms."""
    angles = [column for column in columns if column.is_angle]
    degree = np.pi / 180.0
    if len(angles) == 2:
        first, second = angles
        units = [next(iter(UNITS[angle.unit])).replace("rad", "deg") for angle in angles]
        options = [f"--unit {column.name}={u}" for column, u in zip(angles, units, strict=True)]
        for factor, what, mend in (
            (degree, "degrees", " ".join(options)),
            (1.0 / degree, "radians", " ".join(options).replace("deg", "rad")),
        ):
            yield LogCorrection(
                "all angles", "times",
                lambda what=what: f"{first.short} and {second.short} are {what}",
                lambda log, k=factor: _times(_times(log, first, k), second, k), f"give {mend}",
            )  # fmt: skip
    rates = [column for column in columns if column.unit in ("mps", "radps")]
    if rates:
        yield LogCorrection(
            "time of odometry", "milliseconds", lambda: "times are milliseconds",
            lambda log: _all_times(log, rates, 1e-3),
            "name the columns time_ms, or give --unit time=ms",
        )  # fmt: skip


def _times(log: Log, column: LogColumn, factor: float) -> Log:
    return column.changed(log, lambda values: factor * values)


def _all_times(log: Log, columns: list[LogColumn], factor: float) -> Log:
    for column in columns:
        log = _times(log, column, factor)
    return log


# Clocks


def _of_clocks(log: Log) -> Iterator[LogCorrection]:
    """Delays of a stream, its rate, and lags of a column behind the other."""
    poses = isinstance(log.odometry, RelativePoses)
    step_s = float(np.median(np.diff(log.odometry.time_s))) if len(log.odometry.time_s) > 1 else 1.0
    grid = tuple(step_s * k for k in range(-5, 6)) if poses else _DELAYS_S
    streams = ["measurements"] if len(log.measurements.time_s) else []
    streams += ["positions"] if log.positions is not None else []
    groups = [(stream,) for stream in streams] + ([tuple(streams)] if len(streams) > 1 else [])
    for group in groups:
        name = group[0] if len(group) == 1 else "odometry"
        sign = 1.0 if len(group) == 1 else -1.0
        yield LogCorrection(
            f"time of {name}", "plus",
            partial(_delay_words, name),
            lambda log, d, group=group, sign=sign: _delayed(log, group, sign * d),
            neutral=(0.0,), steps=(0.05,), grid=grid,
            shown=abs if name == "positions" else float,
        )  # fmt: skip
        if not poses:
            yield LogCorrection(
                f"time of {name}", "times",
                lambda k, name=name: f"times of the {name} {k:.4g} times the log's",
                lambda log, k, group=group, sign=sign: _clocked(log, group, k**sign),
                neutral=(1.0,), steps=(2e-3,), grid=_RATES,
            )  # fmt: skip
    for column in odometry_columns(log) if len(log.odometry.time_s) else ():
        if column.name in ("x", "y") or (poses and column.name == "heading"):
            continue
        lags = sorted({*_LAGS, *(-lag for lag in _LAGS), 0})
        yield LogCorrection(
            f"odometry: {column.name}", "lag",
            partial(_lag_words, column.words, step_s),
            lambda log, k, column=column: column.changed(log, lambda v: _lagged(v, round(k))),
            neutral=(0.0,), steps=(1.0,), grid=tuple(map(float, lags)),
            shown=partial(_lag_s, step_s),
        )  # fmt: skip


def _delay_words(stream: str, delay_s: float) -> str:
    if stream == "positions":
        late = "early" if delay_s > 0.0 else "late"
        return f"time stamps of the positions {abs(delay_s):.3g} s too {late}"
    return f"{stream} {delay_s:+.3g} s later than the log says"


def _lag_words(column: str, step_s: float, samples: float) -> str:
    return f"{column} {_lag_s(step_s, samples):+.3g} s later than the rest of the odometry"


def _lag_s(step_s: float, samples: float) -> float:
    return -samples * step_s


def _delayed(log: Log, streams: tuple[str, ...], delay_s: float) -> Log:
    """Streams later, within the odometry's time; at poses' times where it has those alone."""
    first_s, last_s = log.prior.time_s, float(log.odometry.time_s[-1])
    changed: dict[str, Any] = {}
    for name in streams:
        stream = getattr(log, name)
        time_s = np.clip(stream.time_s + delay_s, first_s, last_s)
        if isinstance(log.odometry, RelativePoses):
            poses_s = np.concatenate(([first_s], log.odometry.time_s))
            time_s = poses_s[np.abs(time_s[:, None] - poses_s).argmin(axis=1)]
        changed[name] = _in_time(stream, time_s)
    return replace(log, **changed)


def _clocked(log: Log, streams: tuple[str, ...], rate: float) -> Log:
    """Streams whose clock runs faster from the log's start on."""
    start_s, last_s = log.prior.time_s, float(log.odometry.time_s[-1])
    changed: dict[str, Any] = {}
    for name in streams:
        stream = getattr(log, name)
        time_s = np.minimum(start_s + rate * (stream.time_s - start_s), last_s)
        changed[name] = _in_time(stream, time_s)
    return replace(log, **changed)


def _in_time(stream: Any, time_s: Array) -> Any:
    """A stream at other times; of positions those that are one after the other."""
    if isinstance(stream, Positions):
        rows = np.flatnonzero(np.diff(time_s, prepend=-np.inf) > 0.0)
        return replace(stream.chosen(rows), time_s=time_s[rows])
    return replace(stream, time_s=time_s)


def _lagged(values: Array, samples: int) -> Array:
    """Values of so many samples later."""
    where = np.clip(np.arange(len(values)) + samples, 0, len(values) - 1)
    return np.asarray(values[where])


# Places of sensors, and measures of the vehicle


def _of_places(log: Log) -> Iterator[LogCorrection]:
    zero, steps = (0.0, 0.0), (1e-3, 1e-3)
    if len(log.measurements.time_s):
        yield LogCorrection(
            "place of the sensor", "plus",
            lambda a, b: f"the sensor of the measurements {in_words(a, b)} of the pose",
            _from_the_pose, "correct the measurements, or the pose that the log is of", zero, steps,
        )  # fmt: skip
    if isinstance(log.odometry, RelativePoses):
        yield LogCorrection(
            "place of the odometry", "plus",
            lambda a, b: f"displacements of a frame {in_words(a, b)} of the pose",
            lambda log, a, b: with_moves(log, _moved_from(moves_of(log), complex(a, b))),
            "give the motion of the pose", zero, steps,
        )  # fmt: skip
    if isinstance(log.odometry, SteeringOdometry):
        yield from _of_vehicle()


def _of_vehicle() -> Iterator[LogCorrection]:
    def with_measure(log: Log, change: Callable[[Ackermann], Ackermann]) -> Log:
        odometry = log.odometry
        if not isinstance(odometry, SteeringOdometry):
            return log
        return replace(log, odometry=replace(odometry, vehicle=change(odometry.vehicle)))

    yield LogCorrection(
        "wheelbase", "times", lambda k: f"a wheelbase {k:.4g} times the log's",
        lambda log, k: with_measure(log, lambda c: replace(c, wheelbase_m=k * c.wheelbase_m)),
        "correct the vehicle's measures", (1.0,), (1e-3,),
    )  # fmt: skip
    yield LogCorrection(
        "place of the odometry", "plus",
        lambda a, b: f"a pose {in_words(a, b)} of where the log has it on the vehicle",
        lambda log, a, b: with_measure(
            log,
            lambda c: replace(
                c, sensor_forward_m=c.sensor_forward_m + a, sensor_left_m=c.sensor_left_m + b
            ),
        ),
        "correct the vehicle's measures", (0.0, 0.0), (1e-3, 1e-3),
    )  # fmt: skip
    yield LogCorrection(
        "encoder", "plus", lambda b: f"{b:+.3g} m on the encoder's offset from the axle's middle",
        lambda log, b: with_measure(
            log, lambda c: replace(c, encoder_offset_m=c.encoder_offset_m + b)
        ),
        "correct the vehicle's measures", (0.0,), (1e-3,),
    )  # fmt: skip


def _from_the_pose(log: Log, ahead_m: float, left_m: float) -> Log:
    """Measurements of a sensor that is not at the pose, as from the pose."""
    measurements = log.measurements
    place = measurements.range_m * np.exp(1j * measurements.bearing_rad) + complex(ahead_m, left_m)
    changed = replace(
        measurements, range_m=np.maximum(abs(place), 1e-3), bearing_rad=np.angle(place)
    )
    return replace(log, measurements=changed)


def _moved_from(displacement: Array, place: complex) -> Array:
    """Motions of the pose, of those of a frame at a place on it."""
    turn = np.exp(1j * displacement[:, 2])
    step = displacement[:, :2] @ (1.0, 1j) + place * (1.0 - turn)
    return np.column_stack((step.real, step.imag, displacement[:, 2]))


# Frames of motions between poses


def _of_motions(log: Log) -> Iterator[LogCorrection]:
    if not isinstance(log.odometry, RelativePoses):
        return
    slot = "frame of the displacements"
    for share, words in (
        (1.0, "in the frame of the arriving pose"),
        (0.5, "in the frame midway between both poses"),
        (-1.0, "turned back by the turn once too often"),
    ):
        yield LogCorrection(
            slot, words, lambda words=words: f"x and y of the displacements are {words}",
            lambda log, k=share: with_moves(
                log, _by_angles(moves_of(log), k * moves_of(log)[:, 2])
            ),
            "give them in the frame of the departing pose",
        )  # fmt: skip
    yield LogCorrection(
        slot, "in the axes of the map",
        lambda: "x and y of the displacements are in the map's axes",
        _out_of_the_map, "give them in the frame of the departing pose",
    )  # fmt: skip
    yield LogCorrection(
        slot, "turned", lambda a: f"x and y of the displacements turned by {a:+.4g} rad",
        lambda log, a: with_moves(log, _by_angles(moves_of(log), np.full(len(moves_of(log)), a))),
        "correct the heading of the sensor that measured them", (0.0,), (1e-3,),
        names=tuple(
            NamedNumber(a, f"x and y of the displacements are turned by {-np.degrees(a):.0f} "
                        "degrees", "turn them back", keeps_size=True)
            for a in (np.pi / 2, -np.pi / 2, np.pi)
        ),
    )  # fmt: skip
    yield from _axes()


def _by_angles(displacement: Array, angle_rad: Array) -> Array:
    step = displacement[:, :2] @ (1.0, 1j) * np.exp(1j * angle_rad)
    return np.column_stack((step.real, step.imag, displacement[:, 2]))


def _out_of_the_map(log: Log) -> Log:
    """Displacements in the map's axes, in the frame of their departing poses."""
    moves = moves_of(log)
    heading = float(log.prior.pose[2]) + np.append(0.0, np.cumsum(moves[:-1, 2]))
    return with_moves(log, _by_angles(moves, -heading))


_SAID_AXES = {
    ("y", "x", 1.0): "x and y of the poses are exchanged",
    ("x", "y", -1.0): "the poses' headings grow clockwise",
    ("x", "-y", 1.0): "y of the poses grows to the right",
    ("x", "-y", -1.0): "the poses are in a frame whose y and heading go clockwise",
    ("y", "x", -1.0): "the poses are north, east and clockwise headings from north",
}


def _axes() -> Iterator[LogCorrection]:
    """All axes of poses, from whose differences the displacements were made."""
    pairs = [(x, y) for x in ("x", "-x", "y", "-y") for y in ("x", "-x", "y", "-y")]
    for (x, y), turned_by in product(pairs, (1.0, -1.0)):
        mirrored = _determinant(x, y) < 0.0
        if x[-1] == y[-1] or (not mirrored and turned_by > 0.0):
            continue
        heading = ", -heading" if turned_by < 0.0 else ""
        what = _SAID_AXES.get(
            (x, y, turned_by), f"the poses have other axes: x is {x}, y is {y}{heading}"
        )
        yield LogCorrection(
            "poses", f"axes {x}, {y}{heading}", lambda what=what: what,
            partial(other_frame, x=x, y=y, turned=turned_by),
            f"give the odometry as x = {x}, y = {y}{heading}", keeps_size=True,
        )  # fmt: skip


def _determinant(x: str, y: str) -> float:
    axes = {"x": (1.0, 0.0), "-x": (-1.0, 0.0), "y": (0.0, 1.0), "-y": (0.0, -1.0)}
    return float(np.linalg.det(np.array((axes[x], axes[y]))))


def other_frame(log: Log, x: str, y: str, turned: float) -> Log:
    """Return a log of motions whose poses, from the origin on, have other axes; its noise stays.

    Args:
        log: With relative poses; else it is returned as it is.
        x: Which of `x`, `y`, `-x` and `-y` of the poses x is.
        y: The same of y.
        turned: 1, or -1 for headings that grow the other way.
    """
    moved = log.odometry
    if not isinstance(moved, RelativePoses):
        return log
    pose = dead_reckoned(np.zeros(3), moved.displacement)
    axes = {"x": pose[:, 0], "-x": -pose[:, 0], "y": pose[:, 1], "-y": -pose[:, 1]}
    heading = turned * pose[:, 2]
    step = (np.diff(axes[x]) + 1j * np.diff(axes[y])) * np.exp(-1j * heading[:-1])
    return with_moves(log, np.column_stack((step.real, step.imag, np.diff(heading))))


# Positions


def of_positions(given: Positions) -> Iterator[LogCorrection]:
    """Yield the frames of positions and the places of their antenna.

    given: the log's; where it says that the antenna is, is part of the words.
    """
    zero = (0.0, 0.0)
    yield LogCorrection(
        "frame of the positions", "plus",
        lambda e, n: f"an offset of {e:.2f} m east, {n:.2f} m north on the positions",
        lambda log, e, n: _placed(log, lambda p: p - (e, n)), "correct their frame", zero,
        (0.01, 0.01),
    )  # fmt: skip
    yield LogCorrection(
        "frame of the positions", "turned",
        lambda a, e, n: f"a frame turned by {np.degrees(a):.2f} degrees about the origin, then "
        f"moved by {e:.2f} m east, {n:.2f} m north",
        lambda log, a, e, n: _placed(
            log, lambda p: turned(p - (e, n), np.full(len(p), -a))
        ),
        "correct their frame", (0.0, 0.0, 0.0), (1e-3, 0.01, 0.01),
        contains=(("frame of the positions", "plus"),),
    )  # fmt: skip
    ahead, left = given.antenna_m
    yield LogCorrection(
        "antenna of the positions", "plus",
        lambda a, b: f"an antenna at {in_words(a + ahead, b + left)} of the pose",
        lambda log, a, b: replace(
            log, positions=replace(positions_of(log), antenna_m=(a + ahead, b + left))
        ),
        "correct antenna_m", zero, (0.01, 0.01),
    )  # fmt: skip


def _placed(log: Log, change: Callable[[Array], Array]) -> Log:
    given = positions_of(log)
    return replace(log, positions=replace(given, position_m=change(given.position_m)))


# Sigmas


class LogSigma(NamedTuple):
    """A stated standard deviation.

    Attributes:
        name: What it is of, as `noise of the range`.
        plural: As `sigma of ranges`.
        component: Whose noise it is, of graphslam.graph_builder.COMPONENTS.
        option: Of `new-log`.
        values: (N,) of the stream.
        scaled: Makes a log with so many times it, by a number or by numbers (N,).
        is_angle: Of an angle.
    """

    name: str
    plural: str
    component: str
    option: str
    values: Array
    scaled: Callable[[Log, Array], Log]
    is_angle: bool = False

    @property
    def value(self) -> float:
        """The middle one."""
        return float(np.median(self.values))

    @property
    def is_constant(self) -> bool:
        """Whether one number is all of it, so that its root is a factor."""
        return float(np.ptp(self.values)) <= 1e-9 * self.value

    @property
    def may_be_variance(self) -> bool:
        """Whether it is below 1: a larger variance has a smaller root."""
        return bool((self.values > 0.0).all() and (self.values < 1.0).all())


def sigmas_of(log: Log) -> Iterator[LogSigma]:
    """Yield the stated sigmas of a log."""
    measurements, moved = log.measurements, log.odometry
    if len(measurements.time_s):
        for name, field in (("range", "sigma_range_m"), ("bearing", "sigma_bearing_rad")):
            yield LogSigma(
                name, f"{name}s", name, OPTIONS[field], getattr(measurements, field),
                partial(_scaled_measurements, field=field), name == "bearing",
            )  # fmt: skip
    if log.positions is not None and len(log.positions.time_s):
        yield LogSigma(
            "positions", "positions", "position", OPTIONS["sigma_m"],
            np.sqrt(log.positions.covariance[:, 0, 0]), _scaled_positions,
        )  # fmt: skip
    if not len(moved.time_s):
        return
    if isinstance(moved, RelativePoses):
        is_known = bool(np.isfinite(moved.covariance).all())
        parts = (("moves", "sigma_move_m", (0, 1)), ("turns", "sigma_turn", (2,)))
        for name, field, rows in parts if is_known else ():
            yield LogSigma(
                name, name, "odometry", OPTIONS[field],
                np.sqrt(moved.covariance[:, rows[0], rows[0]]),
                partial(_scaled_motions, rows=rows), name == "turns",
            )  # fmt: skip
        return
    for name, field in (("speed", "sigma_speed_mps"), ("turn", "sigma_turn")):
        yield LogSigma(
            name, f"{name}s", "odometry", OPTIONS[field],
            np.array((getattr(moved.noise, field),)),
            partial(_scaled_controls, field=field), name == "turn",
        )  # fmt: skip


def _scaled_measurements(log: Log, factor: Array, field: str) -> Log:
    changed: dict[str, Any] = {field: factor * getattr(log.measurements, field)}
    return replace(log, measurements=replace(log.measurements, **changed))


def _scaled_positions(log: Log, factor: Array) -> Log:
    given = positions_of(log)
    square = np.square(factor)[..., None, None]
    return replace(log, positions=replace(given, covariance=square * given.covariance))


def _scaled_motions(log: Log, factor: Array, rows: tuple[int, ...]) -> Log:
    moved = log.odometry
    if not isinstance(moved, RelativePoses):
        return log
    factors = np.where(np.isin(np.arange(3), rows), np.asarray(factor)[..., None], 1.0)
    covariance = factors[..., :, None] * moved.covariance * factors[..., None, :]
    return replace(log, odometry=replace(moved, covariance=covariance))


def _scaled_controls(log: Log, factor: Array, field: str) -> Log:
    moved = log.odometry
    if isinstance(moved, RelativePoses):
        return log
    changed: dict[str, Any] = {field: float(np.max(factor)) * getattr(moved.noise, field)}
    return replace(log, odometry=replace(moved, noise=replace(moved.noise, **changed)))


def sigma_corrections(log: Log) -> Iterator[LogCorrection]:
    """Yield what corrects stated sigmas.

    A factor of each, with those that have a name, as of a variance or of another unit; one factor
    of those of a stream; and variances of several.
    """
    sigmas = list(sigmas_of(log))
    for sigma in sigmas:
        yield _times_sigmas(sigma.name, (sigma,), tuple(_named_factors(sigma)))
    for stream, components in (("measurements", ("range", "bearing")), ("odometry", ("odometry",))):
        together = tuple(log_sigma for log_sigma in sigmas if log_sigma.component in components)
        if len(together) > 1:
            yield _times_sigmas(stream, together, ())
    rooted = [log_sigma for log_sigma in sigmas if log_sigma.may_be_variance]
    for count in range(1, len(rooted) + 1):
        for some in combinations(rooted, count):
            if count > 1 or not some[0].is_constant:
                yield _rooted(some)


def _times_sigmas(
    name: str, sigmas: tuple[LogSigma, ...], names: tuple[NamedNumber, ...]
) -> LogCorrection:
    def correct(log: Log, factor: float) -> Log:
        for sigma in sigmas:
            log = sigma.scaled(log, np.array(factor))
        return log

    return LogCorrection(
        f"noise of the {name}", "times",
        lambda k: f"a noise of the {name} {k:.3g} times the stated", correct,
        f"correct {' and '.join(sigma.option for sigma in sigmas)}", (1.0,), names=names,
        sensors=_components(sigmas),
    )  # fmt: skip


def _named_factors(sigma: LogSigma) -> Iterator[NamedNumber]:
    """What a sigma that is too small has to be multiplied by, where it is no sigma or of a unit."""
    if sigma.may_be_variance and sigma.is_constant:
        root = float(np.sqrt(sigma.value))
        yield NamedNumber(
            1.0 / root, f"the sigma of {sigma.plural}, {sigma.value:.4g}, is a variance",
            f"give {sigma.option} {root:.4g}",
        )  # fmt: skip
    if sigma.is_angle:
        degrees = float(np.degrees(1.0))
        yield NamedNumber(
            degrees, f"the sigma of {sigma.plural} is in radians and was taken for degrees",
            f"give {sigma.option} {degrees * sigma.value:.4g}rad", is_unit=True,
        )  # fmt: skip


def _rooted(sigmas: tuple[LogSigma, ...]) -> LogCorrection:
    plurals = [sigma.plural for sigma in sigmas]
    what = f"the sigmas of {', '.join(plurals[:-1])} and {plurals[-1]} are variances"
    if len(sigmas) == 1:
        what = f"the sigmas of {plurals[0]}, {sigmas[0].value:.4g} in the middle, are variances"
    options = " ".join(f"{sigma.option} {np.sqrt(sigma.value):.4g}" for sigma in sigmas)
    constant = all(sigma.is_constant for sigma in sigmas)
    mend = f"give {options}" if constant else "give their square roots"

    names = [sigma.name for sigma in sigmas]

    def correct(log: Log) -> Log:
        for sigma in sigmas_of(log):
            if sigma.name in names:
                log = sigma.scaled(log, sigma.values**-0.5)
        return log

    return LogCorrection(
        " and ".join(f"noise of the {name}" for name in names), "square", lambda: what, correct,
        mend, sensors=_components(sigmas),
        contains=tuple((f"noise of the {name}", "times") for name in names if len(names) > 1),
    )  # fmt: skip


def _components(sigmas: tuple[LogSigma, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(sigma.component for sigma in sigmas))
