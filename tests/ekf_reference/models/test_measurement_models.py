"""What all measurement models have in common."""

import numpy as np
import pytest

from ekf_reference.core.blocks import block_diagonal
from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.filters.misono import OwnAxesObservation, PairRelativePose, UnwrappedPose
from ekf_reference.models.range_bearing import RangeBearing
from ekf_reference.models.relative_pose import RelativePose
from tests.ekf_reference.numerics import central_difference, relative_error

MODELS: dict[str, tuple[MeasurementModel, int, int]] = {
    "range and bearing": (RangeBearing(), 3, 2),
    "own axes": (OwnAxesObservation(), 4, 2),
    "relative pose": (RelativePose(), 3, 3),
    "relative pose, pair": (PairRelativePose(UnwrappedPose(0.0)), 4, 3),
}
"""Each with the entries of its pose and of its landmarks."""
SEEDS = range(5)


def pose_and_landmarks(seed: int, p: int, width: int) -> tuple[Array, Array]:
    """A pose (p,), off the circle where it has a pair, and landmarks (4, width) around it."""
    rng = np.random.default_rng(seed)
    pose = np.concatenate((rng.uniform(-5.0, 5.0, 2), rng.uniform(-1.5, 1.5, p - 2)))
    return pose, rng.uniform(-9.0, 9.0, (4, width))


@pytest.mark.parametrize("name", MODELS)
def test_the_innovation_is_what_was_measured_less_what_was_predicted(name: str) -> None:
    model, _, width = MODELS[name]
    z, predicted = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 5, width))
    assert np.allclose(model.innovation(z, predicted), z - predicted, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("name", MODELS)
def test_the_range_is_the_distance_to_the_landmark(name: str) -> None:
    model, p, width = MODELS[name]
    pose, landmark = np.array((1.0, -2.0, 0.6, 0.8))[:p], np.zeros((1, width))
    landmark[0, :2] = 4.0, 2.0
    assert np.isclose(model.range_m(model.predict(pose, landmark).z)[0], 5.0)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", MODELS)
def test_jacobians_equal_central_differences(name: str, seed: int) -> None:
    model, p, width = MODELS[name]
    pose, landmarks = pose_and_landmarks(seed, p, width)
    at = model.predict(pose, landmarks)

    def seen(state: Array) -> Array:
        places = state[p:].reshape(-1, width)
        return model.innovation(model.predict(state[:p], places).z, at.z).ravel()

    by_state = central_difference(seen, np.concatenate((pose, landmarks.ravel())))
    assert relative_error(at.jacobian_pose.reshape(-1, p), by_state[:, :p]) < 1e-8
    assert relative_error(block_diagonal(at.jacobian_landmark), by_state[:, p:]) < 1e-8


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", MODELS)
def test_inverse_undoes_prediction_and_its_jacobians_hold(name: str, seed: int) -> None:
    model, p, width = MODELS[name]
    pose, landmarks = pose_and_landmarks(seed, p, width)
    z = model.predict(pose, landmarks).z
    new = model.invert(pose, z)
    back = model.predict(pose, new.landmark)

    def placed(both: Array) -> Array:
        return model.invert(both[:p], both[p:].reshape(-1, width)).landmark.ravel()

    by_both = central_difference(placed, np.concatenate((pose, z.ravel())))
    assert relative_error(new.jacobian_pose.reshape(-1, p), by_both[:, :p]) < 1e-8
    assert relative_error(block_diagonal(new.jacobian_z), by_both[:, p:]) < 1e-8
    if name == "own axes":  # whose pair undoes itself on the circle alone
        return
    assert np.abs(model.innovation(z, back.z)).max() < 1e-12
    # The two models describe one constraint: H_l G_x = -H_v and H_l G_z = I.
    h = back.jacobian_landmark
    assert np.allclose(h @ new.jacobian_pose, -back.jacobian_pose, atol=1e-12)
    assert np.allclose(h @ new.jacobian_z, np.eye(width), atol=1e-12)
