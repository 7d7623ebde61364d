"""The smoother's ways: starts, optimisers, kernels, iSAM2, fixed lag."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.typing import NDArray

from graphslam.arrays import Marginal
from graphslam.graph_builder import build_graph, last_poses
from graphslam.incremental import run_fixed_lag
from graphslam.initialisation import extension
from graphslam.marginals import SingularProblemError
from graphslam.observability import explain_singularity
from graphslam.optimisers import OPTIMISERS
from graphslam.problem import SlamProblem
from graphslam.smoother import SmootherOptions, _distance, _Followed, smooth
from tests.graphslam import worlds
from tests.graphslam.numerics import relative_error


@pytest.fixture(scope="module")
def problem() -> SlamProblem:
    return worlds.loop(1, poses=300).problem


def wild(problem: SlamProblem, share: float) -> tuple[SlamProblem, NDArray[np.bool_]]:
    """Some measurements replaced by anything; which."""
    rng = np.random.default_rng(0)
    rows = rng.random(len(problem.z)) < share
    z = problem.z.copy()
    z[rows] = rng.uniform((1.0, -1.5), (20.0, 1.5), (int(rows.sum()), 2))
    return replace(problem, z=z), rows


def apart(one: Marginal, other: Marginal) -> float:
    """The largest difference of covariances, in products of the other's sigmas."""
    sigma = np.sqrt(other.covariance.diagonal())
    return float(np.abs((one.covariance - other.covariance) / np.outer(sigma, sigma)).max())


def test_last_poses_follow_the_order_of_the_graph(problem: SlamProblem) -> None:
    graph, last = build_graph(problem), last_poses(problem)
    assert len(last) == graph.size()
    pose = gtsam.symbolChr(gtsam.symbol("x", 0))
    for row in range(0, graph.size(), 7):
        keys = list(graph.at(row).keys())
        poses = [gtsam.symbolIndex(key) for key in keys if gtsam.symbolChr(key) == pose]
        assert max(poses, default=0) == last[row]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_tracking_ends_where_the_truth_would(seed: int) -> None:
    """Two loops at twice the noise: the optimum is the one that a start at the truth reaches."""
    world = worlds.loop(seed, poses=2 * worlds.LOOP, noise=2.0)
    tracked = smooth(world.problem, {})
    best = smooth(world.problem, {"truth": (world.poses, world.landmarks)})
    assert abs(tracked.error - best.error) < 1e-6 * best.error


@pytest.mark.parametrize("name", OPTIMISERS)
def test_optimisers_agree(problem: SlamProblem, name: str) -> None:
    reference = smooth(problem, {})
    other = smooth(problem, {}, options=SmootherOptions(optimiser=name))
    assert abs(other.error - reference.error) < 1e-9 * reference.error
    assert other.optimality.verified
    assert other.rank == problem.state_dimension


def test_isam2_reaches_the_optimum(problem: SlamProblem) -> None:
    result = smooth(problem, {}, options=SmootherOptions("isam2"))
    assert result.optimality.distance_sigma < 0.05
    assert result.optimality.verified
    assert {start.name for start in result.starts} == {"relaxed", "isam2"}


def test_whole_turns_are_no_distance_from_the_optimum(problem: SlamProblem) -> None:
    """Of the last heading; a hundredth of a radian is one."""
    optimum = smooth(problem, {})
    apart_sigma = []
    for turn in (0.0, 2.0 * np.pi, 0.01):
        poses = optimum.poses + (0.0, 0.0, turn)
        followed = _Followed(poses, optimum.landmarks, optimum.pose_landmarks(), None)
        apart_sigma.append(_distance(optimum, followed))
    assert max(apart_sigma[:2]) < 1e-9
    sigma = np.sqrt(optimum.marginal().covariance[2, 2])
    assert apart_sigma[2] == pytest.approx(0.01 / sigma, rel=1e-6)


@pytest.mark.slow
def test_fixed_lag_says_how_far_it_drifts(problem: SlamProblem) -> None:
    """A lag as long as the log is the batch; a short one drifts, and is not taken for verified."""
    batch = smooth(problem, {})
    whole = smooth(problem, {}, options=SmootherOptions("fixed-lag", lag=10_000))
    assert whole.optimality.distance_sigma < 0.05
    assert apart(whole.marginal(), batch.marginal()) < 0.02
    loop = worlds.loop(0).problem  # which comes back to its beginning
    short = smooth(loop, {}, options=SmootherOptions("fixed-lag", lag=5))
    assert short.optimality.distance_sigma > 0.05
    assert not short.optimality.verified
    assert short.pose_covariances().shape == (loop.pose_count, 3, 3)
    assert np.linalg.eigvalsh(short.pose_covariances()).min() > 0.0


def test_fixed_lag_keeps_every_pose(problem: SlamProblem) -> None:
    """Within its sigmas of the batch, which has seen more; those of the pose before are not."""
    end = run_fixed_lag(problem, build_graph(problem), 20)
    batch = smooth(problem, {}).poses
    sigma = np.sqrt(np.einsum("kii->ki", end.pose_covariance))
    assert np.abs((end.poses - batch) / sigma).max() < 0.5
    assert np.abs((end.poses[:-1] - batch[1:]) / sigma[:-1]).max(axis=0).min() > 2.0


