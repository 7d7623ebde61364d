"""Faults of a log's streams: what a filter reads of them, as a channel and a change of it.

A channel is a column of measured values, or a part of what the log says of their noise. A change
is a sign, an exchange, a lag, a factor, an offset, a root; words are made of both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index
from comparisons.faults.data import waiting_for_control
from comparisons.faults.fault import Family, Fault, remembering
from comparisons.logs.log import LandmarkMeasurements, Log, Positions
from comparisons.logs.odometry import OdometryNoise, RelativePoses, SteeringOdometry
from comparisons.logs.transforms.calibration import Line, controlled, delayed, driven, sensed
from comparisons.logs.validation import LEAST_SIGMA

_RATES = ("variance_rate_position", "variance_rate_heading")
_CONTROLS = ("sigma_speed_mps", "sigma_turn")
STABILISATION = "the stabilisation noise"
_RESOLVED_S = 1e-6
"""Stamps that are closer are of one instant."""
_LAGS = (1, -1, 2, -2)
_EVERY = (2, 3)
"""Of so many one is left out, or used."""

_MEASURES = {
    "the encoder's way to the side": "encoder_offset_m",
    "the sensor's way forward": "sensor_forward_m",
    "the sensor's way to the left": "sensor_left_m",
}
_PLACES = {
    "the sensor's place": ("sensor_forward_m", "sensor_left_m"),
    "the encoder's place": ("encoder_offset_m",),
}
"""Of a steering vehicle."""

ByLine = Callable[[Log, Line], Log]


class Channel(NamedTuple):
    """Measured values. by_line: the log with other ones by a factor and an offset."""

    name: str
    unit: str
    by_line: ByLine
    is_plural: bool = False

    @property
    def verb(self) -> str:
        """After the name."""
        return "are" if self.is_plural else "is"


class Noise(NamedTuple):
    """What a log says of noise. fields: of its record; those of sigmas are fitted as variances."""

    name: str
    fields: tuple[str, ...]


_R = (
    Noise("R", ("sigma_range_m", "sigma_bearing_rad")),
    Noise("R of the range", ("sigma_range_m",)),
    Noise("R of the bearing", ("sigma_bearing_rad",)),
)
_Q = (
    Noise("Q", (*_CONTROLS, *_RATES)),
    Noise("the controls' part of Q", _CONTROLS),
    Noise("the speed's part of Q", _CONTROLS[:1]),
    Noise("the turn's part of Q", _CONTROLS[1:]),
    Noise(STABILISATION, _RATES),
)


def stream_faults(log: Log) -> Iterator[Fault]:
    """Yield the faults of a log's streams without a number."""
    for channel in channels(log):
        have = "have" if channel.is_plural else "has"
        yield Fault(f"{channel.name} {have} the opposite sign", feed=_lined(channel, (-1.0, 0.0)))
        yield Fault(f"{channel.name} {channel.verb} zero", feed=_lined(channel, (0.0, 0.0)))
    for noise in noises(log):
        for what, change in _NOISE_CHANGES.items():
            yield Fault(f"{noise.name} {what}", feed=partial(_with_noise, noise, change))
    for first, second in _exchanged(log):
        feed = partial(_noise_exchanged, first.fields[0], second.fields[0])
        names = " and ".join(one.name for one in (first, second))
        yield Fault(f"the sigmas of {names} are exchanged", feed=feed)
    if log.positions is not None:
        yield Fault("east and north of the positions are exchanged",
                    feed=partial(_with_positions, lambda p: p[:, ::-1]))  # fmt: skip
        yield Fault("the antenna's place is left out", feed=partial(_antenna_at, 0.0, (0.0, 0.0)))
    for place, measures in _PLACES.items() if isinstance(log.odometry, SteeringOdometry) else ():
        yield Fault(f"{place} is left out", feed=partial(_of_vehicle, measures, 0.0, 0.0))
    yield from _shifted_odometry(log)
    yield from _shifted_measurements(log)
    yield from _left_out()


