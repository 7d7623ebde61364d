"""What a point's local coordinates share with the rest of the map, and how they change.

Nieto 2005, section 3.6, eqs. 3.11 to 3.20.
"""

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.core.state import KalmanState
from ekf_reference.dense.triangles import to_local
from ekf_reference.models.range_bearing import RangeBearing
from research.documents.decorrelation import (
    correlations,
    displacements,
    local_cross_covariance,
)
from tests.ekf_reference.dense.test_triangles import random_triangles
from tests.ekf_reference.numerics import (
    central_difference,
    point_columns,
    random_covariance,
    relative_error,
)


def test_correlations_are_those_of_the_propagated_covariance() -> None:
    """By central differences of alpha and beta; without either half of eq. 3.5 they are others."""
    rng = np.random.default_rng(0)
    triangle, covariance = random_triangles(rng, 1)[0], random_covariance(rng, 11)
    x = np.append(triangle, rng.uniform(-9.0, 9.0, 2))

    def local(x: Array) -> Array:
        return to_local(x[:6].reshape(3, 2), x[6:])

    by_x, side_m = central_difference(local, x), np.linalg.norm(triangle[1:] - triangle[0], axis=1)
    found = correlations(triangle, x[6:], covariance)
    for kept, holds in ((slice(0, 8), True), (slice(0, 6), False), (slice(6, 8), False)):
        whole = np.eye(13, 11)
        whole[11:, 3:][:, kept] = by_x[:, kept]
        joint = whole @ covariance @ whole.T
        sigma = np.sqrt(np.diag(joint))
        expected = np.abs(joint) / np.outer(sigma, sigma)
        assert np.allclose(found.local, expected[:3, 11:], rtol=1e-6) is holds
        assert np.allclose(found.sigma_local_m, sigma[11:] * side_m, rtol=1e-6) is holds
        assert np.allclose(found.world, expected[:3, 9:11])
        assert np.allclose(found.sigma_world_m, sigma[9:11])


def test_displacement_is_zero_under_a_common_motion_and_in_metres_otherwise() -> None:
    triangle = np.array([(0.0, 0.0), (20.0, 0.0), (5.0, 15.0)])
    point, shift = np.array((6.0, 4.0)), np.array((1.5, -2.0))
    moved = displacements(triangle, point, triangle + shift, point + shift)
    assert np.allclose((moved.world_m, moved.local_m), (2.5, 0.0), atol=1e-12)
    moved = displacements(triangle, point, triangle, point + shift)
    assert np.allclose((moved.world_m, moved.local_m), 2.5)


def passive_change(
    cross: Array, jacobian: Array, innovation_covariance: Array, innovation: Array
) -> Array:
    """How an observation moves n states that it did not see; (n,).

    Source: Nieto 2005, eq. 3.16: the error that a dense map makes which leaves it out. Erratum:
    3.12, which it comes from, is printed P grad h S^-1 nu; P grad h^T S^-1 nu holds.

    cross: (n, c) covariance of these states with those that the observation depends on (the
    vehicle and landmark i): P_jv and P_ji side by side, or for local coordinates
    local_cross_covariance, transposed. jacobian: (m, c). innovation_covariance: (m, m).
    innovation: (m,), wrapped.
    """
    return cross @ jacobian.T @ np.linalg.solve(innovation_covariance, innovation)


NOISE = np.diag((0.1, 1e-3))


def seen_once(rng: np.random.Generator) -> KalmanState:
    """Five landmarks, all initialised at one pose."""
    state = KalmanState(np.array((1.0, 2.0, 0.4)), 1e-2 * random_covariance(rng, 3))
    z = np.column_stack((rng.uniform(5, 20, 5), rng.uniform(-2, 2, 5)))
    new = RangeBearing().invert(state.pose, z)
    spread = np.broadcast_to(NOISE, (5, 2, 2))
    state.augment(new, spread)
    return state


