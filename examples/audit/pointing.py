"""An attitude filter: gyro and the direction of gravity and north, its error on the world's side.

R_true = Exp(theta) R, beside the gyro's bias. Two vectors of the world are measured in the body:
the functions that the Jacobians are of go to the recorder, as in turning.py.

python pointing.py TRACE [--bug]
"""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from examples.audit.inertial import rotation, skew
from slamcheck import Recorder

Array = NDArray[np.float64]
DT = 0.05
STATE = {"attitude": 3, "bias": 3}
VECTORS = {"gravity": np.array([0.0, 0.0, 9.81]), "field": np.array([0.2, 0.0, 0.4])}
R = {"gravity": 0.01 * np.eye(3), "field": 1e-4 * np.eye(3)}
DENSITY = np.repeat([0.01, 1e-4], 3)
SIGMA = np.repeat([0.3, 0.02], 3)
Change = Callable[[str, Array, Array], Array]
"""Of the name of a matrix, F or H, the matrix, and the state: what a filter with a fault has."""


def unchanged(name: str, matrix: Array, x: Array) -> Array:
    """Return a matrix as it is."""
    return matrix


def turned(x: Array, gyro: Array) -> Array:
    """Return the state (12,), nine numbers of R and the bias, a sample later."""
    attitude = x[:9].reshape(3, 3) @ rotation((gyro - x[9:]) * DT)
    return np.concatenate((attitude.ravel(), x[9:]))


def jacobian_of_turn(x: Array, gyro: Array) -> Array:
    """Return F (6, 6): the world's side turns with nothing, and the bias turns with R."""
    turn = (gyro - x[9:]) * DT
    angle = float(np.linalg.norm(turn))
    axis = skew(turn / angle) if angle > 0.0 else np.zeros((3, 3))
    spread = np.eye(3) + (1.0 - np.cos(angle)) / angle * axis
    spread = spread + (1.0 - np.sin(angle) / angle) * axis @ axis
    jacobian = np.eye(6)
    jacobian[:3, 3:] = -x[:9].reshape(3, 3) @ spread * DT
    return jacobian


def in_body(x: Array, vector: Array) -> Array:
    """Return a vector of the world as the body sees it."""
    return np.asarray(x[:9].reshape(3, 3).T @ vector)


def point(path: str | Path, change: Change = unchanged, seed: int = 0, steps: int = 400) -> None:
    """Simulate a turning body, filter it, and record it. change: of the filter's Jacobians."""
    rng = np.random.default_rng(seed)
    q, p = np.diag(DENSITY**2 * DT), np.diag(SIGMA**2)
    x = np.concatenate((np.eye(3).ravel(), np.zeros(3)))
    truth = plus(x, SIGMA * rng.standard_normal(6))
    with Recorder(path) as record:
        record.prior(STATE, p, point=x, charts={"attitude": "so3 left"})
        for step in range(1, steps + 1):
            rate = np.array([0.1, 0.2 * np.cos(0.1 * step), 0.4])
            gyro = rate + truth[9:]
            truth = plus(turned(truth, gyro), DENSITY * DT**0.5 * rng.standard_normal(6))
            by_state = change("F", jacobian_of_turn(x, gyro), x)
            before, x = x, turned(x, gyro)
            p = by_state @ p @ by_state.T + q
            record.at(step * DT)
            function = partial(turned, gyro=gyro)
            record.predict(by_state, q, function=function, point=before, after=x)
            for sensor, vector in VECTORS.items() if step % 4 == 0 else ():
                r = R[sensor]
                z = in_body(truth, vector) + np.sqrt(np.diag(r)) * rng.standard_normal(3)
                by_state = np.hstack((x[:9].reshape(3, 3).T @ skew(vector), np.zeros((3, 3))))
                by_state, residual = change("H", by_state, x), z - in_body(x, vector)
                gain = p @ by_state.T @ np.linalg.inv(by_state @ p @ by_state.T + r)
                record.update(
                    *(sensor, residual, by_state, r),
                    gain=gain,
                    point=x,
                    measured=z,
                    function=partial(in_body, vector=vector),
                )
                x, p = plus(x, gain @ residual), p - gain @ by_state @ p
                p = 0.5 * (p + p.T)
            record.snapshot(p)


def plus(x: Array, error: Array) -> Array:
    """Return a state with an error added."""
    attitude = rotation(error[:3]) @ x[:9].reshape(3, 3)
    return np.concatenate((attitude.ravel(), x[9:] + error[3:]))


def on_the_other_side(name: str, matrix: Array, x: Array) -> Array:
    """Return H as if the attitude's error were on the body's side, in the sign alone."""
    if name == "H":
        matrix[:, :3] *= -1.0
    return matrix


if __name__ == "__main__":
    point(sys.argv[1], on_the_other_side if "--bug" in sys.argv else unchanged)
