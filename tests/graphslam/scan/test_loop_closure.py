"""Loops: which are tried, which are believed, and what they do for the estimate."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from graphslam.increments import dead_reckoned
from graphslam.problem import SlamProblem
from graphslam.scan import loop_closure, planar
from graphslam.scan.loop_closure import (
    Closed,
    KeyframeEstimate,
    LoopOptions,
    NoLoopClosure,
    RegistrationLoopCloser,
    choose_keyframes,
    loop_closer,
    starts,
)
from graphslam.scan.matchers import SurfaceMatcher
from graphslam.scan.odometry import KissIcpOptions
from graphslam.scan.registration import Registration, ScanError
from graphslam.smoother import smooth
from tests.graphslam.numerics import Array, central_difference, random_covariance, relative_error
from tests.graphslam.scan.shapes import BLOCK, ROOM, round_the_block, scan
from tests.graphslam.worlds import chain

STEP_SIGMA = np.array((0.02, 0.01, 0.01))


def even_chain(moves: Array, covariance: Array) -> SlamProblem:
    """Poses from the origin on by increments (K, 3), all with the same covariance."""
    spread = np.tile(covariance, (len(moves), 1, 1))
    return chain(moves, spread, prior_covariance=1e-6 * np.eye(3))


@cache
def drive() -> tuple[Array, SlamProblem, dict[int, Array]]:
    """True poses, what odometry says, and scans at every second pose."""
    rng = np.random.default_rng(4)
    moves = round_the_block()
    true = dead_reckoned(np.array((-6.0, -6.0, 0.0)), moves)
    noisy = np.array([planar.compose(move, rng.normal(size=3) * STEP_SIGMA) for move in moves])
    problem = replace(even_chain(noisy, np.diag(STEP_SIGMA**2)), prior_pose=true[0])
    return true, problem, {k: scan(rng, BLOCK, true[k], 0.02) for k in range(0, len(true), 2)}


@cache
def closed() -> Closed:
    _, problem, clouds = drive()
    return loop_closer(KissIcpOptions()).close(problem, clouds)


def position_error(problem: SlamProblem, true: Array) -> float:
    offset = smooth(problem, {}).poses[:, :2] - true[:, :2]
    return float(np.sqrt((offset**2).sum(axis=1).mean()))


@pytest.mark.slow
def test_a_drive_round_the_block_is_closed() -> None:
    true, problem, _ = drive()
    found = closed().loop_closures
    assert len(found.first) >= 5
    assert (found.second - found.first > 50).all()
    assert found.kernel == "cauchy"
    squared = []
    for i, j, motion, covariance in zip(
        found.first, found.second, found.motion, found.covariance, strict=True
    ):
        error = planar.wrapped(planar.between(motion, planar.between(true[i], true[j])))
        squared.append(error @ np.linalg.solve(covariance, error))
        assert (np.abs(error) < 3.0 * np.sqrt(np.diag(covariance))).all()
    assert 0.1 < np.mean(squared) < 3.0
    before, after = (
        position_error(p, true) for p in (problem, replace(problem, loop_closures=found))
    )
    assert after < 0.4 * before


def test_every_attempt_says_what_came_of_it() -> None:
    found = closed()
    accepted = [(a.first, a.second) for a in found.attempts if a.outcome == "accepted"]
    pairs = zip(
        found.loop_closures.first.tolist(), found.loop_closures.second.tolist(), strict=True
    )
    assert sorted(accepted) == list(pairs)
    assert all(a.outcome and "\n" not in a.outcome for a in found.attempts)


@pytest.mark.slow
def test_the_same_scans_close_the_same_loops() -> None:
    _, problem, clouds = drive()
    again = loop_closer(KissIcpOptions()).close(problem, clouds)
    assert np.array_equal(again.loop_closures.motion, closed().loop_closures.motion)
    assert np.array_equal(again.loop_closures.covariance, closed().loop_closures.covariance)


def test_no_loop_closure_changes_nothing() -> None:
    _, problem, clouds = drive()
    nothing = NoLoopClosure().close(problem, clouds)
    assert nothing.attempts == ()
    assert len(nothing.loop_closures.first) == 0
    with_it = smooth(replace(problem, loop_closures=nothing.loop_closures), {})
    assert np.array_equal(with_it.poses, smooth(problem, {}).poses)


class Refusing:
    """A matcher that finds nothing, and counts how often it was asked."""

    def match(self, source: Array, target: Array, guess: Array) -> Registration:
        raise ScanError("nothing fits")


def tried(sigma: tuple[float, ...], options: LoopOptions | None = None) -> int:
    """Pairs tried on a way out along x and back 13 m to the left, by sigmas per step."""
    straight, turn = np.array((1.0, 0.0, 0.0)), np.array((1.0, 0.0, np.pi / 10))
    moves = np.vstack((np.tile(straight, (20, 1)), np.tile(turn, (5, 1)), np.tile(straight, (7, 1)),
                       np.tile(turn, (5, 1)), np.tile(straight, (20, 1))))  # fmt: skip
    problem = even_chain(moves, np.diag(np.square(sigma)))
    cloud = scan(np.random.default_rng(0), ROOM, np.zeros(3), 0.0)
    clouds = dict.fromkeys(range(len(moves) + 1), cloud)
    return len(RegistrationLoopCloser(Refusing(), options).close(problem, clouds).attempts)


def test_candidates_are_those_that_may_lie_within_reach() -> None:
    """The same poses throughout: it is their covariance that decides, along the way between."""
    least = 1e-4
    assert tried((0.01, 0.01, least)) == 0
    assert tried((1.0, 1.0, least)) > 20
    # Errors ahead, between the streets, blur the distance of all pairs; errors to the side only
    # that of pairs far out.
    assert tried((1.0, 0.01, least)) > 2 * tried((0.01, 1.0, least)) > 0
    far = LoopOptions(reach_m=20.0)
    assert tried((0.01, 0.01, least), far) > 20
    assert tried((1.0, 1.0, least), replace(far, apart_m=1e3)) == 0


class BlindMatcher:
    """Place recognition by looks alone: it asks no graph where to begin."""

    def match(self, source: Array, target: Array, guess: Array) -> Registration:
        return SurfaceMatcher().match(source, target, np.zeros(3))


def alike() -> tuple[SlamProblem, dict[int, Array]]:
    """Two rooms alike, 10 m apart by a way of 20 m that is known to 2.2 m."""
    moves = np.array(((6.0, 0.0, 0.0), (0.0, 5.0, 0.0), (4.0, 0.0, 0.0), (0.0, -5.0, 0.0)))
    sigma = 2.2 / np.sqrt(4.0)
    problem = even_chain(moves, np.diag((sigma**2, sigma**2, 1e-6)))
    rng = np.random.default_rng(0)
    return problem, {k: scan(rng, ROOM, np.zeros(3), 0.01) for k in (0, 4)}


def test_places_that_look_alike_are_told_apart_by_the_graph(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem, clouds = alike()
    closer = RegistrationLoopCloser(BlindMatcher(), LoopOptions(neighbours=0))
    found = closer.close(problem, clouds)
    assert [a.outcome.partition(":")[0] for a in found.attempts] == ["contradicts the graph"]
    assert len(found.loop_closures.first) == 0
    # Nothing else speaks against it.
    monkeypatch.setattr(loop_closure, "_CHI2_3_999", np.inf)
    believed = closer.close(problem, clouds)
    assert believed.loop_closures.second.tolist() == [4]
    assert np.abs(believed.loop_closures.motion).max() < 0.05


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"overlap": 0.5}, "overlap 0.50, expected 0.7 at least"),
        ({"residual_m": 0.3}, "residual 0.300 m, expected 0.15 m at most"),
        (
            {"stiffness": np.array((5.0, 90.0, 90.0))},
            "the surroundings do not constrain one direction",
        ),
        ({}, "accepted"),
    ],
)
def test_what_speaks_against_a_match(change: dict[str, object], reason: str) -> None:
    good = Registration(
        motion=np.array((9.5, 0.0, 0.0)),
        covariance=1e-4 * np.eye(3),
        inliers=300,
        overlap=0.9,
        residual_m=0.02,
        stiffness=np.array((50.0, 90.0, 90.0)),
    )

    class Fixed:
        def match(self, source: Array, target: Array, guess: Array) -> Registration:
            return replace(good, **change)  # type: ignore[arg-type]

    found = RegistrationLoopCloser(Fixed(), LoopOptions(neighbours=0)).close(*alike())
    assert [a.outcome for a in found.attempts] == [reason]
    if reason == "accepted":
        widened = 1e-4 * np.eye(3) + np.diag((0.02**2, 0.02**2, 0.003**2))
        assert relative_error(found.loop_closures.covariance[0], widened) < 1e-12


def test_a_relative_pose_has_the_covariance_of_its_two_poses() -> None:
    _, problem, _ = drive()
    rng = np.random.default_rng(1)
    # Covariances with correlations, so that nothing vanishes by chance.
    spread = np.array([1e-4 * random_covariance(rng, 3) for _ in problem.increment])
    result = smooth(replace(problem, increment_covariance=spread), {})
    keyframes = np.array((31, 56, 92, 113))
    running_estimate = KeyframeEstimate(result, keyframes)
    for first, second in ((0, 1), (1, 3), (3, 0)):
        i, j = int(keyframes[first]), int(keyframes[second])

        def relative(poses: Array) -> Array:
            return planar.between(poses[:3], poses[3:])

        motion, covariance = running_estimate.relative(first, second)
        poses = np.concatenate((result.poses[i], result.poses[j]))
        jacobian = central_difference(relative, poses)
        expected = jacobian @ result.joint([i, j], []) @ jacobian.T
        assert relative_error(motion, planar.wrapped(relative(poses))) < 1e-12
        assert relative_error(covariance, expected) < 1e-7
        turned = jacobian.copy()
        for block in (turned[:2, :2], turned[:2, 3:5]):
            block[:] = block.T.copy()
        assert relative_error(covariance, turned @ result.joint([i, j], []) @ turned.T) > 0.1
        places = running_estimate.position_spread(np.array([first]), second)[0]
        apart = np.hstack((-np.eye(2), np.zeros((2, 1)), np.eye(2), np.zeros((2, 1))))
        assert relative_error(places, apart @ result.joint([i, j], []) @ apart.T) < 1e-9


def test_a_match_is_as_unsure_as_what_it_was_matched_with() -> None:
    """A source that goes with a keyframe wherever that one is, against central differences."""
    problem = drive()[1]
    running_estimate = KeyframeEstimate(smooth(problem, {}), np.array((29, 31, 33)))
    motion = np.array((1.5, -2.0, 0.8))
    place, spread = running_estimate.relative(1, 2)
    offset = planar.between(place, motion)

    def astray(place: Array) -> Array:
        return planar.between(motion, planar.compose(place, offset))

    jacobian = central_difference(astray, place)
    # The base is where it is by definition, so that it counts half.
    expected = 0.5 * jacobian @ spread @ jacobian.T
    assert relative_error(running_estimate.misplacement(1, range(1, 3), motion), expected) < 1e-7
    assert relative_error(0.5 * spread, expected) > 0.1
    assert np.abs(running_estimate.misplacement(1, range(1, 2), motion)).max() < 1e-9 * spread.max()


def test_starts_are_where_the_expectation_is_vague() -> None:
    expected = np.array((1.0, 2.0, 0.3))
    assert len(starts(expected, np.diag((0.1, 0.1, 0.01)) ** 2, 4.0)) == 1
    vague = starts(expected, np.diag((0.1, 1.0, 0.01)) ** 2, 4.0)
    assert np.abs(np.sort([s[1] for s in vague]) - (0.0, 2.0, 4.0)).max() < 1e-9
    turned = starts(expected, np.diag((0.1, 0.1, 0.2)) ** 2, 4.0)
    assert np.abs(np.sort([s[2] for s in turned]) - (-0.1, 0.3, 0.7)).max() < 1e-9
    lost = starts(expected, np.diag((100.0, 0.1, 0.01)) ** 2, 4.0)
    assert np.abs(np.sort([s[0] for s in lost]) - (-7.0, 1.0, 9.0)).max() < 1e-9


def test_keyframes_are_so_far_apart_by_way_or_by_turn() -> None:
    moves = np.array([(0.4, 0.0, 0.0)] * 10 + [(0.0, 0.0, -0.2)] * 6 + [(0.0, 0.0, 0.0)] * 5)
    problem = even_chain(moves, np.eye(3))
    every = dict.fromkeys(range(22), np.zeros((1, 3)))
    assert choose_keyframes(problem, every, 1.0, 0.3).tolist() == [0, 3, 6, 9, 12, 14, 16]
    some = dict.fromkeys((20, 4, 11, 5), np.zeros((1, 3)))
    assert choose_keyframes(problem, some, 1.0, 0.3).tolist() == [4, 11, 20]
    assert choose_keyframes(problem, {}, 1.0, 0.3).tolist() == []
