"""Rooms as segments, and scans of them, for tests of what lays one scan onto another."""

import math

import numpy as np

from graphslam.scan import planar
from tests.graphslam.numerics import Array

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


BLOCK = np.vstack(
    (
        box(0, 0, 24, 18),
        box(0, 0, 12, 6),
        box(3, -8, 2, 1.0, 0.2),
        box(-6, -4, 1, 1.5, 0.4),
        box(11, 2, 1, 3, 0.1),
        box(7, 4, 1, 1, 0.8),
        box(-2, 8, 3, 0.8, -0.2),
        box(-11, 5, 1, 2, 0.3),
        box(-7, -1, 1, 1, 0.6),
    )
)
"""A block of houses with a street around it."""


def round_the_block() -> Array:
    """(K, 3) motions of half a metre or less, once round and 9 m of the first street again."""
    street, turn = np.array((0.5, 0.0, 0.0)), np.array((0.4, 0.0, np.pi / 20))
    sides = []
    for length in (26, 14, 26, 14, 18):
        sides += [np.tile(street, (length, 1)), np.tile(turn, (10, 1))]
    return np.vstack(sides[:-1])


def cast(segment: Array, beam: Array, scanner: Array) -> Array:
    """(B,) ranges to the nearest of segments (S, 4) along beams (B,), inf where there is none.

    scanner: its pose (3,), or one for each beam (B, 3).
    """
    x, y, heading = np.broadcast_to(scanner, (len(beam), 3)).T[:, :, None]
    cos, sin = np.cos(heading + beam[:, None]), np.sin(heading + beam[:, None])
    x1, y1, x2, y2 = segment.T
    x1, y1, x2, y2 = x1 - x, y1 - y, x2 - x, y2 - y
    one, other = y1 * cos - x1 * sin, y2 * cos - x2 * sin
    with np.errstate(divide="ignore", invalid="ignore"):
        part = one / (one - other)
        way = (x1 + part * (x2 - x1)) * cos + (y1 + part * (y2 - y1)) * sin
    met = ((one < 0.0) != (other < 0.0)) & (way > 0.0)
    nearest: Array = np.where(met, way, np.inf).min(axis=1)
    return nearest


def scan(rng: np.random.Generator, segment: Array, pose: Array, sigma_m: float) -> Array:
    """(B, 3) a planar scan from a pose (3,), in the scanner's frame."""
    way = cast(segment, BEAMS, pose) + sigma_m * rng.standard_normal(len(BEAMS))
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
