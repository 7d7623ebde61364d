"""Directions that relative sensors cannot tell, by kind of filter."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comparisons.arrays import Array
from comparisons.audit.directions import Part, inertial_directions, planar_directions

STEP = 1e-6
UP = np.array([0.0, 0.0, 1.0])


def test_planar_directions_are_a_shift_and_a_turn_of_the_whole() -> None:
    rng = np.random.default_rng(0)
    pose, points, poses = rng.normal(size=3), rng.normal(size=(4, 2)), rng.normal(size=(2, 3))
    found = planar_directions(pose, points, poses)
    assert list(found) == ["east", "north", "heading"]
    state = np.concatenate((pose, points.ravel(), poses.ravel()))

    def moved(shift: Array, angle: float) -> Array:
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        place = [pose[:2] + (one - pose[:2]) @ turn.T + shift for one in (pose[:2], points)]
        others = pose[:2] + (poses[:, :2] - pose[:2]) @ turn.T + shift
        posed = np.column_stack((others, poses[:, 2] + angle))
        return np.concatenate((place[0], [pose[2] + angle], place[1].ravel(), posed.ravel()))

    for name, shift, angle in (("east", (1, 0), 0), ("north", (0, 1), 0), ("heading", (0, 0), 1)):
        by = STEP * np.array(shift, float), STEP * float(angle)
        change = (moved(*by) - moved(-by[0], -by[1])) / (2.0 * STEP)
        assert np.allclose(found[name], change, atol=1e-8), name
    assert np.allclose(moved(np.zeros(2), 0.0), state)


@pytest.mark.parametrize("attitude", ["attitude, world", "attitude, body"])
def test_inertial_directions_are_a_shift_and_a_turn_about_gravity(attitude: Part) -> None:
    """By central differences of the error's own definition; biases stay."""
    rng = np.random.default_rng(1)
    position, clone, point, velocity = rng.normal(size=(4, 3))
    rotation = Rotation.from_rotvec(rng.normal(size=3))
    found = inertial_directions(
        (
            ("position", position),
            (attitude, rotation.as_matrix()),
            ("velocity", velocity),
            ("other", np.ones(6)),
            ("position", clone),
            ("point", point),
        )
    )
    assert list(found) == ["x", "y", "z", "yaw"]

    def error(shift: Array, angle: float) -> Array:
        """Truth, moved as a whole, minus the estimate."""
        turn = Rotation.from_rotvec(angle * UP)
        place = [position + turn.apply(p - position) + shift - p for p in (position, clone, point)]
        true = turn * rotation
        apart = true * rotation.inv() if attitude == "attitude, world" else rotation.inv() * true
        faster = turn.apply(velocity) - velocity
        return np.concatenate((place[0], apart.as_rotvec(), faster, np.zeros(6), *place[1:]))

    for i, name in enumerate(("x", "y", "z", "yaw")):
        shift, angle = STEP * np.eye(4)[i, :3], STEP * np.eye(4)[i, 3]
        change = (error(shift, angle) - error(-shift, -angle)) / (2.0 * STEP)
        assert np.allclose(found[name], change, atol=1e-8), name


def test_a_camera_sees_none_of_them_and_the_other_convention_would() -> None:
    """z = R^T (point - position): H N = 0 with the attitude error that H is taken by."""
    rng = np.random.default_rng(2)
    position, point = rng.normal(size=(2, 3))
    r = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    offset = point - position

    def skew(v: Array) -> Array:
        return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])

    by_world = np.hstack((-r.T, r.T @ skew(offset), r.T))
    by_body = np.hstack((-r.T, skew(r.T @ offset), r.T))
    world, body = (
        np.column_stack(
            list(inertial_directions((("position", position), (a, r), ("point", point))).values())
        )
        for a in ("attitude, world", "attitude, body")
    )
    assert np.abs(by_world @ world).max() < 1e-14
    assert np.abs(by_body @ body).max() < 1e-14
    assert np.abs(by_world @ body).max() > 0.1