def stream_families(log: Log) -> Iterator[Family]:
    """Yield the faults of a log's streams that have a number."""
    for noise in noises(log):
        yield Family(f"{noise.name} is {{}} times the log's", partial(_with_factor, noise))
    yield Family("the prior's covariance is {} times the log's", _wider_prior)
    for channel in channels(log):
        yield Family(f"{channel.name} {channel.verb} {{}} times the log's",
                     partial(_times, channel))  # fmt: skip
        have = "have" if channel.is_plural else "has"
        yield Family(f"{channel.name} {have} a bias of {{}} {channel.unit}",
                     partial(_plus, channel), 0.0, factor=False)  # fmt: skip
    yield Family("the measurements are used {} s late", delayed, 0.0, factor=False)
    if log.positions is not None:
        yield Family("R of positions is {} times the log's", _wider_positions)
        for axis, side in enumerate(("forward", "to the left")):
            yield Family(f"the antenna is {{}} m farther {side}", partial(_antenna_moved, axis),
                         0.0, factor=False)  # fmt: skip
    if isinstance(log.odometry, SteeringOdometry):
        yield Family("the wheelbase is {} times the log's",
                     lambda log, k: _of_vehicle(("wheelbase_m",), k, 0.0, log))  # fmt: skip
        for name, at in _MEASURES.items():
            yield Family(f"{name} is {{}} m more", partial(_vehicle_plus, at), 0.0,
                         factor=False)  # fmt: skip


def channels(log: Log) -> Iterator[Channel]:
    """Yield the measured values of a log."""
    turn = "rad" if isinstance(log.odometry, RelativePoses) else "(rad or rad/s)"
    way = "m" if isinstance(log.odometry, RelativePoses) else "m/s"
    yield Channel("the speed", way, lambda log, line: driven(log, speed=line))
    yield Channel("the turn", turn, lambda log, line: driven(log, turn=line))
    yield Channel("the ranges", "m", lambda log, line: sensed(log, range_=line), True)
    yield Channel("the bearings", "rad", lambda log, line: sensed(log, bearing=line), True)
    if log.positions is not None:
        for axis, name in enumerate(("east", "north")):
            yield Channel(f"the positions' {name}", "m", partial(_positions_by_line, axis))


def noises(log: Log) -> Iterator[Noise]:
    """Yield the parts of what a log says of its noise."""
    yield from _R
    if not isinstance(log.odometry, RelativePoses):
        yield from _Q


def _exchanged(log: Log) -> Iterator[tuple[Noise, Noise]]:
    yield _R[1], _R[2]
    if not isinstance(log.odometry, RelativePoses):
        yield _Q[2], _Q[3]


def _lined(channel: Channel, line: Line) -> Callable[[Log], Log]:
    return lambda log: channel.by_line(log, line)


def _times(channel: Channel, log: Log, factor: float) -> Log:
    return channel.by_line(log, (factor, 0.0))


def _plus(channel: Channel, log: Log, bias: float) -> Log:
    return channel.by_line(log, (1.0, bias))


_NOISE_CHANGES: dict[str, Callable[[Any], Any]] = {
    "contains sigma, not its square": np.sqrt,
    "holds sigma^4, not sigma^2": np.square,
    "is left out": np.zeros_like,
}
"""Of variances."""


def _with_noise(noise: Noise, change: Callable[[Any], Any], log: Log) -> Log:
    """The log with other variances in some fields."""

    def changed_in(record: Any) -> Any:
        made = {}
        for name in noise.fields:
            value = getattr(record, name)
            changed = change(value) if name in _RATES else np.sqrt(change(value**2))
            made[name] = np.maximum(changed, LEAST_SIGMA) if noise in _R else changed
        return replace(record, **made)

    if noise in _R:
        return replace(log, measurements=changed_in(log.measurements))
    odometry: Any = log.odometry
    return replace(log, odometry=replace(odometry, noise=changed_in(odometry.noise)))


