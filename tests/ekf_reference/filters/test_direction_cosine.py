"""Misono's models: motion, measurements and positions on x, y, cosine, sine."""

import math

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.filters.misono import (
    DirectionCosineMotion,
    DirectionCosinePosition,
    OwnAxesObservation,
    along_circle,
    from_heading,
    heading_jacobian,
)
from ekf_reference.models.motion import (
    AckermannModel,
    MotionModel,
    MotionStep,
    RelativePoseModel,
    UnicycleModel,
)
from ekf_reference.models.position import PositionModel
from ekf_reference.models.range_bearing import RangeBearing
from tests.ekf_reference.numerics import central_difference, relative_error

POSE = np.array([3.0, -2.0, 2.1])
OWN = from_heading(POSE)
OFF_CIRCLE = np.array([3.0, -2.0, -0.6, 0.95])
LANDMARKS = np.array([[8.0, 1.0], [-4.0, 2.5], [3.5, -9.0]])


class TurnThenDrive:
    """The paper's vehicle. Control: (way [m], turn [rad])."""

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        way, turn = control.tolist()
        cos, sin = math.cos(pose[2] + turn), math.sin(pose[2] + turn)
        east, north = way * cos, way * sin
        jacobian_pose = np.array([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 1.0]])
        jacobian_control = np.array([[cos, -north], [sin, east], [0.0, 1.0]])
        return MotionStep(pose + (east, north, turn), jacobian_pose, jacobian_control)


MODELS: list[tuple[MotionModel, Array]] = [
    (TurnThenDrive(), np.array([0.7, 0.3])),
    (UnicycleModel(), np.array([1.2, -0.4])),
    (AckermannModel(2.83, 0.76, 3.78, 0.5), np.array([2.0, 0.2])),
    (RelativePoseModel(), np.array([0.5, -0.2, 0.4])),
]


@pytest.mark.parametrize(("motion", "control"), MODELS)
def test_motion_equals_that_of_the_heading(motion: MotionModel, control: Array) -> None:
    """Same pose, same F and B along the circle."""
    own = DirectionCosineMotion(motion).step(OWN, control, 0.5)
    heading = motion.step(POSE, control, 0.5)
    assert np.allclose(own.pose, from_heading(heading.pose), atol=1e-14)
    read = heading_jacobian(own.pose)
    assert relative_error(read @ own.jacobian_pose @ along_circle(OWN), heading.jacobian_pose) < (
        1e-14
    )
    assert relative_error(read @ own.jacobian_control, heading.jacobian_control) < 1e-14


@pytest.mark.parametrize(("motion", "control"), MODELS)
@pytest.mark.parametrize("pose", [OWN, OFF_CIRCLE])
def test_motion_is_linear_in_the_pose(motion: MotionModel, control: Array, pose: Array) -> None:
    model = DirectionCosineMotion(motion)
    step = model.step(pose, control, 0.5)
    numeric = central_difference(lambda x: model.step(x, control, 0.5).pose, pose)
    assert relative_error(step.jacobian_pose, numeric) < 1e-8
    assert np.allclose(step.pose, step.jacobian_pose @ pose, atol=1e-14)


@pytest.mark.parametrize(("motion", "control"), MODELS[:3])
@pytest.mark.parametrize("pose", [OWN, OFF_CIRCLE])
def test_noise_input_equals_central_differences(
    motion: MotionModel, control: Array, pose: Array
) -> None:
    model = DirectionCosineMotion(motion)
    numeric = central_difference(lambda u: model.step(pose, u, 0.5).pose, control)
    assert relative_error(model.step(pose, control, 0.5).jacobian_control, numeric) < 1e-8


def test_transition_is_equation_4() -> None:
    d, turn = 0.7, 0.3
    cos, sin = math.cos(turn), math.sin(turn)
    printed = np.array(
        [[1, 0, d * cos, -d * sin], [0, 1, d * sin, d * cos], [0, 0, cos, -sin], [0, 0, sin, cos]]
    )
    f = DirectionCosineMotion(TurnThenDrive()).step(OWN, np.array([d, turn]), 1.0).jacobian_pose
    assert relative_error(f, printed) < 1e-15


