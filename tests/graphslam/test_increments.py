import numpy as np
import pytest

from graphslam.graph_builder import to_tangent
from graphslam.increments import MotionSamples, compose
from tests.graphslam.motions import GEOMETRY, controls, samples
from tests.graphslam.numerics import Array, central_difference, exponential, product, relative_error


def stepped(kind: str, pose: Array, control: Array, duration_s: float) -> Array:
    """A pose (3,) after one sample, in global coordinates; control: speed, steering or yaw rate."""
    speed, turning = control
    if kind == "unicycle":
        middle = pose[2] + 0.5 * duration_s * turning
        velocity = np.array((speed * np.cos(middle), speed * np.sin(middle), turning))
    else:
        wheelbase, encoder, forward, left = GEOMETRY
        tan, cos, sin = np.tan(turning), np.cos(pose[2]), np.sin(pose[2])
        way = (
            cos - tan / wheelbase * (forward * sin + left * cos),
            sin + tan / wheelbase * (forward * cos - left * sin),
            tan / wheelbase,
        )
        velocity = speed / (1.0 - tan * encoder / wheelbase) * np.array(way)
    arrived: Array = pose + duration_s * velocity
    return arrived


@pytest.mark.parametrize("kind", ["ackermann", "unicycle"])
def test_increments_compose_to_the_propagated_gaussian(kind: str) -> None:
    """Against stepping through the motion model (Nieto 2005, A.3, A.4), Jacobians numeric."""
    u, w, dt = controls(40, 3)
    start = np.array((4.0, -7.0, 2.1))
    pose, covariance = start, np.zeros((3, 3))
    for v, turning, seconds in zip(u, w, dt, strict=True):

        def arrival(x: Array, seconds: float = seconds) -> Array:
            return stepped(kind, x[:3], x[3:], seconds)

        at = np.concatenate((pose, (v, turning)))
        jacobian = central_difference(arrival, at)
        before = np.zeros((5, 5))
        before[:3, :3], before[3:, 3:] = covariance, np.diag((0.04, 0.0025))
        covariance = jacobian @ before @ jacobian.T + seconds * np.diag((1e-5, 1e-5, 1e-7))
        pose = arrival(at)
    whole = compose(samples(kind, u, w, dt), np.zeros(40, dtype=np.intp), 1)
    assert relative_error(product(start, whole.displacement[0]), pose) < 1e-13
    turn = to_tangent(pose[2:])[0].T
    assert relative_error(turn @ whole.covariance[0] @ turn.T, covariance) < 1e-7
    assert relative_error(turn.T @ whole.covariance[0] @ turn, covariance) > 0.1


@pytest.mark.parametrize("kind", ["ackermann", "unicycle"])
def test_sample_noise_equals_central_differences(kind: str) -> None:
    """The covariance is B Q B^T with B numeric, in the frame of arrival."""
    u, w, dt = controls(1, 5)

    def displacement(control: Array) -> Array:
        moved: Array = samples(kind, control[:1], control[1:], dt).displacement[0]
        return moved

    b = central_difference(displacement, np.array((u[0], w[0])))
    turn = to_tangent(displacement(np.array((u[0], w[0])))[2:])[0]
    expected = turn @ b @ np.diag((0.04, 0.0025)) @ b.T @ turn.T
    expected += dt[0] * np.diag((1e-5, 1e-5, 1e-7))
    assert relative_error(samples(kind, u, w, dt).covariance[0], expected) < 1e-8


def test_composition_transports_perturbations_exactly() -> None:
    """Against central differences through the product of perturbed motions."""
    rng = np.random.default_rng(0)
    moves = rng.uniform(-1, 1, (5, 3))
    covariances = np.array([np.diag(rng.uniform(0.1, 1, 3)) for _ in moves])
    whole = compose(MotionSamples(moves, covariances), np.zeros(5, dtype=np.intp), 1)

    def perturbed(xi: Array) -> Array:
        """Right perturbation of the end when every sample's arrival is perturbed."""
        pose = np.zeros(3)
        for move, e in zip(moves, xi.reshape(5, 3), strict=True):
            pose = product(product(pose, move), exponential(e))
        end = whole.displacement[0]
        difference: Array = pose - end
        difference[:2] = to_tangent(end[2:])[0][:2, :2] @ difference[:2]
        return difference

    j = central_difference(perturbed, np.zeros(15))
    full = np.zeros((15, 15))
    for i in range(5):
        full[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = covariances[i]
    assert relative_error(whole.covariance[0], j @ full @ j.T) < 1e-8


def test_intervals_are_composed_apart_and_may_be_empty() -> None:
    u, w, dt = controls(6, 1)
    every = samples("unicycle", u, w, dt)
    parts = compose(every, np.array((0, 0, 2, 2, 2, 3)), 4)
    for interval, rows in ((0, slice(0, 2)), (2, slice(2, 5)), (3, slice(5, 6))):
        alone = compose(
            MotionSamples(every.displacement[rows], every.covariance[rows]),
            np.zeros(rows.stop - rows.start, dtype=np.intp),
            1,
        )
        assert np.allclose(parts.displacement[interval], alone.displacement[0], atol=1e-13)
        assert np.allclose(parts.covariance[interval], alone.covariance[0], atol=1e-16)
    assert np.array_equal(parts.displacement[1], np.zeros(3))
    assert np.array_equal(parts.covariance[1], np.zeros((3, 3)))
