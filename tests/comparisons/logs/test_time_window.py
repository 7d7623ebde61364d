"""A part of a log, by seconds from its start."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.time_window import cut_log
from comparisons.config import LogSection
from comparisons.errors import InputError
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log, LoopClosures, Positions, Truth
from comparisons.logs.odometry import RelativePoses, SteeringOdometry
from comparisons.pipeline.read import load_log
from tests.commands import slamcheck
from tests.helpers import compared, present, simulated


@pytest.fixture(scope="module")
def loop() -> Log:
    return simulated(3, loop_s=40.0)


def test_without_limits_it_is_the_log(loop: Log) -> None:
    assert cut_log(loop) is loop
    assert cut_log(loop, 0.0) is loop


def test_what_lies_before_the_start_is_cut_by_a_start_alone(loop: Log) -> None:
    fixes = Positions(np.array([-1.0, 5.0, 15.0]), np.zeros((3, 2)), np.array([np.eye(2)] * 3))
    log = replace(loop, positions=fixes)
    for start_s, kept in ((None, [-1.0, 5.0]), (0.0, [-1.0, 5.0]), (1.0, [5.0])):
        positions = present(cut_log(log, start_s, 10.0).positions)
        assert positions.time_s.tolist() == kept


def test_an_empty_part_is_named(loop: Log) -> None:
    with pytest.raises(
        InputError, match=r"no measurements, .* in the part from 10.01 s to 10.011 s$"
    ):
        cut_log(loop, 10.01, 10.011)


def test_a_part_of_wheel_odometry(loop: Log) -> None:
    part = cut_log(loop, 10.013, 20.0)
    assert isinstance(part.odometry, SteeringOdometry)
    assert isinstance(loop.odometry, SteeringOdometry)
    assert part.prior.time_s == part.odometry.time_s[0] == 10.013
    held = np.searchsorted(loop.odometry.time_s, 10.013) - 1  # began before, and holds at 10.013
    assert part.odometry.speed_mps[0] == loop.odometry.speed_mps[held]
    assert part.odometry.time_s[-1] < 20.0
    assert part.measurements.time_s.min() >= 10.013
    assert part.measurements.time_s.max() < 20.0
    assert np.allclose(part.prior.pose, present(loop.truth.poses).at(np.array([10.013]))[0])
    assert part.provenance["part"] == "10.013 to 20 s of the log"
    assert compared(part).verdict.outcome == "agree"


def test_the_prior_without_truth(loop: Log) -> None:
    """Its own figures, or those of dead reckoning where positions hold the frame."""
    blind = replace(loop, truth=Truth())
    assert cut_log(blind, 10.0).prior.pose.tolist() == loop.prior.pose.tolist()
    fixes = Positions(np.array([5.0, 15.0]), np.zeros((2, 2)), np.array([np.eye(2)] * 2))
    prior = cut_log(replace(blind, positions=fixes), 10.0).prior
    truth = present(loop.truth.poses)
    error = prior.pose - truth.at(np.array([10.0]))[0]
    error[2] = np.angle(np.exp(1j * error[2]))
    assert error @ np.linalg.solve(prior.covariance, error) < 14.2  # chi-square of 3, 99.7 %
    assert prior.covariance[0, 0] > 100 * loop.prior.covariance[0, 0]


def test_dead_reckoning_by_hand() -> None:
    """Two motions of 1 m with a turn of a quarter, covariances seen from the arriving pose."""
    covariance = np.diag((0.01, 0.04, 0.09))
    odometry = RelativePoses(
        np.array([1.0, 2.0]), np.array([(1.0, 0.0, np.pi / 2)] * 2), np.array([covariance] * 2)
    )
    seen = {"time_s": [2.0], "range_m": 5.0, "bearing_rad": 0.0}
    seen |= {"sigma_range_m": 0.1, "sigma_bearing_rad": 0.1}
    moved = {"time_s": [1.0, 2.0], "dx_m": 1.0, "dy_m": 0.0, "dheading_rad": 0.0}
    fixes = {"time_s": [0.0], "x_m": 0.0, "y_m": 0.0, "sigma_m": 1.0}
    log = replace(Log.from_arrays(moved, seen, positions=fixes), odometry=odometry)
    loop_closures = LoopClosures(np.array([0.0, 1.0]), np.array([2.0, 2.0]), np.ones((2, 3)),
                        np.array([np.eye(3)] * 2))  # fmt: skip
    part = cut_log(replace(log, loop_closures=loop_closures), 0.5)
    assert part.prior.time_s == 1.0
    assert np.allclose(part.prior.pose, (1.0, 0.0, np.pi / 2))
    expected = np.diag((0.04, 0.01, 0.09)) + 1e-6 * np.array(((1, 0, 0), (0, 2, 1), (0, 1, 1)))
    assert np.allclose(part.prior.covariance, expected, atol=1e-12)
    assert part.odometry.time_s.tolist() == [2.0]
    assert present(part.loop_closures).from_s.tolist() == [1.0]


def test_scans_are_cut_too() -> None:
    log = open_log("scan-loop")
    part = cut_log(log, 5.0, 6.0)
    assert log.scans is not None
    assert part.scans is not None
    kept = (log.scans.time_s >= 5.0) & (log.scans.time_s < 6.0)
    assert np.array_equal(part.scans.range_m, log.scans.range_m[kept], equal_nan=True)
    assert np.array_equal(part.scans.angle_rad, log.scans.angle_rad)
    whole = open_log("scan-loop-3d")
    clouds = cut_log(whole, 5.0, 6.0).clouds
    assert whole.clouds is not None
    first = int(np.flatnonzero(whole.clouds.time_s >= 5.0)[0])
    assert np.array_equal(present(clouds).points(1), whole.clouds.points(first + 1))


def test_the_settings_cut(loop: Log) -> None:
    section = LogSection(source="simulated-loop", start_s=10.0, end_s=20.0)
    assert load_log(section).end_s < 20.0
    with pytest.raises(InputError, match=r"log.end_s is 5: expected above start_s 10"):
        LogSection.of(start_s=10.0, end_s=5.0)
    with pytest.raises(InputError, match=r"nothing lies from 99 s on, .* of its 40\.000 s"):
        cut_log(loop, 99.0)


def test_flags(tmp_path: Path) -> None:
    done = slamcheck("solve", "simulated-loop", "--start", "70", "--end", "80", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "slamcheck-solve-simulated-loop-start-70-end-80" / "config.toml").read_text()
    assert "start_s = 70.0\nend_s = 80.0" in text
    done = slamcheck("solve", "simulated-loop", "--topic", "/scan", cwd=tmp_path)
    assert done.returncode == 2
    assert "--topic /scan: simulated-loop is not a ROS bag" in done.stderr
