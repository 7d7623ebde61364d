"""Scan odometry through a yard, against truth and against itself."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from graphslam.increments import dead_reckoned
from graphslam.scan import planar
from graphslam.scan.odometry import Increment, KissIcpOptions, ScanOdometry
from graphslam.scan.registration import ScanError
from tests.graphslam.numerics import Array
from tests.graphslam.scan.shapes import BLOCK, hall_in_space, round_the_block, scan, seen_from
from tests.graphslam.scan.yard import STEP, drive


def run(scans: list[Array], guess: Array | None = None) -> tuple[list[Increment], Array]:
    """All increments, and the pose (3,) they lead to."""
    odometry = ScanOdometry()
    assert odometry.register(scans[0]) is None
    found = [odometry.register(points, STEP if guess is None else guess) for points in scans[1:]]
    return [f for f in found if f is not None], odometry.pose


def test_increments_without_noise_are_those_driven() -> None:
    found, end = run(drive(25, 0.0)[1])
    assert len(found) == 24
    for increment in found:
        assert np.abs(increment.motion - STEP).max() < 0.01 * STEP[0]
        assert increment.since == 1
        assert increment.match.overlap > 0.8
    chained = np.zeros(3)
    for increment in found:
        chained = planar.compose(chained, increment.motion)
    assert np.abs(chained - end).max() < 1e-12


def squared_errors(seed: int) -> tuple[list[float], list[float]]:
    """Round a block: of the increments as stated, and with covariances turned a quarter."""
    rng, moves = np.random.default_rng(seed), round_the_block()
    true = dead_reckoned(np.array((-6.0, -6.0, 0.0)), moves)
    odometry, quarter = ScanOdometry(), planar.rotation(0.5 * np.pi)
    odometry.register(scan(rng, BLOCK, true[0], 0.02))
    right, wrong = [], []
    for end, move in zip(true[1:], moves, strict=True):
        guess = move + rng.normal(size=3) * (0.02, 0.01, 0.01)
        found = odometry.register(scan(rng, BLOCK, end, 0.02), guess)
        assert found is not None
        assert found.since == 1
        error = planar.between(found.motion, move)
        spread = found.covariance
        right.append(float(error @ np.linalg.solve(spread, error)))
        wrong.append(float(error @ np.linalg.solve(quarter @ spread @ quarter.T, error)))
    return right, wrong


@pytest.mark.slow
def test_errors_are_as_large_as_the_covariances_say() -> None:
    """The sigmas, on seeds that no calibration was found on, are right to 10 %."""
    drives = [squared_errors(seed) for seed in (10, 11, 12)]
    right, wrong = (np.mean(one) / 3.0 for one in zip(*drives, strict=True))
    low, high = 0.9**2, 1.1**2
    assert low < right < high
    assert not low < wrong < high
    assert not low < right / 0.8**2 < high
    assert not low < right / 1.2**2 < high


def fingerprint() -> str:
    """Of every pose and covariance of a drive in the plane and one in space."""
    total = hashlib.sha256()
    space = [seen_from(k * STEP, hall_in_space(np.random.default_rng(k))) for k in range(4)]
    for scans in (drive(12)[1], space):
        found, end = run(scans)
        for increment in found:
            total.update(increment.motion.tobytes() + increment.covariance.tobytes())
            total.update(increment.match.motion.tobytes())
        total.update(end.tobytes())
    return total.hexdigest()


@pytest.mark.slow
@pytest.mark.parametrize(("hash_seed", "threads"), [("1", "1"), ("77", "4")])
def test_another_process_finds_the_same_bits(hash_seed: str, threads: str) -> None:
    code = "from tests.graphslam.scan.test_odometry import fingerprint; print(fingerprint())"
    root = str(Path(__file__).resolve().parents[3])
    settings = {
        "PYTHONHASHSEED": hash_seed,
        "OMP_NUM_THREADS": threads,
        "OPENBLAS_NUM_THREADS": threads,
        "TBB_NUM_THREADS": threads,
        "PYTHONPATH": root,
    }
    end = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | settings,
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    )
    assert end.stdout.strip() == fingerprint()


def test_the_order_of_points_does_not_matter() -> None:
    """Bit for bit, though a voxel keeps those of its points that come first."""
    rng = np.random.default_rng(0)
    space = [seen_from(k * STEP, hall_in_space(np.random.default_rng(k))) for k in range(4)]
    for scans in (drive(8)[1], space):
        found, end = run(scans)
        mixed, mixed_end = run([rng.permutation(points) for points in scans])
        assert np.array_equal(mixed_end, end)
        for one, other in zip(found, mixed, strict=True):
            assert np.array_equal(one.motion, other.motion)
            assert np.array_equal(one.covariance, other.covariance)


def test_inputs_stay_as_they_are() -> None:
    scans, guess = drive(4)[1], STEP.copy()
    scans[2][5] = np.nan
    before = [points.copy() for points in scans]
    for points in (*scans, guess):
        points.setflags(write=False)
    odometry, motions = ScanOdometry(), []
    for k, points in enumerate(scans):
        found = odometry.register(points, guess if k else None)
        motions.append(None if found is None else found.motion.copy())
        points.setflags(write=True)
        points += 1.0  # nor does odometry hold on to them
    for points, copy in zip(scans, before, strict=True):
        assert np.array_equal(points, copy + 1.0, equal_nan=True)
    again = [found.motion for found in run(before)[0]]
    assert np.array_equal(np.array(motions[1:]), np.array(again))


def test_a_planar_map_stays_in_the_plane() -> None:
    """At any heading: else every surface would be looked for in space."""
    for heading in np.linspace(-3.1, 3.1, 9).tolist():
        odometry = ScanOdometry()
        odometry.pose = np.array((4.0, -3.0, heading))
        for points in drive(3)[1]:
            odometry.register(points, STEP)
            assert not odometry.map_points()[:, 2].any()


def test_without_a_guess_the_velocity_is_kept() -> None:
    """Where alignment reaches less far than the vehicle goes between two scans."""
    step = np.array((1.3, 0.05, 0.1))
    scans = drive(5, step=step)[1]
    short = KissIcpOptions(blind_threshold_m=0.3, blind_jump_m=0.8)
    moving, standing = ScanOdometry(short), ScanOdometry(short)
    moving.register(scans[0])
    moving.register(scans[1], step)
    for points in scans[2:]:
        found = moving.register(points)
        assert found is not None
        assert np.abs(found.motion - step).max() < 0.02
    standing.register(scans[0])
    with pytest.raises(ScanError):
        standing.register(scans[1])


def test_the_map_forgets_what_lies_far_back() -> None:
    poses, scans = drive(40)
    whole, short = ScanOdometry(), ScanOdometry(KissIcpOptions(memory_m=1.0))
    for k, points in enumerate(scans):
        whole.register(points, STEP if k else None)
        found = short.register(points, STEP if k else None)
        if found is not None:
            assert np.abs(found.motion - STEP).max() < 0.02
    assert 100 < len(short.map_points()) < 0.9 * len(whole.map_points())
    for odometry in (whole, short):
        error = planar.between(planar.between(poses[0], poses[-1]), odometry.pose)
        assert np.abs(error).max() < 0.05