@pytest.mark.slow
def test_wild_measurements_are_found_and_left_out(problem: SlamProblem) -> None:
    """30 % of them; what is left is the problem without them."""
    spoilt, rows = wild(problem, 0.3)
    plain = smooth(spoilt, {})
    assert plain.optimality.chi_square.reading == "too high"
    result = smooth(spoilt, {}, options=SmootherOptions(robust="gnc"))
    rejected = np.zeros(len(rows), dtype=bool)
    rejected[result.rejected.measurements] = True
    assert np.mean(rejected[rows]) > 0.98
    assert np.mean(rejected[~rows]) < 0.02
    mean, covariance = smooth(problem, {}).marginal()
    apart = result.landmarks.ravel() - mean[3:]
    assert np.max(np.abs(apart) / np.sqrt(covariance.diagonal()[3:])) < 3.0
    assert len(result.problem.z) == len(problem.z) - len(result.rejected.measurements)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["huber", "cauchy"])
def test_kernels_resist_a_few_wild_measurements(problem: SlamProblem, kernel: str) -> None:
    spoilt, _ = wild(problem, 0.05)
    clean = smooth(problem, {}).landmarks
    plain = np.linalg.norm(smooth(spoilt, {}).landmarks - clean, axis=1)
    result = smooth(spoilt, {}, options=SmootherOptions(robust=kernel))
    assert np.median(np.linalg.norm(result.landmarks - clean, axis=1)) < 0.5 * np.median(plain)
    assert result.optimality.chi_square.dof == 0  # not tested under a kernel


@pytest.mark.parametrize(
    "wrong", [{"method": "best"}, {"lag": 0}, {"optimiser": "adam"}, {"robust": "tukey"}]
)
def test_unknown_choices_are_named(wrong: dict[str, str]) -> None:
    [name] = wrong
    with pytest.raises(ValueError, match=name):
        SmootherOptions(**wrong)  # type: ignore[arg-type]


def singular(problem: SlamProblem, graph: gtsam.NonlinearFactorGraph) -> str:
    values = extension(problem, gtsam.Values(), 0, problem.pose_count)
    return explain_singularity(graph, values)


def test_what_is_not_determined_is_named(problem: SlamProblem) -> None:
    graph = build_graph(problem)
    assert not singular(problem, graph)
    loose = gtsam.NonlinearFactorGraph()
    for row in range(1, graph.size()):
        loose.push_back(graph.at(row))
    assert "no prior" in singular(problem, loose)
    of_landmark = set(
        (np.flatnonzero(problem.measurement_landmark == 3) + problem.pose_count).tolist()
    )
    kept = gtsam.NonlinearFactorGraph()
    for row in set(range(graph.size())) - of_landmark:
        kept.push_back(graph.at(row))
    assert singular(problem, kept) == "no measurement constrains landmark 3"


def test_a_landmark_seen_by_bearing_only_is_named(problem: SlamProblem) -> None:
    """One measurement whose range says nothing."""
    once = problem.measurement_landmark != 5
    once[np.flatnonzero(~once)[0]] = True
    sigma = problem.sigma.copy()
    sigma[problem.measurement_landmark == 5, 0] = 1e9
    lone = replace(
        problem,
        measurement_pose=problem.measurement_pose[once],
        measurement_landmark=problem.measurement_landmark[once],
        z=problem.z[once],
        sigma=sigma[once],
    )
    said = singular(lone, build_graph(lone))
    assert said.startswith("landmark 5 can move freely")
    assert "one measurement" in said


def test_a_landmark_that_nobody_saw_is_no_crash(problem: SlamProblem) -> None:
    more = replace(problem, landmark_count=problem.landmark_count + 1)
    with pytest.raises(SingularProblemError):
        smooth(more, {}).marginal()


def test_any_block_has_a_covariance(problem: SlamProblem) -> None:
    """Two poses and two landmarks jointly; their own blocks are those of the usual marginals."""
    result = smooth(problem, {})
    last = problem.pose_count - 1
    joint = result.joint([last, 40], [3, 0])
    assert np.allclose(joint, joint.T)
    marginal, poses = result.marginal().covariance, result.pose_covariances()
    assert relative_error(joint[:3, :3], marginal[:3, :3]) < 1e-8
    assert relative_error(joint[3:6, 3:6], poses[40]) < 1e-8
    assert relative_error(joint[6:8, 6:8], marginal[9:11, 9:11]) < 1e-8
    assert relative_error(joint[:3, 8:], marginal[:3, 3:5]) < 1e-8


@pytest.mark.parametrize("lag", [1, 5])
def test_a_blind_stretch_may_be_longer_than_the_lag(lag: int) -> None:
    """What leaves the lag has come in before."""
    problem = worlds.loop(1, poses=40).problem
    blind = problem.keep(
        (problem.measurement_pose < 8) | (problem.measurement_pose > 30),
        np.zeros(0, dtype=np.bool_),
    )
    result = smooth(blind, {}, options=SmootherOptions("fixed-lag", lag=lag))
    assert np.isfinite(result.poses).all()
