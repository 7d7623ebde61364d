"""The relaxed start, the alternatives of a minimum, and the search among minima."""

from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from graphslam import ambiguity, search, surroundings
from graphslam.ambiguity import alternatives, landmark_modes, loose, mirrors, windings
from graphslam.arrays import wrap_angle
from graphslam.graph_builder import POSE_KEY, build_graph, to_values
from graphslam.optimisers import _descend, optimise, polish
from graphslam.problem import LoopClosures, SlamProblem
from graphslam.relaxation import relax
from graphslam.search import MinimumSearch, draw, relaxed_values
from graphslam.smoother import smooth
from graphslam.surroundings import Surroundings
from tests.graphslam import worlds
from tests.graphslam.numerics import Array, angle


def silent(stage: str) -> None:
    """Takes what a search reports."""


def exact(seed: int) -> worlds.World:
    """A world without noise, with pose landmarks and one merge."""
    return worlds.with_frames(worlds.loop(seed, poses=120, noise=0.0), seed, noise=0.0)


def two_sided(seed: int) -> tuple[SlamProblem, Array, Array]:
    """A straight drive past six posts whose ranges are exact and bearings nearly unknown."""
    rng = np.random.default_rng(seed)
    poses = np.column_stack((np.arange(40.0), np.zeros((40, 2))))
    posts = np.column_stack((np.linspace(4.0, 36.0, 6), (3.0, -4.0, 5.0, -3.0, 4.0, -5.0)))
    offset = posts - poses[:, None, :2]
    pose, post = np.nonzero(np.hypot(offset[..., 0], offset[..., 1]) < 12.0)
    x, y = offset[pose, post].T
    sigma = np.array((0.02, 0.7))
    z = np.column_stack((np.hypot(x, y), np.arctan2(y, x)))
    step = np.array((0.05, 0.02, 0.01))
    problem = SlamProblem(
        prior_pose=np.zeros(3),
        prior_covariance=np.diag((0.01, 0.01, 0.002)) ** 2,
        increment=np.diff(poses, axis=0) + step * rng.standard_normal((39, 3)),
        increment_covariance=np.tile(np.diag(step**2), (39, 1, 1)),
        measurement_pose=pose,
        measurement_landmark=post,
        z=z + sigma * rng.standard_normal(z.shape),
        sigma=np.tile(sigma, (len(z), 1)),
        landmark_count=6,
    )
    return problem, poses, posts


def test_the_relaxed_start_is_exact_without_noise() -> None:
    world = exact(2)
    start = relax(world.problem)
    assert np.allclose(start.poses[:, :2], world.poses[:, :2], atol=1e-6)
    assert np.allclose(angle(start.poses[:, 2] - world.poses[:, 2]), 0.0, atol=1e-7)
    assert np.allclose(start.landmarks, world.landmarks, atol=1e-6)
    assert np.allclose(start.frames[:, :2], world.frames[:, :2], atol=1e-6)
    assert np.allclose(angle(start.frames[:, 2] - world.frames[:, 2]), 0.0, atol=1e-7)


def test_the_relaxed_start_uses_positions_and_surveyed_landmarks() -> None:
    """Positions of an antenna and known landmarks, moved by one metre, move the start with them."""
    world = worlds.loop(2, poses=120, noise=0.0)
    lever = np.array((1.5, 0.5))
    cos, sin = np.cos(world.poses[::10, 2]), np.sin(world.poses[::10, 2])
    antenna = world.poses[::10, :2] + np.column_stack(
        (cos * lever[0] - sin * lever[1], sin * lever[0] + cos * lever[1])
    )
    reported = replace(
        world.problem,
        prior_covariance=np.eye(3) * 1e4,
        prior_pose=np.zeros(3),
        position_pose=np.arange(0, 120, 10),
        position=antenna + 1.0,
        position_covariance=np.tile(np.eye(2) * 1e-6, (12, 1, 1)),
        lever_m=(1.5, 0.5),
    )
    assert np.allclose(relax(reported).poses[:, :2], world.poses[:, :2] + 1.0, atol=1e-3)
    surveyed = replace(
        world.problem,
        prior_covariance=np.eye(3) * 1e4,
        prior_pose=np.zeros(3),
        surveyed=world.landmarks[:3] - 1.0,
        surveyed_covariance=np.tile(np.eye(2) * 1e-6, (3, 1, 1)),
    )
    assert np.allclose(relax(surveyed).landmarks, world.landmarks - 1.0, atol=1e-2)


