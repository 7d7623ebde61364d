"""An error-state filter of an IMU and position fixes, with the functions that its Jacobians are of.

The state is attitude, velocity, position and the biases of gyro and accelerometer: 15 errors, of 21
numbers, for the attitude is a rotation matrix. Its error is a rotation vector on the body's side:
R_true = R Exp(theta). The fixes are of an antenna on a lever arm.

python inertial.py TRACE [--bug]
"""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slamcheck import Recorder

Array = NDArray[np.float64]
DT, EVERY = 0.01, 20
GRAVITY = np.array([0.0, 0.0, -9.81])
LEVER = np.array([1.0, 0.2, 0.5])
STATE = {"attitude": 3, "velocity": 3, "position": 3, "gyro bias": 3, "accelerometer bias": 3}
SIGMA = np.repeat([0.02, 0.2, 1.0, 0.005, 0.05], 3)
DENSITY = np.repeat([0.005, 0.05, 1e-4, 1e-4, 1e-3], 3)
R = 0.25 * np.eye(3)
Change = Callable[[str, Array, Array], Array]
"""Of the name of a matrix, F or H, the matrix, and the state: what a filter with a fault has."""


def unchanged(name: str, matrix: Array, x: Array) -> Array:
    """Return a matrix as it is."""
    return matrix


def skew(vector: Array) -> Array:
    """Return the matrix of a cross product."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation(vector: Array) -> Array:
    """Return Exp of a rotation vector."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-9:
        return np.eye(3) + skew(vector)
    axis = skew(vector / angle)
    turned: Array = np.eye(3) + np.sin(angle) * axis + (1.0 - np.cos(angle)) * axis @ axis
    return turned


def right_jacobian(vector: Array) -> Array:
    """Return J with Exp(vector + d) about Exp(vector) Exp(J d)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-9:
        return np.eye(3) - 0.5 * skew(vector)
    axis = skew(vector / angle)
    first, second = (1.0 - np.cos(angle)) / angle, 1.0 - np.sin(angle) / angle
    jacobian: Array = np.eye(3) - first * axis + second * axis @ axis
    return jacobian


def moved(x: Array, gyro: Array, force: Array) -> Array:
    """Return the state (21,) a sample later."""
    attitude, velocity, position = x[:9].reshape(3, 3), x[9:12], x[12:15]
    acceleration = attitude @ (force - x[18:]) + GRAVITY
    turned = attitude @ rotation((gyro - x[15:18]) * DT)
    position = position + velocity * DT + 0.5 * acceleration * DT**2
    return np.concatenate((turned.ravel(), velocity + acceleration * DT, position, x[15:]))


def jacobian_of_move(x: Array, gyro: Array, force: Array) -> Array:
    """Return F (15, 15)."""
    attitude, turn, jacobian = x[:9].reshape(3, 3), (gyro - x[15:18]) * DT, np.eye(15)
    jacobian[0:3, 0:3] = rotation(turn).T
    jacobian[0:3, 9:12] = -right_jacobian(turn) * DT
    by_attitude = -attitude @ skew(force - x[18:])
    jacobian[3:6, 0:3], jacobian[3:6, 12:15] = by_attitude * DT, -attitude * DT
    jacobian[6:9, 0:3], jacobian[6:9, 12:15] = by_attitude * DT**2 / 2, -attitude * DT**2 / 2
    jacobian[6:9, 3:6] = DT * np.eye(3)
    return jacobian


def antenna(x: Array) -> Array:
    """Return where the antenna is."""
    return np.asarray(x[12:15] + x[:9].reshape(3, 3) @ LEVER)


def jacobian_of_antenna(x: Array) -> Array:
    """Return H (3, 15)."""
    jacobian = np.zeros((3, 15))
    jacobian[:, 0:3], jacobian[:, 6:9] = -x[:9].reshape(3, 3) @ skew(LEVER), np.eye(3)
    return jacobian


def plus(x: Array, error: Array) -> Array:
    """Return a state with an error added."""
    turned = x[:9].reshape(3, 3) @ rotation(error[:3])
    return np.concatenate((turned.ravel(), x[9:] + error[3:]))


def fly(path: str | Path, change: Change = unchanged, seed: int = 0, steps: int = 1500) -> None:
    """Simulate a turning drive, filter it, and record it. change: of the filter's Jacobians."""
    rng = np.random.default_rng(seed)
    q, p = np.diag(DENSITY**2 * DT), np.diag(SIGMA**2)
    x = np.concatenate((np.eye(3).ravel(), [5.0, 0.0, 0.0], np.zeros(9)))
    truth = plus(x, SIGMA * rng.standard_normal(15))
    with Recorder(path, components={"gnss": ("east", "north", "up")}) as record:
        record.prior(STATE, p, point=x, charts={"attitude": "so3 right"})
        for step in range(1, steps + 1):
            time_s = step * DT
            gyro = np.array([0.02, 0.05 * np.sin(time_s), 0.3]) + truth[15:18]
            force = np.array([0.5 * np.cos(time_s), 1.5, 0.0]) + truth[18:]
            force = force - truth[:9].reshape(3, 3).T @ GRAVITY
            truth = plus(moved(truth, gyro, force), DENSITY * DT**0.5 * rng.standard_normal(15))
            by_state = change("F", jacobian_of_move(x, gyro, force), x)
            before, x = x, moved(x, gyro, force)
            p = by_state @ p @ by_state.T + q
            record.at(time_s)
            function = partial(moved, gyro=gyro, force=force)
            record.predict(by_state, q, function=function, point=before, after=x)
            if step % EVERY == 0:
                z = antenna(truth) + np.sqrt(np.diag(R)) * rng.standard_normal(3)
                residual, by_state = z - antenna(x), change("H", jacobian_of_antenna(x), x)
                gain = p @ by_state.T @ np.linalg.inv(by_state @ p @ by_state.T + R)
                record.update(
                    *("gnss", residual, by_state, R),
                    gain=gain,
                    point=x,
                    function=antenna,
                    measured=z,
                )
                x, p = plus(x, gain @ residual), p - gain @ by_state @ p
                p = 0.5 * (p + p.T)
                record.snapshot(p)


def without_lever(name: str, matrix: Array, x: Array) -> Array:
    """Return H as of an antenna without a lever arm."""
    if name == "H":
        matrix[:, :3] = 0.0
    return matrix


if __name__ == "__main__":
    fly(sys.argv[1], without_lever if "--bug" in sys.argv else unchanged)