def _with_factor(noise: Noise, log: Log, factor: float) -> Log:
    return _with_noise(noise, lambda variance: factor * variance, log)


def _noise_exchanged(first: str, second: str, log: Log) -> Log:
    def exchanged(record: Any) -> Any:
        return replace(record, **{first: getattr(record, second), second: getattr(record, first)})

    if first in _CONTROLS:
        odometry: Any = log.odometry
        noise: OdometryNoise = exchanged(odometry.noise)
        return replace(log, odometry=replace(odometry, noise=noise))
    return replace(log, measurements=exchanged(log.measurements))


def _wider_prior(log: Log, factor: float) -> Log:
    return with_prior(log, factor * log.prior.covariance)


def with_prior(log: Log, covariance: Array) -> Log:
    """Return the log with another covariance (3, 3) of its prior."""
    return replace(log, prior=replace(log.prior, covariance=covariance))


def _with_positions(change: Callable[[Array], Array], log: Log) -> Log:
    positions = log.positions
    if positions is None:
        return log
    return replace(log, positions=replace(positions, position_m=change(positions.position_m)))


def _positions_by_line(axis: int, log: Log, line: Line) -> Log:
    def changed(position_m: Array) -> Array:
        moved = position_m.copy()
        moved[:, axis] = line[0] * moved[:, axis] + line[1]
        return moved

    return _with_positions(changed, log)


def _antenna_at(share: float, more_m: tuple[float, float], log: Log) -> Log:
    """The antenna elsewhere: at a share of its place, and moved."""
    if log.positions is None:
        return log
    forward_m, left_m = log.positions.antenna_m
    antenna_m = share * forward_m + more_m[0], share * left_m + more_m[1]
    return replace(log, positions=replace(log.positions, antenna_m=antenna_m))


def _antenna_moved(axis: int, log: Log, more_m: float) -> Log:
    return _antenna_at(1.0, (more_m, 0.0) if axis == 0 else (0.0, more_m), log)


def _wider_positions(log: Log, factor: float) -> Log:
    if log.positions is None:
        return log
    covariance = factor * log.positions.covariance
    return replace(log, positions=replace(log.positions, covariance=covariance))


def _of_vehicle(names: tuple[str, ...], factor: float, more_m: float, log: Log) -> Log:
    """The log of a vehicle with other measures."""
    if not isinstance(log.odometry, SteeringOdometry):
        return log
    vehicle = log.odometry.vehicle
    changed = {name: factor * getattr(vehicle, name) + more_m for name in names}
    return replace(log, odometry=replace(log.odometry, vehicle=replace(vehicle, **changed)))


def _vehicle_plus(name: str, log: Log, more_m: float) -> Log:
    return _of_vehicle((name,), 1.0, more_m, log)


def _side(lag: int, what: str) -> str:
    many = f"{abs(lag)} {what}{'s' * (abs(lag) > 1)}"
    return f"{many} {'late' if lag > 0 else 'early'}"


def _shifted_odometry(log: Log) -> Iterator[Fault]:
    """Both controls, or one of them, are those of samples before or after."""
    for lag, (name, of_speed, of_turn) in product(_LAGS, _SHIFTED):
        if isinstance(log.odometry, RelativePoses) and not (of_speed and of_turn):
            continue
        what = f"{name} used {_side(lag, 'sample')}"
        shifted = partial(_with_lag, lag, of_speed, of_turn)
        yield Fault(what, feed=partial(shifted, held=False))
        if lag > 0:
            yield Fault(f"{what}, the first twice", feed=partial(shifted, held=True))
        if lag > 0 and of_speed and of_turn:
            waiting = remembering(waiting_for_control)
            yield Fault(f"{what}, none before the first", waiting, partial(shifted, held=False))


