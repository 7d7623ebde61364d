"""Faults of a log's streams: what a filter reads of them, as a column and a change of it.

So are parts of what the log says of noise, and the measures of its vehicle; words are made of both.
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
from comparisons.faults.columns import read_columns
from comparisons.faults.data import waiting_for_control
from comparisons.faults.fault import Family, Fault, remembering
from comparisons.faults.misreadings import LAGS, Misreading, lag_words, late, misreadings
from comparisons.logs.log import LandmarkMeasurements, Log, Positions
from comparisons.logs.odometry import (
    Ackermann,
    OdometryNoise,
    RelativePoses,
    SteeringOdometry,
)
from comparisons.logs.schema import LEAST_SIGMA
from comparisons.logs.transforms.calibration import delayed

_RATES = ("variance_rate_position", "variance_rate_heading")
_CONTROLS = ("sigma_speed_mps", "sigma_turn")
STABILISATION = "the stabilisation noise"
RANGE_POWERS = 0, 1, 2
"""With which a variance may grow."""
_RESOLVED_S = 1e-6
"""Stamps that are closer are of one instant."""
_EVERY = (2, 3)
"""Of so many one is left out, or used."""

_PLACES = {
    "encoder_offset_m of the vehicle": ("encoder_offset_m",),
    "sensor_forward_m of the vehicle": ("sensor_forward_m",),
    "sensor_left_m of the vehicle": ("sensor_left_m",),
    "the sensor's position on the vehicle": ("sensor_forward_m", "sensor_left_m"),
}
"""Of a vehicle that steers: what is measured to its sensors."""


class VehicleChange(NamedTuple):
    """Other measures of a vehicle.

    Attributes:
        words: With a place for each number.
        measures: Makes of numbers the measures that are others, by name.
        start: The log's numbers.
    """

    words: str
    measures: Callable[..., dict[str, float]]
    start: tuple[float, ...] = ()


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
    for misread in _misreadings(log):
        if not misread.start:
            yield Fault(misread.words, feed=partial(_fed, misread))
    yield from _waiting(log)
    for noise in noises(log):
        for what, altered in _NOISE_CHANGES.items():
            yield Fault(f"{noise.name} {what}", feed=partial(_with_noise, noise, altered))
    for first, second in _exchanged(log):
        feed = partial(_noise_exchanged, first.fields[0], second.fields[0])
        names = " and ".join(noise.name for noise in (first, second))
        yield Fault(f"the sigmas of {names} are exchanged", feed=feed)
    if log.positions is not None:
        yield Fault("the antenna's place is left out", feed=partial(_antenna_at, 0.0, (0.0, 0.0)))
    for measured in _of_vehicle(log):
        if not measured.start:
            yield Fault(measured.words, feed=partial(_with_measures, measured))
    yield from _shifted_measurements(log)
    yield from _left_out()


def stream_families(log: Log) -> Iterator[Family]:
    """Yield the faults of a log's streams that have a number."""
    for noise in noises(log):
        yield Family(f"{noise.name} is {{}} times the log's", partial(_with_factor, noise))
    yield from _growing(log)
    yield Family("the prior's covariance is {} times the log's", _wider_prior)
    for misread in _misreadings(log):
        if misread.start and misread.change.is_neutral:
            yield Family(misread.words, partial(_fed, misread), misread.start[0],
                         factor=misread.change.is_factor, said=misread.said)  # fmt: skip
    yield Family("the measurements are used {} s late", delayed, 0.0, factor=False)
    if log.positions is not None:
        yield Family("R of positions is {} times the log's", _wider_positions)
        for axis, side in enumerate(("forward", "to the left")):
            yield Family(f"the antenna is {{}} m farther {side}", partial(_antenna_moved, axis),
                         0.0, factor=False)  # fmt: skip
    for measured in _of_vehicle(log):
        if len(measured.start) == 1:
            yield Family(measured.words, partial(_with_measures, measured), measured.start[0],
                         factor=False, said=measured.words.format)  # fmt: skip


def _misreadings(log: Log) -> Iterator[Misreading]:
    streams = ["odometry", "measurements", *(["positions"] if log.positions is not None else [])]
    for stream in streams:
        yield from misreadings(read_columns(log, stream), LAGS)


def _fed(misread: Misreading, log: Log, *numbers: float) -> Log:
    """The log as a program reads it."""
    whole = read_columns(log, misread.column.stream)[0]
    return whole.write(log, misread.values(whole.read(log), *numbers))


def noises(log: Log) -> Iterator[Noise]:
    """Yield the parts of what a log says of its noise."""
    yield from _R
    if not isinstance(log.odometry, RelativePoses):
        yield from _Q


def _exchanged(log: Log) -> Iterator[tuple[Noise, Noise]]:
    yield _R[1], _R[2]
    if not isinstance(log.odometry, RelativePoses):
        yield _Q[2], _Q[3]


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


