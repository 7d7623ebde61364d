"""Regions on a lattice of landmarks, and scans from known poses."""

import math
from functools import cache

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.layers.gaussians import Gaussians
from ekf_reference.dense.layers.layer import Hits, Layer
from ekf_reference.dense.layers.occupancy import OccupancyGrid
from ekf_reference.dense.layers.particles import Particles
from ekf_reference.dense.layers.points import AllReturns
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan, ScanSensor
from ekf_reference.dense.triangles import determinant, is_degenerate
from tests.ekf_reference.ray_casting import Solids, cast, sides

SENSOR = ScanSensor(0.1, math.radians(0.5), math.radians(0.5))
HERE = np.array([2.0, 5.0, 0.1])
WALL_M = 14.3
"""A wall along north, at this east."""
LAYERS = ("points", "occupancy", "particles", "gaussians")


def layer(name: str, seed: int = 0) -> Layer:
    made: dict[str, Layer] = {
        "points": AllReturns(),
        "occupancy": OccupancyGrid(),
        "particles": Particles(np.random.default_rng(seed)),
        "gaussians": Gaussians(),
    }
    return made[name]


def lattice(low: Array, high: Array, step_m: float) -> tuple[Array, LocalRegions]:
    """Landmarks (L, 2) on a lattice with two regions in every square."""
    count = np.ceil((high - low) / step_m).astype(int) + 1
    i, j = np.meshgrid(np.arange(count[0]), np.arange(count[1]), indexing="ij")
    landmark = low + step_m * np.stack((i, j), axis=-1).reshape(-1, 2)
    at = (i * count[1] + j)[:-1, :-1].ravel()
    east, north = at + count[1], at + 1
    base = np.concatenate(
        (np.stack((at, east, east + 1), axis=1), np.stack((at, east + 1, north), axis=1))
    )
    return landmark, LocalRegions(base=base, _order=np.arange(len(base)))


def flipped(regions: LocalRegions, landmark: Array) -> Index:
    """Regions that have turned over, or lost their area, among landmarks (L, 2) of the map."""
    triangle = regions.corners(landmark)[regions.base]
    turned_over = (determinant(triangle) >= 0.0) | is_degenerate(triangle)
    return np.flatnonzero(turned_over & np.isfinite(triangle).all(axis=(1, 2)))


def field() -> tuple[Array, LocalRegions]:
    """20 m east by 20 m north of regions, 5 m long, from (0, -5)."""
    return lattice(np.array([0.0, -5.0]), np.array([20.0, 15.0]), 5.0)


def place() -> RegionsAtMap:
    """The field where its landmarks are."""
    landmark, regions = field()
    return regions.placed(landmark)


def reported(
    placed: RegionsAtMap, scan: Scan, late: bool = False
) -> tuple[Hits, RegionsAtMap, Scan | None, Index]:
    """What a dense map tells its layers of a scan."""
    found = placed.locate(scan.point)
    inside = np.flatnonzero(found.region >= 0)
    hits = Hits(
        region=found.region[inside],
        local=found.local[inside],
        point=scan.point[inside],
        covariance=scan.covariance[inside],
    )
    near = np.sort(placed.tree.meeting(scan.box()[None]).item)
    return hits, placed, None if late else scan, near


def wall_scan(
    pose: Array = HERE,
    rng: np.random.Generator | None = None,
    wall_m: float = WALL_M,
    half_rad: float = math.radians(25.0),
) -> Scan:
    """A wall seen from a pose, without noise where no generator is given."""
    bearing = np.arange(-half_rad, half_rad, SENSOR.beam_rad)
    range_m = (wall_m - pose[0]) / np.cos(pose[2] + bearing)
    if rng is not None:
        range_m = range_m + SENSOR.sigma_range_m * rng.standard_normal(len(range_m))
    return Scan.of_ranges(pose, bearing, range_m, SENSOR)


def yard() -> Solids:
    """Five boxes and a drum, inside and outside of a circle of 20 m."""
    boxes = ((0, 3, 9, 6), (-7, -4, 5, 7), (30, 8, 6, 14), (-5, 32, 16, 5), (-32, -6, 6, 18))
    corner = np.array(((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)))
    walls = [sides(corner * (length, width) + (x, y)) for x, y, length, width in boxes]
    return Solids(np.vstack(walls), disc=np.array(((6.0, -33.0, 8.0),)))


@cache
def simulation() -> tuple[RegionsAtMap, tuple[Scan, ...]]:
    """Scans of the noise of Nieto 2005, Table 4.1, from known poses on one loop, in regions."""
    rng, sensor = np.random.default_rng(1), ScanSensor(0.1, math.radians(1.0), math.radians(0.5))
    beam = np.arange(-0.5 * math.pi, 0.5 * math.pi, sensor.beam_rad)
    landmark, regions = lattice(np.full(2, -50.0), np.full(2, 50.0), 11.0)
    taken: list[Scan] = []
    for turn in np.linspace(0.0, 2.0 * math.pi, 165, endpoint=False).tolist():
        pose = np.array((20.0 * math.cos(turn), 20.0 * math.sin(turn), turn + 0.5 * math.pi))
        aside = sensor.sigma_bearing_rad * rng.standard_normal(len(beam))
        way = cast(beam + aside, pose, yard())
        way = np.where(way < 25.0, way, np.nan)
        way = way + sensor.sigma_range_m * rng.standard_normal(len(beam))
        taken.append(Scan.of_ranges(pose, beam, way, sensor))
    return regions.placed(landmark), tuple(taken)


@cache
def mapped(name: str) -> Layer:
    """A layer after one loop of the simulation; not to be changed."""
    placed, scans = simulation()
    filled = layer(name)
    for scan in scans:
        filled.fuse(*reported(placed, scan))
    return filled
