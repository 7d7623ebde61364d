"""Simulated logs: on which planted defects show, on which a filter is sound, and extreme ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from comparisons.arrays import Array
from comparisons.config import EkfConfig, RunConfig
from comparisons.jobs.run import Comparison, compare
from comparisons.logs.log import Log, Positions, Truth
from comparisons.logs.odometry import SteeringOdometry
from comparisons.logs.simulate.drive import Drive, simulate
from research.script import present

LOGS = ("loop", "closing", "uneven", "positions")
ANTENNA_M = (0.6, -0.3)
"""Little enough for a filter without it to accept most positions."""
SCALE = 0.01
"""Of the documents' noise: sigmas of 1.5 mm and 0.01 degree, where nothing is curved."""
_POSITION_SIGMA_M = 0.3
_POSITION_EVERY = 40
_KEPT = 0.8
_CLOSING_S = 35.0


def steering(log: Log) -> SteeringOdometry:
    """Return the odometry of the simulated vehicle, which steers."""
    assert isinstance(log.odometry, SteeringOdometry)
    return log.odometry


def open_case(name: str, seed: int, loop_s: float = 60.0) -> tuple[Log, EkfConfig]:
    """A log of LOGS, and what a filter is to do with it.

    loop: long enough for the heading to pass pi. closing: until its beginning is in view again.
    uneven: the same, with a fifth of the odometry's records lost. positions: the same with a
    position of an antenna every second, to be fused. Raises ValueError for another name.
    """
    if name not in LOGS:
        raise ValueError(f"log '{name}' is unknown, expected one of {', '.join(LOGS)}")
    rng = np.random.default_rng(seed)
    log = simulate(rng, Drive(loop_s=loop_s, extra_s=_CLOSING_S if name == "closing" else 0.0))
    if name == "positions":
        log = _with_positions(log, rng, _POSITION_SIGMA_M, ANTENNA_M)
        return log, EkfConfig(association="known", gps="on")
    if name == "uneven":
        kept = rng.random(len(log.odometry.time_s)) < _KEPT
        kept[0] = True
        log = replace(log, odometry=log.odometry.chosen(kept))
    return log, EkfConfig(association="known")


def sound_log(seed: int, seconds: float, *, positions: bool = False) -> Log:
    """A drive whose truth is drawn from what the log states, to the letter.

    Without stabilisation noise, which the simulated vehicle has none of. positions: one a second.
    """
    rng = np.random.default_rng(seed)
    log = without_noise(simulate(rng, Drive(noise_scale=SCALE, loop_s=seconds)))
    return _with_positions(log, rng, SCALE * _POSITION_SIGMA_M) if positions else log


def sound_run(seed: int, seconds: float, *, positions: bool = False) -> Comparison:
    """Both estimators over one of these drives."""
    config = RunConfig(ekf=EkfConfig(gps="on" if positions else "off"))
    return compare(sound_log(seed, seconds, positions=positions), config)


def without_noise(log: Log) -> Log:
    """The log without stabilisation noise, its controls' noise alone."""
    noise = replace(steering(log).noise, variance_rate_position=0.0, variance_rate_heading=0.0)
    return replace(log, odometry=replace(steering(log), noise=noise))


def _with_positions(
    log: Log, rng: np.random.Generator, sigma_m: float, antenna_m: tuple[float, float] = (0.0, 0.0)
) -> Log:
    """With one position a second, of an antenna beside the vehicle's origin."""
    rows, truth = slice(_POSITION_EVERY, None, _POSITION_EVERY), present(log.truth.poses)
    pose, (forward, left) = truth.pose[rows], antenna_m
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    arm = np.column_stack((cos * forward - sin * left, sin * forward + cos * left))
    place = pose[:, :2] + arm + sigma_m * rng.standard_normal((len(pose), 2))
    covariance = np.broadcast_to(sigma_m**2 * np.eye(2), (len(pose), 2, 2))
    return replace(log, positions=Positions(truth.time_s[rows], place, covariance, antenna_m))


def extreme_log(seed: int) -> tuple[str, Log]:
    """A short drive with one or two extremes at once, and which."""
    rng = np.random.default_rng(seed)
    log, said = simulate(rng, Drive(loop_s=rng.uniform(10.0, 20.0))), []
    for number in rng.choice(3, rng.integers(1, 3), replace=False):
        if number == 0:
            still_s = float(rng.choice((86_400.0, 1e6)))
            said.append(f"stand-still of {still_s:g} s")
            log = standing_still(log, rng.uniform(3.0, 8.0), still_s)
        elif number == 1:
            said.append("1e9 m from the origin")
            log = far_away(log, 1e9)
        elif rng.integers(3):
            sigma = float(rng.choice((1e6, 1e-7)))
            said.append(f"odometry known to {sigma:g}")
            log = _known_to(log, sigma)
        else:
            said.append("all known to 1e-7")
            log = fine(log)
    return " and ".join(said), log


def standing_still(log: Log, from_s: float, still_s: float) -> Log:
    """The vehicle stands still once, for so long, and is as unsure of it as of its speed."""
    odometry = steering(log)
    stand = int(np.searchsorted(odometry.time_s, from_s))
    moved = {
        name: np.insert(getattr(odometry, name), stand, value)
        for name, value in (("time_s", from_s), ("speed_mps", 0.0), ("steering_rad", 0.0))
    }

    def later(time_s: Array) -> Array:
        return np.where(time_s > from_s, time_s + still_s, time_s)

    moved["time_s"] = later(moved["time_s"])
    measurements = replace(log.measurements, time_s=later(log.measurements.time_s))
    noise = replace(odometry.noise, variance_rate_position=1e-2, variance_rate_heading=1e-7)
    odometry = replace(odometry, **moved, noise=noise)  # type: ignore[arg-type]
    return replace(log, odometry=odometry, measurements=measurements, truth=Truth())


def far_away(log: Log, far_m: float) -> Log:
    """The same beside another origin."""
    pose = log.prior.pose + (far_m, -far_m, 0.0)
    return replace(log, prior=replace(log.prior, pose=pose), truth=Truth())


def fine(log: Log) -> Log:
    """Controls and measurements stated to be known to 1e-7: a coordinate's last place counts."""
    seen, sigma = log.measurements, np.full(len(log.measurements.time_s), 1e-7)
    seen = replace(seen, sigma_range_m=sigma, sigma_bearing_rad=sigma)
    return replace(_known_to(log, 1e-7), measurements=seen)


def _known_to(log: Log, sigma: float) -> Log:
    """With controls stated to be known so well, or badly."""
    noise = replace(steering(log).noise, sigma_speed_mps=sigma, sigma_turn=sigma)
    return replace(log, odometry=replace(steering(log), noise=noise))
