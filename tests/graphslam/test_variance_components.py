"""Components of variance: unbiased, as sure as they say, and silent where nothing can be told."""

import gtsam
import numpy as np
import pytest
from scipy.sparse import csr_matrix

from graphslam.arrays import Array, Index
from graphslam.graph_builder import COMPONENTS, POSE_LANDMARK_KEY, build_graph, row_components
from graphslam.variance_components import Component, estimate_components
from tests.graphslam import worlds

_STEPS = 80
_LANDMARKS = 5
_NAMES = {"odometry": 0, "range": 2}


def line(
    rng: np.random.Generator, odometry: float, ranges: float, sure: float = 2.0
) -> tuple[Array, Array, Index]:
    """A vehicle on a line, its way measured, and the distance of landmarks to both sides.

    odometry, ranges: standard deviations of the true noise over the stated. sure: one over the
    stated one of the odometry; that of ranges is 0.2.
    """
    size = _STEPS + _LANDMARKS
    moves = np.eye(_STEPS, size) - np.eye(_STEPS, size, k=-1)
    seen = np.zeros((_STEPS * 2, size))
    rows = np.arange(len(seen))
    seen[rows, rows // 2] = -1.0
    seen[rows, _STEPS + rng.integers(_LANDMARKS, size=len(rows))] = 1.0
    jacobian = np.vstack((sure * moves, 5.0 * seen))
    component = np.repeat((_NAMES["odometry"], _NAMES["range"]), (len(moves), len(seen)))
    true = np.repeat((odometry, ranges), (len(moves), len(seen)))
    return jacobian, true * rng.standard_normal(len(jacobian)), component


def found(seed: int, odometry: float, ranges: float) -> tuple[Component, ...]:
    """The components of one such drive."""
    jacobian, errors, component = line(np.random.default_rng(seed), odometry, ranges)
    return estimate_components(csr_matrix(jacobian), errors, component)


@pytest.mark.parametrize("true", [(1.0, 1.0), (1.3, 1.0), (1.0, 0.6), (5.0, 0.4)])
def test_factors_are_unbiased_and_as_sure_as_they_say(true: tuple[float, float]) -> None:
    every = [found(seed, *true) for seed in range(60)]
    for one, right in enumerate(true):
        drawn = [components[one] for components in every]
        assert all(c.settled for c in drawn)
        ratio = np.array([(c.factor / right) ** 2 for c in drawn])
        spread = np.sqrt(2.0 / np.mean([c.dof for c in drawn]))
        # Of 60: five sigma of the mean, and of the standard deviation.
        assert abs(ratio.mean() - 1.0) < 5.0 * spread / np.sqrt(60)
        assert 0.55 < ratio.std() / spread < 1.45
        inside = [low <= right <= high for low, high in (c.interval() for c in drawn)]
        assert sum(inside) >= 50  # 57 expected; 1 of 1,000 draws has less than 51


def test_a_factor_that_takes_the_residuals_for_the_errors_is_far_off() -> None:
    """What least squares makes of residuals: they are smaller than the errors."""
    jacobian, errors, component = line(np.random.default_rng(3), 1.0, 1.0, sure=20.0)
    rest = errors - jacobian @ np.linalg.lstsq(jacobian, errors, rcond=None)[0]
    naive = float(np.mean(rest[component == _NAMES["odometry"]] ** 2))
    right = estimate_components(csr_matrix(jacobian), errors, component)[0]
    low, high = right.interval(0.001)
    assert low < 1.0 < high
    assert naive < low**2


def test_what_leaves_no_residuals_is_not_known() -> None:
    jacobian = np.vstack((np.eye(4), np.eye(2, 4), np.eye(2, 4)))
    component = np.repeat((0, 3), (4, 4))[:8]
    component[[0, 1]] = 1
    errors = np.random.default_rng(0).standard_normal(8)
    by_name = {c.name: c for c in estimate_components(csr_matrix(jacobian), errors, component)}
    assert by_name["odometry"].dof == 0.0
    assert by_name["odometry"].interval() == (0.0, np.inf)
    assert 0.0 < by_name["position"].dof < 4.0
    assert tuple(by_name) == (COMPONENTS[0], COMPONENTS[1], COMPONENTS[3])


def test_what_is_known_beforehand_is_taken_as_stated() -> None:
    """Twice the noise in what has no factor is not put down to what has one."""
    rng = np.random.default_rng(1)
    jacobian = np.vstack((np.eye(3), np.tile(np.eye(3), (200, 1))))
    component = np.repeat((-1, 3), (3, 600))
    (one,) = estimate_components(csr_matrix(jacobian), rng.standard_normal(603), component)
    assert one.name == "position"
    assert one.dof == pytest.approx(600.0, abs=3.0)


def test_each_row_of_a_graph_has_the_noise_of_its_factor() -> None:
    """By the factors' own types and keys: a prior's and a merge's rows are of no component."""
    problem = worlds.with_frames(worlds.loop(0, poses=40), 0).problem
    graph, expected = build_graph(problem), list[int]()
    odometry, bearing, range_, template = (
        COMPONENTS.index(name) for name in ("odometry", "bearing", "range", "pose landmark")
    )
    for factor in map(graph.at, range(graph.size())):
        frames = sum(key - POSE_LANDMARK_KEY in range(100) for key in factor.keys())  # noqa: SIM118
        if isinstance(factor, gtsam.BearingRangeFactor2D):
            expected += [bearing, range_]
        elif isinstance(factor, gtsam.BetweenFactorPose2) and frames < 2:
            expected += [(odometry, template)[frames]] * 3
        else:
            expected += [-1] * 3
    assert set(expected) == {-1, odometry, bearing, range_, template}
    assert row_components(problem).tolist() == expected


def test_data_without_noise_have_the_least_factor() -> None:
    jacobian, _, component = line(np.random.default_rng(0), 1.0, 1.0)
    every = estimate_components(csr_matrix(jacobian), np.zeros(len(jacobian)), component)
    assert [c.factor for c in every] == pytest.approx([1e-3, 1e-3], rel=1e-6)
