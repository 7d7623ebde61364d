"""FastSLAM beside the filter and the smoother."""

import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from pydantic import ValidationError

from comparisons.config import RunConfig
from comparisons.errors import InputError
from comparisons.extensions.fastslam.check import LEVEL, check_clouds, check_exact
from comparisons.extensions.fastslam.config import FastSlamConfig
from comparisons.extensions.fastslam.drive import DriveStart, Sampling
from comparisons.extensions.fastslam.extension import (
    FastSlamExtension,
    FastSlamFinding,
    cloud_estimate,
)
from comparisons.extensions.fastslam.stretches import StretchComparison, between, draw_particle
from comparisons.jobs.run import Comparison, compare
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Landmarks, Log
from comparisons.report.run import RunReport
from research.fastslam import with_wheelbase
from research.posterior_sampling import circle, draw_problem
from tests.helpers import present


def test_what_fastslam_does_not_estimate_is_refused() -> None:
    for extra, message in (
        ({"ekf": {"gps": "on"}}, "fuses no absolute positions"),
        ({"extensions": {"fastslam": {}, "scan_landmarks": {}}}, "does not go with --landmarks"),
    ):
        given = {"extensions": {"fastslam": {}}, **extra}
        with pytest.raises(ValidationError, match=message):
            RunConfig.model_validate(given)


def test_surveyed_landmarks_are_refused() -> None:
    log = open_log("simulated-loop")
    known = Landmarks(np.array([3]), np.array([[10.0, 4.0]]), np.eye(2)[None])
    seen = log.measurements
    log = replace(log, known_landmarks=known, known_measurements=seen.chosen(seen.landmark == 3))
    given = RunConfig.model_validate({"extensions": {"fastslam": {}}})
    with pytest.raises(InputError, match="--third fastslam takes no surveyed landmarks"):
        compare(log, given)


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    given = {"extensions": {"fastslam": {"particles": 40, "clouds": 48}}}
    return compare(open_log("simulated-loop"), RunConfig.model_validate(given))


@pytest.fixture(scope="module")
def stretches(comparison: Comparison) -> StretchComparison:
    return StretchComparison(comparison.known.gaps, comparison.prepared.log, Sampling(40))


def summary_lines(comparison: Comparison) -> Sequence[tuple[str, str]]:
    return RunReport(comparison, RunReport.build(comparison)).summary().lines


@pytest.mark.slow
def test_a_run_reports_the_third_estimate(comparison: Comparison) -> None:
    found = comparison.find(FastSlamFinding)
    assert found.check.agrees is True
    result = json.loads(RunReport.build(comparison).model_dump_json())["fastslam"]
    assert (result["particles"], result["clouds"]) == (40, 48)
    assert result["verdict"] == "agree"
    assert len(result["stretches"]) == 6
    assert result["stretches"][0]["begin_s"] == 0.0
    estimate = found.estimates["fastslam"]
    smoothed = comparison.known.gaps.smoothed
    assert estimate.pose.shape == smoothed.pose.shape
    np.testing.assert_array_equal(np.sort(estimate.landmark_id), np.sort(smoothed.landmark_id))
    assert np.linalg.eigvalsh(estimate.joint_covariance).min() > -1e-12
    assert np.linalg.norm(estimate.pose[:, :2] - smoothed.pose[:, :2], axis=1).max() < 4.0
    assert {row.group for row in found.rows()} >= {"FastSLAM"}
    assert not found.causes  # it has no say in the verdict
    (remark,) = found.remarks
    assert remark.startswith("over the whole log FastSLAM is depleted: 1 of 40 particles at its ")
    assert result["path_m"] < 4.0
    (line,) = (words for name, words in summary_lines(comparison) if name == "FastSLAM")
    assert line.startswith("agrees with the smoother over 6 stretches of ")


@pytest.mark.slow
def test_the_joint_covariance_has_the_clouds_own_blocks(comparison: Comparison) -> None:
    extension = FastSlamExtension(FastSlamConfig(particles=12), RunConfig())
    cloud = extension.cloud(comparison.prepared, len(comparison.ekf.estimate.time_s))
    estimate = cloud_estimate(cloud, comparison.ekf.estimate.time_s)
    np.testing.assert_allclose(
        estimate.joint_covariance[:3, :3], estimate.pose_covariance[-1], atol=1e-12
    )
    mixture = cloud.slam.mixture_map()
    np.testing.assert_allclose(estimate.landmark_covariances(), mixture.covariance, atol=1e-12)


@pytest.mark.slow
def test_stretches_cover_the_log_and_end_before_the_cloud_is_depleted(
    comparison: Comparison, stretches: StretchComparison
) -> None:
    found = stretches.stretches(1000)
    epochs = len(comparison.prepared.timeline.epoch_time_s)
    assert (found[0].first, found[-1].last) == (0, epochs - 1)
    assert all(a.last == b.first for a, b in pairwise(found))
    assert len(found) > 10
    few = stretches.stretches(4)
    assert [one.first for one in few[:: len(few) - 1]] == [0, found[-1].first]