def test_the_relaxed_start_leads_where_tracking_does_not() -> None:
    problem, poses, posts = two_sided(0)
    graph = build_graph(problem)
    true = polish(graph, optimise(graph, to_values(poses, posts, np.arange(6)))[0])[1]
    result = smooth(problem, {})
    ends = {start.name: start.error for start in result.starts}
    assert ends["tracked"] > true + 10.0
    assert np.isclose(ends["relaxed"], true, rtol=1e-6)
    assert np.isclose(result.error, true, rtol=1e-6)
    assert result.optimality.verified, result.optimality.lacks
    assert len(result.optimality.exploration.minima) > 1
    assert result.optimality.exploration.draws > 0


def test_a_landmark_may_stand_on_the_other_side() -> None:
    problem, poses, posts = two_sided(1)
    modes = landmark_modes(problem, poses, posts)
    mirrored = posts * (1.0, -1.0)
    for landmark in range(6):
        places = modes.place[modes.landmark == landmark]
        assert np.linalg.norm(places - mirrored[landmark], axis=1).min() < 0.3
    back = landmark_modes(problem, poses, mirrored)
    assert (back.excess < 0.0).any()  # the right side is the better one
    first = alternatives(problem, poses, mirrored)[0]
    assert first.excess < 0.0
    assert np.count_nonzero(np.abs(first.landmarks - mirrored).max(axis=1) > 0.1) > 1


def test_a_sure_bearing_leaves_no_alternative() -> None:
    problem, poses, posts = two_sided(1)
    offset = posts[problem.measurement_landmark] - poses[problem.measurement_pose, :2]
    sure = replace(
        problem,
        sigma=np.tile((0.02, 0.02), (len(problem.z), 1)),
        z=np.column_stack((np.hypot(*offset.T), np.arctan2(offset[:, 1], offset[:, 0]))),
    )
    assert alternatives(sure, poses, posts) == []


def blind_loop(sigma_turn: float) -> tuple[SlamProblem, Array, Array]:
    """A round of 30 m without measurements, between two looks at three posts."""
    turn = np.concatenate((np.zeros(3), np.full(36, 2.0 * np.pi / 36), np.zeros(3)))
    increment = np.column_stack((np.full(42, 0.8), np.zeros(42), turn))
    heading = np.concatenate(([0.0], np.cumsum(turn)))
    step = increment[:, 0] * np.exp(1j * heading[:-1])
    place = np.concatenate(([0.0], np.cumsum(step)))
    poses = np.column_stack((place.real, place.imag, heading))
    posts = np.array(((3.0, 2.0), (5.0, -2.0), (7.0, 1.0)))
    pose = np.repeat(np.concatenate((np.arange(4), np.arange(39, 43))), 3)
    post = np.tile(np.arange(3), 8)
    x, y = (posts[post] - poses[pose, :2]).T
    variance = np.tile((0.03**2, 0.02**2, 0.01**2), (42, 1))
    variance[3:39, 2] = sigma_turn**2
    problem = SlamProblem(
        prior_pose=poses[0],
        prior_covariance=np.eye(3) * 1e-6,
        increment=increment,
        increment_covariance=np.array([np.diag(v) for v in variance]),
        measurement_pose=pose,
        measurement_landmark=post,
        z=np.column_stack((np.hypot(x, y), angle(np.arctan2(y, x) - poses[pose, 2]))),
        sigma=np.tile((0.05, 0.02), (24, 1)),
        landmark_count=3,
    )
    return problem, poses, posts


def test_a_poor_gyro_may_have_lost_a_turn() -> None:
    """The alternative keeps the poses outside the loop, one turn apart, and is a minimum."""
    problem, poses, posts = blind_loop(sigma_turn=0.3)
    found = list(windings(problem, poses, posts))
    turns = [round(float(one.poses[-1, 2] - poses[-1, 2]) / (2.0 * np.pi)) for one in found]
    assert sorted(turns) == [-1, 1]
    for one in found:
        assert np.allclose(one.poses[:4], poses[:4])
        assert np.allclose(one.poses[39:, :2], poses[39:, :2], atol=1e-9)
        assert np.isclose(one.excess, (2.0 * np.pi) ** 2 / (2.0 * 36 * 0.09))
    assert list(windings(blind_loop(sigma_turn=0.02)[0], poses, posts)) == []
    assert loose(problem)
    assert not loose(blind_loop(sigma_turn=0.02)[0])


