"""Array types and plane geometry that the whole package shares."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]


def wrap_angle(angle_rad: Array) -> Array:
    """Wrap angles to (-pi, pi].

    Args:
        angle_rad: Of any shape [rad].

    Returns:
        The same shape. -pi becomes pi.
    """
    return math.pi - np.mod(math.pi - angle_rad, 2.0 * math.pi)


def rotation(heading_rad: float) -> Array:
    """Return the rotation that turns vectors of a frame with this heading into the map's.

    Args:
        heading_rad: Counter-clockwise from east [rad].

    Returns:
        (2, 2), R with v_world = R v_frame.
    """
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    return np.array([[cos, -sin], [sin, cos]])


def to_frame(pose: Array, point: Array) -> Array:
    """Return points of the world in the frame of a pose.

    Args:
        pose: (3,) x, y, heading.
        point: (N, 2) in the world.

    Returns:
        (N, 2) in the frame.
    """
    return (point - pose[:2]) @ rotation(float(pose[2]))


def to_world(pose: Array, point: Array) -> Array:
    """Return points of the frame of a pose in the world.

    Args:
        pose: (3,) x, y, heading.
        point: (N, 2) in the frame.

    Returns:
        (N, 2) in the world.
    """
    return point @ rotation(float(pose[2])).T + pose[:2]