def added_words(name: str, power: int) -> str:
    """Return that a variance has a number added, or as many times a power of the range."""
    if power == 0:
        return f"{name} has a constant of {{:.4g}} added"
    return f"{name} has {{:.4g}} times {'the range' + ' squared' * (power == 2)} added"


def _growing(log: Log) -> Iterator[Family]:
    """Variances of measurements with something added; numbers are in units of the variance.

    Of one that is always the same, a constant added is a factor.
    """
    if not len(log.measurements.time_s):
        return
    for noise, power in product(_R[1:], RANGE_POWERS):
        stated = np.square(getattr(log.measurements, noise.fields[0]))
        if power == 0 and np.ptp(stated) <= 1e-9 * stated.max():
            continue
        size = float(np.median(stated / log.measurements.range_m**power))
        words = added_words(noise.name, power)

        def feed(
            log: Log, number: float, noise: Noise = noise, size: float = size, power: int = power
        ) -> Log:
            more = number * size * log.measurements.range_m**power
            return _with_noise(noise, lambda variance: np.maximum(variance + more, 0.0), log)

        def said(number: float, words: str = words, size: float = size) -> str:
            return words.format(number * size)

        yield Family(words, feed, 0.0, factor=False, said=said)


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


def _of_vehicle(log: Log) -> Iterator[VehicleChange]:
    if isinstance(log.odometry, SteeringOdometry):
        yield from vehicle_changes(log.odometry.vehicle)


def vehicle_changes(vehicle: Ackermann) -> Iterator[VehicleChange]:
    """Yield what a program may take for the measures of a vehicle."""
    for place, names in _PLACES.items():
        stated = {name: float(getattr(vehicle, name)) for name in names}
        if not any(stated.values()):
            continue
        zero = dict.fromkeys(names, 0.0)
        opposite = {name: -value for name, value in stated.items()}
        yield VehicleChange(f"{place} is left out", lambda zero=zero: zero)
        yield VehicleChange(f"{place} has the opposite sign", lambda changed=opposite: changed)
    base = vehicle.wheelbase_m
    yield VehicleChange(f"the wheelbase is {{:.3f}} m, in the log {base:.3f} m",
                        lambda b: {"wheelbase_m": b}, (base,))  # fmt: skip
    for place, names in _PLACES.items():
        start = tuple(float(getattr(vehicle, name)) for name in names)
        text = ", ".join(["{:.4g}"] * len(names))
        form = f"({text}) m" if len(names) > 1 else f"{text} m"
        yield VehicleChange(
            f"{place} is {form}, in the log {form.format(*start)}",
            lambda *numbers, names=names: dict(zip(names, numbers, strict=True)), start,
        )  # fmt: skip


def _with_measures(change: VehicleChange, log: Log, *numbers: float) -> Log:
    """The log of a vehicle with other measures."""
    if not isinstance(log.odometry, SteeringOdometry):
        return log
    vehicle = replace(log.odometry.vehicle, **change.measures(*numbers))
    return replace(log, odometry=replace(log.odometry, vehicle=vehicle))


def _waiting(log: Log) -> Iterator[Fault]:
    """The odometry is used late by a filter that does nothing before its first sample."""
    whole, waiting = read_columns(log, "odometry")[0], remembering(waiting_for_control)
    for lag in (one for one in LAGS if one > 0):
        misread = late(whole, lag)
        words = f"{misread.words}, none before the first"
        yield Fault(words, waiting, partial(_fed, misread))


def _shifted_measurements(log: Log) -> Iterator[Fault]:
    for lag in LAGS:
        yield Fault(
            f"the measurements are fused {lag_words(lag, 'odometry sample')}",
            feed=partial(_at_other_stops, lag),
        )
    for lag in (1, -1):
        yield Fault(
            f"the stamps of measurements are those of {'the next' if lag > 0 else 'the last'} scan",
            feed=partial(_at_other_scans, lag),
        )
    for lag in LAGS[:2] if log.positions is not None else ():
        yield Fault(
            f"positions are fused {lag_words(lag, 'odometry sample')}",
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
    measurements = log.measurements
    return replace(
        log,
        measurements=replace(measurements, time_s=_moved(measurements.time_s, _stops(log), lag)),
    )


def _at_other_scans(lag: int, log: Log) -> Log:
    measurements = log.measurements
    scans = np.unique(measurements.time_s)
    return replace(
        log, measurements=replace(measurements, time_s=_moved(measurements.time_s, scans, lag))
    )


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
    measurements: LandmarkMeasurements = log.measurements
    number: NDArray[np.intp] = np.arange(len(measurements.time_s))
    if of_scans:
        number = np.unique(measurements.time_s, return_inverse=True)[1]
    return replace(log, measurements=measurements.chosen(number % every != phase))