def test_a_path_may_be_mirrored_where_directions_are_loose() -> None:
    """Surveyed posts on a line and ranges alone: the mirror image about them is as good."""
    problem, poses, posts = two_sided(0)
    line = posts * (1.0, 0.0)
    beside = poses + (0.0, 2.0, 0.0)
    offset = line[problem.measurement_landmark] - beside[problem.measurement_pose, :2]
    reported = replace(
        problem,
        prior_pose=beside[0],
        prior_covariance=np.diag((9.0, 9.0, 0.01)),
        increment=np.diff(beside, axis=0),
        z=np.column_stack((np.hypot(*offset.T), np.zeros(len(problem.z)))),
        sigma=np.tile((0.05, 3.0), (len(problem.z), 1)),
        surveyed=line,
        surveyed_covariance=np.tile(np.eye(2) * 1e-4, (6, 1, 1)),
    )
    assert loose(reported)
    images = [one.poses for one in mirrors(reported, beside, line)]
    about_line = beside * (1.0, -1.0, -1.0)
    assert min(np.abs(image - about_line).max() for image in images) < 1e-9
    assert all(np.array_equal(one.landmarks, line) for one in mirrors(reported, beside, line))
    minima = smooth(reported, {}).optimality.exploration.minima
    assert max(one.pose_m for one in minima) > 3.5  # the image was found and weighed


def test_other_minima_are_told_with_where_they_differ() -> None:
    """Without the turn's noise the lowest is the truth; one turn less is a minimum, too."""
    problem = blind_loop(sigma_turn=0.3)[0]
    result = smooth(problem, {})
    assert result.optimality.verified, result.optimality.lacks
    lowest, other = result.optimality.exploration.minima[:2]
    assert lowest.error < 1e-6
    assert lowest.furthest_m == 0.0
    assert other.error > 1.0
    assert 3 < other.pose < 39
    assert other.pose_m > 1.0


def test_a_landmark_that_nobody_saw_is_passed_over_where_minima_differ() -> None:
    """The fourth post on the other side, behind one that is not there: number 4 from 0."""
    problem, poses, posts = two_sided(0)
    problem = replace(
        problem, measurement_landmark=problem.measurement_landmark + 1, landmark_count=7
    )
    search = MinimumSearch(problem, build_graph(problem), "levenberg-marquardt", silent)
    for name, sign in (("right", 1.0), ("wrong", -1.0)):
        posts[3, 1] *= sign
        places = np.vstack((np.full(2, np.nan), posts))
        search.attempt(name, "sequential", search.values(poses, places))
    lowest, other = search._minima()
    assert (lowest.landmark_m, other.landmark) == (0.0, 4)
    assert other.landmark_m > 3.0


def test_a_hop_leads_out_of_a_local_minimum() -> None:
    """Begun with every post on the wrong side, hops alone reach the lowest error."""
    problem, poses, posts = two_sided(0)
    graph = build_graph(problem)
    search = MinimumSearch(problem, graph, "levenberg-marquardt", silent)
    wrong = search.attempt("wrong", "sequential", search.values(poses, posts * (1.0, -1.0)))
    search.explore()
    true = polish(graph, optimise(graph, to_values(poses, posts, np.arange(6)))[0])[1]
    assert wrong.error > true + 10.0
    assert np.isclose(search.best.error, true, rtol=1e-6)


def test_starts_of_one_kind_are_one_start() -> None:
    problem, poses, posts = two_sided(0)
    graph = build_graph(problem)
    search = MinimumSearch(problem, graph, "levenberg-marquardt", silent)
    search.attempt("tracked", "sequential", search.values(poses, posts))
    search.attempt("ekf", "sequential", search.values(poses, posts))
    assert len(search.agreeing()) == 2
    assert not search.agreed
    search.attempt_relaxed()
    assert search.agreed


