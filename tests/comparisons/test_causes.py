"""Causes beside the gaps: where linearising cost something, dropouts, noise."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from comparisons.adapters.smoother_input import build_problem, model_system_at, model_system_of
from comparisons.checks.diagnosis.data_usage import odometry_remarks
from comparisons.checks.diagnosis.dropouts import find_dropouts
from comparisons.checks.diagnosis.linearisation_growth import (
    LinearisationGrowth,
    linearisation_growth,
)
from comparisons.checks.explaining import dropout, other_noise
from comparisons.checks.linearisation import _grew, linearisation_cause
from comparisons.estimates.estimate import Estimate
from comparisons.figures import degrees
from comparisons.jobs.run import Comparison
from comparisons.logs.log import Log
from comparisons.logs.odometry import SteeringOdometry
from comparisons.words import GAPS
from ekf_reference.core.landmark_types import POSE
from graphslam.layout import POINT
from graphslam.model_system import LinearisationPoints, RelationPoints, model_system
from graphslam.problem import SlamProblem
from tests.helpers import Array, compared, present, simulated

NONE = np.zeros(0, dtype=np.intp)


@cache
def sound() -> Comparison:
    return compared(simulated(seed=3, loop_s=30.0))


def silent(log: Log, begin_s: float, end_s: float) -> Log:
    """The log without its measurements of some time."""
    t = log.measurements.time_s
    return replace(log, measurements=log.measurements.chosen((t <= begin_s) | (t >= end_s)))


def linearised(landmark: Array, poses: Array) -> tuple[SlamProblem, LinearisationPoints]:
    """One landmark ahead, seen once from the first of two poses, linearised where asked."""
    problem = SlamProblem(
        prior_pose=poses[0],
        prior_covariance=np.eye(3),
        increment=np.array([[1.0, 0.0, 0.0]]),
        increment_covariance=np.eye(3)[None],
        measurement_pose=np.array([0]),
        measurement_landmark=np.array([0]),
        z=np.array([[10.0, 0.0]]),
        sigma=np.array([[0.1, 0.02]]),
        landmark_count=1,
    )
    points = LinearisationPoints(
        departed=poses,
        arrived=poses,
        measurements={POINT: RelationPoints(np.array([0]), np.ones(1), poses[:1], landmark[None])},
        merges={},
        position=NONE,
        position_weight=np.zeros(0),
        position_pose=np.zeros((0, 3)),
    )
    return problem, points


def estimate(poses: Array, landmark: Array) -> Estimate:
    return Estimate(
        time_s=np.arange(2.0),
        pose=poses,
        pose_covariance=np.tile(np.eye(3), (2, 1, 1)),
        landmark_id=np.array([0]),
        landmark=landmark[None],
        joint_covariance=np.eye(5),
        information="smoothed",
    )


def test_the_error_of_linearising_is_that_of_the_formula() -> None:
    poses, sideways = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 2.0
    off = np.array([10.0, sideways])
    problem, at_filter = linearised(np.array([10.0, 0.0]), poses)
    optimum = model_system(problem, linearised(off, poses)[1])
    growth = linearisation_growth(model_system(problem, at_filter), optimum, estimate(poses, off))
    by_range = (np.hypot(10.0, sideways) - 10.0) / 0.1
    by_bearing = (np.arctan2(sideways, 10.0) - sideways / 10.0) / 0.02
    assert growth.kind == "a measurement"
    assert (growth.epoch, growth.landmark_index) == (0, 0)
    assert np.isclose(growth.sigma, np.hypot(by_range, by_bearing), rtol=1e-9)
    assert np.isclose(growth.total, growth.sigma**2, rtol=1e-9)


def test_a_prediction_counts_with_its_turn() -> None:
    """A step of 1 m, its start turned by 0.3 rad after linearising: 1 - cos, and sin less 0.3."""
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    turned = poses.copy()
    turned[:, 2] = 0.3
    landmark = np.array([10.0, 0.0])
    problem, at_filter = linearised(landmark, poses)
    optimum = model_system(problem, linearised(landmark, turned)[1])
    growth = linearisation_growth(
        model_system(problem, at_filter), optimum, estimate(turned, landmark)
    )
    assert growth.squared[1] > 0.0
    assert growth.reached(1.0) == 1
    wound = turned + (0.0, 0.0, 2.0 * np.pi)
    around = linearisation_growth(
        model_system(problem, at_filter), optimum, estimate(wound, landmark)
    )
    assert np.allclose(around.squared, growth.squared, rtol=1e-9)


def test_at_the_optimum_nothing_is_missed() -> None:
    c = sound()
    problem = build_problem(c.log, c.ekf)
    there = model_system_at(problem, c.ekf, c.smoothed)
    growth = linearisation_growth(there, there, c.smoothed)
    assert growth.total == 0.0
    filters = model_system_of(problem, c.ekf)
    assert linearisation_growth(filters, there, c.smoothed).total > 0.1


def test_a_dropout_is_found_with_what_it_did() -> None:
    log = silent(simulated(seed=3, loop_s=30.0), 10.0, 22.0)
    c = compared(log)
    found = find_dropouts(c.ekf, c.smoothed)
    worst = present(found.worst)
    assert len(found.stretches) == 1
    assert abs(worst.begin_s - 10.0) < 0.5
    assert abs(worst.end_s - 22.0) < 0.5
    assert worst.refused == 0
    t = c.ekf.estimate.time_s
    assert np.isclose(found.coverage, 1.0 - (worst.end_s - worst.begin_s) / (t[-1] - t[0]))
    assert log.truth.poses is not None
    inside = (log.truth.poses.time_s >= worst.begin_s) & (log.truth.poses.time_s <= worst.end_s)
    way = np.linalg.norm(np.diff(log.truth.poses.pose[inside, :2], axis=0), axis=1).sum()
    assert np.isclose(worst.way_m, way, rtol=0.1)
    assert worst.growth > 3.0
    reported = dropout(found)
    assert "the filter used no measurement from" in reported[0].evidence
    assert "rejected" not in reported[0].evidence


def test_a_stretch_with_scan_landmarks_seen_is_no_dropout() -> None:
    c = compared(silent(simulated(seed=3, loop_s=30.0), 10.0, 22.0))
    assert find_dropouts(c.ekf, c.smoothed).stretches
    steps = np.arange(len(c.ekf.trace.departed))
    trace = c.ekf.trace
    used, new = trace.measurements, trace.initialisations
    for seen in (
        replace(trace, measurements={**used, POSE: replace(used[POSE], step=steps)}),
        replace(trace, initialisations={**new, POSE: replace(new[POSE], step=steps)}),
    ):
        run = replace(c.ekf, trace=seen)
        assert not find_dropouts(run, c.smoothed).stretches


def test_the_sigma_at_a_dropouts_end_is_the_prediction() -> None:
    log = silent(simulated(seed=3, loop_s=30.0), 22.0, 1e9)
    c = compared(log)
    worst = present(find_dropouts(c.ekf, c.smoothed).worst)
    last = c.ekf.estimate.pose_covariance[-1]
    assert np.isclose(worst.sigma_m[1], np.sqrt(last[0, 0] + last[1, 1]), rtol=1e-6)
    assert np.isclose(worst.sigma_heading_rad[1], np.sqrt(last[2, 2]), rtol=1e-6)


def test_direction_cosines_predict_the_same_sigma() -> None:
    log = silent(simulated(seed=3, loop_s=30.0), 10.0, 14.0)
    full, other = (
        find_dropouts(c.ekf, c.smoothed).worst
        for c in (compared(log, filter=f) for f in ("full", "misono-full"))
    )
    assert full is not None
    assert other is not None
    assert np.allclose(other.sigma_m, full.sigma_m, rtol=0.2)
    assert np.allclose(other.sigma_heading_rad, full.sigma_heading_rad, rtol=0.2)


def test_sound_logs_have_neither_dropouts_nor_too_much_noise() -> None:
    c = sound()
    found = find_dropouts(c.ekf, c.smoothed)
    assert not found.stretches
    assert found.coverage == 1.0
    assert dropout(found) == []
    assert other_noise(c.known, c.smoother.optimality.chi_square) == []


def test_the_variance_that_is_off_most_is_named() -> None:
    """A tenth is farther off than five times."""
    c = sound()
    blocks = [
        replace(one, agrees=False, distance_sigma=0.0, variance_ratio_least=1.0 / ratio,
                variance_ratio_largest=1.0)
        for one, ratio in zip(c.agreement.landmarks, (1.5, 10.0, 5.0), strict=False)
    ]  # fmt: skip
    blocks[2] = replace(blocks[2], variance_ratio_least=1.0, variance_ratio_largest=5.0)
    said = linearisation_cause(replace(c.agreement, landmarks=tuple(blocks)), c.ekf).evidence
    second = c.ekf.estimate.names[1]
    assert f"the variance of landmark {second} is 0.1 times the smoother's" in said


def test_the_headings_sigma_is_that_around_the_worst_relation() -> None:
    """Of the epoch and the one before it: 4 degrees here, not the 9 before, nor the 7 behind."""
    c = sound()
    sigma = np.zeros(len(c.ekf.estimate.time_s))
    sigma[2:7] = np.radians((9.0, 4.0, 3.0, 7.0, 8.0))
    growth = LinearisationGrowth(np.ones(len(sigma)), "odometry", 4, -1, 2.0)
    said = _grew(growth, c.ekf, sigma)
    assert "the largest linearisation error is that of odometry at " in said
    assert "the heading's sigma was 4.0 degrees" in said


@pytest.mark.parametrize(
    ("angle", "said"),
    [(2e-4, "0.011 degrees"), (0.01, "0.57 degrees"), (0.1, "5.7 degrees"), (1.0, "57.3 degrees")],
)
def test_a_small_angle_is_not_zero(angle: float, said: str) -> None:
    assert degrees(angle) == said


def test_an_understated_sigma_is_named() -> None:
    log = simulated(seed=3, loop_s=30.0)
    stated = replace(log.measurements, sigma_range_m=log.measurements.sigma_range_m / 3.0)
    c = compared(replace(log, measurements=stated))
    (named,) = other_noise(c.known, c.smoother.optimality.chi_square)
    assert named.gap == "noise"
    assert named.gap not in GAPS
    assert named.hint == "check the sigma of the range"
    factor = float(named.evidence.split("noise of the range ")[1].split()[0])
    assert abs(factor - 3.0) < 0.6
    assert "bearing" not in named.evidence


def test_no_sigma_is_blamed_for_what_it_does_not_explain() -> None:
    """One landmark's range is off by 2 m half way on, and no noise is that."""
    log = simulated(seed=3, loop_s=30.0)
    seen = log.measurements
    rows = np.flatnonzero(seen.landmark == np.bincount(seen.landmark).argmax())
    range_m = seen.range_m.copy()
    range_m[rows[len(rows) // 2 :]] += 2.0
    c = compared(replace(log, measurements=replace(seen, range_m=range_m)))
    assert "noise" not in [one.gap for one in c.verdict.causes]
    (cause,) = [one for one in c.verdict.causes if one.gap == "misfit"]
    assert cause.evidence.startswith("none of the changes tried makes the log fit: chi-square ")
    assert "the residuals depart " in cause.evidence
    assert "sigma" not in cause.hint


def test_odometry_that_ends_early_is_remarked() -> None:
    """As of a file that was cut off; the whole log has no such remark."""
    log = simulated(loop_s=20.0)
    o = log.odometry
    assert isinstance(o, SteeringOdometry)
    kept = o.time_s < 5.0
    columns = (o.time_s[kept], o.speed_mps[kept], o.steering_rad[kept])
    cut = replace(log, odometry=SteeringOdometry(*columns, o.vehicle, o.noise))
    assert odometry_remarks(log) == []
    (remark,) = odometry_remarks(cut)
    assert "15.0 s before the last measurement" in remark
    assert compared(cut).verdict.remarks[0] == remark
