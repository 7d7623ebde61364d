"""Visual-inertial odometry: a shift of the whole and a turn about gravity cannot be told.

An error-state filter with clones, linearised at the truth or beside it; its error of the attitude
is in the world's axes, or in the body's.
"""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from comparisons.arrays import Array
from comparisons.audit.directions import Part, inertial_directions
from comparisons.audit.spurious import Learnt, learnt
from comparisons.trace.events import (
    Augment,
    Clone,
    Directions,
    Event,
    Predict,
    Prior,
    Remove,
    Update,
)
from tests.helpers import present

STEP_S, STEPS = 0.1, 25
GRAVITY = np.array([0.0, 0.0, -9.81])
STATE = ("position", "velocity", "attitude", "bias")
POINTS = np.array([[4.0, 1.0, 1.0], [3.0, -2.0, 0.5], [6.0, 3.0, -1.0]])


def skew(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def by_attitude(attitude: Part, world: Array, r: Array) -> Array:
    """A derivative by the attitude's error in the world's axes, for the error that is kept."""
    return world if attitude == "attitude, world" else world @ r


class Flight:
    """Writes down the events of a filter that is linearised at points with errors of some size."""

    def __init__(self, attitude: Part, off: float) -> None:
        self.attitude, self.off, self.rng = attitude, off, np.random.default_rng(3)
        self.position, self.velocity = np.zeros(3), np.array([1.0, 0.2, 0.1])
        self.rotation = Rotation.from_rotvec([0.1, -0.2, 0.4])
        self.events: list[Event] = [Prior(0, 0.0, STATE, (3, 3, 3, 3), np.eye(12) * 1e-2)]
        start = inertial_directions(
            (
                ("position", self.position),
                ("velocity", self.velocity),
                (attitude, self.rotation.as_matrix()),
                ("other", np.zeros(3)),
            )
        )
        basis = np.column_stack(list(start.values()))
        self.events.append(Directions(1, 0.0, STATE, basis, tuple(start), ("camera",)))
        self.clone_rotation: dict[str, Array] = {}

    def _at(self) -> tuple[int, float]:
        return len(self.events), 0.1 * len(self.events)

    def seen(self, place: Array) -> Array:
        """Where a filter believes that something is."""
        return place + self.off * self.rng.standard_normal(3)

    def move(self, k: int) -> None:
        force = np.array([0.3 * np.sin(k), 0.2, 9.7])
        r = self.rotation.as_matrix()
        turned = self.rotation * Rotation.from_rotvec([0.02, 0.01, 0.05])
        after = turned.as_matrix()
        along = -skew(r @ force)
        f = np.eye(12)
        f[0:3, 3:6] = STEP_S * np.eye(3)
        f[0:3, 6:9] = by_attitude(self.attitude, 0.5 * STEP_S**2 * along, r)
        f[3:6, 6:9] = by_attitude(self.attitude, STEP_S * along, r)
        f[3:6, 9:12] = -STEP_S * r
        if self.attitude == "attitude, body":
            f[6:9, 6:9] = after.T @ r
        acceleration = r @ force + GRAVITY
        self.position = self.position + STEP_S * self.velocity + 0.5 * STEP_S**2 * acceleration
        self.velocity = self.velocity + STEP_S * acceleration
        self.rotation = turned
        noise = block_diag(*(s * np.eye(3) for s in (1e-8, 1e-4, 1e-6, 1e-8)))
        self.events.append(Predict(*self._at(), STATE, f, noise))

    def jacobians(self, point: Array) -> tuple[Array, Array]:
        """Of z = R^T (point - position) by position and attitude."""
        r = self.rotation.as_matrix()
        offset = self.seen(point) - self.position
        return -r.T, by_attitude(self.attitude, r.T @ skew(offset), r)

    def begin(self, name: str, point: Array) -> None:
        """Point = position + R z."""
        by_position, by_angle = self.jacobians(point)
        r = self.rotation.as_matrix()
        g_x = np.hstack((-r @ by_position, -r @ by_angle))
        blocks = ("position", "attitude")
        self.events.append(Augment(*self._at(), name, blocks, g_x, r, 1e-2 * np.eye(3)))

    def look(self, name: str, point: Array, position: str, attitude: str) -> None:
        by_position, by_angle = self.jacobians(point)
        h = np.hstack((by_position, by_angle, self.rotation.as_matrix().T))
        blocks = (position, attitude, name)
        z, r = np.zeros(3), 1e-2 * np.eye(3)
        found = Update(*self._at(), "camera", blocks, z, h, r, True, None, None)
        self.events.append(found)


def flown(attitude: Part, off: float) -> Learnt:
    """Look at the points now and then, every other time from a clone of the pose."""
    flight = Flight(attitude, off)
    for i, point in enumerate(POINTS):
        flight.begin(f"point {i}", point)
    for k in range(STEPS):
        flight.move(k)
        names = "position", "attitude"
        if k % 2:
            for name in names:
                clone = f"{name} at {k}"
                flight.events.append(Clone(len(flight.events), 0.0, clone, name))
            names = f"position at {k}", f"attitude at {k}"
        for i, point in enumerate(POINTS):
            flight.look(f"point {i}", point, *names)
        if k % 2:
            flight.events.append(Remove(len(flight.events), 0.0, names))
    return present(learnt(flight.events))


@pytest.mark.parametrize("attitude", ["attitude, world", "attitude, body"])
def test_linearised_at_the_truth_nothing_is_learnt(attitude: Part) -> None:
    found = flown(attitude, 0.0)
    assert [one.name for one in found.directions] == ["x", "y", "z", "yaw"]
    assert [one.information for one in found.directions] == [0.0] * 4
    assert np.abs(found.information).max() < 1e-15


@pytest.mark.parametrize("attitude", ["attitude, world", "attitude, body"])
def test_linearised_at_different_points_the_yaw_is_learnt(attitude: Part) -> None:
    x, y, z, yaw = flown(attitude, 0.2).directions
    assert x.information == y.information == z.information == 0.0
    assert yaw.information > 1.0
    assert yaw.unit == "deg"
    assert x.unit == "m"


def test_both_conventions_say_the_same() -> None:
    world, body = (flown(a, 0.2).directions[3] for a in ("attitude, world", "attitude, body"))
    assert np.isclose(world.information, body.information, rtol=1e-6)
