"""Pose graphs whose numbers mean something else than their format says."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from graphslam.extreme_edges import extreme_edges, meant
from graphslam.increments import dead_reckoned
from graphslam.misread_edges import misread_edges
from graphslam.optimum import chi_square_test
from graphslam.problem import LoopClosures, SlamProblem
from graphslam.scan import planar
from graphslam.smoother import smooth
from graphslam.unclosed import unclosed_passage
from tests.graphslam.g2o_files import loosened, rounds
from tests.graphslam.numerics import Array


def root(covariance: Array) -> Array:
    """What is read where the root of an information, upper triangle, stands for it."""
    upper = np.linalg.cholesky(np.linalg.inv(covariance)).transpose(0, 2, 1)
    return np.asarray(np.linalg.inv(np.triu(upper) + np.triu(upper, 1).transpose(0, 2, 1)))


def inverse(covariance: Array) -> Array:
    return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def inverted(problem: SlamProblem) -> SlamProblem:
    closed = problem.loop_closures
    return replace(problem, loop_closures=replace(closed, first=closed.second, second=closed.first))


def odometry_as_covariance(problem: SlamProblem) -> SlamProblem:
    return replace(problem, increment_covariance=inverse(problem.increment_covariance))


def closures_as_root(problem: SlamProblem) -> SlamProblem:
    closed = problem.loop_closures
    return replace(problem, loop_closures=replace(closed, covariance=root(closed.covariance)))


def all_as_covariance(problem: SlamProblem) -> SlamProblem:
    closed = problem.loop_closures
    changed = replace(closed, covariance=inverse(closed.covariance))
    return replace(odometry_as_covariance(problem), loop_closures=changed)


def without_odometry(problem: SlamProblem) -> SlamProblem:
    """Its steps are closures, as in a graph whose edges join no poses in a row."""
    closed, at = problem.loop_closures, np.arange(len(problem.increment))
    edges = LoopClosures(
        np.concatenate((at, closed.first)),
        np.concatenate((at + 1, closed.second)),
        np.concatenate((problem.increment, closed.motion)),
        np.concatenate((problem.increment_covariance, closed.covariance)),
    )
    none = np.full_like(problem.increment_covariance, np.nan)
    return replace(problem, increment_covariance=none, loop_closures=edges)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (inverted, "the loop closures fit when inverted"),
        (
            lambda problem: without_odometry(all_as_covariance(problem)),
            "all edges between poses fit when .* is the covariance",
        ),
        (
            odometry_as_covariance,
            "the odometry's edges fit when .* times the loop closures.* is the covariance",
        ),
        (all_as_covariance, "all edges between poses fit when .* is the covariance"),
        (closures_as_root, "the loop closures fit when .* is a square root of it"),
    ],
)
def test_what_was_meant_is_found(spoil: Callable[[SlamProblem], SlamProblem], words: str) -> None:
    problem = rounds()
    right = smooth(problem, {})
    assert right.optimality.chi_square.reading == "plausible"
    spoilt = spoil(problem)
    found = misread_edges(spoilt, smooth(spoilt, {}).optimality.chi_square)
    assert found is not None
    assert pytest.approx(2.0 * right.error, rel=1e-6) == found.chi_square.chi2
    assert re.match(words, found.words)


def squares() -> SlamProblem:
    """Twice round a square, the second lap closed to the first; on a circle no frame shows."""
    turn = np.where(np.arange(32) % 4 == 3, 0.5 * np.pi, 0.0)
    moves = np.column_stack((np.ones(32), np.zeros(32), turn))
    truth = dead_reckoned(np.zeros(3), moves)
    first = np.arange(1, 14)
    second = first + 15 + first % 3
    closed = [planar.between(*pair) for pair in zip(truth[first], truth[second], strict=True)]
    sigma, rng = np.array((0.05, 0.03, 0.01)), np.random.default_rng(0)
    spread = np.diag(sigma**2)
    return replace(
        rounds(),
        increment=moves + sigma * rng.standard_normal((32, 3)),
        increment_covariance=np.tile(spread, (32, 1, 1)),
        loop_closures=LoopClosures(
            first,
            second,
            np.array(closed) + sigma * rng.standard_normal((13, 3)),
            np.tile(spread, (13, 1, 1)),
        ),
    )


def test_closures_of_a_sensors_frame_are_found() -> None:
    """It looks backwards, 0.3 m ahead and 0.1 m to the left."""
    problem, sensor = squares(), np.array((0.3, 0.1, np.pi))
    closed, right = problem.loop_closures, smooth(problem, {})
    back = planar.between(sensor, np.zeros(3))
    seen = [planar.compose(planar.compose(back, one), sensor) for one in closed.motion]
    spoilt = replace(problem, loop_closures=replace(closed, motion=np.array(seen)))
    found = misread_edges(spoilt, smooth(spoilt, {}).optimality.chi_square)
    assert found is not None
    assert found.chi_square.chi2 <= 2.0 * right.error + 1e-6
    said = re.fullmatch(
        r"the loop closures fit as motions of a frame (\S+) m ahead and (\S+) m to the left and "
        r"turned by (\S+) degrees",
        found.words,
    )
    assert said is not None
    ahead, left, turn = map(float, said.groups())
    assert abs(ahead - 0.3) < 0.05
    assert abs(left - 0.1) < 0.05
    assert abs(abs(turn) - 180.0) < 1.0


def test_informations_that_tell_nothing_still_tell_the_direction() -> None:
    """A plausible chi-square that is not verified; one that is needs no other reading."""
    wrong = inverted(loosened(rounds(), 300.0))
    test = smooth(wrong, {}).optimality.chi_square
    assert test.reading == "plausible"
    found = misread_edges(wrong, test)
    assert found is not None
    assert found.words == "the loop closures fit when inverted"
    assert found.chi_square.chi2 < 1e-2 * test.chi2
    assert misread_edges(wrong, test, verified=True) is None


@pytest.mark.parametrize("factor", [1.0, 0.01, 30.0])
def test_noise_of_another_size_is_not_explained(factor: float) -> None:
    """A chi-square far out, and no other reading that fits; broken: one that takes the nearest."""
    problem = rounds()
    closed = problem.loop_closures
    scaled = replace(
        problem,
        increment_covariance=problem.increment_covariance / factor,
        loop_closures=replace(closed, covariance=closed.covariance / factor),
    )
    assert misread_edges(scaled, smooth(scaled, {}).optimality.chi_square) is None


def test_graphs_without_closures_have_one_reading() -> None:
    problem = rounds()
    bare = replace(problem, loop_closures=type(problem.loop_closures)())
    assert misread_edges(bare, chi_square_test(1e9, 36)) is None


def laps(step_m: float, *, between_laps: bool) -> SlamProblem:
    """Two laps; closures between neighbours tie no lap to the other, those between laps do."""
    problem, rng = squares(), np.random.default_rng(2)
    noise, short = 3.0 * np.array((0.05, 0.03, 0.01)), np.array((step_m, step_m, 1.0))
    step = short * problem.increment + noise * rng.standard_normal((32, 3))
    spread = np.tile(np.diag(noise**2), (32, 1, 1))
    problem = replace(problem, increment=step, increment_covariance=spread)
    loops = problem.loop_closures
    if between_laps:
        return replace(problem, loop_closures=replace(loops, motion=short * loops.motion))
    first = np.arange(1, 14)
    motion = np.array([planar.compose(step[i], step[i + 1]) for i in first])
    motion += np.array((0.05, 0.03, 0.01)) * rng.standard_normal((13, 3))
    closures = replace(loops, first=first, second=first + 2, motion=motion)
    return replace(problem, loop_closures=closures)


@pytest.mark.parametrize(
    ("step_m", "between_laps", "told"),
    [(0.1, True, False), (0.1, False, True), (1.0, False, False)],
)
def test_a_place_that_is_passed_twice_and_not_closed_is_told(
    step_m: float, between_laps: bool, told: bool
) -> None:
    """What is known to less than a step is no place of its own."""
    result = smooth(laps(step_m, between_laps=between_laps), {})
    found = unclosed_passage(result, result.pose_covariances())
    assert (found is not None) == told
    if found is not None:
        x, y, _ = planar.between(result.poses[found.first], result.poses[found.second])
        assert np.hypot(x, y) == pytest.approx(found.apart_m)
        assert found.second - found.first > 5
        assert found.apart_m < found.sigma_m


@pytest.mark.parametrize(
    ("read", "how"), [(inverse, ["the covariance"]), (root, ["a square root of it"])]
)
def test_few_edges_are_read_as_the_others_are(
    read: Callable[[Array], Array], how: list[str]
) -> None:
    """Sigmas of 0.03 mm; broken: a reading as far off on the other side."""
    covariance = np.tile(1e-9 * np.diag((1.0, 2.0, 4.0)), (40, 1, 1))
    assert not len(extreme_edges(covariance).rows)
    covariance[[3, 30]] = read(covariance[[3, 30]])
    found = extreme_edges(covariance)
    assert found.rows.tolist() == [3, 30]
    readings = list(meant(covariance, found))
    assert [words for words, _ in readings] == how
    assert np.allclose(readings[0][1], 1e-9 * np.diag((1.0, 2.0, 4.0)), rtol=1e-9, atol=0.0)
    covariance[10:20] = read(covariance[10:20])
    assert not len(extreme_edges(covariance).rows)  # no few
