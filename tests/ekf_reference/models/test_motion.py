import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.models.motion import (
    AckermannModel,
    IntegratedModel,
    Integration,
    MotionModel,
    RelativePoseModel,
    UnicycleModel,
)
from tests.ekf_reference.numerics import central_difference, relative_error

UTE = AckermannModel(2.83, 0.76, 3.78, 0.5)
MODELS: dict[str, tuple[MotionModel, int]] = {
    "ackermann": (UTE, 2),
    "bicycle": (AckermannModel(2.83), 2),
    "unicycle": (UnicycleModel(), 2),
    "relative pose": (RelativePoseModel(), 3),
    "ackermann, arc": (IntegratedModel(UTE, "euler", "arc"), 2),
    "ackermann, middle": (IntegratedModel(UTE, "euler", "middle"), 2),
    "unicycle, euler": (IntegratedModel(UnicycleModel(), "middle", "euler"), 2),
    "unicycle, arc": (IntegratedModel(UnicycleModel(), "middle", "arc"), 2),
    "unicycle, 10 steps": (IntegratedModel(UnicycleModel(), "middle", 10), 2),
    "ackermann, 3 steps": (IntegratedModel(UTE, "euler", 3), 2),
}


def random_case(seed: int, controls: int) -> tuple[Array, Array, float]:
    rng = np.random.default_rng(seed)
    pose = rng.uniform((-50, -50, -9), (50, 50, 9))
    return pose, rng.uniform(-1, 1, controls) * (3.0, 0.5, 0.3)[:controls], rng.uniform(0.01, 0.3)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("seed", range(5))
def test_jacobians_equal_central_differences(name: str, seed: int) -> None:
    model, controls = MODELS[name]
    pose, control, dt = random_case(seed, controls)
    step = model.step(pose, control, dt)
    by_pose = central_difference(lambda p: model.step(p, control, dt).pose, pose)
    assert relative_error(step.jacobian_pose, by_pose) < 1e-8
    if name == "relative pose":  # its control error is in the frame of arrival

        def perturbed(e: Array) -> Array:
            cos, sin = np.cos(control[2]), np.sin(control[2])
            turned = (cos * e[0] - sin * e[1], sin * e[0] + cos * e[1], e[2])
            return model.step(pose, control + turned, dt).pose

        by_control = central_difference(perturbed, np.zeros(3))
    else:
        by_control = central_difference(lambda u: model.step(pose, u, dt).pose, control)
    assert relative_error(step.jacobian_control, by_control) < 1e-7


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("seed", range(3))
def test_moving_the_start_moves_the_result_alike(name: str, seed: int) -> None:
    """SE(2)-equivariance, without which increments would not carry the EKF's information."""
    model, controls = MODELS[name]
    pose, control, dt = random_case(seed, controls)
    from_origin = model.step(np.zeros(3), control, dt).pose
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    moved = pose + (
        cos * from_origin[0] - sin * from_origin[1],
        sin * from_origin[0] + cos * from_origin[1],
        from_origin[2],
    )
    assert np.allclose(model.step(pose, control, dt).pose, moved, rtol=0, atol=1e-13)


def test_bicycle_is_equation_2_6() -> None:
    pose, control, dt = random_case(1, 2)
    v, alpha = control
    expected = pose + dt * v * np.array((np.cos(pose[2]), np.sin(pose[2]), np.tan(alpha) / 2.83))
    assert np.allclose(AckermannModel(2.83).step(pose, control, dt).pose, expected, atol=1e-14)


def test_ackermann_follows_the_laser_of_a_turning_axle() -> None:
    """A.4 is the derivative of A.2 along A.1: a small step moves the laser as the axle does."""
    dt, pose, control = 1e-6, np.array((3.0, -2.0, 0.7)), np.array((2.0, 0.3))
    v = 2.0 / (1 - np.tan(0.3) * 0.76 / 2.83)

    def laser(axle: Array) -> Array:
        cos, sin = np.cos(axle[2]), np.sin(axle[2])
        return axle + (3.78 * cos - 0.5 * sin, 3.78 * sin + 0.5 * cos, 0.0)

    cos, sin = np.cos(0.7), np.sin(0.7)
    axle = pose - (3.78 * cos - 0.5 * sin, 3.78 * sin + 0.5 * cos, 0.0)
    moved = axle + dt * v * np.array((cos, sin, np.tan(0.3) / 2.83))
    assert np.allclose(UTE.step(pose, control, dt).pose, laser(moved), rtol=0, atol=1e-11)


