"""The smoother that grows with a log is the smoother: its optimum, and its covariances."""

from dataclasses import replace
from itertools import pairwise

import gtsam
import numpy as np
import pytest

from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY, build_graph, last_poses, to_values
from graphslam.growing_smoother import GrowingSmoother
from graphslam.increments import dead_reckoned
from graphslam.marginals import SingularProblemError, joint_marginal
from graphslam.optimisers import levenberg_marquardt
from graphslam.problem import SlamProblem
from tests.graphslam import worlds
from tests.graphslam.numerics import relative_error

ENDS = (0, 100, 250, 400, 465)


def grown(world: worlds.World, problem: SlamProblem) -> GrowingSmoother:
    """Poses enter where the odometry leads from the last one, in pieces; landmarks where they are.

    problem: the world's, or a variant of it.
    """
    graph, last, growing = build_graph(problem), last_poses(problem), GrowingSmoother()
    reckoned = dead_reckoned(problem.prior_pose, problem.increment)
    known = np.zeros(0, dtype=np.intp)
    for begin, end in pairwise(ENDS):
        start, before = gtsam.Values(), gtsam.Pose2()
        if begin:
            there = gtsam.Pose2(*reckoned[begin - 1])
            before = growing.values.atPose2(POSE_KEY + begin - 1).compose(there.inverse())
        for k in range(begin, end):
            start.insert(POSE_KEY + k, before.compose(gtsam.Pose2(*reckoned[k])))
        seen = np.unique(problem.measurement_landmark[problem.measurement_pose < end])
        for j in np.setdiff1d(seen, known).tolist():
            start.insert(LANDMARK_KEY + j, world.landmarks[j])
        known = seen
        rows = np.flatnonzero((last >= begin) & (last < end))
        growing.extend([graph.at(row) for row in rows.tolist()], start)
    return growing


def test_growing_leads_to_the_optimum_and_its_joint_covariance() -> None:
    world = worlds.loop(1, poses=ENDS[-1])
    graph, growing = build_graph(world.problem), grown(world, world.problem)
    seen = np.unique(world.problem.measurement_landmark)
    start = to_values(world.poses, world.landmarks, seen)
    optimum, *_ = levenberg_marquardt(graph, start, 1e-12)
    # All unknowns together are within a tenth of a sigma, 0.1^2 / 2.
    assert graph.error(growing.values) == pytest.approx(graph.error(optimum), abs=5e-3)
    # The last pose, then landmarks from last to first, which is not the order of elimination.
    keys = [POSE_KEY + ENDS[-1] - 1, *(LANDMARK_KEY + seen[::-1]).tolist()]
    expected = joint_marginal(graph.linearize(optimum), keys, 3 + 2 * len(seen)).covariance
    found = growing.joint_covariance(keys)
    assert relative_error(found, expected) < 0.01
    ratio = np.linalg.eigvals(np.linalg.solve(expected, found)).real
    assert ratio.min() > 0.95  # nowhere surer than the smoother by more than 2.5 % of a sigma
    # Some landmarks have the marginal of all, not what is left when the others are known.
    some = growing.joint_covariance(keys[:6])
    assert relative_error(some, found[: len(some), : len(some)]) < 1e-9
    conditional = np.linalg.inv(np.linalg.inv(found)[: len(some), : len(some)])
    assert relative_error(conditional, some) > 0.1


def test_where_cholesky_breaks_down_qr_goes_on() -> None:
    """Increments of next to no noise, beside a prior of a centimetre."""
    world = worlds.loop(1, poses=ENDS[-1], noise=0.0)
    problem = replace(
        world.problem, increment_covariance=1e-14 * world.problem.increment_covariance
    )
    growing = grown(world, problem)
    assert growing._exact
    assert build_graph(problem).error(growing.values) < 1e-3


def test_what_has_no_information_is_refused() -> None:
    growing, start = GrowingSmoother(), gtsam.Values()
    for k in (0, 1):
        start.insert(POSE_KEY + k, gtsam.Pose2(float(k), 0.0, 0.0))
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.ones(3))
    step = gtsam.BetweenFactorPose2(POSE_KEY, POSE_KEY + 1, gtsam.Pose2(1.0, 0.0, 0.0), noise)
    with pytest.raises(SingularProblemError, match="do not fix"):
        growing.extend([step], start)
