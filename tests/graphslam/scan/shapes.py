"""Rooms as segments, and scans of them, for tests of what lays one scan onto another."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graphslam.scan import planar

Array = NDArray[np.float64]

BEAMS = np.deg2rad(np.arange(0.0, 360.0, 1.0))


def polygon(*corner: tuple[float, float]) -> Array:
    """(K, 4) its sides."""
    corners = np.array(corner)
    return np.hstack((corners, np.roll(corners, -1, axis=0)))


def box(x: float, y: float, length: float, width: float, turn: float = 0.0) -> Array:
    """(4, 4) the sides of a rectangle about its middle."""
    half = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    corner = np.array(half) * (length, width)
    cos, sin = math.cos(turn), math.sin(turn)
    placed = corner @ np.array(((cos, sin), (-sin, cos))) + (x, y)
    return np.hstack((placed, np.roll(placed, -1, axis=0)))


ROOM = np.vstack((box(0, 0, 16, 11), box(4, 2, 2, 1, 0.4), box(-4, -3, 3, 1.5, -0.3)))
HALL = np.vstack((box(0, 0, 24, 7), box(6, 2.2, 3, 1, 0.2), box(-7, -2, 1, 1, 0.7)))
_SEVEN = [(9 * math.cos(k * math.tau / 7), 7 * math.sin(k * math.tau / 7)) for k in range(7)]
TENT = np.vstack((polygon(*_SEVEN), box(3, 3, 2, 2, 0.2), box(-3, -2, 1, 3, 0.5)))
ELL = np.vstack(
    (polygon((-4, -4), (10, -4), (10, 4), (4, 4), (4, 11), (-4, 11)), box(7, -1, 1.5, 1, 0.9))
)
COURT = np.vstack((box(0, 0, 14, 14, 0.5), box(-4, 2, 4, 1, 0.2), box(3, -4, 1, 3, 1.0)))
YARD = np.vstack(
    (
        polygon((-10, -5), (9, -7), (12, 4), (2, 8), (-9, 6)),
        box(5, 0, 2, 2, 0.6),
        box(-4, -2, 2, 1, 0.1),
    )
)
LONG = np.vstack((box(0, 0, 60, 4), box(9, 1.7, 0.6, 0.6), box(-8, -1.7, 0.6, 0.6)))


def ranges(segment: Array, pose: Array) -> Array:
    """(B,) to the nearest of segments (S, 4) along all beams, from a pose (3,) within."""
    cos, sin = np.cos(pose[2] + BEAMS)[:, None], np.sin(pose[2] + BEAMS)[:, None]
    x1, y1, x2, y2 = (segment - np.tile(pose[:2], 2)).T
    one, other = y1 * cos - x1 * sin, y2 * cos - x2 * sin
    with np.errstate(divide="ignore", invalid="ignore"):
        part = one / (one - other)
        way = (x1 + part * (x2 - x1)) * cos + (y1 + part * (y2 - y1)) * sin
    met = ((one < 0.0) != (other < 0.0)) & (way > 0.0)
    nearest: Array = np.where(met, way, np.inf).min(axis=1)
    return nearest


def scan(rng: np.random.Generator, segment: Array, pose: Array, sigma_m: float) -> Array:
    """(B, 3) a planar scan from a pose (3,), in the scanner's frame."""
    way = ranges(segment, pose) + sigma_m * rng.standard_normal(len(BEAMS))
    return np.column_stack((way * np.cos(BEAMS), way * np.sin(BEAMS), np.zeros(len(BEAMS))))


def scan_pair(
    rng: np.random.Generator, segment: Array, sigma_m: float
) -> tuple[Array, Array, Array]:
    """Source, target and the true motion (3,) between two places near the middle."""
    first = np.append(rng.uniform(-1.0, 1.0, 2), rng.uniform(-3.0, 3.0))
    motion = rng.uniform(-0.5, 0.5, 3)
    second = planar.compose(first, motion)
    return scan(rng, segment, second, sigma_m), scan(rng, segment, first, sigma_m), motion


def hall_in_space(rng: np.random.Generator) -> Array:
    """(N, 3) walls 3 m high around a floor."""
    parts = []
    for x1, y1, x2, y2 in box(0, 0, 16, 11, 0.2).tolist():
        along = rng.random((250, 1))
        wall = np.array((x1, y1)) + along * (x2 - x1, y2 - y1)
        parts.append(np.column_stack((wall, rng.uniform(-1.0, 2.0, 250))))
    floor = rng.uniform((-7.0, -4.0), (7.0, 4.0), (400, 2))
    return np.vstack((*parts, np.column_stack((floor, np.full(400, -1.0)))))


def seen_from(motion: Array, points: Array) -> Array:
    """The same points in the frame that a motion (3,) leads to."""
    return planar.moved(planar.between(motion, np.zeros(3)), points)
