import math

import numpy as np
import pytest

from graphslam import increments
from graphslam.scan import planar
from tests.graphslam.numerics import (
    Array,
    central_difference,
    exponential,
    random_covariance,
    relative_error,
)


def random_motion(rng: np.random.Generator) -> Array:
    motion: Array = rng.uniform((-20.0, -20.0, -4.0), (20.0, 20.0, 4.0))
    return motion


def test_between_undoes_compose() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        start, motion = random_motion(rng), random_motion(rng)
        end = planar.compose(start, motion)
        assert relative_error(planar.between(start, end), motion) < 1e-13
        assert relative_error(planar.compose(start, planar.between(start, end)), end) < 1e-13
        back = planar.between(motion, np.zeros(3))
        assert np.abs(planar.compose(motion, back)).max() < 1e-13 * np.abs(motion).max()


def test_composition_is_the_product_of_matrices() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        one, other = random_motion(rng), random_motion(rng)
        product = planar.matrix(one) @ planar.matrix(other)
        assert relative_error(planar.matrix(planar.compose(one, other)), product) < 1e-13


def transport(motion: Array) -> Array:
    """(3, 3) how a perturbation before a motion shows after it, by central differences."""

    def after(xi: Array) -> Array:
        return planar.between(motion, planar.compose(exponential(xi), motion))

    return central_difference(after, np.zeros(3))


def test_a_covariance_is_carried_as_perturbations_are() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        motion, covariance = random_motion(rng), random_covariance(rng, 3)
        jacobian = transport(motion)
        carried = planar.carried(covariance, motion)
        assert relative_error(carried, jacobian @ covariance @ jacobian.T) < 1e-8
        # Transposed, or undone instead of done.
        inverse = np.linalg.inv(jacobian)
        for wrong in (jacobian.T @ covariance @ jacobian, inverse @ covariance @ inverse.T):
            assert relative_error(carried, wrong) > 0.1


def test_a_covariance_is_carried_as_odometry_composes_it() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        moves = np.array([random_motion(rng) for _ in range(2)])
        spread = np.array([random_covariance(rng, 3) for _ in range(2)])
        samples = increments.MotionSamples(moves, spread)
        whole = increments.compose(samples, np.zeros(2, dtype=np.intp), 1)
        assert relative_error(planar.compose(*moves), whole.displacement[0]) < 1e-13
        carried = planar.carried(spread[0], moves[1]) + spread[1]
        assert relative_error(carried, whole.covariance[0]) < 1e-12


@pytest.mark.parametrize("turns", [-3, 0, 2])
@pytest.mark.parametrize("heading", [-3.0, -1e-3, 0.0, 0.5, 3.0, math.pi])
def test_wrapped_takes_whole_turns_away(heading: float, turns: int) -> None:
    motion = np.array((1.0, 2.0, heading + turns * math.tau))
    wrapped = planar.wrapped(motion)
    assert np.array_equal(wrapped[:2], motion[:2])
    assert math.remainder(wrapped[2] - heading, math.tau) == pytest.approx(0.0, abs=1e-14)
    assert abs(wrapped[2]) <= math.pi
    assert motion[2] == heading + turns * math.tau


def test_half_a_turn_is_to_the_left() -> None:
    for heading in (math.pi, -math.pi):
        assert planar.wrapped(np.array((0.0, 0.0, heading)))[2] == math.pi
    assert planar.wrapped(np.array((0.0, 0.0, -math.pi + 1e-9)))[2] < 0.0
    assert planar.wrapped(np.array((0.0, 0.0, math.pi + 1e-9)))[2] < 0.0


def test_points_move_as_the_matrix_says() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        pose, points = random_motion(rng), rng.normal(size=(30, 3))
        before = points.copy()
        moved = planar.moved(pose, points)
        one = np.column_stack((points, np.ones(30)))
        assert relative_error(moved, (planar.matrix(pose) @ one.T).T[:, :3]) < 1e-13
        assert np.array_equal(moved[:, 2], points[:, 2])
        assert np.array_equal(planar.moved(pose, points[:, :2]), moved[:, :2])
        assert np.array_equal(points, before)


def test_a_pose_comes_back_out_of_its_matrix() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        pose = random_motion(rng)
        back = planar.from_matrix(planar.matrix(pose))
        assert relative_error(back, planar.wrapped(pose)) < 1e-13


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_shares_of_a_motion_lead_where_it_does(count: int) -> None:
    rng = np.random.default_rng(6)
    for _ in range(20):
        motion = random_motion(rng) * (1.0, 1.0, 0.75)
        share, end = planar.share(motion, count), np.zeros(3)
        for _ in range(count):
            end = planar.compose(end, share)
        assert relative_error(end, motion) < 1e-13
    whole_turn = planar.share(np.array((1.0, 0.0, math.tau)), count)
    assert np.abs(whole_turn[:2]).max() <= 1.0
    assert whole_turn[2] == math.tau / count
