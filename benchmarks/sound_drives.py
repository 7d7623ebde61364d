"""Drives on which the filter is sound: linear ones, and some that cost double precision digits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from comparisons.arrays import Array
from comparisons.config import EkfConfig, RunConfig
from comparisons.jobs.run import Comparison, compare
from comparisons.logs.log import Log, Positions, Truth
from comparisons.logs.odometry import SteeringOdometry
from comparisons.logs.simulate.drive import Drive, simulate

SCALE = 0.01
"""Of the documents' noise: sigmas of 1.5 mm and 0.01 degree, where nothing is curved."""
_POSITION_SIGMA_M = 0.3
_POSITION_EVERY = 40


def sound_log(seed: int, seconds: float, *, positions: bool = False) -> Log:
    """A drive whose truth is drawn from what the log states, to the letter.

    Without stabilisation noise, which the simulated vehicle has none of. positions: one a second.
    """
    rng = np.random.default_rng(seed)
    log = simulate(rng, Drive(noise_scale=SCALE, loop_s=seconds))
    odometry, truth = _steering(log), log.truth.poses
    if truth is None:
        raise TypeError("the simulated vehicle has true poses")
    noise = replace(odometry.noise, variance_rate_position=0.0, variance_rate_heading=0.0)
    log = replace(log, odometry=replace(odometry, noise=noise))
    if not positions:
        return log
    rows, sigma = slice(_POSITION_EVERY, None, _POSITION_EVERY), SCALE * _POSITION_SIGMA_M
    place = truth.pose[rows, :2]
    measured = place + sigma * rng.standard_normal(place.shape)
    covariance = np.broadcast_to(sigma**2 * np.eye(2), (len(place), 2, 2))
    return replace(log, positions=Positions(truth.time_s[rows], measured, covariance))


def sound_run(seed: int, seconds: float, *, positions: bool = False) -> Comparison:
    """Both estimators over one of these drives."""
    config = RunConfig(ekf=EkfConfig(gps="on" if positions else "off"))
    return compare(sound_log(seed, seconds, positions=positions), config)


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
    odometry = _steering(log)
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
    noise = replace(_steering(log).noise, sigma_speed_mps=sigma, sigma_turn=sigma)
    return replace(log, odometry=replace(_steering(log), noise=noise))


def _steering(log: Log) -> SteeringOdometry:
    if not isinstance(log.odometry, SteeringOdometry):
        raise TypeError("the simulated vehicle steers")
    return log.odometry
