"""Other ways to associate: time reversed is the same problem, and a quiet world tells no ways."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from graphslam.association import associate
from graphslam.association_variants import associate_by, reversed_problem, variants
from graphslam.graph_builder import build_graph, to_values
from graphslam.increments import dead_reckoned
from graphslam.problem import SlamProblem
from tests.graphslam import worlds
from tests.graphslam.numerics import Array

FIXED = np.diag((1e-2, 1e-2, 1e-3)) ** 2


def error(problem: SlamProblem, poses: Array, landmarks: Array) -> float:
    """Of increments and measurements, the prior left out."""
    graph = build_graph(problem)
    values = to_values(poses, landmarks, np.arange(len(landmarks)), problem.pose_landmarks)
    prior = graph.at(0)
    assert isinstance(prior, gtsam.PriorFactorPose2)
    return float(graph.error(values) - prior.error(values))


def test_reversed_time_is_the_same_problem() -> None:
    """Any trajectory, however bad, has the same error read backwards."""
    world = worlds.loop(seed=3, poses=40)
    rng = np.random.default_rng(0)
    poses = world.poses + rng.normal(scale=0.1, size=world.poses.shape)
    back = reversed_problem(world.problem, poses[-1], FIXED)
    forth = error(world.problem, poses, world.landmarks)
    assert error(back, poses[::-1], world.landmarks) == pytest.approx(forth, rel=1e-9)
    # A broken variant: covariances that are not carried to the other end.
    broken = replace(back, increment_covariance=world.problem.increment_covariance[::-1])
    assert abs(error(broken, poses[::-1], world.landmarks) - forth) > 1e-3 * forth


def test_reversed_odometry_leads_back() -> None:
    problem = worlds.loop(seed=1, poses=60).problem
    there = dead_reckoned(problem.prior_pose, problem.increment)
    back = reversed_problem(problem, there[-1], FIXED)
    again = dead_reckoned(back.prior_pose, back.increment)
    assert np.allclose(again[::-1], there, atol=1e-9)
    assert np.array_equal(back.z, problem.z)
    assert np.array_equal(back.measurement_pose, problem.pose_count - 1 - problem.measurement_pose)


@pytest.mark.slow
def test_all_ways_to_associate_a_quiet_world_end_alike() -> None:
    world = worlds.loop(seed=2, poses=120)
    nobody = np.zeros(len(world.problem.z), dtype=np.intp)
    problem = replace(world.problem, measurement_landmark=nobody, landmark_count=1)
    own = associate(problem)
    label = world.problem.measurement_landmark
    for variant in variants():
        found = associate_by(problem, variant, own.poses[-1])
        used = found.landmark_index >= 0
        assert np.mean(used) > 0.8, variant.name
        pairs = set(zip(found.landmark_index[used].tolist(), label[used].tolist(), strict=True))
        assert len(pairs) == found.landmark_count, variant.name
        assert np.abs(found.poses - world.poses)[:, :2].max() < 1.0, variant.name
        assert np.abs(found.poses[0] - problem.prior_pose).max() < 0.1, variant.name


def test_the_ways_differ() -> None:
    ways = variants()
    assert len({way.name for way in ways}) == len(ways) == 4
    assert sum(way.backwards for way in ways) == 1
    assert len({(way.options, way.backwards) for way in ways}) == 4
