"""Known faults of EKF-SLAM filters: planted in the filter, or made by feeding it another log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.faults import algebra, data, models, noise
from comparisons.faults.fault import Family, Fault, Feed, moving, observing, remembering, together
from comparisons.logs.log import LandmarkMeasurements, Log
from comparisons.logs.odometry import (
    OdometryNoise,
    RelativePoses,
    SteeringOdometry,
    VelocityOdometry,
)
from comparisons.logs.transforms.calibration import controlled, driven, sensed
from comparisons.statistics import ROUNDING

NAMED = tuple(
    fault._replace(name=name)
    for module in (algebra, models, noise, data)
    for name, fault in module.FAULTS.items()
)
"""Faults with a short name each, planted in the filter."""
_STEERING = {"steering sign", "wheelbase wrong", "sensor's place left out"}
_POSITIONS = {"lever arm left out", "position fused twice"}
_LABELS = {"landmark initialised again", "labels exchanged", "gate of sigmas"}
_RATES = ("variance_rate_position", "variance_rate_heading")
_VARIANCES = (0.0, 1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0)
_STARTS = (0.0, 1e-12, 1e-10, 1e-9, 1e-8, 1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
"""Variances by which filters begin that take them from no log."""
_EXACT_START = 1e-16
"""Stands for a variance of zero at the start, whose inverse a prior needs."""
_RESOLVED_S = 1e-6
"""Stamps that are closer are of one instant."""
_SIMULATED = {"interval ignored"}
"""Of one interval only, that of the logs that it is planted in."""


Change = Callable[[LandmarkMeasurements], LandmarkMeasurements]

_COLUMNS: dict[str, Callable[[float, float, float], models.Column]] = {
    "cosine and sine are exchanged": lambda e, n, t: (-e, n),
    "the x row has the opposite sign": lambda e, n, t: (n, e),
    "the y row has the opposite sign": lambda e, n, t: (-n, -e),
    "the turn is used in place of the distance in the x row": lambda e, n, t: (-n * t, e),
    "the turn is used in place of the distance in the y row": lambda e, n, t: (-n, e * t),
    "the turn is used in place of the distance": lambda e, n, t: (-n * t, e * t),
}
"""Errors in the heading's column of F."""
_SIGNS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("position", "range", {"pose": np.s_[:, 0, :2]}),
    ("position", "bearing", {"pose": np.s_[:, 1, :2]}),
    ("heading", "bearing", {"pose": np.s_[:, 1, 2:]}),
    ("landmark", "range", {"landmark": np.s_[:, 0]}),
    ("landmark", "bearing", {"landmark": np.s_[:, 1]}),
)
"""Terms of H, by a row and what they are by."""


def catalogue(log: Log) -> Iterator[Fault]:
    """Yield the faults without a number that a filter of this log may have."""
    skipped = set(_SIMULATED)
    if not isinstance(log.odometry, SteeringOdometry):
        skipped |= _STEERING
    if log.positions is None:
        skipped |= _POSITIONS
    if not log.measurements.labelled:
        skipped |= _LABELS
    yield from (one for one in NAMED if one.name not in skipped)
    yield Fault("Q is not rotated into the map's axes", moving(models.noise_in_body_axes))
    for of, row, entries in _SIGNS:
        yield Fault(f"the {of}'s terms in the {row} row of H have the opposite sign",
                    models.h_times(-1.0, **entries))  # fmt: skip
    yield Fault("the heading's column of G_x has the opposite sign", models.gx_times(-1.0))
    yield Fault("the innovation is not wrapped, but the expected bearing is",
                observing(innovation=models.expected_wrapped))  # fmt: skip
    yield Fault("a landmark is initialised without any cross-covariance",
                algebra.new_landmarks_apart())  # fmt: skip
    for value in _VARIANCES:
        yield Fault(f"a landmark is initialised with the covariance {value:g} m^2 I, whatever is "
                    "known, and without any cross-covariance",
                    algebra.new_landmarks_apart(value))  # fmt: skip
    yield Fault("steps lead along the heading of plain dead reckoning, not the filter's",
                remembering(models.dead_reckoned_heading))  # fmt: skip
    for what, column in _COLUMNS.items():
        yield Fault(f"{what} in the heading's column of F", models.heading_column(column))
    yield Fault("measurements of landmarks in the map are used twice in one update",
                noise.new_landmarks(0.5, 1.0))  # fmt: skip
    yield from (Fault(what, feed=_seen(change)) for what, change in _MEASUREMENTS.items())
    yield Fault("the measurements are fused one odometry sample early", feed=_one_sample_early)
    yield Fault(
        _SIGMAS_IN_PRIOR, feed=lambda log: _with_prior(log, _of_sigmas(log.prior.covariance))
    )
    yield _start(0.0)
    if not isinstance(log.odometry, RelativePoses):
        yield from (Fault(what, feed=_noise(change)) for what, change in _WHEELS.items())
        bare = Fault(_UNSTABLE, feed=_noise(_WHEELS[_UNSTABLE]))
        yield from (together(_start(value), bare) for value in _STARTS)
        yield Fault("the controls' part of Q grows with the interval, not with its square",
                    moving(models.noise_by_interval))  # fmt: skip
        yield from _shifted_odometry()
        yield Fault("the turn counts to the right", feed=lambda log: driven(log, turn=(-1.0, 0.0)))


