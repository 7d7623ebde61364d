import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.dense.triangles import (
    DegenerateTriangleError,
    contains,
    determinant,
    global_jacobians,
    local_covariance,
    local_jacobians,
    to_global,
    to_local,
)
from tests.ekf_reference.numerics import central_difference, random_covariance, relative_error


def random_triangles(rng: np.random.Generator, count: int) -> Array:
    """Triangles of some tens of metres, neither flat nor all of one orientation."""
    triangle = rng.uniform(-40, 40, (20 * count, 3, 2))
    return triangle[np.abs(determinant(triangle)) > 200.0][:count]


def test_round_trip_of_all_points_in_all_triangles() -> None:
    rng = np.random.default_rng(0)
    triangle, point = random_triangles(rng, 50), rng.uniform(-40, 40, (200, 2))
    local = to_local(triangle[:, None], point)
    assert local.shape == (50, 200, 2)
    assert np.allclose(to_global(triangle[:, None], local), point, rtol=0, atol=1e-11)
    again = to_local(triangle[:, None], to_global(triangle[:, None], local))
    assert relative_error(again, local) < 1e-12


def test_corners_and_printed_formula() -> None:
    triangle = random_triangles(np.random.default_rng(1), 30)
    corners = to_local(triangle[:, None], triangle)
    assert np.allclose(corners, [(0, 0), (1, 0), (0, 1)], atol=1e-13)
    assert contains(corners, 1e-12).all()
    one, point = triangle[0], np.array((3.0, -8.0))
    d, d12, d13 = point - one[0], one[1] - one[0], one[2] - one[0]
    delta = d13[0] * d12[1] - d13[1] * d12[0]
    by_hand = np.array((d[1] * d13[0] - d[0] * d13[1], d[0] * d12[1] - d[1] * d12[0])) / delta
    assert np.allclose(to_local(one, point), by_hand, rtol=1e-14)
    assert np.isclose(determinant(one), delta)


def test_printed_bounds_lose_and_double_points_of_shared_edges() -> None:
    """Equation 3.7 prints alpha > 0, beta > 0, alpha + beta <= 1."""

    def as_printed(local: Array) -> bool:
        return bool(local[0] > 0 and local[1] > 0 and local.sum() <= 1)

    p = np.array([(0.0, 0.0), (8.0, 0.0), (0.0, 8.0), (8.0, 8.0)])
    on_edge = np.array((4.0, 4.0))  # of 1 2, shared by triangles 0 1 2 and 3 1 2
    for first, second, printed in (
        ((0, 1, 2), (3, 2, 1), 2),
        ((0, 1, 2), (1, 3, 2), 1),
        ((1, 2, 0), (2, 1, 3), 0),
    ):
        local = [to_local(p[list(base)], on_edge) for base in (first, second)]
        assert sum(map(as_printed, local)) == printed
        assert all(contains(x) for x in local)


@pytest.mark.parametrize("seed", range(5))
def test_points_follow_any_affine_map_of_their_landmarks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    triangle, point = random_triangles(rng, 20), rng.uniform(-40, 40, (20, 2))
    matrix, shift = rng.standard_normal((2, 2)), rng.uniform(-100, 100, 2)
    local = to_local(triangle, point)
    moved = to_global(triangle @ matrix.T + shift, local)
    assert np.allclose(moved, point @ matrix.T + shift, rtol=0, atol=1e-9)


def both_ways(landmarks_and_point: Array) -> Array:
    return to_local(landmarks_and_point[:6].reshape(3, 2), landmarks_and_point[6:])


@pytest.mark.parametrize("seed", range(10))
def test_jacobians_equal_central_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    triangle, point = random_triangles(rng, 4), rng.uniform(-40, 40, (4, 2))
    inward = local_jacobians(triangle, point)
    local = to_local(triangle, point)
    outward = global_jacobians(triangle, local)
    for i in range(4):
        x = np.concatenate((triangle[i].ravel(), point[i]))
        exact = central_difference(both_ways, x, 1e-5)
        assert relative_error(inward.by_landmarks[i], exact[:, :6]) < 1e-7
        assert relative_error(inward.by_point[i], exact[:, 6:]) < 1e-7
        x = np.concatenate((triangle[i].ravel(), local[i]))
        exact = central_difference(lambda y: to_global(y[:6].reshape(3, 2), y[6:]), x, 1e-5)
        assert relative_error(outward.by_landmarks[i], exact[:, :6]) < 1e-7
        assert relative_error(outward.by_point[i], exact[:, 6:]) < 1e-7


