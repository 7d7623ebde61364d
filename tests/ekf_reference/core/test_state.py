import numpy as np
import pytest
from numpy.typing import NDArray

from ekf_reference.core.blocks import block_diagonal, stack
from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import POSE, NewLandmarks
from ekf_reference.core.state import FilterDivergedError, KalmanState
from tests.ekf_reference.numerics import point_columns, random_covariance, relative_error


def mapped_state(rng: np.random.Generator, landmarks: int) -> KalmanState:
    """A state with correlated landmarks."""
    state = KalmanState(rng.standard_normal(3), random_covariance(rng, 3))
    gx = rng.standard_normal((landmarks, 2, 3))
    gz = rng.standard_normal((landmarks, 2, 2)) + 2 * np.eye(2)
    noise = np.array([random_covariance(rng, 2) for _ in range(landmarks)])
    state.augment(NewLandmarks(rng.standard_normal((landmarks, 2)), gx, gz), noise)
    return state


def dense(columns: NDArray[np.intp], jacobian: Array, n: int) -> Array:
    full = np.zeros((len(jacobian), n))
    for i, column in enumerate(columns):
        full[:, column] += jacobian[:, i]
    return full


@pytest.mark.parametrize("landmarks", [1, 4])
def test_prediction_equals_the_full_product(landmarks: int) -> None:
    rng = np.random.default_rng(0)
    state = mapped_state(rng, landmarks)
    n = 3 + 2 * landmarks
    f = np.eye(n)
    f[:3, :3] += rng.standard_normal((3, 3))
    q = np.zeros((n, n))
    q[:3, :3] = random_covariance(rng, 3)
    expected = f @ state.covariance @ f.T + q  # eq. 2.33
    state.predict(np.arange(3.0), f[:3, :3], q[:3, :3])
    assert relative_error(state.covariance, expected) < 1e-14
    assert np.array_equal(state.covariance, state.covariance.T)
    assert np.array_equal(state.pose, np.arange(3.0))


@pytest.mark.parametrize("landmark_indices", [[2], [0, 3, 1], [1, 1]])
def test_update_equals_joseph_form(landmark_indices: list[int]) -> None:
    rng = np.random.default_rng(len(landmark_indices))
    state, m = mapped_state(rng, 4), len(landmark_indices)
    columns = point_columns(np.array(landmark_indices))
    jacobian = stack(rng.standard_normal((m, 2, 3)), rng.standard_normal((m, 2, 2)))
    nu = rng.standard_normal(2 * m)
    r = block_diagonal(np.array([random_covariance(rng, 2) for _ in landmark_indices]))
    x, p = state.mean.copy(), state.covariance.copy()
    h = dense(columns, jacobian, 11)
    w = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
    joseph = (np.eye(11) - w @ h) @ p @ (np.eye(11) - w @ h).T + w @ r @ w.T
    state.update(columns, jacobian, nu, r)
    assert relative_error(state.covariance, joseph) < 1e-13
    assert relative_error(state.mean, x + w @ nu) < 1e-13
    assert np.array_equal(state.covariance, state.covariance.T)


def test_printed_gain_without_transpose_fails() -> None:
    """W = P H S^-1 as printed in eq. 2.47 has no meaning but for a square H, and is wrong there."""
    rng = np.random.default_rng(3)
    p, h, r = random_covariance(rng, 3), rng.standard_normal((3, 3)), random_covariance(rng, 3)
    state = KalmanState(np.zeros(3), p)
    state.update(np.arange(3), h, np.ones(3), r)
    printed: Array = p @ h @ np.linalg.inv(h @ p @ h + r) @ np.ones(3)
    exact = np.linalg.solve(
        np.linalg.inv(p) + h.T @ np.linalg.inv(r) @ h, h.T @ np.linalg.inv(r) @ np.ones(3)
    )
    assert relative_error(state.mean, exact) < 1e-12
    assert relative_error(printed, exact) > 1e-2


def test_what_lies_within_a_circle_is_found_by_position_alone() -> None:
    state = KalmanState(np.array((1.0, 2.0, 0.5)), np.eye(3))
    places = np.array(((4.0, 6.0, 9.0), (4.0, 6.1, 0.0), (1.0, 2.0, 0.0)))
    square = np.tile(np.eye(3), (3, 1, 1))
    state.augment(NewLandmarks(places, np.zeros((3, 3, 3)), square), square, POSE)
    assert state.within(5.0, POSE).tolist() == [0, 2]


def test_buffers_grow_by_doubling() -> None:
    """Not with each landmark, which would be quadratic in their number."""
    rng, rooms = np.random.default_rng(0), set()
    state = mapped_state(rng, 1)
    for _ in range(100):
        state.augment(
            NewLandmarks(np.zeros((1, 2)), np.zeros((1, 2, 3)), np.eye(2)[None]), np.eye(2)[None]
        )
        rooms.add(len(state._mean))
    assert len(rooms) <= 4


def test_augmentation_is_the_limit_of_a_boundless_prior() -> None:
    """Eq. 2.53 equals 2.56 with P_LL* growing: one measurement of an unknown landmark."""
    rng = np.random.default_rng(4)
    state = mapped_state(rng, 2)
    gx, gz = rng.standard_normal((1, 2, 3)), np.eye(2)[None] + 0.1 * rng.standard_normal((1, 2, 2))
    noise = random_covariance(rng, 2)[None]
    n, huge = 7, 1e9
    wide = np.zeros((n + 2, n + 2))
    wide[:n, :n] = state.covariance
    wide[n:, n:] = huge * np.eye(2)
    h = np.zeros((2, n + 2))
    h[:, n:] = np.linalg.inv(gz[0])
    h[:, :3] = -h[:, n:] @ gx[0]
    s = h @ wide @ h.T + noise[0]
    limit = wide - wide @ h.T @ np.linalg.solve(s, h @ wide)
    state.augment(NewLandmarks(np.zeros((1, 2)), gx, gz), noise)
    assert relative_error(state.covariance, limit) < 1e-5


def test_growth_keeps_what_was_there() -> None:
    rng = np.random.default_rng(5)
    state = mapped_state(rng, 3)
    before_mean, before = state.mean.copy(), state.covariance.copy()
    many = 60
    state.augment(
        NewLandmarks(np.zeros((many, 2)), np.zeros((many, 2, 3)), np.tile(np.eye(2), (many, 1, 1))),
        np.tile(np.eye(2), (many, 1, 1)),
    )  # fmt: skip
    assert np.array_equal(state.mean[:9], before_mean)
    assert np.array_equal(state.covariance[:9, :9], before)
    assert np.array_equal(state.covariance[9:, 9:], np.eye(2 * many))


def test_views_cannot_be_written() -> None:
    state = KalmanState(np.zeros(3), np.eye(3))
    with pytest.raises(ValueError, match="read-only"):
        state.mean[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        state.covariance[0, 0] = 1.0


def test_indefinite_innovation_covariance_is_reported() -> None:
    state = KalmanState(np.zeros(3), -np.eye(3))
    with pytest.raises(FilterDivergedError, match="not positive definite"):
        state.update(np.arange(3), np.eye(3), np.zeros(3), 0.5 * np.eye(3))
