"""The waypoint run: what is simulated, and Misono's claim about it (Figs. 5 and 6)."""

from itertools import pairwise

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.adapters.tree_features import with_tree_features
from comparisons.checks.accuracy import assess, assess_trajectory
from comparisons.config import EkfConfig
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.simulate.waypoints import WaypointRun, simulate
from ekf_reference.models.range_bearing import RangeBearing
from graphslam.increments import dead_reckoned
from research.documents.misono import FilterNavigator, FilterSetting
from tests.helpers import present

RUN = WaypointRun()


def run_of(seed: int, **settings: float) -> Log:
    return simulate(np.random.default_rng(seed), WaypointRun(**settings))  # type: ignore[arg-type]


def end_from_base(log: Log) -> float:
    return float(np.hypot(*present(log.truth.poses).pose[-1, :2]))


def test_the_truth_passes_all_waypoints_and_ends_at_the_base() -> None:
    log = run_of(0)
    way = present(log.truth.poses).pose[:, :2]
    for waypoint in RUN.waypoint:
        assert np.linalg.norm(way - waypoint, axis=1).min() < RUN.reached_m
    assert end_from_base(log) < RUN.reached_m
    assert log.positions is not None
    assert len(log.positions.time_s) == len(RUN.waypoint) + 1
    assert np.linalg.norm(log.positions.position_m[:-1] - RUN.waypoint, axis=1).max() < 2.0
    assert log.provenance["goals_reached"] == "10 of 10"


def test_without_noise_odometry_measurements_and_positions_are_exact() -> None:
    log = run_of(1, exact=True)
    assert isinstance(log.odometry, RelativePoses)
    pose = present(log.truth.poses).pose
    assert np.allclose(dead_reckoned(log.prior.pose, log.odometry.displacement), pose, atol=1e-9)
    seen = log.measurements
    at = np.rint(seen.time_s / RUN.sample_s).astype(int)
    for k in np.unique(at)[::40]:
        rows = at == k
        expected = RangeBearing().predict(
            pose[k], present(log.truth.landmarks).position_m[seen.landmark[rows]]
        )
        z = np.column_stack((seen.range_m, seen.bearing_rad))[rows]
        assert np.allclose(RangeBearing().innovation(z, expected.z), 0.0, atol=1e-9)


@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_odometry_is_as_uncertain_as_it_says(scale: float) -> None:
    """Normalised squared errors of the increments: chi-square, two-sided."""
    log = run_of(2, noise_scale=scale)
    assert isinstance(log.odometry, RelativePoses)
    pose, said = present(log.truth.poses).pose, log.odometry
    nis = []
    for k, (before, after) in enumerate(pairwise(pose)):
        cos, sin = np.cos(before[2]), np.sin(before[2])
        true = np.array([[cos, sin], [-sin, cos]]) @ (after - before)[:2]
        turn = said.displacement[k, 2]
        cos, sin = np.cos(turn), np.sin(turn)
        apart = np.array([[cos, sin], [-sin, cos]]) @ (true - said.displacement[k, :2])
        error = np.array([*apart, after[2] - before[2] - turn])
        nis.append(error @ np.linalg.solve(said.covariance[k], error))
    assert 1.8 < np.mean(nis) < 2.2  # way and turn, two numbers


def test_obstacles_of_the_range_profile() -> None:
    """Runs of returns become obstacles within centimetres of the true ones."""
    log = with_tree_features(run_of(3))
    pose = present(log.truth.poses).pose[
        np.rint(log.measurements.time_s / RUN.sample_s).astype(int)
    ]
    angle = pose[:, 2] + log.measurements.bearing_rad
    place = pose[:, :2] + log.measurements.range_m[:, None] * np.column_stack(
        (np.cos(angle), np.sin(angle))
    )
    true = present(log.truth.landmarks).position_m
    nearest = np.linalg.norm(place[:, None] - true[None], axis=2).min(axis=1)
    assert len(place) > 500
    assert np.median(nearest) < 0.05
    assert np.mean(nearest < 0.3) > 0.97


@pytest.mark.parametrize("filter_name", ["misono", "misono-full"])
def test_slam_cancels_what_dead_reckoning_accumulates(filter_name: str) -> None:
    """M Fig. 5, on one drive."""
    log = run_of(4)
    timeline = build_timeline(log)
    assert isinstance(log.odometry, RelativePoses)
    alone = dead_reckoned(log.prior.pose, log.odometry.displacement)
    reckoned = assess_trajectory(timeline.epoch_time_s, alone, log)
    slam = assess(
        run_ekf(log, timeline, settle(EkfConfig(filter=filter_name), log)).estimate,
        log,
        labelled=True,
    )
    assert reckoned is not None
    assert slam is not None
    assert present(slam.ate_m) < 0.5 * present(reckoned.ate_m)


@pytest.mark.parametrize("filter_name", ["misono", "misono-full"])
def test_slam_returns_to_the_base_and_dead_reckoning_does_not(filter_name: str) -> None:
    """M Fig. 6: by its own estimate, with labels and GPS, the robot comes home, else not."""
    ends = {}
    for name in (filter_name, ""):
        pilot = FilterNavigator(FilterSetting(name, aided=True))
        ends[name] = end_from_base(simulate(np.random.default_rng(0), RUN, pilot))
        assert np.hypot(*pilot.pose()[:2]) <= RUN.reached_m  # where it believes to be
    assert ends[filter_name] < 1.0
    assert ends[""] > 3.0
