"""FastSLAM beside the filter and the smoother."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from comparisons.arrays import Array
from comparisons.checks.agreement import Gaussian
from comparisons.config import RunConfig
from comparisons.extensions.fastslam.check import (
    LEVEL,
    CloudCheck,
    check_clouds,
    standardised_moments,
)
from comparisons.extensions.fastslam.config import FastSlamConfig
from comparisons.extensions.fastslam.extension import (
    FastSlamExtension,
    FastSlamFinding,
    cloud_estimate,
    compare_clouds,
)
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.logs.odometry import SteeringOdometry
from comparisons.pipeline.compare import Comparison, compare
from comparisons.report.result import build_result

CLOUDS = 16
NO_SHAPE = np.zeros((CLOUDS, 2, 3))
ROOT_P = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.01, 0.02, 0.02]])
SMOOTHER = Gaussian(np.array([1.0, -2.0, 3.1]), ROOT_P @ ROOT_P.T)


def clouds_of(scatter: float, shift: float, seed: int) -> CloudCheck:
    """Clouds whose means scatter by so many sigma of the smoother, shifted by so many."""
    generator = np.random.default_rng(seed)
    means = scatter * generator.standard_normal((CLOUDS, 3)) @ ROOT_P.T
    means += SMOOTHER.mean + shift * ROOT_P[:, 1] + (0.0, 0.0, 2.0 * np.pi)
    return check_clouds(means, NO_SHAPE, SMOOTHER)


def test_the_level_holds_where_the_bias_is_like_the_error_of_a_cloud() -> None:
    tiny = Gaussian(SMOOTHER.mean, 1e-12 * SMOOTHER.covariance)
    generator, statistic = np.random.default_rng(5), []
    for _ in range(4000):
        bias = generator.standard_normal(3)
        means = SMOOTHER.mean + (bias + generator.standard_normal((CLOUDS, 3))) @ ROOT_P.T
        statistic.append(check_clouds(means, NO_SHAPE, tiny))
    beyond = sum(one.agrees is False for one in statistic)
    assert 0 < beyond < 4000 * LEVEL + 5.0 * (4000 * LEVEL) ** 0.5
    chi_square = 16.27  # the limit as if the scatter were known
    assert sum(one.statistic > chi_square for one in statistic) > 60


def test_agreement_disagreement_and_no_verdict() -> None:
    near, far, wide = (clouds_of(*case, 1) for case in ((0.5, 0.3), (0.5, 12.0), (20.0, 0.3)))
    assert (near.agrees, far.agrees, wide.agrees) == (True, False, None)
    assert near.independent > 1.0 > wide.independent
    far_and_wide = clouds_of(20.0, 900.0, 1)
    assert far_and_wide.agrees is False  # small clouds may still tell that something is wrong


def moments(draw: str, clouds: int = CLOUDS) -> Array:
    generator = np.random.default_rng(2)
    found = []
    for _ in range(clouds):
        pose = generator.standard_normal((400, 3))
        if draw == "skew":
            pose[:, 0] = generator.exponential(size=400)
        if draw == "modes":
            pose[:, 2] += 8.0 * (generator.random(400) < 0.5)
        found.append(standardised_moments(pose, np.full(400, 1 / 400)))
    return np.array(found)


@pytest.mark.parametrize(
    ("draw", "words"), [("gauss", []), ("skew", ["east is skew"]), ("modes", ["heading is flat"])]
)
def test_shapes_that_are_not_gaussian_are_named(draw: str, words: list[str]) -> None:
    means = SMOOTHER.mean + 0.1 * np.random.default_rng(0).standard_normal((CLOUDS, 3)) @ ROOT_P.T
    shape = check_clouds(means, moments(draw), SMOOTHER).shape
    assert len(shape) == len(words)
    assert all(one.startswith(word) for one, word in zip(shape, words, strict=True))


def test_what_fastslam_does_not_estimate_is_refused() -> None:
    for extra, message in (
        ({"ekf": {"gps": "on"}}, "fuses no absolute positions"),
        ({"extensions": {"fastslam": {}, "scan_landmarks": {}}}, "does not go with --landmarks"),
    ):
        given = {"extensions": {"fastslam": {}}, **extra}
        with pytest.raises(ValidationError, match=message):
            RunConfig.model_validate(given)


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    given = {"extensions": {"fastslam": {"particles": 12, "clouds": 8}}}
    return compare(open_log("simulated-loop"), RunConfig.model_validate(given))


def test_a_run_reports_the_third_estimate(comparison: Comparison) -> None:
    found = comparison.findings["fastslam"]
    assert isinstance(found, FastSlamFinding)
    result = json.loads(build_result(comparison).model_dump_json())
    assert result["fastslam"]["particles"] == 12
    assert result["fastslam"]["agrees"] is found.check.agrees
    estimate = found.estimates["fastslam"]
    smoothed = comparison.gaps.smoothed
    assert estimate.pose.shape == smoothed.pose.shape
    np.testing.assert_array_equal(np.sort(estimate.landmark_id), np.sort(smoothed.landmark_id))
    assert np.linalg.eigvalsh(estimate.joint_covariance).min() > -1e-12
    assert np.linalg.norm(estimate.pose[:, :2] - smoothed.pose[:, :2], axis=1).max() < 4.0
    assert {row.group for row in found.rows()} >= {"FastSLAM"}
    assert not found.causes  # it has no say in the verdict


def test_the_joint_covariance_has_the_clouds_own_blocks(comparison: Comparison) -> None:
    extension = FastSlamExtension(FastSlamConfig(particles=12, clouds=8))
    log = comparison.prepared.log
    cloud = extension.cloud(comparison.prepared, log, 0)
    estimate = cloud_estimate(cloud, comparison.ekf.estimate.time_s)
    np.testing.assert_allclose(
        estimate.joint_covariance[:3, :3], estimate.pose_covariance[-1], atol=1e-12
    )
    mixture = cloud.slam.mixture_map()
    np.testing.assert_allclose(estimate.landmark_covariances(), mixture.covariance, atol=1e-12)


def wrong_wheelbase(log: Log, factor: float) -> Log:
    odometry = log.odometry
    assert isinstance(odometry, SteeringOdometry)
    vehicle = replace(odometry.vehicle, wheelbase_m=factor * odometry.vehicle.wheelbase_m)
    return replace(log, odometry=replace(odometry, vehicle=vehicle))


@pytest.mark.slow
def test_only_a_wrong_wheelbase_in_fastslam_alone_disagrees() -> None:
    found = compare(open_log("simulated-loop", choices=SimulationChoices(seed=3)))
    prepared, smoothed = found.prepared, found.gaps.smoothed
    extension = FastSlamExtension(FastSlamConfig(particles=30))
    agrees = []
    for log in (prepared.log, wrong_wheelbase(prepared.log, 1.25)):
        clouds = [extension.cloud(prepared, log, k) for k in range(CLOUDS)]
        agrees.append(compare_clouds(clouds, smoothed).agrees)
    assert agrees[0] is not False
    assert agrees[1] is False


@pytest.mark.slow
def test_a_run_that_does_not_ask_for_it_loads_none_of_it() -> None:
    code = (
        "import sys\n"
        "from comparisons.logs.bundled import open_log\n"
        "from comparisons.pipeline.compare import compare\n"
        "compare(open_log('simulated-loop'))\n"
        "print([name for name in sys.modules if 'fastslam' in name])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=Path(__file__).resolve().parents[2],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "[]"
