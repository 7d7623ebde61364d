"""The scan front end and the three-way comparison, as a user meets them."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.adapters.scan_odometry import ScanFailure, ScanMotion, run_scan_odometry
from comparisons.checks.consistency.finding import ConsistencyFinding
from comparisons.checks.map_agreement import compare_maps
from comparisons.checks.qualifiers import TRUTH_GAP
from comparisons.checks.registry import BASIS, CHECKS
from comparisons.config import FrontEndConfig, OdometryConfig
from comparisons.errors import InputError
from comparisons.estimates.folder import read_estimate
from comparisons.extensions.scan_motion.extension import ScanMotionFinding
from comparisons.extensions.scan_motion.job import run_front_end
from comparisons.extensions.scan_motion.report import FrontEndReport, FrontEndResult
from comparisons.extensions.scan_motion.three_way import ThreeWay, find_inconsistent_source
from comparisons.jobs.run import Comparison
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log, Truth
from comparisons.logs.log_folder import write_log_folder
from comparisons.logs.odometry import RelativePoses, SteeringOdometry
from comparisons.logs.readers import read_log
from comparisons.logs.readers.scan_odometry import no_measurements
from comparisons.report.models import Result
from comparisons.report.run import RunReport
from graphslam.g2o import read_g2o
from tests.commands import files_in, job_files, refused, works
from tests.helpers import compared, present


@pytest.fixture(scope="module")
def scan_loop() -> Log:
    return open_log("scan-loop-fine")


def with_speed_scaled(log: Log, factor: float) -> Log:
    """Wheels that measure the speed wrongly, and say nothing of it."""
    odometry = log.odometry
    assert isinstance(odometry, SteeringOdometry)
    noise = replace(odometry.noise, sigma_speed_mps=0.05)
    scaled = replace(odometry, speed_mps=factor * odometry.speed_mps, noise=noise)
    return replace(log, odometry=scaled)


def three_of(c: Comparison) -> ThreeWay:
    """The smoother on scans beside both."""
    return present(c.find(ScanMotionFinding).three)


@pytest.mark.slow
def test_the_front_end_leaves_a_whole_folder(tmp_path: Path) -> None:
    printed = works("odometry", "scan-loop-fine", "--out", "scans", cwd=tmp_path)
    assert "verdict: verified" in printed
    assert "248 of 248 scans used" in printed
    folder = tmp_path / "scans"
    own = ("odometry.json", "map.png", "graph.g2o", "odometry.tum", "wheels.tum")
    names = job_files(*own, estimates=("graph",))
    assert files_in(folder) == names
    text = (folder / "odometry.json").read_text()
    assert "NaN" not in text
    result = FrontEndResult.model_validate_json(text)
    assert set(result.files) == names
    assert result.loops.closed > 10
    assert result.loops.tried == result.loops.closed + sum(result.loops.reasons.values())
    assert present(present(result.accuracy).ate_aligned_m) < 0.1 * present(
        present(result.wheels).ate_aligned_m
    )
    assert 0.7 < present(result.increments).factor < 1.4
    graph = read_g2o(folder / "graph.g2o")
    assert len(graph.problem.loop_closures.first) == result.loops.closed
    assert np.allclose(read_estimate(folder / "graph").pose[:, :2], graph.poses[:, :2])


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["pcd", "ply"])
@pytest.mark.usefixtures("open3d_library")
def test_the_map_as_a_cloud(suffix: str, tmp_path: Path) -> None:
    from graphslam.scan.libraries import open3d

    arguments = ("scan-loop-fine", "--cloud", suffix, "--no-loop-closure", "--out", "scans")
    works("odometry", *arguments, cwd=tmp_path)
    cloud = open3d().io.read_point_cloud(str(tmp_path / f"scans/map.{suffix}"))
    points = np.asarray(cloud.points)
    assert len(points) > 20_000
    assert np.isfinite(points).all()


@pytest.mark.slow
def test_loops_are_closed_without_wheels_and_without_loops_nothing_is(scan_loop: Log) -> None:
    none = run_front_end(scan_loop, OdometryConfig(front_end=FrontEndConfig(loop_closure=False)))
    assert not none.closed.attempts
    assert not len(none.graph.problem.loop_closures.first)
    blind = run_front_end(scan_loop, OdometryConfig(front_end=FrontEndConfig(guess="none")))
    assert blind.accuracy["wheels"] is not None
    assert present(blind.accuracy["scan graph"]).ate_aligned_m is not None


@pytest.mark.slow
def test_three_estimates_leave_three_folders(tmp_path: Path) -> None:
    printed = works(
        "run", "scan-loop-fine", "-v", "--motion", "both", "--out", "three", cwd=tmp_path
    )
    assert "EKF on wheels and smoother on scans\n  maps agree " in printed
    ids = [
        read_estimate(tmp_path / "three" / name).landmark_id.tolist()
        for name in ("ekf", "smoother", "scans")
    ]
    assert ids[0] == ids[1] == ids[2]
    page = (tmp_path / "three" / "report.html").read_text()
    for layer in ("trajectory", "landmarks"):
        assert f'data-name="smoother on scans {layer}"' in page
    assert '"title":"distance from the smoother [m]"' in page


@pytest.mark.slow
def test_three_estimates_agree_when_nothing_is_wrong(scan_loop: Log) -> None:
    c = compared(scan_loop, motion="both")
    assert c.verdict.outcome == "agree"
    three = three_of(c)
    assert three.ekf.agrees
    assert three.smoother.agrees
    assert three.inconsistent_source == ""
    assert three.loops > 10
    extra = present(Result.model_validate_json(RunReport.build(c).model_dump_json()).model_extra)
    assert extra["three_way"]["ekf"]["landmarks"] == 34
    assert extra["scan_odometry"]["used"] == 248
    assert extra["increments"]["against"] == "truth"


@pytest.fixture(scope="module")
def wrong_wheels(scan_loop: Log) -> Comparison:
    """Both estimators on wheels believe in a wrong scale; few measurements contradict it."""
    return compared(with_speed_scaled(scan_loop, 1.1), motion="both")


@pytest.mark.slow
def test_scans_surer_than_they_may_be_are_remarked_upon(
    scan_loop: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    def boasting(*arguments: Any, **options: Any) -> ScanMotion:
        motion = run_scan_odometry(*arguments, **options)
        return replace(motion, covariance=0.1 * motion.covariance)

    monkeypatch.setattr("comparisons.extensions.scan_motion.extension.run_scan_odometry", boasting)
    result = RunReport.build(compared(scan_loop, motion="scan"))
    assert any("too small" in remark for remark in result.remarks)


@pytest.mark.slow
def test_wrong_wheels_are_found_out(wrong_wheels: Comparison) -> None:
    """Algebra and model are right, and both estimators on wheels agree; only the scans tell."""
    c = wrong_wheels
    assert c.agreement.algebra.sigma < 1e-6
    assert c.agreement.model.sigma < 1e-6
    assert not three_of(c).ekf.agrees
    assert three_of(c).inconsistent_source == "wheels"
    assert c.verdict.outcome == "disagree"
    assert "motion" in {cause.gap for cause in c.verdict.causes}


@pytest.mark.slow
def test_maps_that_share_nothing_cannot_be_compared(wrong_wheels: Comparison) -> None:
    estimate = wrong_wheels.smoothed
    other = replace(estimate, landmark_id=estimate.landmark_id + 1000)
    with pytest.raises(ValueError, match="share no landmark"):
        compare_maps(estimate, other)
    same = compare_maps(estimate, estimate)
    assert same.agrees
    assert same.rms_m == 0.0


@pytest.mark.slow
def test_the_graph_is_asked_what_a_solution_is(scan_loop: Log) -> None:
    """Its kernel on closures leaves no sigma to be judged; a truth elsewhere is a truth gap."""
    poses = present(scan_loop.truth.poses)
    moved = replace(poses, pose=poses.pose + (30.0, 0.0, 0.0))
    found = run_front_end(replace(scan_loop, truth=Truth(poses=moved)))
    report = FrontEndReport.of(found)
    known, result = found.known, report.result
    own = {"scans", "loops", "smoother"}
    asked = {one.name for one in (*BASIS, *CHECKS)} | own
    assert {*known.findings, *known.absent} == asked
    assert "does not weight every measurement" in result.not_checked["stated_noise"]
    assert present(present(known.value(ConsistencyFinding)).smoother).poses is not None
    assert result.qualifiers == [TRUTH_GAP]
    assert "verified, truth gap" in report.summary().headline
    assert set(known.rows()) <= set(report.summary().rows)
    blind = run_front_end(replace(found.log, measurements=no_measurements()))
    assert "no landmark is measured" in blind.known.absent["truth_gap"]


@pytest.mark.slow
def test_the_car_park(shared_data: Path) -> None:
    """The issue's figures: scan odometry 1.0 m, with closed loops 0.35 m, wheels about 2 m."""
    f = run_front_end(read_log(shared_data / "acfr_car_park"))
    wheels, odometry, graph = (
        present(f.accuracy[name]).gps_rms_aligned_m for name in ("wheels", "scans", "scan graph")
    )
    assert present(odometry) < min(1.0, present(wheels))
    assert present(graph) < 0.35
    assert f.graph.optimality.verified


