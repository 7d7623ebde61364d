"""Array types and plane geometry that the whole package shares."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]


def wrap_angle(angle_rad: Array) -> Array:
    """Wrap angles of any shape to (-pi, pi]."""
    return math.pi - np.mod(math.pi - angle_rad, 2.0 * math.pi)


def rotation(heading_rad: float) -> Array:
    """Return the rotation (2, 2) that turns vectors of a frame with this heading into the map's."""
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    return np.array([[cos, -sin], [sin, cos]])
