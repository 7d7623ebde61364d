import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.models.relative_pose import RelativePose
from tests.ekf_reference.both_kinds import relative

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


def test_the_heading_is_wrapped_and_nothing_is_written_into_the_arguments() -> None:
    z, expected = np.array([[1.0, 2.0, 3.1]]), np.array([[0.5, 2.5, -3.1 - 4.0 * np.pi]])
    before = z.copy(), expected.copy()
    found = MODEL.innovation(z, expected)
    assert np.allclose(found, [[0.5, -0.5, 6.2 - 2.0 * np.pi]], rtol=0.0, atol=1e-13)
    assert np.array_equal(z, before[0])
    assert np.array_equal(expected, before[1])