def measured(state: KalmanState, landmark_index: int) -> Array:
    """Jacobian (2, 5) of a measurement by the pose and the landmark."""
    predicted = RangeBearing().predict(state.pose, state.landmarks[[landmark_index]])
    return np.hstack((predicted.jacobian_pose[0], predicted.jacobian_landmark[0]))


def observed(rng: np.random.Generator) -> tuple[KalmanState, Array, Array, Array]:
    """Landmarks seen from two places; Jacobian, S and innovation of a measurement of the first."""
    state = seen_once(rng)
    state.predict(state.pose + (3.0, 1.0, 0.2), np.eye(3), np.diag((0.2, 0.3, 0.01)))
    for landmark_index in range(1, 5):
        columns = point_columns(np.array([landmark_index]))
        state.update(columns, measured(state, landmark_index), 0.1 * rng.standard_normal(2), NOISE)
    jacobian = measured(state, 0)
    spread = jacobian @ state.covariance[:5, :5] @ jacobian.T + NOISE
    return state, jacobian, spread, np.array((0.3, -0.02))


@pytest.mark.parametrize("seed", range(3))
def test_passive_change_is_what_the_filter_does(seed: int) -> None:
    """And what 3.16 spells out; 3.12 as printed, P grad h S^-1 nu, has no product."""
    state, jacobian, spread, innovation = observed(np.random.default_rng(seed))
    before, covariance = state.mean.copy(), state.covariance.copy()
    change = passive_change(covariance[5:, :5], jacobian, spread, innovation)
    p_jv, p_ji, s = covariance[5:, :3], covariance[5:, 3:5], np.linalg.inv(spread)
    spelt = (p_jv @ jacobian[0, :3] + p_ji @ jacobian[0, 3:]) * (s[0] @ innovation) + (
        p_jv @ jacobian[1, :3] + p_ji @ jacobian[1, 3:]
    ) * (s[1] @ innovation)
    assert relative_error(change, spelt) < 1e-10
    state.update(np.arange(5), jacobian, innovation, NOISE)
    assert relative_error(change, (state.mean - before)[5:]) < 1e-9
    with pytest.raises(ValueError, match="mismatch"):
        covariance[5:, :5] @ jacobian


@pytest.mark.parametrize("seed", range(3))
def test_passive_change_of_local_coordinates(seed: int) -> None:
    """To first order it is how far the update moves a landmark within its triangle."""
    rng = np.random.default_rng(seed)
    _, jacobian, spread, innovation = observed(rng)
    covariance, innovation = random_covariance(rng, 13), 1e-5 * innovation
    triangle, point = random_triangles(rng, 1)[0], rng.uniform(-40, 40, 2)
    cross = local_cross_covariance(triangle, point, covariance[:5, 5:11], covariance[:5, 11:])
    change = passive_change(cross.T, jacobian, spread, innovation)
    shift = passive_change(covariance[:, :5], jacobian, spread, innovation)[5:].reshape(4, 2)
    after = to_local(triangle + shift[:3], point + shift[3])
    assert relative_error(change, after - to_local(triangle, point)) < 1e-3


def test_what_is_seen_from_one_pose_has_no_local_correlation_at_all() -> None:
    """The pose's error moves and turns base and point as one, which alpha and beta do not see."""
    once, (twice, *_) = seen_once(np.random.default_rng(0)), observed(np.random.default_rng(0))
    for state, none in ((once, True), (twice, False)):
        cross = state.covariance[:5, 5:]
        local = local_cross_covariance(
            state.landmarks[1:4], state.landmarks[4], cross[:, :6], cross[:, 6:]
        )
        assert (np.abs(local).max() < 1e-12 * np.abs(cross).max()) is np.bool_(none)


def test_one_dimension_of_the_argument() -> None:
    """Equation 3.4: P_vL = P_vv - P_vb vanishes when robot and base are one."""
    triangle = random_triangles(np.random.default_rng(0), 1)[0]
    common = np.tile(np.eye(2), (1, 4)) * 9.0
    cross = local_cross_covariance(triangle, triangle.mean(axis=0), common[:, :6], common[:, 6:])
    assert np.abs(cross).max() < 1e-12
