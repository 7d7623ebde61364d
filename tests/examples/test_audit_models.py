"""Jacobians of the recorded filters by central differences, and what the UKF records as noise."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.trace.events import Predict, Update
from comparisons.trace.reader import TraceReader
from examples.audit import gtsam_filters, msckf
from examples.audit.navlie_groups import SE3
from tests.examples.test_audit_filters import needs

STEP = 1e-6


def differences(g: Callable[[Array], Array], n: int) -> Array:
    """The derivative of g at zero, a column an entry."""
    return np.column_stack([(g(d) - g(-d)) / (2.0 * STEP) for d in STEP * np.eye(n)])


def test_radar() -> None:
    needs("filterpy_ekf")
    from examples.audit.filterpy_ekf import radar, radar_jacobian

    x = np.array([300.0, 700.0, -3.0, 4.0, 2.0, 0.01])
    np.testing.assert_allclose(radar_jacobian(x), differences(lambda d: radar(x + d), 6), atol=1e-7)


@pytest.mark.parametrize("sensor", [gtsam_filters.gps, gtsam_filters.dvl])
def test_sensors_of_a_navigation_state(
    sensor: Callable[[gtsam.NavState], tuple[Array, Array]],
) -> None:
    attitude = gtsam.Rot3.RzRyRx(0.3, -0.2, 1.0)
    state = gtsam.NavState(attitude, np.array([1.0, 2.0, 3.0]), np.array([3.0, -1.0, 0.5]))
    h = differences(lambda d: sensor(state.retract(d))[0], 9)
    np.testing.assert_allclose(sensor(state)[1], h, atol=1e-8)


def test_motion_in_the_plane() -> None:
    x = np.array([1.0, -2.0, 0.7, 0.02, -0.03])
    f = differences(lambda d: msckf.move(x + d, 0.4)[0], 5)
    np.testing.assert_allclose(msckf.move(x, 0.4)[1], f, atol=1e-8)


def test_bearings() -> None:
    rng = np.random.default_rng(0)
    poses, point = rng.standard_normal((3, 3)), np.array([7.0, -4.0])
    _, by_pose, by_point = msckf.bearings_of(poses, point)
    h = differences(lambda d: msckf.bearings_of(poses, point + d)[0], 2)
    np.testing.assert_allclose(by_point, h, atol=1e-8)
    h = differences(lambda d: msckf.bearings_of(poses + d, point)[0], 3)
    np.testing.assert_allclose(by_pose, h, atol=1e-8)


def test_bearings_without_noise_give_the_point() -> None:
    poses = np.array([[0.0, 0.0, 0.1], [1.0, 0.2, 0.0], [2.0, 0.1, -0.2], [3.0, 0.0, 0.3]])
    point = np.array([4.0, 5.0])
    found = msckf.triangulated(poses, msckf.wrapped(msckf.bearings_of(poses, point)[0]))
    assert found is not None
    np.testing.assert_allclose(found, point, atol=1e-9)
    assert msckf.triangulated(poses, np.zeros(4) - poses[:, 2]) is None


def test_the_groups_that_stand_in_for_pylie() -> None:
    xi = np.array([0.3, -0.5, 0.2, 1.0, -2.0, 0.5])
    back = SE3.inverse(SE3.Exp(xi))
    left = differences(lambda d: SE3.Log(SE3.Exp(xi + d) @ back), 6)
    np.testing.assert_allclose(SE3.left_jacobian(xi), left, atol=1e-8)
    pose, other = SE3.Exp(xi), SE3.Exp(0.3 * xi[::-1])
    moved = SE3.Log(pose @ other @ SE3.inverse(pose))
    np.testing.assert_allclose(SE3.adjoint(pose) @ SE3.Log(other), moved, atol=1e-12)


def test_navlies_motion() -> None:
    needs("navlie_se3")
    from examples.audit import navlie_se3

    x = navlie_se3.start().plus(0.1 * np.arange(9.0))
    u: Any = navlie_se3.velocity(x, 3.0)
    model = navlie_se3.BiasedVelocity()
    there = model.evaluate(x, u, 0.1)
    f = differences(lambda d: model.evaluate(x.plus(d), u, 0.1).minus(there).ravel(), 9)
    np.testing.assert_allclose(model.jacobian(x, u, 0.1), f, atol=1e-8)


@pytest.mark.parametrize("sensor", ["gps", "landmark"])
def test_navlies_sensors(sensor: str) -> None:
    needs("navlie_se3")
    from examples.audit import navlie_se3

    x = navlie_se3.start().plus(0.1 * np.arange(9.0))
    model = navlie_se3.model_of(sensor, 1)[0]
    h = differences(lambda d: model.evaluate(x.plus(d)).ravel(), 9)
    np.testing.assert_allclose(model.jacobian(x), h, atol=1e-8)


def test_a_ukf_leaves_over_no_less_than_the_sensors_noise(tmp_path: Path) -> None:
    """What is not linear adds to it; of the speed, which is linear, H and R are the model's."""
    needs("filterpy_ukf")
    from examples.audit import filterpy_ukf

    filterpy_ukf.record(tmp_path / "trace", 3)
    more = 0.0
    for event in TraceReader(tmp_path / "trace"):
        if isinstance(event, Predict):
            assert np.linalg.eigvalsh(event.noise - filterpy_ukf.Q)[0] > -1e-12
        elif isinstance(event, Update) and event.sensor == "speed":
            np.testing.assert_allclose(event.jacobian, np.eye(1, 5, 3), atol=1e-9)
            np.testing.assert_allclose(event.noise, filterpy_ukf.SENSORS["speed"][1], rtol=1e-9)
        elif isinstance(event, Update):
            added = np.linalg.eigvalsh(event.noise - filterpy_ukf.SENSORS["ranges"][1])
            assert added[0] > -1e-12
            more = max(more, float(added[-1]))
    assert more > 1e-9
