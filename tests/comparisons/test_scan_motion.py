"""Motion from scans: honest increments, little drift, logs that move by their scans."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from comparisons.adapters.scan_odometry import ScanMotion, run_scan_odometry
from comparisons.errors import InputError
from comparisons.extensions.scan_motion.increments import check_increments, normalised_errors
from comparisons.extensions.scan_motion.log_by_scans import divide, with_scan_motion
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.readers import read_log
from comparisons.logs.simulate.scan_drive import (
    ScanExperiment,
    dense_slam_fine,
    dense_slam_in_space,
    simulate,
)
from graphslam.increments import MotionSamples, compose
from graphslam.scan import planar
from tests.comparisons.test_front_end_faults import with_scans, without_odometry
from tests.helpers import compared, present, random_covariance, relative_error

Array = NDArray[np.float64]
SEEDS = 50


def scan_loop(seed: int = 0, name: str = "scan-loop-fine") -> Log:
    return open_log(name, choices=SimulationChoices(seed))


def with_ranges(log: Log, ranges: Array) -> Log:
    return replace(log, scans=replace(present(log.scans), range_m=ranges))


def squared_errors(log: Log) -> tuple[ScanMotion, Array]:
    motion = run_scan_odometry(log)
    return motion, normalised_errors(motion, present(log.truth.poses))


def beginning(experiment: ScanExperiment, seed: int, seconds: float) -> Log:
    """The first seconds of a drive."""
    drive = replace(experiment.drive, loop_s=seconds, extra_s=0.0)
    return simulate(np.random.default_rng(seed), replace(experiment, drive=drive))


@pytest.mark.slow
@pytest.mark.parametrize(("make", "seconds"), [(dense_slam_fine, 14.0), (dense_slam_in_space, 7.0)])
def test_increments_are_as_exact_as_they_say(
    make: Callable[[], ScanExperiment], seconds: float
) -> None:
    runs = []
    for seed in range(SEEDS):
        motion, squared = squared_errors(beginning(make(), seed, seconds))
        assert len(motion.failures) <= 1
        runs.append(squared.mean())
    low, high = chi2.ppf((0.025, 0.975), 3 * SEEDS) / SEEDS
    assert low < np.mean(runs) < high
    assert not low < np.mean(runs) / 0.7**2 < high, "sigmas 30 % too small would pass"
    assert not low < np.mean(runs) / 1.4**2 < high, "sigmas 40 % too large would pass"


@pytest.mark.slow
def test_errors_of_whole_drives_are_as_large_as_the_covariances_say() -> None:
    """On seeds that no calibration was found on."""
    logs = [simulate(np.random.default_rng(seed), dense_slam_fine()) for seed in (10, 11, 12)]
    total = np.concatenate([squared_errors(log)[1] for log in logs])
    low, high = chi2.ppf((0.005, 0.995), 3 * len(total)) / len(total)
    assert low < total.mean() < high
    assert high < 1.2 * total.mean()
    assert low > 0.8 * total.mean()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scan-loop-fine", "scan-loop-3d"])
def test_drift_stays_below_one_percent(name: str) -> None:
    log = scan_loop(name=name)
    stream = log.scans or present(log.clouds)
    assert len(stream.time_s) >= 200
    motion = run_scan_odometry(log)
    poses = present(log.truth.poses)
    true = np.column_stack([np.interp(motion.time_s, poses.time_s, c) for c in poses.pose.T])
    way = np.hypot(*np.diff(true[:, :2], axis=0).T).sum()
    for k in range(0, len(true), 20):
        miss = motion.pose[k, :2] - planar.between(true[0], true[k])[:2]
        assert np.hypot(*miss) < 0.01 * way


def test_scans_that_cannot_be_used_are_counted_not_passed_over() -> None:
    log = with_scans(scan_loop(), slice(30))
    ranges = present(log.scans).range_m.copy()
    ranges[5] = np.nan
    ranges[9, 3:] = np.nan
    ranges[12:14] = 1e6
    ranges[20] = 2.0 + np.sin(np.arange(361.0))  # somewhere else altogether
    motion, squared = squared_errors(with_ranges(log, ranges))
    assert [f.row for f in motion.failures] == [5, 9, 12, 13, 20]
    assert all(f.reason for f in motion.failures)
    assert len(motion.row) == 25
    assert motion.breaks == 0
    assert squared.mean() < 10.0, "increments across the gaps"


def test_no_usable_scan_is_an_error() -> None:
    log = with_scans(scan_loop(), slice(5))
    with pytest.raises(InputError, match="none of 5 scans could be used; the first: 0 of 0"):
        run_scan_odometry(with_ranges(log, np.full_like(present(log.scans).range_m, np.nan)))


def test_a_lost_track_is_bridged_by_wheels_or_is_an_error() -> None:
    log = with_scans(scan_loop(), slice(30))
    ranges = present(log.scans).range_m.copy()
    ranges[8:16] = np.nan
    blind = with_ranges(log, ranges)
    motion = run_scan_odometry(blind)
    assert motion.breaks == 1
    after = int(np.flatnonzero(motion.bridged)[1])
    assert motion.row[after] == 16
    assert np.array_equal(motion.displacement[after], present(motion.wheels)[after])
    with pytest.raises(InputError, match=r"lost track at 5\.\d+ s, and there is no wheel odometry"):
        run_scan_odometry(without_odometry(blind))


def test_divided_increments_compose_to_the_whole() -> None:
    rng = np.random.default_rng(1)
    knots = np.array([0.0, 0.5, 1.5, 2.0])
    times = np.array([0.0, 0.1, 0.4, 0.5, 1.5, 1.6, 1.7, 2.0])
    whole = MotionSamples(
        rng.standard_normal((3, 3)) * (1.0, 0.2, 0.3),
        np.array([1e-4 * random_covariance(rng, 3) for _ in range(3)]),
    )
    pieces = divide(whole, knots, times)
    interval = np.searchsorted(knots, times[1:]) - 1
    again = compose(pieces, interval, 3)
    assert relative_error(again.displacement, whole.displacement) < 1e-12
    assert np.array_equal(pieces.covariance[3], whole.covariance[1]), "an undivided one is kept"
    traces = np.trace(again.covariance, axis1=1, axis2=2)
    assert np.allclose(traces, np.trace(whole.covariance, axis1=1, axis2=2), rtol=0.5)
    half = np.array([[0.0, 0.0, 0.0]])
    straight = divide(MotionSamples(half, whole.covariance[:1]), knots[:2], knots[[0, 1]])
    assert np.array_equal(straight.displacement, half)


@pytest.mark.slow
def test_both_estimators_move_by_scans() -> None:
    log = scan_loop()
    motion = run_scan_odometry(log)
    moved = with_scan_motion(log, motion)
    assert isinstance(moved.odometry, RelativePoses)
    assert np.isin(moved.measurements.time_s, moved.odometry.time_s).all()
    by_wheels, by_scans = compared(log), compared(log, motion="scan")
    assert by_scans.verdict.outcome == "agree"
    assert by_scans.agreement.algebra.sigma < 1e-9
    assert by_scans.agreement.model.sigma < 1e-9
    assert by_scans.smoother.optimality.chi_square.reading == "plausible"
    assert present(present(by_scans.accuracy.ekf).ate_aligned_m) < 0.5 * present(
        present(by_wheels.accuracy.ekf).ate_aligned_m
    )


def with_fixes(log: Log, sigma_m: float, seed: int = 0) -> Log:
    """The log with positions made from its truth, which it then lacks."""
    poses = present(log.truth.poses)
    rng = np.random.default_rng(seed)
    rows = np.arange(3, len(poses.time_s), 11)
    fixes = poses.pose[rows, :2] + sigma_m * rng.standard_normal((len(rows), 2))
    covariance = np.broadcast_to(sigma_m**2 * np.eye(2), (len(rows), 2, 2))
    positions = Positions(poses.time_s[rows], fixes, covariance)
    return replace(log, positions=positions, truth=replace(log.truth, poses=None))


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 0.3, 3.0])
def test_positions_tell_by_how_much_sigmas_are_wrong(scale: float) -> None:
    """Increments drawn from covariances that are then stated wrongly by a known factor."""
    log = with_fixes(scan_loop(), 0.1)
    true = present(scan_loop().truth.poses)
    motion = run_scan_odometry(log)
    rng = np.random.default_rng(5)
    at = np.column_stack([np.interp(motion.time_s, true.time_s, c) for c in true.pose.T])
    spread = np.diag((0.03, 0.03, 0.003)) ** 2
    moves = [np.zeros(3)]
    for before, after in pairwise(at):
        noise = rng.multivariate_normal(np.zeros(3), spread)
        moves.append(planar.compose(planar.between(before, after), noise))
    stated = np.broadcast_to((scale**2) * spread, (len(moves), 3, 3))
    drawn = replace(motion, displacement=np.array(moves), covariance=stated)
    check = present(check_increments(drawn, log))
    assert check.against == "positions"
    assert check.factor == pytest.approx(1.0 / scale, rel=0.2)
    assert check.reference_factor == pytest.approx(1.0, abs=0.35)


@pytest.mark.slow
def test_the_car_park_by_its_scans(shared_data: Path) -> None:
    log = read_log(shared_data / "acfr_car_park")
    motion = run_scan_odometry(log)
    assert len(motion.row) == 585
    check = present(check_increments(motion, log))
    assert 0.5 < check.factor < 2.0
