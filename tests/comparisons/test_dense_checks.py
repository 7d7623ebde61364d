"""Dense maps against true surfaces and against the smoother's."""

from dataclasses import replace
from itertools import pairwise
from types import ModuleType

import numpy as np
import pytest

from comparisons.adapters.motion import poses_at
from comparisons.extensions.dense_maps.accuracy import (
    distance_to_segments,
    error_of_points,
    surface_error,
)
from comparisons.extensions.dense_maps.check import AGREE_M, compare_dense
from comparisons.extensions.dense_maps.extension import DenseMapsFinding
from comparisons.jobs.run import Comparison
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.odometry import RelativePoses
from ekf_reference.dense.layers.layer import LayerSamples
from graphslam.scan import planar
from tests.helpers import compared, present


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    log = open_log("occupancy-loop", choices=SimulationChoices(seed=2))
    return compared(log, dense=["points", "occupancy"])


def test_distances_to_segments_by_hand() -> None:
    segment = np.array([(0.0, 0.0, 4.0, 0.0), (10.0, 0.0, 10.0, 0.0)])  # the second is a point
    point = np.array([(1.0, 2.0), (-3.0, 4.0), (5.0, 0.0), (10.0, 3.0)])
    assert np.allclose(distance_to_segments(point, segment), (2.0, 5.0, 1.0, 3.0))


def test_distances_equal_brute_force() -> None:
    """Short and long segments, near and far points."""
    rng = np.random.default_rng(0)
    start = rng.uniform(-20, 20, (60, 2))
    way = rng.normal(size=(60, 2)) * rng.choice((0.02, 1.0, 9.0), (60, 1))
    point = rng.uniform(-40, 40, (800, 2))
    apart = point[:, None] - start
    along = np.clip((apart * way).sum(axis=2) / np.square(way).sum(axis=1), 0.0, 1.0)
    brute = np.linalg.norm(apart - along[..., None] * way, axis=2).min(axis=1)
    found = distance_to_segments(point, np.hstack((start, start + way)))
    assert np.allclose(found, brute, rtol=0.0, atol=1e-12)


def test_only_what_is_occupied_counts() -> None:
    samples = LayerSamples(
        np.array([(0.0, 1.0), (0.0, 50.0)]), np.array((0.9, 0.3)), np.zeros(2, dtype=np.intp)
    )
    error = surface_error(samples, np.array([(-1.0, 0.0, 1.0, 0.0)]))
    assert (error.median_m, error.occupied) == (1.0, 1)
    nothing = error_of_points(np.empty((0, 2)), np.array([(-1.0, 0.0, 1.0, 0.0)]))
    assert nothing.occupied == 0
    assert np.isnan(nothing.median_m)


@pytest.mark.slow
def test_both_maps_agree_where_the_filter_is_right(comparison: Comparison) -> None:
    check = present(comparison.find(DenseMapsFinding).agreement)
    assert comparison.verdict.outcome == "agree"
    assert check.agrees
    assert check.median_m < 0.1
    assert len(check.regions) > 10
    assert check.regions[0].distance_m == max(row.distance_m for row in check.regions)
    assert present(check.occupancy_share) > 0.9
    assert set(check.surface_errors) == {"points", "occupancy", "smoother"}


@pytest.mark.slow
def test_a_map_that_hangs_on_wrong_landmarks_is_found(comparison: Comparison) -> None:
    """One corner moved by two metres after the drive: its regions are off, and told first."""
    dense = comparison.find(DenseMapsFinding).dense
    base = dense.dense.regions.base
    corner = int(base[base >= 0][0])
    moved = dense.landmark.copy()
    moved[corner] += (2.0, 0.0)
    check = present(
        compare_dense(comparison.log, replace(dense, landmark=moved), comparison.smoothed)
    )
    assert not check.agrees
    worst = check.regions[0]
    assert worst.distance_m > AGREE_M
    virtual = dense.dense.regions.virtual
    of_pair = -1 - np.flatnonzero((virtual.pair == corner).any(axis=1))
    assert np.isin(base[worst.region], [corner, *of_pair]).any()


@pytest.mark.slow
def test_a_dense_disagreement_is_a_cause(
    monkeypatch: pytest.MonkeyPatch, comparison: Comparison
) -> None:
    monkeypatch.setattr("comparisons.extensions.dense_maps.check.AGREE_M", 1e-4)
    log = open_log("occupancy-loop", choices=SimulationChoices(seed=2))
    found = compared(log, dense=["points"])
    assert comparison.verdict.outcome == "agree"
    assert found.verdict.outcome == "disagree"
    assert [cause.gap for cause in found.verdict.causes] == ["dense"]
    assert "region" in found.verdict.causes[0].evidence
    result = present(found.find(DenseMapsFinding).agreement)
    assert not result.agrees
    assert len(result.regions) <= 20


@pytest.mark.slow
def test_poses_at_are_led_on_by_the_wheels(comparison: Comparison) -> None:
    """At epochs the estimate's, in between composed from the one before."""
    estimate, log = comparison.smoothed, comparison.log
    time = estimate.time_s
    assert np.array_equal(poses_at(log, estimate, time[3:6]), estimate.pose[3:6])
    between = poses_at(log, estimate, time[3:5] + (0.0, -0.1))
    step = planar.between(between[0], between[1])
    whole = planar.between(estimate.pose[3], estimate.pose[4])
    assert 0.0 < step[0] < whole[0]
    beyond = poses_at(log, estimate, time[-1:] + 5.0)
    assert np.array_equal(beyond, estimate.pose[-1:])


@pytest.mark.slow
def test_scans_between_relative_poses_are_led_on_evenly(comparison: Comparison) -> None:
    """As slamcheck run --motion scan has them, whose poses are some scans only."""
    estimate, log = comparison.smoothed, comparison.log
    moved = [planar.between(a, b) for a, b in pairwise(estimate.pose)]
    spread = np.tile(1e-6 * np.eye(3), (len(moved), 1, 1))
    relative = replace(
        log,
        prior=replace(log.prior, time_s=float(estimate.time_s[0])),
        odometry=RelativePoses(estimate.time_s[1:], np.array(moved), spread),
    )
    halfway = 0.5 * (estimate.time_s[3:6] + estimate.time_s[4:7])
    found = poses_at(relative, estimate, halfway)
    expected = [planar.compose(estimate.pose[k], 0.5 * moved[k]) for k in (3, 4, 5)]
    assert np.allclose(found, expected, atol=1e-3)


@pytest.mark.slow
def test_cloud_distances_are_open3ds(comparison: Comparison, open3d_library: ModuleType) -> None:
    """The k-d tree's figures against a library made for clouds."""
    check, o3d = comparison.find(DenseMapsFinding).agreement, open3d_library
    assert check is not None

    def cloud(points: np.ndarray) -> object:
        flat = np.column_stack((points, np.zeros(len(points))))
        return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(flat))

    layer = check.layers["points"]
    theirs = cloud(layer.point).compute_point_cloud_distance(  # type: ignore[attr-defined]
        cloud(check.smoother_point)
    )
    assert np.allclose(np.asarray(theirs), layer.distance_m, rtol=0.0, atol=1e-9)
