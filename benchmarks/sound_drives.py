"""Drives on which the filter is sound: true noise as stated, so small that all is linear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from comparisons.config import EkfConfig, RunConfig
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import SteeringOdometry
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.pipeline.compare import Comparison, compare

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
    odometry, truth = log.odometry, log.truth.poses
    if not isinstance(odometry, SteeringOdometry) or truth is None:
        raise TypeError("the simulated vehicle steers and has true poses")
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