@pytest.mark.parametrize("seed", range(3))
def test_printed_jacobians_of_the_thesis_fail(seed: int) -> None:
    """A.7, A.9 and A.11 as printed (errata) differ from the derivative; the corrected ones hold."""
    pose, control, dt = random_case(seed, 2)
    h, length, a, b = 0.76, 2.83, 3.78, 0.5
    steering, phi = control[1], pose[2]
    tan = np.tan(steering)
    vc = control[0] / (1 - tan * h / length)
    dvc = vc / (1 - tan * h / length) * h / length / np.cos(steering) ** 2
    t1, t2 = a * np.sin(phi) + b * np.cos(phi), a * np.cos(phi) - b * np.sin(phi)
    turn = vc / length / np.cos(steering) ** 2
    printed = np.array(
        (
            -t1 * turn + (np.cos(phi) - tan / length * t1) * dvc * dt,
            -t2 * turn + (np.sin(phi) + tan / length * t2) * dvc * dt,
            turn + tan / length * dvc * dt,
        )
    )
    exact = central_difference(lambda u: UTE.step(pose, u, dt).pose, control)[:, 1]
    assert np.all(np.abs(printed - exact) > 1e-2 * np.abs(exact))
    corrected = UTE.step(pose, control, dt).jacobian_control[:, 1]
    assert relative_error(corrected, exact) < 1e-7


@pytest.mark.parametrize("turn_radps", [-3.0, -0.2, -1e-3, 1e-9, 0.0, 0.04, 0.7])
def test_the_arc_is_the_limit_of_small_steps(turn_radps: float) -> None:
    """Of a thousand steps; the closed form of a unicycle's circle where it turns at all."""
    control, pose = np.array((2.0, turn_radps)), np.array((3.0, -4.0, 1.0))
    arc = IntegratedModel(UnicycleModel(), "middle", "arc").step(pose, control, 0.5).pose
    small = pose
    for _ in range(1000):
        small = UnicycleModel().step(small, control, 0.0005).pose
    assert np.abs(arc - small).max() < 1e-6
    if abs(turn_radps) > 0.01:
        radius, (a, b) = 2.0 / turn_radps, (1.0, 1.0 + 0.5 * turn_radps)
        circle = radius * np.array((np.sin(b) - np.sin(a), np.cos(a) - np.cos(b)))
        assert np.abs(arc[:2] - pose[:2] - circle).max() < 1e-12


def test_middle_of_the_middle_is_the_model_itself() -> None:
    control, pose = np.array((2.0, 0.7)), np.array((3.0, -4.0, 1.0))
    own = UnicycleModel().step(pose, control, 0.5)
    again = IntegratedModel(UnicycleModel(), "middle", "middle").step(pose, control, 0.5)
    for one, other in zip(own, again, strict=True):
        assert np.abs(one - other).max() < 1e-14


@pytest.mark.parametrize(("model", "own"), [(UTE, "euler"), (UnicycleModel(), "middle")])
@pytest.mark.parametrize("count", [1, 2, 10, 50])
def test_several_euler_steps_are_chained(model: MotionModel, own: Integration, count: int) -> None:
    control, pose = np.array((3.0, 0.25)), np.array((2.0, -1.0, 0.7))
    short, chained = IntegratedModel(model, own, "euler"), pose
    for _ in range(count):
        chained = short.step(chained, control, 0.8 / count).pose
    once = IntegratedModel(model, own, count).step(pose, control, 0.8).pose
    np.testing.assert_allclose(once, chained, rtol=0, atol=1e-13)
    other = IntegratedModel(model, own, count + 1).step(pose, control, 0.8).pose
    assert np.abs(other - chained).max() > 1e-5, "a number of steps that is one off passes"
    longest_s = 0.8 / (count - 0.5)
    by_length = IntegratedModel(model, own, longest_s).step(pose, control, 0.8).pose
    np.testing.assert_array_equal(by_length, once)