def _start(variance: float) -> Fault:
    """The fault of a filter that begins with a variance [m^2, rad^2] of its own."""
    what = f"the prior's covariance is {f'{variance:g} I' if variance else 'zero'}"
    covariance = max(variance, _EXACT_START) * np.eye(3)
    return Fault(what, feed=lambda log: _with_prior(log, covariance))


_SIGMAS_IN_PRIOR = "the prior's covariance contains sigmas, not their squares"
EXCHANGED_ROWS = {
    "x and the heading": (2, 1, 0),
    "y and the heading": (0, 2, 1),
    "x and y": (1, 0, 2),
}
"""Orders of a pose's rows."""


def own_start(log: Log, covariance: Array) -> Fault:
    """The fault of a filter whose first pose has a covariance (3, 3) of its own."""
    prior = log.prior.covariance
    ratio = np.diag(covariance) / np.diag(prior)
    named = ", ".join(f"{one:.3g}" for one in ratio)
    if np.ptp(ratio) <= 1e-6 * ratio.max():
        named = f"{ratio[0]:.3g}"
    what = f"the prior's covariance is {named} times the log's"
    known = {_SIGMAS_IN_PRIOR: _of_sigmas(prior)}
    for names, order in EXCHANGED_ROWS.items():
        known[f"the rows of {names} in the prior's covariance are exchanged"] = prior[
            np.ix_(order, order)
        ]
    sigma = np.sqrt(np.diag(covariance))
    for named, other in known.items():
        if np.abs((covariance - other) / np.outer(sigma, sigma)).max() <= ROUNDING:
            what = named
    return Fault(what, feed=lambda log: _with_prior(log, covariance))


def is_setting(what: str) -> bool:
    """Return whether a fault is one of a filter's own settings: where it starts, and padding of Q.

    Args:
        what: The fault in words, as of this catalogue.
    """
    return what.startswith(("the prior's covariance", "the stabilisation noise"))


def families(log: Log) -> Iterator[Family]:
    """Yield the faults with a number."""
    for what, in_range, in_bearing in (
        ("R", True, True), ("R of the range", True, False), ("R of the bearing", False, True)
    ):  # fmt: skip
        yield Family(f"{what} is {{}} times the log's", _wider_noise(in_range, in_bearing))
    yield Family(
        "R of new landmarks is {} times the log's", plant=lambda k: noise.new_landmarks(1.0, k)
    )
    yield Family("R of updates, or of the gain alone, but not of new landmarks, is {} times the "
                 "log's", plant=lambda k: noise.new_landmarks(k, 1.0))  # fmt: skip
    yield Family("the gain is computed with {} R, the covariance by Joseph's form with R",
                 plant=algebra.other_gain)  # fmt: skip
    yield Family("the prior's covariance is {} times the log's", _wider_prior)
    yield Family("the ranges are {} times the log's", lambda log, k: sensed(log, range_=(k, 0.0)))
    yield Family("the ranges have a bias of {} m", lambda log, b: sensed(log, range_=(1.0, b)),
                 0.0, factor=False)  # fmt: skip
    yield Family("the bearings have a bias of {} rad", lambda log, b: sensed(log, bearing=(1.0, b)),
                 0.0, factor=False)  # fmt: skip
    if isinstance(log.odometry, RelativePoses):
        return
    for what, parts in (
        ("Q", ("sigma_speed_mps", "sigma_turn", *_RATES)),
        ("the controls' part of Q", ("sigma_speed_mps", "sigma_turn")),
        ("the speed's part of Q", ("sigma_speed_mps",)),
        ("the turn's part of Q", ("sigma_turn",)),
        ("the stabilisation noise", _RATES),
    ):
        yield Family(f"{what} is {{}} times the log's", _wider_control(parts))
    yield Family("the speed is {} times the log's", lambda log, k: driven(log, speed=(k, 0.0)))
    yield Family("the turn is {} times the log's", lambda log, k: driven(log, turn=(k, 0.0)))
    yield Family("the turn has a bias of {} (rad or rad/s)",
                 lambda log, b: driven(log, turn=(1.0, b)), 0.0, factor=False)  # fmt: skip


def _kept(first: int) -> Change:
    return lambda s: s.chosen(np.arange(len(s.time_s)) % 2 == first)