@pytest.mark.parametrize("seed", range(3))
def test_printed_derivative_by_the_second_axis_fails(seed: int) -> None:
    """Equation C.14 is printed (d_x, -d_y) / Delta; C.7 and C.9 hold with (d_y, -d_x)."""
    rng = np.random.default_rng(seed)
    triangle, point = random_triangles(rng, 1)[0], rng.uniform(-40, 40, 2)
    d12, d = triangle[1] - triangle[0], point - triangle[0]
    delta, alpha = determinant(triangle), to_local(triangle, point)[0]
    x = np.concatenate((triangle.ravel(), point))
    exact = central_difference(both_ways, x, 1e-5)[0, 4:6]
    by_delta = -alpha / delta * np.array((d12[1], -d12[0]))
    printed = np.array((d[0], -d[1])) / delta + by_delta
    corrected = np.array((d[1], -d[0])) / delta + by_delta
    assert relative_error(printed, exact) > 1e-2
    assert relative_error(corrected, exact) < 1e-7
    assert relative_error(local_jacobians(triangle, point).by_landmarks[0, 4:], exact) < 1e-7


def test_all_shapes_broadcast_alike() -> None:
    rng = np.random.default_rng(2)
    triangle, point = random_triangles(rng, 3), rng.uniform(-40, 40, (7, 2))
    each = local_jacobians(triangle[0], point[3])
    for first, lead in ((triangle[0], (7,)), (triangle[:, None], (3, 7))):
        inward = local_jacobians(first, point)
        outward = global_jacobians(first, to_local(first, point))
        for jacobians in (inward, outward):
            assert jacobians.by_point.shape == (*lead, 2, 2)
            assert jacobians.by_landmarks.shape == (*lead, 2, 6)
        assert np.allclose(inward.by_landmarks.reshape(-1, 2, 6)[3], each.by_landmarks)


def test_covariances() -> None:
    """There and back the covariance is the same when the correlation is kept."""
    rng = np.random.default_rng(3)
    triangle = random_triangles(rng, 1)[0]
    local, bases, own = np.array((0.3, 0.4)), random_covariance(rng, 6), 1e-3 * np.eye(2)
    j = global_jacobians(triangle, local)
    covariance = j.by_landmarks @ bases @ j.by_landmarks.T + j.by_point @ own @ j.by_point.T
    draws = 200_000
    moved = triangle + rng.multivariate_normal(np.zeros(6), bases, draws).reshape(-1, 3, 2)
    points = to_global(triangle, local + rng.multivariate_normal(np.zeros(2), own, draws))
    sampled = np.cov(to_global(moved, np.broadcast_to(local, (draws, 2))).T) + np.cov(points.T)
    assert relative_error(covariance, sampled) < 2e-2
    cross = j.by_landmarks @ bases
    joint = np.block([[bases, cross.T], [cross, covariance]])
    back = local_covariance(triangle, to_global(triangle, local), joint)
    assert relative_error(back, own) < 1e-9
    joint[:6, 6:] = joint[6:, :6].T * 0.0  # the correlation dropped: no longer the same
    joint[6:, :6] = 0.0
    assert relative_error(local_covariance(triangle, to_global(triangle, local), joint), own) > 1


@pytest.mark.parametrize(
    "triangle",
    [
        [(0, 0), (1, 1), (2, 2)],
        [(5, 5), (5, 5), (7, 9)],
        [(5, 5), (5, 5), (5, 5)],
        [(0, 0), (1, 0), (np.nan, 3)],
        [(0, 0), (1, 0), (np.inf, 3)],
        [(1e6, 1e6), (1e6 + 30, 1e6), (1e6 + 60, 1e6 + 1e-9)],
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_triangles_without_area_are_refused(triangle: list[tuple[float, float]]) -> None:
    good = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    both = np.stack((good, np.array(triangle, dtype=float)))
    point = np.zeros((2, 2))
    with pytest.raises(DegenerateTriangleError, match="1 of 2 triangles"):
        to_local(both, point)
    with pytest.raises(DegenerateTriangleError, match="span no area"):
        local_jacobians(both, point)
