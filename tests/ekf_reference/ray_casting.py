"""Laser beams in a plane of walls and discs."""

from dataclasses import dataclass, field

import numpy as np

from ekf_reference.core.geometry import Array


@dataclass(frozen=True)
class Solids:
    """What beams meet.

    segment: (S, 4) walls x1, y1, x2, y2 [m]. disc: (L, 3) x, y, diameter [m].
    """

    segment: Array = field(default_factory=lambda: np.zeros((0, 4)))
    disc: Array = field(default_factory=lambda: np.zeros((0, 3)))


def sides(corner: Array) -> Array:
    """Return the sides (K, 4) of a closed polygon with corners (K, 2)."""
    return np.hstack((corner, np.roll(corner, -1, axis=0)))


def cast(angle_rad: Array, pose: Array, solids: Solids) -> Array:
    """Return the ranges (B,) [m] to the nearest wall or disc, infinite for none.

    angle_rad: (B,) from the heading of the sensor's pose (3,). The sensor does not see a disc
    that it is in. A beam to a corner of a closed polygon
    meets one of its two sides.
    """
    direction = pose[2] + angle_rad
    cos, sin = np.cos(direction)[:, None], np.sin(direction)[:, None]
    walls = _walls(cos, sin, solids.segment - np.tile(pose[:2], 2))
    discs = _discs(cos, sin, solids.disc - (pose[0], pose[1], 0.0))
    nearest: Array = np.min(np.hstack((walls, discs)), axis=1, initial=np.inf)
    return nearest


def _walls(cos: Array, sin: Array, segment: Array) -> Array:
    """(B, S) ranges to walls relative to the sensor: the ends lie on different sides of a beam."""
    x1, y1, x2, y2 = segment.T
    side1, side2 = y1 * cos - x1 * sin, y2 * cos - x2 * sin
    crossed = (side1 < 0.0) != (side2 < 0.0)
    part = side1 / np.where(crossed, side1 - side2, 1.0)
    way = (x1 + part * (x2 - x1)) * cos + (y1 + part * (y2 - y1)) * sin
    return np.where(crossed & (way > 0.0), way, np.inf)


def _discs(cos: Array, sin: Array, disc: Array) -> Array:
    """(B, L) ranges to discs relative to the sensor."""
    x, y, diameter = disc.T
    along, across = x * cos + y * sin, y * cos - x * sin
    squared = (0.5 * diameter) ** 2 - across**2
    half = np.sqrt(np.maximum(squared, 0.0))
    return np.where((squared >= 0.0) & (along > half), along - half, np.inf)