def test_printed_noise_input_fails() -> None:
    """Equation 5 with xi(k), eta(k) is off by the turn; with those of k + 1 it holds."""
    d, turn = 0.7, 0.3
    model = DirectionCosineMotion(TurnThenDrive())
    step = model.step(OWN, np.array([d, turn]), 1.0)
    numeric = central_difference(lambda u: model.step(OWN, u, 1.0).pose, np.array([d, turn]))

    def equation_5(pose: Array) -> Array:
        xi, eta = pose[2:]
        return np.array([[xi, -d * eta], [eta, d * xi], [0.0, -eta], [0.0, xi]])

    assert relative_error(equation_5(step.pose), numeric) < 1e-8
    assert relative_error(equation_5(OWN), numeric) > 0.1


def test_observation_jacobians() -> None:
    """As published, against the full ones, which test_measurement_models derives."""
    full, published = OwnAxesObservation(), OwnAxesObservation(full_jacobian=False)
    for pose in (OWN, OFF_CIRCLE):
        predicted = full.predict(pose, LANDMARKS)
        as_printed = published.predict(pose, LANDMARKS)
        assert not as_printed.jacobian_pose[:, :, 2:].any()
        assert np.array_equal(as_printed.jacobian_pose[:, :, :2], predicted.jacobian_pose[:, :, :2])
        h = np.concatenate((as_printed.jacobian_pose, as_printed.jacobian_landmark), axis=2)
        state = np.column_stack((np.tile(pose, (3, 1)), LANDMARKS))
        assert np.allclose(np.einsum("mij,mj->mi", h, state), as_printed.z, atol=1e-12)  # 12


def test_measurements_are_range_and_bearing_in_other_axes() -> None:
    """What range and bearing predict, turned into the vehicle's axes, is what this predicts."""
    polar = RangeBearing().predict(POSE, LANDMARKS).z
    sigma = np.tile((0.1, 0.02), (3, 1))
    z, noise = OwnAxesObservation().measured(polar, sigma)
    assert np.allclose(z, OwnAxesObservation().predict(OWN, LANDMARKS).z, atol=1e-12)
    assert np.allclose(OwnAxesObservation().range_m(z), polar[:, 0], atol=1e-12)
    for i in range(3):
        jacobian = central_difference(
            lambda p: OwnAxesObservation().measured(p[None], sigma[:1])[0][0], polar[i]
        )
        propagated = jacobian @ np.diag(sigma[i] ** 2) @ jacobian.T
        assert relative_error(noise[i], propagated) < 1e-8


def test_printed_inverse_fails() -> None:
    """Equation 16 as printed puts landmarks elsewhere; with (eta, xi) it is the inverse of 9."""
    z = OwnAxesObservation().predict(OWN, LANDMARKS).z
    xi, eta = OWN[2:]
    printed = OWN[:2] + z @ np.array([[eta, -xi], [-xi, eta]]).T
    corrected = OWN[:2] + z @ np.array([[eta, xi], [-xi, eta]]).T
    assert np.allclose(corrected, LANDMARKS, atol=1e-12)
    assert np.allclose(OwnAxesObservation().invert(OWN, z).landmark, corrected, atol=1e-12)
    assert np.linalg.norm(printed - LANDMARKS, axis=1).max() > 5.0


def test_positions_are_linear() -> None:
    lever = (0.8, -0.3)
    expected, jacobian = DirectionCosinePosition(lever).predict(OWN)
    by_heading, jacobian_heading = PositionModel(lever).predict(POSE)
    assert np.allclose(expected, by_heading, atol=1e-14)
    assert relative_error(jacobian @ along_circle(OWN), jacobian_heading) < 1e-14


def test_reading_undoes_the_pair() -> None:
    numeric = central_difference(lambda p: np.array([*p[:2], math.atan2(p[3], p[2])]), OFF_CIRCLE)
    assert relative_error(heading_jacobian(OFF_CIRCLE), numeric) < 1e-8
    assert np.allclose(heading_jacobian(OWN) @ along_circle(OWN), np.eye(3), atol=1e-15)
