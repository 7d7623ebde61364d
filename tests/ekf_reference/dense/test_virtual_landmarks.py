from __future__ import annotations

import numpy as np
import pytest

from ekf_reference.dense.conditions import Conditions
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.virtual_landmarks import VirtualLandmarks
from ekf_reference.kalman import KalmanState
from ekf_reference.observation import RangeBearing
from tests.helpers import Array

POSE = np.array((2.0, -6.0, 1.2))
WALL = np.array([(0.0, 0.0), (12.0, 1.0)])
ANYWHEN = VirtualLandmarks(Conditions(least_correlation=-1.0))


def at_a_wall(position_m: float, range_m: float) -> KalmanState:
    """Two landmarks on a wall, seen once: the pose's uncertainty and the sensor's."""
    state = KalmanState(POSE, np.diag((position_m**2, position_m**2, 1e-6)))
    model = RangeBearing()
    new = model.invert(POSE, model.predict(POSE, WALL).z)
    noise = np.broadcast_to(np.diag((range_m**2, 1e-6)), (2, 2, 2))
    state.augment(new.point, new.jacobian_pose, new.jacobian_sighting, noise)
    return state


def created(state: KalmanState, z: Array) -> None:
    new = RangeBearing().invert(state.pose, z[None])
    state.augment(new.point, new.jacobian_pose, new.jacobian_sighting, np.zeros((1, 2, 2)))


def test_it_makes_a_region_behind_two_landmarks() -> None:
    """The region is accepted, includes the wall, and the filter knows what it knew to the bit."""
    state = at_a_wall(2.0, 0.1)
    mean, covariance = state.mean.copy(), state.covariance.copy()
    found = VirtualLandmarks().wanted(state.pose, state.landmarks, state.covariance)
    assert found is not None
    created(state, found.z)
    assert np.allclose(state.landmarks[2], found.point, atol=1e-12)
    assert np.array_equal(state.mean[:7], mean)
    assert np.array_equal(state.covariance[:7, :7], covariance)
    regions = LocalRegions()
    regions.extend(state.landmarks, np.arange(3), state.covariance[3:, 3:])
    assert len(regions.base) == 1
    behind = WALL.mean(axis=0) + (-0.1, 1.2)
    assert regions.placed(state.landmarks).locate(behind[None]).region[0] == 0


def test_not_while_the_vehicle_is_poorly_correlated() -> None:
    """Created then it would be of no use: the region is refused."""
    state = at_a_wall(0.3, 0.5)
    assert VirtualLandmarks().wanted(state.pose, state.landmarks, state.covariance) is None
    early = ANYWHEN.wanted(state.pose, state.landmarks, state.covariance)
    assert early is not None
    created(state, early.z)
    assert not len(LocalRegions().extend(state.landmarks, np.arange(3), state.covariance[3:, 3:]))


@pytest.mark.parametrize("seed", range(20))
def test_it_lies_across_the_line_from_the_vehicle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose, landmark = rng.uniform(-20, 20, 3), rng.uniform(-20, 20, (2, 2))
    for corners in (landmark, landmark[::-1]):
        found = ANYWHEN.wanted(pose, corners, np.eye(7))
        assert found is not None
        sides = np.linalg.norm(
            np.vstack((corners, found.point))
            - np.roll(np.vstack((corners, found.point)), 1, axis=0),
            axis=1,
        )
        assert np.allclose(sides, sides[0])
        edge = corners[1] - corners[0]
        across = [
            edge[0] * (p - corners[0])[1] - edge[1] * (p - corners[0])[0]
            for p in (pose[:2], found.point)
        ]
        assert across[0] * across[1] < 0.0
        assert np.allclose(RangeBearing().invert(pose, found.z[None]).point[0], found.point)
        assert abs(found.z[1]) <= np.pi


@pytest.mark.parametrize(
    "landmark", [[(3.0, 3.0), (3.0, 3.0)], [(2.0, 0.0), (2.0, 9.0)], [(2.0, -6.0), (2.0, -6.0)]]
)
def test_no_far_side_no_landmark(landmark: list[tuple[float, float]]) -> None:
    assert ANYWHEN.wanted(POSE, np.array(landmark), np.eye(7)) is None
