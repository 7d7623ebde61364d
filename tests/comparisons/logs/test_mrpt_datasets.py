"""Rawlogs that MRPT wrote: Debian's, where the package mrpt-common is installed."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig
from comparisons.estimates.estimate import Estimate
from comparisons.jobs.run import compare
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.readers import read_log
from tests.comparisons.logs.test_readers import assert_refused
from tests.helpers import present


@pytest.fixture
def datasets() -> Path:
    """Of Debian's package mrpt-common, or where SLAMCHECK_MRPT_DATASETS says."""
    folder = Path(os.environ.get("SLAMCHECK_MRPT_DATASETS", "/usr/share/mrpt/datasets"))
    if not (folder / "kf-slam_demo.rawlog").is_file():
        pytest.skip(f"{folder} has no kf-slam_demo.rawlog (Debian's mrpt-common)")
    return folder


@pytest.mark.slow
def test_the_demo_of_kf_slam(datasets: Path) -> None:
    """MRPT 0.9's simulation runs to a verdict; the filter finds the true map to millimetres."""
    log = read_log(datasets / "kf-slam_demo.rawlog")
    assert log.records == {"odometry": 249, "measurements": 3607, "truth poses": 250}
    assert len(present(log.truth.landmarks).id) == 70
    compared = compare(log)
    assert compared.verdict.outcome != "unverified"
    assert _rms(compared.ekf.estimate, log) < 0.01
    assert _rms(compared.known.gaps.smoothed, log) < 0.01


def _rms(estimate: Estimate, log: Log) -> float:
    places = present(log.truth.landmarks).places_of(estimate.landmark_id)
    return float(np.sqrt(np.mean((estimate.landmark - places) ** 2)))


def test_the_filter_of_mrpt(datasets: Path) -> None:
    """From the second frame, where kf-slam starts, both filters are one and the same.

    kf-slam of MRPT 2.5.8 with its EKF-SLAM_test_2d.ini, but std_sensor_range = 0.01 as in the file:
    the first two lines are its last robot_pose and the roots of full_cov's first diagonal, the
    third its mean, least and largest error of landmarks.
    """
    last = (8.4005094057197844, -0.0030954389275139188, 1.1774676343001191)
    sigma = (0.00304155, 0.00320587, 0.0006487)
    errors = (0.002193, 0.000263, 0.007301)
    whole = read_log(datasets / "kf-slam_demo.rawlog")
    assert isinstance(whole.odometry, RelativePoses)
    moves = (whole.odometry.displacement[1:], whole.odometry.covariance[1:])
    log = replace(
        whole,
        prior=replace(whole.prior, time_s=1.0),
        odometry=RelativePoses(whole.odometry.time_s[1:], *moves),
        measurements=whole.measurements.chosen(whole.measurements.time_s > 0),
    )
    estimate = run_ekf(log, build_timeline(log), settle(EkfConfig(), log)).estimate
    apart = np.array([*estimate.pose[-1, :2], np.angle(np.exp(1j * estimate.pose[-1, 2]))]) - last
    assert np.allclose(apart, 0, atol=2e-6)
    assert np.allclose(np.sqrt(np.diag(estimate.pose_covariance[-1])), sigma, rtol=1e-4)
    missed = estimate.landmark - present(log.truth.landmarks).places_of(estimate.landmark_id)
    distance = np.hypot(*missed.T)
    found = (distance.mean(), distance.min(), distance.max())
    assert np.allclose(found, errors, rtol=0, atol=2e-6)


@pytest.mark.parametrize(
    ("name", "scans"),
    [
        ("localization_demo.rawlog", 37),
        ("2006-01ENE-21-SENA_Telecom Faculty_one_loop_only.rawlog", 225),
        ("uwb_ro-localization_demo.rawlog", 343),
        ("graphslam-engine-demos/action_observations_map/simul.rawlog", 1733),
    ],
)
def test_scans_of_debians_files(name: str, scans: int, datasets: Path) -> None:
    log = read_log(datasets / name)
    assert len(present(log.scans).time_s) == scans == len(log.odometry.time_s) + 1


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("kf-slam_6D_demo.rawlog", "CActionRobotMovement3D: a motion in space"),
        ("RO-SLAM_demo.rawlog", "no CObservationBearingRange or"),
        ("test_rtk_path.rawlog", "byte 1706: CObservationGPS of version 8"),
    ],
)
def test_what_debians_files_have_besides(name: str, message: str, datasets: Path) -> None:
    assert_refused(datasets / name, message)