_SHIFTED = (
    ("the odometry is", True, True),
    ("the speed is", True, False),
    ("the turn is", False, True),
)


def _with_lag(lag: int, of_speed: bool, of_turn: bool, log: Log, *, held: bool) -> Log:
    """Each control is that of so many samples before. held: the first acts before it, too."""

    def late(values: Array) -> Array:
        moved = np.full(values.shape, values[0] if held else 0.0)
        if lag > 0:
            moved[lag:] = values[:-lag]
        else:
            moved[:lag], moved[lag:] = values[-lag:], values[-1]
        return moved

    def same(values: Array) -> Array:
        return values

    return controlled(log, late if of_speed else same, late if of_turn else same)


def _shifted_measurements(log: Log) -> Iterator[Fault]:
    for lag in _LAGS:
        yield Fault(
            f"the measurements are fused {_side(lag, 'odometry sample')}",
            feed=partial(_at_other_stops, lag),
        )
    for lag in (1, -1):
        yield Fault(
            f"the stamps of measurements are those of {'the next' if lag > 0 else 'the last'} scan",
            feed=partial(_at_other_scans, lag),
        )
    for lag in _LAGS[:2] if log.positions is not None else ():
        yield Fault(
            f"positions are fused {_side(lag, 'odometry sample')}",
            feed=partial(_positions_at_other_stops, lag),
        )


def _stops(log: Log) -> Array:
    return np.union1d(log.prior.time_s, log.odometry.time_s)


def _moved(time_s: Array, stops: Array, lag: int) -> Array:
    """Times at other stops: the last before or the first after where lag is one."""
    if lag < 0:
        row = np.searchsorted(stops, time_s - _RESOLVED_S) + lag
    else:
        row = np.searchsorted(stops, time_s + _RESOLVED_S, side="right") + lag - 1
    return np.asarray(stops[np.clip(row, 0, len(stops) - 1)])


def _at_other_stops(lag: int, log: Log) -> Log:
    """Measurements at another sample; the first stay at the start, the last at the end."""
    seen = log.measurements
    return replace(log, measurements=replace(seen, time_s=_moved(seen.time_s, _stops(log), lag)))


def _at_other_scans(lag: int, log: Log) -> Log:
    seen = log.measurements
    scans = np.unique(seen.time_s)
    return replace(log, measurements=replace(seen, time_s=_moved(seen.time_s, scans, lag)))


def _positions_at_other_stops(lag: int, log: Log) -> Log:
    positions = log.positions
    if positions is None:
        return log
    time_s, kept = np.unique(_moved(positions.time_s, _stops(log), lag), return_index=True)
    return replace(log, positions=_chosen(positions, kept, time_s))


def _chosen(positions: Positions, rows: Index, time_s: Array) -> Positions:
    return replace(
        positions,
        time_s=time_s,
        position_m=positions.position_m[rows],
        covariance=positions.covariance[rows],
    )


def _left_out() -> Iterator[Fault]:
    """One of some measurements, or of some scans, is not used, or is the only one that is."""
    for every in _EVERY:
        for phase in range(every):
            which = f"{_ORDINALS[every]}, from the {_ORDINALS[phase + 1]} on,"
            yield Fault(f"of the measurements every {which} is left out",
                        feed=partial(_without, every, phase, False))  # fmt: skip
            yield Fault(f"of the scans every {which} is left out",
                        feed=partial(_without, every, phase, True))  # fmt: skip


_ORDINALS = {1: "first", 2: "second", 3: "third"}


def _without(every: int, phase: int, of_scans: bool, log: Log) -> Log:
    seen: LandmarkMeasurements = log.measurements
    number: NDArray[np.intp] = np.arange(len(seen.time_s))
    if of_scans:
        number = np.unique(seen.time_s, return_inverse=True)[1]
    return replace(log, measurements=seen.chosen(number % every != phase))
