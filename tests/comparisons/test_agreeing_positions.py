"""Positions of stretches that agree with themselves and with SLAM, and no others, are fused."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from comparisons.adapters.agreeing_positions import MOST_OFFSET, STRETCH_S, in_stretches
from comparisons.arrays import Array
from comparisons.config import RunConfig
from comparisons.errors import InputError
from comparisons.jobs.run import compare
from comparisons.logs.log import Log, Positions
from comparisons.report.run import RunReport
from tests.helpers import present, simulated

SIGMA_M = 0.1
GOOD_S = ((10.0, 22.0), (50.0, 62.0))
"""When the receiver is good; else its error wanders by a metre."""
TIME_S = np.arange(0.5, 84.0, 0.5)


def is_good(time_s: Array) -> NDArray[np.bool_]:
    good: NDArray[np.bool_] = np.zeros(len(time_s), dtype=bool)
    for begin_s, end_s in GOOD_S:
        good |= (time_s >= begin_s) & (time_s <= end_s)
    return good


def with_receiver() -> Log:
    rng, log = np.random.default_rng(3), simulated(1, noise_scale=0.2)
    wandering = np.cumsum(0.4 * rng.standard_normal((len(TIME_S), 2)), axis=0) + 1.0
    error = np.where(
        is_good(TIME_S)[:, None], 0.05 * rng.standard_normal((len(TIME_S), 2)), wandering
    )
    path = present(log.truth.poses).at(TIME_S)[:, :2]
    spread = np.broadcast_to(4.0 * np.eye(2), (len(TIME_S), 2, 2))
    return replace(log, positions=Positions(TIME_S, path + error, spread))


def config(**ekf: object) -> RunConfig:
    return RunConfig.of(ekf={"gps": "on", "stretch_sigma_m": SIGMA_M, **ekf})


def test_stretches_are_of_one_small_distance() -> None:
    time_s, near = np.arange(0.0, 30.0, 0.5), np.zeros((60, 2))
    assert in_stretches(time_s, near, SIGMA_M).all()
    assert not in_stretches(time_s, near + (1.01 * MOST_OFFSET * SIGMA_M, 0.0), SIGMA_M).any()
    assert in_stretches(time_s, near + (0.99 * MOST_OFFSET * SIGMA_M, 0.0), SIGMA_M).all()
    drifting = np.column_stack((0.5 * (time_s - 15.0), np.zeros(60)))
    assert not in_stretches(time_s, drifting, SIGMA_M).any()
    jumps = near + np.where(time_s < 12.0, 0.0, 5.0)[:, None]
    assert np.array_equal(in_stretches(time_s, jumps, SIGMA_M), time_s < 12.0)


def test_a_stretch_is_long_and_without_large_gaps() -> None:
    near = np.zeros((30, 2))
    assert not in_stretches(np.arange(0.0, 0.6 * STRETCH_S, 1.0), near[:3], SIGMA_M).any()
    sparse = np.concatenate((np.arange(0.0, 8.0, 0.5), np.arange(10.0, 38.0, 2.0)))
    kept = in_stretches(sparse, near, SIGMA_M)
    assert np.array_equal(kept, sparse < 8.0)


def test_only_what_lies_in_a_good_stretch_is_fused() -> None:
    log = with_receiver()
    c = compare(log, config())
    given = present(c.prepared.positions)
    assert len(given.time_s) >= 0.9 * np.sum(is_good(TIME_S))
    assert is_good(given.time_s).mean() >= 0.95
    assert np.allclose(given.covariance, SIGMA_M**2 * np.eye(2), rtol=1e-12)
    assert c.verdict.outcome == "agree"
    found = RunReport.build(c).ekf
    assert found.fixes_outside_stretches == len(TIME_S) - len(given.time_s)
    assert found.fixes_fused + found.fixes_rejected == len(given.time_s)
    every = RunReport.build(compare(log, config(stretch_sigma_m=None)))
    assert every.ekf.fixes_outside_stretches is None


def test_without_a_good_stretch_nothing_is_left_out_in_silence() -> None:
    log = with_receiver()
    positions = present(log.positions)
    poor = replace(log, positions=positions.chosen(~is_good(TIME_S)))
    with pytest.raises(InputError, match=r"no 5 s in which its .* expected some for ekf.stretch"):
        compare(poor, config(stretch_sigma_m=0.02))
