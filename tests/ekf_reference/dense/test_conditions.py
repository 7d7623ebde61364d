import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.core.state import correlation_coefficients
from ekf_reference.dense.conditions import (
    Conditions,
    coordinate_correlation,
    crosses,
    ellipse_margin,
    flip_margin,
    overlap,
    relative_sigma,
    smallest_angle,
)
from ekf_reference.dense.triangles import contains, determinant, to_global, to_local
from tests.ekf_reference.numerics import random_covariance


def shared(common_m: float, own_m: float, count: int = 3) -> Array:
    """Covariance of landmarks that share one error and have another of their own."""
    return common_m**2 * np.kron(np.ones((count, count)), np.eye(2)) + own_m**2 * np.eye(2 * count)


def test_correlation_is_the_lower_of_east_and_north() -> None:
    covariance = random_covariance(np.random.default_rng(0), 8)
    sigma = np.sqrt(np.diag(covariance))
    signed = covariance / np.outer(sigma, sigma)
    expected = np.minimum(signed[::2, ::2], signed[1::2, 1::2])
    assert np.allclose(coordinate_correlation(covariance), expected)
    assert np.allclose(correlation_coefficients(covariance), np.abs(signed))


def test_correlation_of_equal_landmarks() -> None:
    assert np.isclose(coordinate_correlation(shared(3.0, 1.0))[0, 1], 0.9)
    assert np.allclose(relative_sigma(shared(3.0, 0.5))[0, 1], 0.5 * np.sqrt(2))
    opposed = shared(3.0, 0.1, 2)
    opposed[:2, 2:] *= -1.0
    opposed[2:, :2] *= -1.0
    assert coordinate_correlation(opposed)[0, 1] < -0.99
    assert np.allclose(coordinate_correlation(np.zeros((6, 6))), 1.0)  # surveyed landmarks
    assert correlation_coefficients(opposed)[0, 2] > 0.99  # eq. 2.62 as printed takes |P_ij|


def test_margins_tell_how_likely_a_region_flips() -> None:
    rng = np.random.default_rng(0)
    triangle = np.array([[(0.0, 0.0), (10.0, 0.0), (5.0, 2.0)]])
    covariance = shared(4.0, 0.8)[None]
    draws = triangle + rng.multivariate_normal(np.zeros(6), covariance[0], 100_000).reshape(
        -1, 3, 2
    )
    share = np.mean(np.sign(determinant(draws)) != np.sign(determinant(triangle)))
    margin = flip_margin(triangle, covariance)[0]
    from_margin = 0.5 * np.mean(np.abs(rng.standard_normal(1_000_000)) > margin)
    assert np.isclose(share, from_margin, rtol=0.1)
    # The thesis' form without correlations: height 2 m over a sigma of the landmark.
    assert np.isclose(ellipse_margin(triangle, covariance)[0], 2.0 / np.hypot(4.0, 0.8))
    assert np.isinf(flip_margin(triangle, np.zeros((1, 6, 6)))[0])


@pytest.mark.parametrize("seed", range(3))
def test_ellipses_touch_the_opposite_axis_at_the_margin(seed: int) -> None:
    """Grown by the margin, one ellipse touches its opposite axis and none crosses."""
    rng = np.random.default_rng(seed)
    triangle, covariance = rng.uniform(-20, 20, (3, 2)), random_covariance(rng, 6)
    margin = ellipse_margin(triangle[None], covariance[None])[0]
    turn = np.linspace(0, 2 * np.pi, 20_001)
    circle = np.stack((np.cos(turn), np.sin(turn)))
    opposite = []  # barycentric coordinate of each landmark's ellipse, zero on the other two's line
    for corner in range(3):
        root = np.linalg.cholesky(covariance[2 * corner :, 2 * corner :][:2, :2])
        ellipse = triangle[corner] + margin * (root @ circle).T
        first, second = triangle[corner - 2], triangle[corner - 1]
        frame = np.stack((first, triangle[corner], second))
        opposite.append(to_local(frame, ellipse)[:, 0].min())
    assert np.isclose(min(opposite), 0.0, atol=1e-6)


def test_angles() -> None:
    triangle = np.array(
        [[(0.0, 0.0), (2.0, 0.0), (0.0, 2.0)], [(0.0, 0.0), (10.0, 0.0), (5.0, 0.1)]]
    )
    assert np.allclose(smallest_angle(triangle), (np.pi / 4, np.arctan(0.02)))


