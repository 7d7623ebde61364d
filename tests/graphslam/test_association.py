"""The smoother's own association: running estimate, joint decision, logs without labels.

And other ways to associate: time reversed is the same problem, a quiet world tells no ways.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import gtsam
import numpy as np
import pytest

from graphslam import association
from graphslam.arrays import Mask
from graphslam.association import associate
from graphslam.association_variants import associate_by, reversed_problem, variants
from graphslam.graph_builder import POSE_KEY, build_graph, to_values
from graphslam.growing_smoother import GrowingSmoother
from graphslam.increments import dead_reckoned
from graphslam.marginals import joint_marginal
from graphslam.optimisers import levenberg_marquardt
from graphslam.problem import SlamProblem
from graphslam.relocalisation import PENDING, UNSEEN, Options, _likely, relocalise
from graphslam.running_estimate import RunningEstimate, wrapped
from tests.graphslam import worlds
from tests.graphslam.numerics import (
    Array,
    Index,
    central_difference,
    random_covariance,
    relative_error,
)
from tests.graphslam.worlds import World

POSTS = np.array([(6.0, -2.0), (6.0, 2.0), (9.0, 5.0)])


def unlabelled(problem: SlamProblem) -> SlamProblem:
    """Every measurement, nothing decided."""
    nobody = np.zeros(len(problem.z), dtype=np.intp)
    return replace(problem, measurement_landmark=nobody, landmark_count=1)


def running_estimate(heading_sigma: float, posts: Array = POSTS) -> RunningEstimate:
    covariance = np.diag([1e-4, 1e-4, heading_sigma**2, *np.full(posts.size, 1e-4)])
    return RunningEstimate(np.concatenate((np.zeros(3), posts.ravel())), covariance)


def seen(*points: tuple[float, float], heading: float = 0.0) -> tuple[Array, Array]:
    p = np.array(points)
    z = np.column_stack((np.hypot(*p.T), np.arctan2(p[:, 1], p[:, 0]) - heading))
    return z, np.tile((0.05**2, 0.01**2), (len(z), 1))


def test_expected_measurements_have_the_right_jacobian() -> None:
    state = np.concatenate((np.array([1.0, -2.0, 2.5]), POSTS.ravel()))

    def of(x: Array) -> Array:
        return RunningEstimate(x, np.eye(9)).expect(np.arange(3)).z.ravel()

    jacobian = RunningEstimate(state, np.eye(9)).expect(np.arange(3)).jacobian
    numeric = central_difference(of, state).reshape(3, 2, 9)
    for j in range(3):
        own = np.concatenate((numeric[j, :, :3], numeric[j, :, 3 + 2 * j : 5 + 2 * j]), axis=1)
        assert relative_error(jacobian[j], own) < 1e-7


def test_the_belief_is_moved_and_narrowed_as_a_gaussian() -> None:
    rng = np.random.default_rng(0)
    mean = np.concatenate((np.array([1.0, -2.0, 0.4]), POSTS.ravel()))
    prior, own = 0.01 * random_covariance(rng, 9), 0.01 * random_covariance(rng, 3)
    step = np.array([0.5, 0.1, 0.2])

    def moved(x: Array) -> Array:
        """State and a right perturbation (last three entries)."""
        cos, sin = np.cos(x[2]), np.sin(x[2])
        arrived = x[:3] + (cos * step[0] - sin * step[1], sin * step[0] + cos * step[1], step[2])
        cos, sin = np.cos(arrived[2]), np.sin(arrived[2])
        u, v, w = x[9:]
        return np.concatenate((arrived + (cos * u - sin * v, sin * u + cos * v, w), x[3:9]))

    it = RunningEstimate(mean, prior)
    it.move(step, own)
    jacobian = central_difference(moved, np.concatenate((mean, np.zeros(3))))
    joint = np.zeros((12, 12))
    joint[:9, :9], joint[9:, 9:] = prior, own
    assert np.allclose(it.mean, moved(np.concatenate((mean, np.zeros(3)))))
    assert relative_error(it.covariance, jacobian @ joint @ jacobian.T) < 1e-7

    before, landmark_indices = RunningEstimate(it.mean, it.covariance), np.array([2, 0, 2])
    z = before.expect(landmark_indices).z + rng.normal(0.0, 0.05, (3, 2))
    variance = np.array([[0.01, 1e-4], [0.02, 2e-4], [0.03, 1e-4]])
    h = central_difference(
        lambda x: RunningEstimate(x, np.eye(9)).expect(landmark_indices).z.ravel(), before.mean
    )
    information = np.linalg.inv(before.covariance) + h.T @ np.diag(1.0 / variance.ravel()) @ h
    it.learn(landmark_indices, z, variance)
    assert relative_error(it.covariance, np.linalg.inv(information)) < 1e-6
    nu = wrapped(z - before.expect(landmark_indices).z).ravel()
    shift = it.covariance @ h.T @ (nu / variance.ravel())
    assert relative_error(it.mean - before.mean, shift) < 1e-6
    two = np.array([0, 2])
    spread = before.spread(two, before.expect(two).jacobian)
    assert relative_error(spread, (h @ before.covariance @ h.T)[2:, 2:]) < 1e-6


def test_known_new_and_doubtful() -> None:
    o = Options()
    z, variance = seen((6.0, 2.0), (5.0, -8.0))
    assert relocalise(running_estimate(0.01), z, variance, o).tolist() == [1, PENDING]
    z, variance = seen(
        (6.3, 0.0)
    )  # half way between two posts, with a heading that allows for both
    assert relocalise(running_estimate(0.4), z, variance, o).tolist() == [UNSEEN]
    assert relocalise(running_estimate(0.01), z, variance, o).tolist() == [PENDING]


def test_two_together_decide_what_one_cannot() -> None:
    lost = running_estimate(
        0.4, np.array([(6.0 * np.cos(b), 6.0 * np.sin(b)) for b in (-0.6, -0.2, 0.6)])
    )
    ring = [(float(x), float(y)) for x, y in lost.landmarks]
    o = Options()
    z, variance = seen(ring[0], heading=-0.25)
    assert relocalise(RunningEstimate(lost.mean, lost.covariance), z, variance, o).tolist() == [
        UNSEEN
    ]
    z, variance = seen(ring[0], ring[1], heading=-0.25)
    assert relocalise(lost, z, variance, o).tolist() == [0, 1]


def test_what_stands_together_is_one_piece_of_evidence() -> None:
    """Three measurements of one clump narrow the running estimate as one does."""
    o = Options()
    one, three = running_estimate(0.2), running_estimate(0.2)
    relocalise(one, *seen((6.0, 2.0)), o)
    landmark_indices = relocalise(three, *seen((6.0, 2.0), (6.1, 2.1), (5.9, 1.9)), o)
    assert landmark_indices.tolist() == [1, 1, 1]
    assert relative_error(three.covariance, one.covariance) < 0.02


def enumerated(
    possible: Mask, innovations: tuple[Array, Array, Array], o: Options, joint: bool = True
) -> set[tuple[int, ...]]:
    """The likely hypotheses, each cost taken from its own S; joint: with its correlations."""
    nu, spread, noise = innovations
    new = -2.0 * math.log(2.0 * math.pi * o.new_density)
    costs = {}
    for choice in product(*([*np.flatnonzero(row).tolist(), -1] for row in possible)):
        paired = [i for i, column in enumerate(choice) if column >= 0]
        entries = [2 * choice[i] + axis for i in paired for axis in (0, 1)]
        s = spread[np.ix_(entries, entries)] + np.diag(noise[paired].ravel())
        if not joint:
            s = s * np.kron(np.eye(len(paired)), np.ones((2, 2)))
        innovation = np.concatenate([np.zeros(0), *(nu[i, choice[i]] for i in paired)])
        cost = innovation @ np.linalg.solve(s, innovation) + np.linalg.slogdet(s)[1]
        costs[choice] = cost + new * choice.count(-1)
    return {c for c, cost in costs.items() if cost <= min(costs.values()) + 2.0 * math.log(o.odds)}


def test_likely_hypotheses_are_those_of_a_full_enumeration() -> None:
    o, different = Options(most_hypotheses=10_000), 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        h = np.vstack([np.column_stack((np.eye(2), rng.normal(0.0, 8.0, 2))) for _ in range(5)])
        spread = h @ np.diag((0.1, 0.01, 0.002)) @ h.T + 0.001 * random_covariance(rng, 10)
        noise = np.tile((0.04, 0.004), (4, 1))
        nu = (h @ rng.normal(0.0, 0.05, 3)).reshape(5, 2) + rng.normal(0.0, 0.3, (4, 5, 2))
        possible = rng.random((4, 5)) < 0.6
        possible[~possible.any(axis=1), 0] = True
        found = _likely(possible, possible.argmax(axis=1), (nu, spread, noise), o).tolist()
        true = enumerated(possible, (nu, spread, noise), o)
        assert len(found) == len(true)
        assert {tuple(choice) for choice in found} == true
        different += true != enumerated(possible, (nu, spread, noise), o, joint=False)
    assert different > 6  # Costs without correlations would not do.


def pairs(*labels: Index) -> int:
    """Pairs of measurements with equal labels, each (M,); in all of them, of several."""
    counts = np.unique(np.column_stack(labels), axis=0, return_counts=True)[1]
    return int(np.sum(counts * (counts - 1) // 2))


def score(landmark_index: Index, true: Index) -> tuple[float, float]:
    """By pairs of measurements: precision and recall of a partition (M,), negative unused."""
    used = landmark_index >= 0
    together, right = pairs(landmark_index[used]), pairs(landmark_index[used], true[used])
    return right / together, right / pairs(true)


def nearest_by_dead_reckoning(world: World) -> Index:
    """The landmark (M,) that each measurement comes nearest to without any correction."""
    problem = world.problem
    at = dead_reckoned(problem.prior_pose, problem.increment)[problem.measurement_pose]
    bearing = at[:, 2] + problem.z[:, 1]
    ray = problem.z[:, :1] * np.column_stack((np.cos(bearing), np.sin(bearing)))
    apart = (at[:, :2] + ray)[:, None] - world.landmarks
    nearest: Index = np.linalg.norm(apart, axis=2).argmin(axis=1)
    return nearest


@pytest.mark.parametrize(("seed", "loops"), [(1, 1), (3, 2)])
def test_loops_are_closed_without_labels(seed: int, loops: int) -> None:
    world = worlds.loop(seed, poses=loops * worlds.LOOP + 40)
    true = world.problem.measurement_landmark
    precision, recall = score(associate(unlabelled(world.problem)).landmark_index, true)
    assert precision > 0.995
    assert recall > 0.99
    # Odometry alone would not do.
    assert score(nearest_by_dead_reckoning(world), true)[0] < 0.9


class FullSmoother(GrowingSmoother):
    """Everything anew after each piece."""

    def extend(self, factors: Sequence[gtsam.NonlinearFactor], start: gtsam.Values) -> None:
        for factor in factors:
            self._graph.push_back(factor)
        self.values.insert(start)
        self.solve()

    def solve(self) -> None:
        self.values, *_ = levenberg_marquardt(self._graph, self.values, 1e-10)

    def joint_covariance(self, keys: Sequence[int]) -> Array:
        size = sum(3 if key >= POSE_KEY else 2 for key in keys)
        return joint_marginal(self._graph.linearize(self.values), keys, size).covariance


class Unmoved(FullSmoother):
    """A broken variant: what was put somewhere stays there."""

    def solve(self) -> None:
        """Nothing."""


@pytest.mark.slow
def test_solving_anew_after_each_piece_decides_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = unlabelled(worlds.loop(1, poses=worlds.LOOP + 40).problem)
    growing = associate(problem)
    monkeypatch.setattr(association, "GrowingSmoother", FullSmoother)
    assert np.array_equal(associate(problem).landmark_index, growing.landmark_index)
    monkeypatch.setattr(association, "GrowingSmoother", Unmoved)
    assert np.mean(associate(problem).landmark_index != growing.landmark_index) > 0.05


def test_clutter_becomes_no_landmark() -> None:
    """A fifth more detections of nothing: nearly all stay unused, and the map is the same."""
    problem = worlds.loop(1).problem
    rng = np.random.default_rng(0)
    everything = unlabelled(problem)
    count = len(everything.z) // 5
    rows = rng.integers(0, len(everything.z), count)
    z = rng.uniform((3.0, -1.5), (20.0, 1.5), (count, 2))
    cluttered = replace(
        everything,
        measurement_pose=np.concatenate(
            (everything.measurement_pose, everything.measurement_pose[rows])
        ),
        measurement_landmark=np.zeros(len(everything.z) + count, dtype=np.intp),
        z=np.vstack((everything.z, z)),
        sigma=np.vstack((everything.sigma, everything.sigma[rows])),
    )
    found = associate(cluttered)
    assert np.mean(found.landmark_index[len(everything.z) :] < 0) > 0.8
    precision, _ = score(found.landmark_index[: len(everything.z)], problem.measurement_landmark)
    assert precision > 0.98
    assert found.landmark_count < 1.25 * problem.landmark_count


def test_landmarks_are_numbered_by_first_measurement() -> None:
    found = associate(unlabelled(worlds.loop(2, poses=150).problem))
    used = found.landmark_index[found.landmark_index >= 0]
    _, first = np.unique(used, return_index=True)
    assert np.all(np.diff(first) > 0)
    assert used.max() + 1 == found.landmark_count == len(found.landmarks)
    assert np.isfinite(found.landmarks).all()


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