@pytest.mark.slow
def test_a_stretch_has_the_motion_and_measurements_of_its_epochs(
    comparison: Comparison, stretches: StretchComparison
) -> None:
    problem = comparison.known.gaps.problem
    prior = DriveStart(problem.prior_pose, problem.prior_covariance)
    same, landmarks = between(problem, (0, problem.pose_count - 1), prior)
    np.testing.assert_array_equal(landmarks, np.arange(problem.landmark_count))
    for name in ("increment", "z", "measurement_pose", "measurement_landmark"):
        np.testing.assert_array_equal(getattr(same, name), getattr(problem, name))
    one = stretches.stretches(8)[4]
    part, landmarks = between(problem, (one.first, one.last), prior)
    assert part.measurement_pose.min() >= 0
    assert part.measurement_pose.max() < part.pose_count
    assert part.landmark_count == len(landmarks) == len(np.unique(part.measurement_landmark))


@pytest.mark.slow
def test_draws_of_a_cloud_have_its_means_and_covariances(comparison: Comparison) -> None:
    cloud = FastSlamExtension(FastSlamConfig(particles=30), RunConfig()).cloud(
        comparison.prepared, len(comparison.ekf.estimate.time_s)
    )
    slam = cloud.slam
    columns = slam.maps.columns_of(slam.mixture_map().number)[:3]
    draws = np.array([draw_particle(slam, columns) for _ in range(4000)])
    own = cloud_estimate(cloud, comparison.ekf.estimate.time_s)
    sigma = np.sqrt(np.diag(own.joint_covariance)[:9])
    error = (draws.mean(axis=0) - np.concatenate((own.pose[-1], own.landmark[:3].ravel()))) / sigma
    assert np.abs(error).max() < 5.0 / np.sqrt(4000)
    ratio = np.cov(draws.T) / own.joint_covariance[:9, :9]
    np.testing.assert_allclose(np.diag(ratio), 1.0, atol=0.15)


def louder(log: Log, factor: float) -> Log:
    seen = log.measurements
    range_m, bearing_rad = factor * seen.sigma_range_m, factor * seen.sigma_bearing_rad
    seen = replace(seen, sigma_range_m=range_m, sigma_bearing_rad=bearing_rad)
    return replace(log, measurements=seen)


@pytest.mark.slow
def test_what_fastslam_alone_has_wrong_disagrees(comparison: Comparison) -> None:
    log, gaps = comparison.prepared.log, comparison.known.gaps
    verdicts = {}
    for name, believed in (
        ("same", log),
        ("wheelbase", with_wheelbase(log, 1.25)),
        ("noise", louder(log, 1.5)),
        ("quiet", louder(log, 0.7)),
    ):
        clouds = StretchComparison(gaps, believed, Sampling(50)).run(48)
        no_draws = [replace(one, exact=lambda generator: None) for one in clouds]
        verdicts[name] = check_clouds(no_draws).agrees
        if name == "wheelbase":
            exact = check_exact(clouds[:2])
    assert verdicts == {"same": True, "wheelbase": False, "noise": False, "quiet": False}
    assert exact.stretches == 2
    assert exact.clouds <= LEVEL < exact.gaussian


@pytest.mark.slow
def test_a_cloud_that_is_too_small_gives_no_verdict(comparison: Comparison) -> None:
    given = RunConfig.model_validate({"extensions": {"fastslam": {"particles": 4, "clouds": 16}}})
    found = compare(comparison.log, given).find(FastSlamFinding)
    assert found.check.agrees is None
    assert "gives no verdict: of clouds of 4 particles, " in found.remarks[0]


@pytest.mark.slow
def test_where_the_gaussian_fails_fastslam_agrees_with_the_exact_posterior() -> None:
    """A loop with 0.1 rad of noise a step, of research/posterior_sampling.py."""
    log = draw_problem(circle(), np.random.default_rng(0)).log
    given = RunConfig.model_validate({"extensions": {"fastslam": {"clouds": 64}}})
    comparison = compare(log, given)
    found = comparison.find(FastSlamFinding)
    assert found.check.agrees is True
    assert found.check.p <= LEVEL
    assert present(found.check.exact).explains
    assert found.remarks[0].startswith("the posterior is not Gaussian, least of all from 0.0 to ")
    assert ", and not from FastSLAM's clouds (p 0." in found.remarks[0]
    (line,) = (words for name, words in summary_lines(comparison) if name == "FastSLAM")
    assert line.startswith("agrees with the exact posterior, not with its Gaussian ")
    quantities = [row.quantity for row in found.rows()]
    assert "stretches: p of the Gaussian against the exact posterior" in quantities