def test_a_mirrored_world_is_not_verified() -> None:
    """A straight path, one post, and bearings that tell nothing of its side."""
    problem, poses, posts = two_sided(0)
    ahead = problem.measurement_landmark == 0
    offset = posts[0] - poses[problem.measurement_pose[ahead], :2]
    alone = replace(
        problem,
        increment=np.tile((1.0, 0.0, 0.0), (39, 1)),
        measurement_pose=problem.measurement_pose[ahead],
        measurement_landmark=problem.measurement_landmark[ahead],
        z=np.column_stack((np.hypot(*offset.T), np.where(offset[:, 0] > 0.0, 0.0, np.pi))),
        sigma=np.tile((0.02, 3.0), (int(ahead.sum()), 1)),
        landmark_count=1,
    )
    result = smooth(alone, {})
    assert not result.optimality.verified
    assert "another minimum, " in result.optimality.lacks


def test_a_draw_differs_by_the_stated_noise() -> None:
    """2,000 draws of one problem: mean and covariance are the measurement's."""
    problem = worlds.loop(1, poses=3).problem
    rng = np.random.default_rng(0)
    drawn = np.array([draw(problem, rng).increment[0] for _ in range(2000)])
    spread = np.cov(drawn.T) - problem.increment_covariance[0]
    scale = np.sqrt(np.outer(*(np.diag(problem.increment_covariance[0]),) * 2))
    assert np.abs(spread / scale).max() < 5.0 * np.sqrt(2.0 / 2000)


