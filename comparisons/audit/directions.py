"""Directions that relative sensors cannot tell, for `Recorder.directions`, by kind of filter.

Each is the error, truth minus estimate, that all of the state has when truth is shifted or turned
as a whole: by 1 m, or by 1 rad about the place where the vehicle is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from comparisons.arrays import Array

Part = Literal["position", "velocity", "attitude, world", "attitude, body", "point", "other"]
"""How a block of a visual-inertial filter moves with the whole."""


def planar_directions(
    pose: ArrayLike, landmarks: ArrayLike = (), pose_landmarks: ArrayLike = ()
) -> dict[str, Array]:
    """Return the directions of planar SLAM: east, north and heading.

    Args:
        pose: (3,) x, y [m], heading [rad], whose errors are additive.
        landmarks: (L, 2) points, behind the pose in the state.
        pose_landmarks: (Q, 3) poses, behind the points.

    Returns:
        (3 + 2 L + 3 Q,) by the direction's name.

    Source: Huang, Mourikis and Roumeliotis 2010, eq. 19.
    """
    centre = np.asarray(pose, dtype=float)[:2]
    points = np.reshape(np.asarray(landmarks, dtype=float), (-1, 2))
    poses = np.reshape(np.asarray(pose_landmarks, dtype=float), (-1, 3))
    found = []
    for shift in np.eye(2):
        posed = np.array((*shift, 0.0))
        shifted = posed, np.tile(shift, len(points)), np.tile(posed, len(poses))
        found.append(np.concatenate(shifted))
    turned = np.column_stack((_left(poses[:, :2] - centre), np.ones(len(poses))))
    heading = np.concatenate(((0.0, 0.0, 1.0), _left(points - centre).ravel(), turned.ravel()))
    return {"east": found[0], "north": found[1], "heading": heading}


def inertial_directions(
    blocks: Sequence[tuple[Part, ArrayLike]], up: ArrayLike = (0.0, 0.0, 1.0)
) -> dict[str, Array]:
    """Return the directions of visual-inertial odometry: a shift, and a turn about gravity.

    Args:
        blocks: Of every block of the state, in order, how it moves, and its estimate: `position`
            (3,) in the world, of the vehicle and of clones, the first one the vehicle's;
            `velocity` (3,) in the world; `attitude, world` (3, 3) body to world, with the error
            R_true = Exp(e) R; `attitude, body` (3, 3), with R_true = R Exp(e); `point` (3,) in
            the world; `other` (d,), biases and calibration, which stay.
        up: (3,) against gravity, of unit length, in the world.

    Returns:
        (n,) by the direction's name: x, y, z and yaw.

    Source: Hesch, Kottas, Bowman and Roumeliotis 2014, for either error of the attitude.
    """
    axis = np.asarray(up, dtype=float)
    values = [(part, np.asarray(value, dtype=float)) for part, value in blocks]
    centre = next(value for part, value in values if part == "position")
    columns: list[Array] = []
    for part, value in values:
        columns.append(_moved(part, value, centre, axis))
    whole = np.concatenate(columns)
    return {name: whole[:, i] for i, name in enumerate(("x", "y", "z", "yaw"))}


def _moved(part: Part, value: Array, centre: Array, axis: Array) -> Array:
    """Return one block's part of the four directions: (d, 4)."""
    none = np.zeros((3, 3))
    match part:
        case "position" | "point":
            return np.column_stack((np.eye(3), np.cross(axis, value - centre)))
        case "velocity":
            return np.column_stack((none, np.cross(axis, value)))
        case "attitude, world":
            return np.column_stack((none, axis))
        case "attitude, body":
            return np.column_stack((none, value.T @ axis))
        case "other":
            return np.zeros((value.size, 4))


def _left(vectors: Array) -> Array:
    """A quarter turn to the left of vectors (n, 2)."""
    return np.column_stack((-vectors[:, 1], vectors[:, 0]))
