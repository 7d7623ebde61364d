"""Array types, and the wrap of angles, that the whole package shares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]


def wrap_angle(angle_rad: Array) -> Array:
    """Wrap angles of any shape to (-pi, pi]."""
    return np.pi - np.mod(np.pi - angle_rad, 2.0 * np.pi)
