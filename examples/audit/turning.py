"""An EKF of a target that drives and turns, with the functions that its Jacobians are of.

The state is position, heading, speed and turn rate; a radar at the origin measures range and
bearing. `function=` hands the recorder f and h, so that `slamcheck audit` compares F and H with
their derivatives, and the residual with what was measured less what h predicts.

python turning.py TRACE [--bug]
"""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slamcheck import Recorder

Array = NDArray[np.float64]
DT = 0.1
STATE = {"position": 2, "heading": 1, "speed": 1, "turn": 1}
Q = DT * np.diag([1e-4, 1e-4, 1e-4, 1e-2, 1e-3])
R = np.diag([0.04, 0.001])
Change = Callable[[str, Array, Array], Array]
"""Of the name of a matrix, F or H, the matrix, and the state: what a filter with a fault has."""


def unchanged(name: str, matrix: Array, x: Array) -> Array:
    """Return a matrix as it is."""
    return matrix


def f(x: Array) -> Array:
    """Return the state a step later."""
    _, _, heading, speed, turn = x
    return x + DT * np.array([speed * np.cos(heading), speed * np.sin(heading), turn, 0.0, 0.0])


def jacobian_of_f(x: Array) -> Array:
    """Return F (5, 5)."""
    _, _, heading, speed, _ = x
    c, s = np.cos(heading), np.sin(heading)
    jacobian = np.eye(5)
    jacobian[:2, 2:4] = DT * np.array([[-speed * s, c], [speed * c, s]])
    jacobian[2, 4] = DT
    return jacobian


def h(x: Array) -> Array:
    """Return range and bearing, the bearing relative to the target's heading."""
    return np.array([np.hypot(x[0], x[1]), wrapped(np.arctan2(x[1], x[0]) - x[2])])


def jacobian_of_h(x: Array) -> Array:
    """Return H (2, 5)."""
    distance = np.hypot(x[0], x[1])
    jacobian = np.zeros((2, 5))
    jacobian[0, :2] = x[:2] / distance
    jacobian[1, :3] = -x[1] / distance**2, x[0] / distance**2, -1.0
    return jacobian


def wrapped(angle: float) -> float:
    """Return an angle in (-pi, pi]."""
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


def track(path: str | Path, change: Change = unchanged, seed: int = 0, steps: int = 400) -> None:
    """Simulate a target, filter it, and record what the filter does. change: of its Jacobians."""
    rng = np.random.default_rng(seed)
    p = np.diag([1.0, 1.0, 0.1, 1.0, 0.01])
    x = np.array([20.0, 5.0, 1.0, 3.0, 0.1])
    truth = x + np.sqrt(np.diag(p)) * rng.standard_normal(5)
    with Recorder(path, components={"radar": ("range", "bearing")}) as record:
        record.prior(STATE, p, point=x, charts={"heading": "angle"})
        for step in range(1, steps + 1):
            truth = f(truth) + np.sqrt(np.diag(Q)) * rng.standard_normal(5)
            by_state = change("F", jacobian_of_f(x), x)
            before, x = x, f(x)
            p = by_state @ p @ by_state.T + Q
            record.at(step * DT)
            record.predict(by_state, Q, function=f, point=before, after=x)
            if step % 3 == 0:
                z = h(truth) + np.sqrt(np.diag(R)) * rng.standard_normal(2)
                residual = z - h(x)
                residual[1] = wrapped(residual[1])
                by_state = change("H", jacobian_of_h(x), x)
                gain = p @ by_state.T @ np.linalg.inv(by_state @ p @ by_state.T + R)
                record.update(
                    *("radar", residual, by_state, R),
                    gain=gain,
                    point=x,
                    function=h,
                    measured=z,
                )
                x = x + gain @ residual
                p = p - gain @ by_state @ p
                p = 0.5 * (p + p.T)
            record.snapshot(p)


def without_turn(name: str, matrix: Array, x: Array) -> Array:
    """Return F without what the turn rate does to the heading."""
    if name == "F":
        matrix[2, 4] = 0.0
    return matrix


if __name__ == "__main__":
    track(sys.argv[1], without_turn if "--bug" in sys.argv else unchanged)