@pytest.mark.slow
def test_the_car_park_without_wheels_is_unverified_where_scans_are_lost(shared_data: Path) -> None:
    """A lost scan is bridged by constant velocity alone; with wheels as the guess it is not."""
    log, how = read_log(shared_data / "acfr_car_park"), FrontEndConfig(guess="none")
    f = run_front_end(log, OdometryConfig(front_end=how))
    assert present(present(f.accuracy["scan graph"]).gps_rms_aligned_m) < 1.0
    lost = ScanFailure(3, 0.6, "too few points")
    for guessed, failures in itertools.product((False, True), ((), (lost,))):
        motion = replace(f.motion, guessed=guessed, failures=failures)
        report = FrontEndReport.of(replace(f, motion=motion))
        result = report.result
        wrong = bool(failures) and not guessed
        assert result.verdict == ("unverified" if wrong else "verified")
        assert ["were lost without the wheels" in why for why in result.reasons] == [True] * wrong
        assert report.summary().reasons == result.reasons


@pytest.mark.slow
def test_the_car_park_on_wheels_and_on_scans(shared_data: Path) -> None:
    """At full lock the steering reading saturates, and the last seconds are wrong on wheels."""
    c = compared(read_log(shared_data / "acfr_car_park"), motion="both")
    assert three_of(c).inconsistent_source == "wheels"
    assert c.verdict.outcome == "disagree"
    cause = next(cause for cause in c.verdict.causes if cause.gap == "motion")
    assert "gps_rms_aligned_m" in cause.evidence


@pytest.mark.slow
def test_scans_alone_make_a_log(tmp_path: Path, scan_loop: Log) -> None:
    """No wheels, no measurements: the front end works, and the others say what is missing."""
    bare = replace(
        scan_loop,
        name="bare",
        odometry=RelativePoses(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3))),
        measurements=no_measurements(),
    )
    write_log_folder(bare, tmp_path / "bare")
    printed = works("odometry", "bare", "-v", "--out", "out", cwd=tmp_path)
    assert "first guess of an alignment none" in " ".join(printed.split())
    for motion in ("wheel", "scan", "both"):
        assert "holds no" in refused("run", "bare", "--motion", motion, cwd=tmp_path)
    with pytest.raises(InputError, match="holds no"):
        compared(bare)


@pytest.mark.slow
def test_a_culprit_needs_evidence(wrong_wheels: Comparison) -> None:
    optimality = wrong_wheels.smoother.optimality
    assert find_inconsistent_source(optimality, optimality, None, None)[0] == ""