@pytest.mark.slow
def test_overlap_equals_area_in_common() -> None:
    """Against random points: triangles overlap when some point lies in both."""
    rng = np.random.default_rng(1)
    pairs = rng.uniform(0, 10, (400, 2, 3, 2))
    pairs = pairs[(np.abs(determinant(pairs)) > 4.0).all(axis=1)]
    found = overlap(pairs[:, 0], pairs[:, 1])
    uniform = rng.dirichlet(np.ones(3), 20_000)[:, 1:]
    points = to_global(pairs[:, :1], uniform)
    sampled = contains(to_local(pairs[:, 1:], points)).any(axis=1)
    assert not (sampled & ~found).any()
    assert np.mean(found & ~sampled) < 0.03  # slivers that no point hit
    assert 0.2 < np.mean(found) < 0.95
    assert np.array_equal(found, overlap(pairs[:, 1, (1, 0, 2)], pairs[:, 0, (2, 0, 1)]))


def test_sharing_an_edge_or_a_corner_is_no_overlap() -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        p = rng.uniform(-1e3, 1e3, 2) + rng.uniform(-10, 10, (3, 2))
        opposite = p[0] + p[1] - p[2]
        beyond = 2.0 * p[0] - p[1:]
        first = p
        assert not overlap(first, np.stack((p[0], p[1], opposite)))
        assert not overlap(first, np.vstack((p[:1], beyond)))
        assert overlap(first, first)
        assert overlap(first, np.stack((p[0], p[1], p.mean(axis=0))))


def test_conditions_bound_what_they_name() -> None:
    square = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (90.0, 0.0)])
    covariance = shared(1.0, 0.2, 4)
    expected = np.zeros((4, 4), dtype=bool)
    expected[:3, :3] = ~np.eye(3, dtype=bool)
    assert np.array_equal(Conditions().pairs(square, covariance), expected)
    assert not Conditions(least_correlation=0.97).pairs(square, covariance).any()
    known = Conditions(least_correlation=0.97, known_apart_m=0.3)
    assert np.array_equal(known.pairs(square, covariance), expected)


TRIANGLE = np.array([(0.0, 0.0), (4.0, 0.0), (0.0, 4.0)])


@pytest.mark.parametrize("turned_over", [False, True])
@pytest.mark.parametrize(
    ("segment", "expected"),
    [
        (((-1.0, 1.0), (5.0, 1.0)), True),
        (((1.0, 1.0), (1.5, 1.0)), True),  # within
        (((1.0, 1.0), (9.0, 9.0)), True),  # out of it
        (((0.0, 0.0), (2.0, 2.0)), True),  # from a corner to the opposite edge
        (((0.0, 0.0), (4.0, 0.0)), False),  # an edge
        (((1.0, 0.0), (3.0, 0.0)), False),  # a part of it
        (((-1.0, 0.0), (9.0, 0.0)), False),  # more than it
        (((1.0, 0.0), (1.0, -3.0)), False),  # from an edge outwards
        (((4.0, 0.0), (8.0, 1.0)), False),  # from a corner outwards
        (((3.0, 3.0), (9.0, 9.0)), False),  # towards it
        (((-1.0, 1.0), (-0.5, 1.0)), False),  # short of it
        (((-3.0, 2.0), (2.0, -3.0)), False),  # past a corner
        (((1.0, 1.0), (1.0, 1.0)), False),  # no length
    ],
)
def test_a_segment_crosses_what_it_runs_through(
    segment: tuple[tuple[float, float], ...], expected: bool, turned_over: bool
) -> None:
    corner = TRIANGLE[[0, 2, 1]] if turned_over else TRIANGLE
    for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        found = crosses(np.array([segment]), corner[None, order])
        assert found.tolist() == [expected]


def test_what_has_a_crossing_edge_overlaps() -> None:
    rng = np.random.default_rng(0)
    region, triangle = rng.normal(size=(2, 20_000, 3, 2))
    through = crosses(triangle[:, :2], region)
    assert 0.2 < through.mean() < 0.8
    assert overlap(triangle[through], region[through]).all()


def test_lines_are_crossed_by_nothing() -> None:
    flat = np.array([[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)], [(0.0, 0.0), (1.0, 1e-10), (2.0, 0.0)]])
    assert not crosses(np.array([[(0.7, -1.0), (0.7, 1.0)]] * 2), flat).any()
