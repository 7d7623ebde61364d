import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.scan_matching.frames import moved, moved_gaussians
from tests.ekf_reference.numerics import central_difference, random_covariance, relative_error


def world(frame: Array, point: Array) -> Array:
    place = (point[:, 0] + 1j * point[:, 1]) * np.exp(1j * frame[2])
    return np.column_stack((place.real, place.imag)) + frame[:2]


def two(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    return rng.uniform(-4.0, 4.0, 3), rng.uniform(-4.0, 4.0, 3), rng.uniform(-2.0, 2.0, (5, 2))


def test_a_moved_point_is_where_it_was_in_the_world() -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        first, second, point = two(rng)
        there = world(first, moved(first, second, point).point)
        assert relative_error(there, world(second, point)) < 1e-13


def test_the_printed_translation_fails() -> None:
    """5.8 prints T = x_L2 - x_L1, which is in the world's axes, not in the first landmark's."""
    first, second, point = two(np.random.default_rng(1))
    angle = second[2] - first[2]
    r = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    printed = point @ r.T + second[:2] - first[:2]
    assert relative_error(world(first, printed), world(second, point)) > 0.1


@pytest.mark.parametrize("seed", range(5))
def test_jacobians_equal_central_differences(seed: int) -> None:
    first, second, point = two(np.random.default_rng(seed))
    at = moved(first, second, point)
    by_first = central_difference(lambda x: moved(x, second, point).point.ravel(), first)
    by_second = central_difference(lambda x: moved(first, x, point).point.ravel(), second)
    by_point = central_difference(lambda x: moved(first, second, x[None]).point[0], point[0])
    assert relative_error(at.by_first.reshape(-1, 3), by_first) < 1e-8
    assert relative_error(at.by_second.reshape(-1, 3), by_second) < 1e-8
    assert relative_error(at.by_point, by_point) < 1e-8


def test_covariances_are_those_of_samples_and_the_printed_sign_fails() -> None:
    """5.12 prints a minus before the cross terms; drawn frames tell that they are added."""
    rng = np.random.default_rng(3)
    first, second, point = two(rng)
    joint, own = 1e-6 * random_covariance(rng, 6), 1e-6 * random_covariance(rng, 2)
    joint[:3, 3:] += 4e-6 * np.eye(3)
    joint[3:, :3] += 4e-6 * np.eye(3)
    mean, covariance = moved_gaussians(first, second, joint, point, np.tile(own, (5, 1, 1)))
    assert np.array_equal(mean, moved(first, second, point).point)
    frames = rng.multivariate_normal(np.concatenate((first, second)), joint, 20000)
    noise = rng.multivariate_normal(np.zeros(2), own, 20000)
    drawn = np.array(
        [
            moved(x[:3], x[3:], (point[0] + e)[None]).point[0]
            for x, e in zip(frames, noise, strict=True)
        ]
    )
    sampled = np.cov(drawn.T)
    assert relative_error(covariance[0], sampled) < 0.04
    at = moved(first, second, point)
    cross = at.by_first[0] @ joint[:3, 3:] @ at.by_second[0].T
    assert relative_error(covariance[0] - 2.0 * (cross + cross.T), sampled) > 0.2
