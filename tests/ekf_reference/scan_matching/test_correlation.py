"""Cross-correlation of sums of Gaussians against the integral, brute force and differences."""

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.scan_matching.correlation import CorrespondenceSearch, Pairs
from tests.ekf_reference.numerics import central_difference, relative_error
from tests.ekf_reference.scan_matching.scenes import random_sum

ALL = CorrespondenceSearch(1000, 1e3, 1e3)
POSES = [np.array((0.3, -0.2, 0.5)), np.array((-1.0, 0.4, -2.0)), np.zeros(3)]


def brute(first: Array, second: Array) -> float:
    """5.13 by the erratum's mean q - p, of sums given as rows of weight, mean, covariance."""
    total = 0.0
    for a, px, py, *p in first:
        for b, qx, qy, *q in second:
            s = np.reshape(p, (2, 2)) + np.reshape(q, (2, 2))
            d = np.array((qx - px, qy - py))
            total += a * b * np.exp(-0.5 * d @ np.linalg.solve(s, d)) / np.sqrt(np.linalg.det(s))
    return total / (2.0 * np.pi)


@pytest.mark.parametrize("pose", POSES)
def test_equals_the_double_sum(pose: Array) -> None:
    rng = np.random.default_rng(0)
    one, other = random_sum(rng, 20), random_sum(rng, 30)

    def rows(s: object) -> Array:
        return np.column_stack((s.weight, s.mean, s.covariance.reshape(-1, 4)))  # type: ignore[attr-defined]

    pairs = Pairs.near(one, other, pose, ALL)
    expected = brute(rows(one.transformed(pose)), rows(other))
    assert pairs.value(pose) == pytest.approx(expected, rel=1e-12)


def test_printed_mean_of_5_13_fails_and_the_corrected_one_is_the_integral() -> None:
    """Lambda(x) = integral of G1(u - x) G2(u): its peak is at q - p, where 5.13 prints p - q."""
    rng = np.random.default_rng(1)
    one, other, shift = random_sum(rng, 3), random_sum(rng, 4), np.array((0.8, -0.5))
    axis = np.arange(-15.0, 15.0, 0.05)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    integral = float(one.value(grid - shift) @ other.value(grid)) * 0.05**2
    pose = np.append(shift, 0.0)
    assert Pairs.near(one, other, pose, ALL).value(pose) == pytest.approx(integral, rel=1e-6)
    printed = Pairs.near(one, other, -pose, ALL).value(-pose)
    assert abs(printed / integral - 1.0) > 0.05


@pytest.mark.parametrize("pose", POSES)
def test_derivatives_equal_central_differences(pose: Array) -> None:
    rng = np.random.default_rng(2)
    pairs = Pairs.near(random_sum(rng, 20), random_sum(rng, 25), pose, ALL)
    found = pairs.derivatives(pose)
    gradient = central_difference(lambda x: np.array([pairs.value(x)]), pose)[0]
    hessian = central_difference(lambda x: pairs.derivatives(x).gradient, pose)
    assert relative_error(found.gradient, gradient) < 1e-7
    assert relative_error(found.hessian, hessian) < 1e-7
    assert relative_error(pairs.scores(pose).sum(axis=1), gradient) < 1e-7
    # A frame that is turned the wrong way is no derivative of this.
    turned = np.diag((1.0, 1.0, -1.0)) @ found.gradient
    assert relative_error(turned, gradient) > 1e-2


def test_several_poses_at_once_are_each_alone() -> None:
    """With other Gaussians counted at each; the last pose has no pairs at all."""
    rng = np.random.default_rng(5)
    one, other = random_sum(rng, 20), random_sum(rng, 25)
    pose = np.array((*POSES, (900.0, 0.0, 0.0)))
    counted, near = rng.random((4, 20)) < 0.7, CorrespondenceSearch(6, 5.0, 3.0)
    pairs = Pairs.near(one, other, pose, near, counted)
    found = pairs.derivatives(pose)
    for k in range(4):
        alone = Pairs.near(one, other, pose[k], near, counted[k])
        expected = alone.derivatives(pose[k])
        assert alone.value(pose[k]) == pytest.approx(found.value[k], rel=1e-12)
        for of_all, of_one in zip(found, expected, strict=True):
            np.testing.assert_allclose(of_all[k], of_one, rtol=1e-9, atol=1e-15)
    assert found.value[3] == 0.0
    assert (found.value[:3] > 0.0).all()
    # Each pose has its own pairs, in order.
    assert abs(pairs.value(pose[[1, 0, 2, 3]])[0] / found.value[0] - 1.0) > 0.1
    # Several times the poses, as for samples about them.
    np.testing.assert_allclose(pairs.value(np.stack((pose, pose))), [found.value] * 2)


def test_derivatives_of_the_logarithm() -> None:
    rng, pose, unit = np.random.default_rng(6), POSES[0], np.array((1.0, 2.0, 0.3))
    pairs = Pairs.near(random_sum(rng, 20), random_sum(rng, 25), pose, ALL)
    slope, bend = pairs.derivatives(pose).of_logarithm(unit)
    expected = central_difference(lambda x: np.log(np.array([pairs.value(x)])), pose)[0] * unit
    assert relative_error(slope, expected) < 1e-7
    by_place = central_difference(
        lambda x: pairs.derivatives(x).of_logarithm(np.ones(3))[0], pose
    ) * np.outer(unit, unit)
    assert relative_error(bend, by_place) < 1e-7


def test_inflation_is_a_wider_second_sum() -> None:
    rng, pose = np.random.default_rng(3), POSES[0]
    one, other = random_sum(rng, 10), random_sum(rng, 10)
    wide = type(other)(
        other.mean, other.covariance + 0.09 * np.eye(2), other.weight, other.boundary
    )
    inflated = Pairs.near(one, other, pose, CorrespondenceSearch(1000, 1e3, 1e3, inflation_m=0.3))
    assert inflated.value(pose) == pytest.approx(Pairs.near(one, wide, pose, ALL).value(pose))


def test_pairs_out_of_reach_add_nothing_to_speak_of() -> None:
    rng, pose = np.random.default_rng(4), POSES[1]
    one, other = random_sum(rng, 200), random_sum(rng, 300)
    whole = Pairs.near(one, other, pose, ALL)
    pruned = Pairs.near(one, other, pose, CorrespondenceSearch(300, 10.0, 4.5))
    assert len(pruned.row) < 0.9 * len(whole.row)
    assert pruned.value(pose) == pytest.approx(whole.value(pose), rel=1e-3)