def _one_sample_early(log: Log) -> Log:
    """Measurements at the time of the last sample before them; the first stay at the start."""
    stops = np.union1d(log.prior.time_s, log.odometry.time_s)
    seen = log.measurements
    before = np.maximum(np.searchsorted(stops, seen.time_s - _RESOLVED_S) - 1, 0)
    return replace(log, measurements=replace(seen, time_s=stops[before]))


def _every_second_scan(seen: LandmarkMeasurements) -> LandmarkMeasurements:
    return seen.chosen(np.unique(seen.time_s, return_inverse=True)[1] % 2 == 0)


def _rooted(name: str) -> Callable[[Any], Any]:
    """The root of a sigma in its place."""
    return lambda one: replace(one, **{name: np.sqrt(getattr(one, name))})


_MEASUREMENTS: dict[str, Change] = {
    "R of the range contains sigma, not its square": _rooted("sigma_range_m"),
    "R of the bearing contains sigma, not its square": _rooted("sigma_bearing_rad"),
    "the sigmas of range and bearing are exchanged": lambda s: replace(
        s, sigma_range_m=s.sigma_bearing_rad, sigma_bearing_rad=s.sigma_range_m
    ),
    "every second measurement is left out, the second first": _kept(0),
    "every second measurement is left out, the first first": _kept(1),
    "every second scan is left out": _every_second_scan,
}
_UNSTABLE = "the stabilisation noise is left out"
_WHEELS: dict[str, Callable[[OdometryNoise], OdometryNoise]] = {
    "Q of the speed contains sigma, not its square": _rooted("sigma_speed_mps"),
    "Q of the turn contains sigma, not its square": _rooted("sigma_turn"),
    _UNSTABLE: lambda n: replace(n, variance_rate_position=0.0, variance_rate_heading=0.0),
}


def _shifted_odometry() -> Iterator[Fault]:
    for lag, side in ((1, "late"), (2, "late"), (-1, "early")):
        what = f"the odometry is used {abs(lag)} sample{'s' * (abs(lag) > 1)} {side}"
        yield Fault(what, feed=_shifted(lag))
        if lag > 0:
            yield Fault(f"{what}, the first twice", feed=_shifted(lag, held=True))
            waiting = remembering(data.waiting_for_control)
            yield Fault(f"{what}, none before the first", waiting, _shifted(lag))


def _shifted(lag: int, *, held: bool = False) -> Feed:
    """Each control is that of so many samples before. held: the first acts before it, too."""

    def late(values: Array) -> Array:
        found = np.full(len(values), values[0] if held else 0.0)
        if lag > 0:
            found[lag:] = values[:-lag]
        else:
            found[:lag], found[lag:] = values[-lag:], values[-1]
        return found

    return lambda log: controlled(log, late, late)


def _wider_noise(in_range: bool, in_bearing: bool) -> Callable[[Log, float], Log]:
    def feed(log: Log, factor: float) -> Log:
        seen, root = log.measurements, np.sqrt(factor)
        wider = replace(
            seen,
            sigma_range_m=(root if in_range else 1.0) * seen.sigma_range_m,
            sigma_bearing_rad=(root if in_bearing else 1.0) * seen.sigma_bearing_rad,
        )
        return replace(log, measurements=wider)

    return feed


def _wider_control(parts: tuple[str, ...]) -> Callable[[Log, float], Log]:
    """parts: fields of the odometry's noise; rates are variances, the others sigmas."""

    def feed(log: Log, factor: float) -> Log:
        def wider(noise: OdometryNoise) -> OdometryNoise:
            changed = {
                part: (factor if part in _RATES else float(np.sqrt(factor))) * getattr(noise, part)
                for part in parts
            }
            return replace(noise, **changed)

        return _noise(wider)(log)

    return feed


def _with_prior(log: Log, covariance: Array) -> Log:
    return replace(log, prior=replace(log.prior, covariance=covariance))


def _wider_prior(log: Log, factor: float) -> Log:
    return _with_prior(log, factor * log.prior.covariance)


def _of_sigmas(covariance: Array) -> Array:
    """The standard deviations in the variances' place, without correlations."""
    return np.diag(np.sqrt(np.diag(covariance)))


def _noise(change: Callable[[OdometryNoise], OdometryNoise]) -> Feed:
    def feed(log: Log) -> Log:
        odometry = _wheels(log)
        return replace(log, odometry=replace(odometry, noise=change(odometry.noise)))

    return feed


def _seen(change: Change) -> Feed:
    return lambda log: replace(log, measurements=change(log.measurements))


def _wheels(log: Log) -> SteeringOdometry | VelocityOdometry:
    if isinstance(log.odometry, RelativePoses):
        raise TypeError("no wheels")
    return log.odometry
