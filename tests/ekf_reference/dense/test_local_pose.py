import numpy as np
import pytest

from ekf_reference.core.geometry import Array, wrap_angle
from ekf_reference.dense.local_pose import Frames, local_pose, local_pose_jacobian, read_local_poses
from ekf_reference.dense.view import FilterView
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.numerics import central_difference, random_covariance

SEEDS = range(8)


def state(seed: int) -> Array:
    """A pose, L1 and L2: axes in all directions, headings of several turns."""
    rng = np.random.default_rng(seed)
    return np.concatenate((rng.uniform(-20, 20, 2), rng.uniform(-9, 9, 1), rng.uniform(-20, 20, 4)))


def of(x: Array) -> Array:
    local = local_pose(x[:3], x[3:5], x[5:])
    return np.append(local[:2], wrap_angle(local[2:]))


@pytest.mark.parametrize("seed", SEEDS)
def test_jacobian_equals_central_differences(seed: int) -> None:
    x = state(seed)
    found = local_pose_jacobian(x[:3], x[3:5], x[5:])
    expected = central_difference(of, x)
    assert np.allclose(found, expected, atol=1e-7)
    axis_at_rest = found.copy()
    axis_at_rest[:, 5:] = 0.0
    assert not np.allclose(axis_at_rest, expected, atol=1e-3)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_point_is_the_local_pose_composed_with_the_measurement(seed: int) -> None:
    """Equation 3.29 in metric coordinates: exact, and without the landmarks."""
    x = state(seed)
    z = np.random.default_rng(100 + seed).uniform((1.0, -3.0), (20.0, 3.0), (5, 2))
    seen = RangeBearing().invert(x[:3], z).landmark
    expected = Frames.of(x[3:5], x[5:]).to_local(seen)
    assert np.allclose(RangeBearing().invert(of(x), z).landmark, expected, atol=1e-12)


def test_printed_arctangent_fails_on_axes_to_the_west() -> None:
    first, second, pose = np.array((5.0, 1.0)), np.array((1.0, 2.0)), np.array((3.0, -2.0, 0.4))
    ahead = second - first
    printed = pose[2] - np.arctan(ahead[1] / ahead[0])
    assert abs(abs(local_pose(pose, first, second)[2] - printed) - np.pi) < 1e-12


def test_frames_go_there_and_back() -> None:
    rng = np.random.default_rng(0)
    first, second, point = rng.uniform(-20, 20, (3, 6, 2))
    frame = Frames.of(first, second)
    assert np.allclose(frame.to_world(frame.to_local(point)), point, atol=1e-12)
    assert np.allclose(frame.to_local(first), 0.0, atol=1e-12)
    length = np.linalg.norm(second - first, axis=1)
    assert np.allclose(frame.to_local(second), np.column_stack((length, np.zeros(6))), atol=1e-12)


def test_local_poses_are_read_with_their_covariance() -> None:
    """Of landmarks that lie anywhere in the map, some of them without a current covariance."""
    rng = np.random.default_rng(3)
    landmark, landmark_index = rng.uniform(-20, 20, (7, 2)), np.array((1, 3, 4, 6))
    pose, joint = np.array((1.0, 2.0, 3.0)), random_covariance(rng, 11)
    view = FilterView(pose, landmark, landmark_index, joint)
    axis = np.array([(1, 3), (6, 4), (3, 6)])
    mean, covariance = read_local_poses(view, axis)
    for k, (i, j) in enumerate(axis):
        columns = [0, 1, 2]
        for place in np.searchsorted(landmark_index, (i, j)):
            columns += [3 + 2 * place, 4 + 2 * place]
        x = np.concatenate((pose, landmark[i], landmark[j]))
        by_state = central_difference(of, x)
        expected = by_state @ joint[np.ix_(columns, columns)] @ by_state.T
        assert np.allclose(covariance[k], expected, rtol=1e-6, atol=1e-7)
        assert np.allclose(mean[k, :2], of(x)[:2])
    mean, covariance = read_local_poses(view, np.empty((0, 2), dtype=np.intp))
    assert mean.shape == (0, 3)
    assert covariance.shape == (0, 3, 3)