def test_a_large_graph_is_searched_nearby(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same hops come back to the same minimum, none of them over the whole graph."""
    world = worlds.loop(2)
    guess = {"truth": (world.poses, world.landmarks)}
    whole = smooth(world.problem, guess)
    monkeypatch.setattr(search, "NEARBY_POSES", world.problem.pose_count - 1)
    monkeypatch.setattr(MinimumSearch, "_trial", None)
    nearby = smooth(world.problem, guess)
    assert whole.optimality.exploration.hops > 0
    for one, other in zip(*(r.optimality.exploration.minima for r in (nearby, whole)), strict=True):
        assert one.starts == other.starts
        assert one.error == pytest.approx(other.error)
    assert nearby.optimality.exploration.hops == whole.optimality.exploration.hops
    assert nearby.optimality.verified
    # What is not pinned drifts away, and no hop comes back.
    monkeypatch.setattr(surroundings, "PINNED", 10.0)
    with pytest.raises(TypeError, match="not callable"):
        smooth(world.problem, guess)


def test_a_nearby_trial_that_leads_below_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """One landmark of a straight drive with poor bearings is on the wrong side."""
    problem, poses, posts = two_sided(0)
    graph = build_graph(problem)
    monkeypatch.setattr(search, "NEARBY_POSES", problem.pose_count - 1)
    monkeypatch.setattr(search, "LOCAL_POSES", problem.pose_count - 1)

    def hop() -> tuple[float, float]:
        one = MinimumSearch(problem, graph, "levenberg-marquardt", silent)
        aside = np.where(np.arange(6)[:, None] == 2, posts * (1.0, -1.0), posts)
        wrong = one.attempt("wrong", "sequential", one.values(poses, aside))
        lower = one._hop(wrong)
        return wrong.error, wrong.error if lower is None else lower.error

    before, after = hop()
    assert after < before - 1.0
    monkeypatch.setattr(search, "FOLLOWED", -np.inf)
    before, after = hop()
    assert after == before
    # What it costs nearby does not count in a graph that is not as large.
    monkeypatch.setattr(search, "LOCAL_POSES", problem.pose_count)
    before, after = hop()
    assert after < before - 1.0


def test_a_hop_that_comes_back_is_not_polished(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is counted where it came back; polishing would only find the same end again."""
    world = worlds.loop(2)
    graph = build_graph(world.problem)
    polished = []

    def counted(*given: Any) -> Any:
        polished.append(given)
        return polish(*given)

    def explored() -> tuple[int, int]:
        one = MinimumSearch(world.problem, graph, "levenberg-marquardt", silent)
        one.attempt("truth", "sequential", one.values(world.poses, world.landmarks))
        one.attempt_relaxed()
        polished.clear()
        ends = one.explore()
        assert [m.starts for m in ends.minima] == [2 + ends.hops]
        return ends.hops, len(polished)

    monkeypatch.setattr(search, "polish", counted)
    hops, count = explored()
    assert hops > 0
    assert count == 0
    rough = MinimumSearch._rough
    monkeypatch.setattr(MinimumSearch, "_rough", lambda self, start, left: rough(self, start))
    assert explored() == (hops, hops)


def test_surroundings_hold_every_factor_of_the_poses_that_saw_a_landmark() -> None:
    """Prior, increments, measurements and positions; a pinned variable adds nothing."""
    world = worlds.loop(2)
    some = np.arange(0, world.problem.pose_count, 3)
    problem = replace(
        world.problem,
        position_pose=some,
        position=world.poses[some, :2] + 0.1 * np.sin(some)[:, None],
        position_covariance=np.tile(0.04 * np.eye(2), (len(some), 1, 1)),
    )
    graph, values = build_graph(problem), relaxed_values(problem)
    for landmark in (problem.measurement_landmark[0], problem.measurement_landmark[-1]):
        saw = POSE_KEY + problem.measurement_pose[problem.measurement_landmark == landmark]
        factors = [graph.at(i) for i in range(graph.size())]
        touching = [f for f in factors if set(saw.tolist()).intersection(f.keys())]
        near = Surroundings(problem, graph, values, int(landmark))
        expected = sum(f.error(values) for f in touching)
        assert near._graph.error(near._values) == pytest.approx(expected)


def test_a_step_that_nothing_measured_is_no_blind_stretch() -> None:
    """The stretch behind it is one, which four turns of 0.3 rad leave loose."""
    spread = np.tile(np.diag((1e-4, 1e-4, 0.09)), (7, 1, 1))
    spread[1] = np.nan
    tight = 1e-4 * np.eye(3)
    problem = worlds.chain(
        np.tile((1.0, 0.0, 0.0), (7, 1)),
        spread,
        prior_covariance=tight,
        loop_closures=LoopClosures(
            np.array([0, 3]),
            np.array([3, 7]),
            np.array([[3.0, 0.0, 0.0], [4.0, 0.0, 0.0]]),
            np.array([tight, tight]),
        ),
    )
    assert loose(problem)
    poses = np.column_stack((np.arange(8.0), np.zeros((8, 2))))
    assert all(
        np.isfinite(other.poses).all() for other in windings(problem, poses, np.zeros((0, 2)))
    )
    spread[3:, 2, 2] = 1e-6
    assert not loose(problem)


def test_of_starts_that_tie_the_first_is_the_best() -> None:
    """Which of two ends at one optimum is lower is rounding."""
    world = worlds.loop(3, poses=20)
    graph = build_graph(world.problem)
    one = MinimumSearch(world.problem, graph, "levenberg-marquardt", silent)
    first = one.attempt("first", "relaxed", relaxed_values(world.problem))
    for lower, best in ((1e-9, "first"), (1e-4, "second")):
        second = replace(first, name="second", error=first.error - lower)
        one.attempts[:] = [first, second]
        assert one.best.name == best


class Ending:
    """An optimiser that is at the minimum after two iterations; noise is what it gains then."""

    def __init__(self, noise: float) -> None:
        self.errors = [4.0, 2.0, 1.0, 1.0 - max(noise, 0.0)]

    def error(self) -> float:
        return self.errors[0]

    def iterate(self) -> None:
        self.errors = self.errors[1:]


@pytest.mark.parametrize("noise", [1e-11, 0.0, -1e-11])
def test_iterations_do_not_count_by_the_sign_of_a_rounding_error(noise: float) -> None:
    """A last step is one, whether it is taken or, for it gains nothing, is not."""
    ending: Any = Ending(noise)
    assert _descend(ending, 1e-5, limit=10) == 3


def test_no_place_of_a_landmark_is_tried_opposite_to_its_bearing() -> None:
    """The residual there is pi or -pi, as rounding has it, and leads to one side or the other."""
    problem, poses, posts = two_sided(1)
    tried: list[Array] = []

    def watch(values: Array) -> Array:
        tried.append(np.asarray(values))
        return wrap_angle(values)

    with patch.object(ambiguity, "wrap_angle", watch):
        landmark_modes(problem, poses, posts)
    assert tried
    residuals = np.concatenate([np.ravel(wrap_angle(one)) for one in tried])
    assert np.min(np.pi - np.abs(residuals)) > 1e-6
