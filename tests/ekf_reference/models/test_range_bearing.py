import numpy as np
import pytest

from ekf_reference.core.geometry import wrap_angle
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.numerics import central_difference, relative_error

MODEL = RangeBearing()


@pytest.mark.parametrize("seed", range(3))
def test_printed_bearing_row_fails(seed: int) -> None:
    """Equation 2.42 as printed has the signs of the position terms exchanged (errata)."""
    rng = np.random.default_rng(seed)
    pose, point = rng.uniform(-9, 9, 3), rng.uniform(10, 30, 2)
    dx, dy = point - pose[:2]
    q = dx * dx + dy * dy
    printed = np.array((-dy / q, dx / q, -1.0))
    exact = central_difference(lambda p: MODEL.predict(p, point[None]).z[0], pose)[1]
    assert relative_error(printed, exact) > 1e-2
    assert relative_error(MODEL.predict(pose, point[None]).jacobian_pose[0, 1], exact) < 1e-8


def test_printed_arctangent_fails_behind_the_vehicle() -> None:
    """Equation 2.8 prints atan(dy / dx), which loses the quadrant (errata)."""
    for dx, dy, same in ((3.0, 4.0, True), (-3.0, 4.0, False), (-3.0, -4.0, False)):
        printed = np.arctan(dy / dx)
        bearing = MODEL.predict(np.zeros(3), np.array([[dx, dy]])).z[0, 1]
        assert np.isclose(bearing, printed) is np.bool_(same)
        assert np.allclose((np.cos(bearing), np.sin(bearing)), (dx / 5, dy / 5))


def test_quadrants_and_wrap() -> None:
    behind = MODEL.predict(np.zeros(3), np.array([[-1.0, 1e-3], [-1.0, -1e-3]])).z[:, 1]
    assert behind[0] > 3.1
    assert behind[1] < -3.1
    innovation = MODEL.innovation(np.array([[1.0, 3.1]]), np.array([[1.0, -3.1]]))
    assert np.isclose(innovation[0, 1], 6.2 - 2 * np.pi)
    angles = np.array((np.pi, -np.pi, 3 * np.pi, 0.1 + 40 * np.pi))
    assert np.allclose(wrap_angle(angles), (np.pi, np.pi, np.pi, 0.1))
