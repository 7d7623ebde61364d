"""Places that a graph passes twice and does not close, and edges of extreme information."""

from dataclasses import replace

import numpy as np
import pytest

from graphslam.extreme_edges import extreme_edges
from graphslam.increments import dead_reckoned
from graphslam.problem import LoopClosures, SlamProblem
from graphslam.scan import planar
from graphslam.smoother import smooth
from graphslam.unclosed import unclosed_passage
from tests.graphslam.g2o_files import rounds
from tests.graphslam.numerics import Array

MOVES = np.column_stack(
    (np.ones(32), np.zeros(32), np.where(np.arange(32) % 4 == 3, 0.5 * np.pi, 0.0))
)


def squares() -> SlamProblem:
    """Twice round a square, the second lap closed to the first; on a circle no frame shows."""
    truth = dead_reckoned(np.zeros(3), MOVES)
    first = np.arange(1, 14)
    second = first + 15 + first % 3
    closed = [planar.between(*pair) for pair in zip(truth[first], truth[second], strict=True)]
    sigma, rng = np.array((0.05, 0.03, 0.01)), np.random.default_rng(0)
    spread = np.diag(sigma**2)
    return replace(
        rounds(),
        increment=MOVES + sigma * rng.standard_normal((32, 3)),
        increment_covariance=np.tile(spread, (32, 1, 1)),
        loop_closures=LoopClosures(
            first,
            second,
            np.array(closed) + sigma * rng.standard_normal((13, 3)),
            np.tile(spread, (13, 1, 1)),
        ),
    )


def laps(step_m: float, *, between_laps: bool) -> SlamProblem:
    """Two laps; closures between neighbours tie no lap to the other, those between laps do."""
    problem, rng = squares(), np.random.default_rng(2)
    noise, short = 3.0 * np.array((0.05, 0.03, 0.01)), np.array((step_m, step_m, 1.0))
    true = short * MOVES
    step = true + noise * rng.standard_normal((32, 3))
    spread = np.tile(np.diag(noise**2), (32, 1, 1))
    problem = replace(problem, increment=step, increment_covariance=spread)
    loops = problem.loop_closures
    if between_laps:
        return replace(problem, loop_closures=replace(loops, motion=short * loops.motion))
    first = np.arange(1, 14)
    motion = np.array([planar.compose(true[i], true[i + 1]) for i in first])
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


def inverse(covariance: Array) -> Array:
    return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def test_few_edges_of_another_size_are_extreme() -> None:
    """Sigmas of 0.03 mm; broken: one that takes a quarter of the edges for few."""
    covariance = np.tile(1e-9 * np.diag((1.0, 2.0, 4.0)), (40, 1, 1))
    assert not len(extreme_edges(covariance).rows)
    covariance[[3, 30]] = inverse(covariance[[3, 30]])
    assert extreme_edges(covariance).rows.tolist() == [3, 30]
    covariance[10:20] = inverse(covariance[10:20])
    assert not len(extreme_edges(covariance).rows)  # no few
