"""Pairs of scans of simulated scenes, whose true motion is known."""

from dataclasses import dataclass

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.dense.scan import ScanSensor
from ekf_reference.scan_matching.scan_shape import of_scan
from ekf_reference.scan_matching.sog import SumOfGaussians
from tests.ekf_reference.ray_casting import Solids, cast, sides

BEAMS = np.deg2rad(np.linspace(-90.0, 90.0, 361))
LASER = ScanSensor(0.02, np.deg2rad(0.1), np.deg2rad(0.5), np.deg2rad(5.0))
THESIS = ScanSensor(0.1, np.deg2rad(1.0), np.deg2rad(0.5), np.deg2rad(5.0))
"""Nieto 2005, Table 5.1."""
REACH_M = 40.0


def outline(*corner: tuple[float, float]) -> Array:
    """(K, 4) the sides of a closed polygon."""
    return sides(np.array(corner, dtype=float))


def box(x: float, y: float, length: float, width: float, turn_deg: float) -> Array:
    """(4, 4) the sides of a rectangle about x, y."""
    cos, sin = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    corner = np.array(((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))) * (length, width)
    place = corner @ np.array(((cos, sin), (-sin, cos))) + (x, y)
    return outline(*(tuple(p) for p in place.tolist()))


def solids(*wall: Array, disc: Array | None = None) -> Solids:
    """Walls, and discs (L, 3), to cast beams into."""
    segment = np.vstack([np.zeros((0, 4)), *wall])
    return Solids(segment, disc=np.zeros((0, 3)) if disc is None else disc)


ELL = solids(outline((-6, -5), (14, -5), (14, 3), (7, 3), (7, 9), (-6, 9)))
COURT = solids(
    outline((-8, -10), (18, -12), (20, 11), (-8, 10)), box(9, 4, 3, 2, 25), box(7, -5, 2, 2, 60)
)
YARD = solids(
    box(10, 6, 8, 3, 15), box(14, -5, 4, 6, -20), box(4, -7, 3, 2, 40),
    disc=np.array(((6.0, 2.0, 1.0), (9.0, -1.5, 0.6), (18.0, 3.0, 2.5))),
)  # fmt: skip
CORRIDOR = solids(np.array(((-200.0, -2.0, 200.0, -2.0), (-200.0, 2.5, 200.0, 2.5))))
WALL = solids(np.array(((8.0, -200.0, 8.0, 200.0),)))
DRUM = solids(disc=np.array(((7.0, 0.5, 6.0),)))


@dataclass(frozen=True)
class Pair:
    """motion: (3,) the true pose of the first scan's frame in the second's."""

    first: SumOfGaussians
    second: SumOfGaussians
    motion: Array


def ranges(rng: np.random.Generator, scene: Solids, pose: Array, sensor: ScanSensor) -> Array:
    """(B,) what a noisy laser of half a circle reads; NaN for no return."""
    aside = sensor.sigma_bearing_rad * rng.standard_normal(len(BEAMS))
    way = cast(BEAMS + aside, pose, scene)
    way = np.where(way < REACH_M, way, np.nan)
    noisy: Array = way + sensor.sigma_range_m * rng.standard_normal(len(BEAMS))
    return noisy


def pair(
    rng: np.random.Generator, scene: Solids, sensor: ScanSensor = LASER, apart: float = 1.0
) -> Pair:
    """Two scans from places near the origin, up to `apart` metres and 0.3 radians different."""
    second = rng.uniform(-1.0, 1.0, 3) * (1.0, 1.0, 0.4)
    motion = rng.uniform(-1.0, 1.0, 3) * (apart, apart, 0.3)
    cos, sin = np.cos(second[2]), np.sin(second[2])
    turned = np.array((cos * motion[0] - sin * motion[1], sin * motion[0] + cos * motion[1]))
    first = np.append(second[:2] + turned, second[2] + motion[2])
    one, other = (
        of_scan(BEAMS, ranges(rng, scene, pose, sensor), sensor) for pose in (first, second)
    )
    return Pair(one, other, motion)


def guess_of(rng: np.random.Generator, motion: Array, covariance: Array) -> Array:
    """(3,) wrong as the covariance says."""
    wrong: Array = motion + np.linalg.cholesky(covariance) @ rng.standard_normal(3)
    return wrong


def random_sum(rng: np.random.Generator, count: int) -> SumOfGaussians:
    """Gaussians of all shapes, a few metres apart."""
    root = rng.normal(size=(count, 2, 2))
    spread = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(2)
    return SumOfGaussians.of_equal_height(3.0 * rng.normal(size=(count, 2)), spread)
