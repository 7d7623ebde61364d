from __future__ import annotations

import numpy as np
import pytest

from ekf_reference.core.blocks import block_diagonal
from ekf_reference.core.geometry import Array
from ekf_reference.models.relative_pose import RelativePose
from tests.ekf_reference.both_kinds import relative
from tests.ekf_reference.numerics import central_difference, relative_error

MODEL = RelativePose()


def some(rng: np.random.Generator) -> tuple[Array, Array]:
    return rng.uniform(-5.0, 5.0, 3), rng.uniform(-5.0, 5.0, (4, 3))


def test_it_is_the_landmark_in_the_vehicles_frame() -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        pose, landmarks = some(rng)
        z = MODEL.predict(pose, landmarks).z
        expected = np.array([relative(pose, one) for one in landmarks])
        assert np.abs(MODEL.innovation(expected, z)).max() < 1e-13


@pytest.mark.parametrize("seed", range(5))
def test_jacobians_equal_central_differences(seed: int) -> None:
    pose, landmarks = some(np.random.default_rng(seed))
    at = MODEL.predict(pose, landmarks)
    by_pose = central_difference(lambda x: MODEL.predict(x, landmarks).z.ravel(), pose)
    assert relative_error(at.jacobian_pose.reshape(-1, 3), by_pose) < 1e-8
    by_own = central_difference(
        lambda x: MODEL.predict(pose, x.reshape(-1, 3)).z.ravel(), landmarks.ravel()
    )
    assert relative_error(block_diagonal(at.jacobian_landmark), by_own) < 1e-8


@pytest.mark.parametrize("seed", range(5))
def test_inverse_undoes_prediction_and_its_jacobians_hold(seed: int) -> None:
    pose, z = some(np.random.default_rng(seed))
    new = MODEL.invert(pose, z)
    assert relative_error(MODEL.predict(pose, new.landmark).z, z) < 1e-13
    by_pose = central_difference(lambda x: MODEL.invert(x, z).landmark.ravel(), pose)
    assert relative_error(new.jacobian_pose.reshape(-1, 3), by_pose) < 1e-8
    by_z = central_difference(
        lambda x: MODEL.invert(pose, x.reshape(-1, 3)).landmark.ravel(), z.ravel()
    )
    assert relative_error(block_diagonal(new.jacobian_z), by_z) < 1e-8


def test_the_heading_is_wrapped_and_nothing_is_written_into_the_arguments() -> None:
    z, expected = np.array([[1.0, 2.0, 3.1]]), np.array([[0.5, 2.5, -3.1 - 4.0 * np.pi]])
    before = z.copy(), expected.copy()
    found = MODEL.innovation(z, expected)
    assert np.allclose(found, [[0.5, -0.5, 6.2 - 2.0 * np.pi]], rtol=0.0, atol=1e-13)
    assert np.array_equal(z, before[0])
    assert np.array_equal(expected, before[1])
