"""Corners of drawn shapes."""

import math

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.scan_landmarks.high_level import harris

CELL_M = 0.25
SIDE = 200
MIDDLE = 0.5 * CELL_M * (SIDE - 1)
SIZE = np.array((16.0, 9.0))
SIGNS = np.array(((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)))


def turned(point: Array, angle_rad: float) -> Array:
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return np.asarray(point @ np.array(((cos, sin), (-sin, cos))))


def drawn(angle_rad: float = 0.0, wall_m: float | None = None, shift_m: float = 0.0) -> Array:
    """A block about the grid's middle, solid or a wall about nothing; edges as cells cover them."""
    fine = (np.arange(4) + 0.5) / 4.0 - 0.5
    at = CELL_M * (np.arange(SIDE)[:, None] + fine).ravel() - MIDDLE - shift_m
    point = np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1)
    inside = np.abs(turned(point, -angle_rad)) - 0.5 * SIZE
    solid = (inside <= 0.0).all(axis=-1)
    if wall_m is not None:
        solid &= ~(inside <= -wall_m).all(axis=-1)
    covered: Array = solid.reshape(SIDE, 4, SIDE, 4).mean(axis=(1, 3))
    return covered


def corners(angle_rad: float = 0.0) -> Array:
    return MIDDLE + turned(0.5 * SIZE * SIGNS, angle_rad)


def missed(found: Array, true: Array) -> Array:
    """(C,) from each true corner to the nearest found."""
    apart = np.linalg.norm(true[:, None] - found, axis=2)
    return np.asarray(apart.min(axis=1))


@pytest.mark.parametrize("wall_m", [None, 0.5])
def test_a_rectangle_has_its_four_corners_and_nothing_else(wall_m: float | None) -> None:
    found = harris(drawn(wall_m=wall_m), CELL_M)
    assert len(found) == 4
    assert missed(found, corners()).max() < 1.1  # inwards by about the window's sigma
    assert not len(harris(drawn(), CELL_M, least=1.001))  # a solid block's is the scale
    assert len(harris(drawn(), CELL_M, least=0.999)) == 4


def test_places_are_finer_than_cells() -> None:
    """A shape that moves by part of a cell takes its corners along."""
    base = harris(drawn(), CELL_M)
    for shift in (0.25, 0.5, 0.75):
        moved = harris(drawn(shift_m=shift * CELL_M), CELL_M)
        apart = np.linalg.norm(base[:, None] + shift * CELL_M - moved, axis=2).min(axis=1)
        assert apart.max() < 0.2 * CELL_M


@pytest.mark.parametrize("angle_deg", [10.0, 30.0, 45.0, 71.0])
@pytest.mark.parametrize("wall_m", [None, 0.5])
def test_a_turned_shape_has_turned_corners(angle_deg: float, wall_m: float | None) -> None:
    angle = math.radians(angle_deg)
    straight, found = harris(drawn(wall_m=wall_m), CELL_M), harris(drawn(angle, wall_m), CELL_M)
    assert len(found) == 4
    assert missed(found, MIDDLE + turned(straight - MIDDLE, angle)).max() < 0.5 * CELL_M


def test_a_straight_wall_has_none() -> None:
    at = CELL_M * np.arange(SIDE) - MIDDLE
    for angle in np.radians((0.0, 17.0, 45.0, 80.0)):
        aside = np.cos(angle) * at[:, None] + np.sin(angle) * at
        wall = np.clip(1.0 - np.abs(aside) / CELL_M, 0.0, 1.0)
        assert not len(harris(wall, CELL_M))
        along = np.cos(angle) * at - np.sin(angle) * at[:, None]
        ends = harris(wall * (along > 0.0), CELL_M, least=0.003)  # where it ends is a corner
        assert len(ends) == 1
        assert np.linalg.norm(ends - MIDDLE) < 1.0
    assert not len(harris(np.zeros((SIDE, SIDE)), CELL_M))


def test_without_the_trace_a_rough_wall_is_full_of_corners() -> None:
    """What the trace is there for."""
    at = CELL_M * np.arange(SIDE) - MIDDLE
    rough = 0.1 * np.random.default_rng(1).standard_normal(SIDE)
    wall = np.clip(1.0 - np.abs(at[:, None] - rough) / 0.5, 0.0, 1.0)
    assert not len(harris(wall, CELL_M))
    assert len(harris(wall, CELL_M, trace=0.0)) > 3
