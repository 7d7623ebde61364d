"""Regions on a lattice of landmarks, and scans from known poses."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from comparisons.logs.simulate.scan_drive import occupancy, simulate
from ekf_reference.dense.layers.gaussians import Gaussians
from ekf_reference.dense.layers.layer import Hits, Layer
from ekf_reference.dense.layers.occupancy import OccupancyGrid
from ekf_reference.dense.layers.particles import Particles
from ekf_reference.dense.layers.points import Points
from ekf_reference.dense.layers.values import Values
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan, Sensor
from ekf_reference.dense.triangles import determinant, is_degenerate
from tests.helpers import Array

Index = NDArray[np.intp]
SENSOR = Sensor(0.1, math.radians(0.5), math.radians(0.5))
HERE = np.array([2.0, 5.0, 0.1])
WALL_M = 14.3
"""A wall along north, at this east."""
LAYERS = ("points", "occupancy", "particles", "gaussians", "values")


def layer(name: str, seed: int = 0) -> Layer:
    made: dict[str, Layer] = {
        "points": Points(),
        "occupancy": OccupancyGrid(),
        "particles": Particles(np.random.default_rng(seed)),
        "gaussians": Gaussians(),
        "values": Values(0.2),
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


def told(
    placed: RegionsAtMap, scan: Scan, late: bool = False
) -> tuple[Hits, RegionsAtMap, Scan | None, Index]:
    """What a dense map tells its layers of a scan."""
    found = placed.locate(scan.point)
    inside = np.flatnonzero(found.region >= 0)
    hits = Hits(
        found.region[inside],
        found.local[inside],
        scan.point[inside],
        scan.covariance[inside],
        np.ones(len(inside)),
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


@cache
def simulation(loops: int = 1) -> tuple[RegionsAtMap, tuple[Scan, ...]]:
    """Scans of Nieto 2005, section 4.1.3, from the true poses, in a lattice of regions."""
    log = simulate(np.random.default_rng(1), occupancy(loops))
    assert log.scans is not None
    assert log.truth is not None
    poses, scans = log.truth.poses, log.scans
    assert poses is not None
    sensor = Sensor(0.1, math.radians(1.0), float(np.diff(scans.angle_rad[:2])[0]))
    place = poses.pose[:, :2]
    landmark, regions = lattice(place.min(axis=0) - 30.0, place.max(axis=0) + 30.0, 11.0)
    taken: list[Scan] = []
    for time, range_m in zip(scans.time_s, scans.range_m, strict=True):
        pose = np.array([np.interp(time, poses.time_s, column) for column in poses.pose.T])
        taken.append(Scan.of_ranges(pose, scans.angle_rad, range_m, sensor, len(taken)))
    return regions.placed(landmark), tuple(taken)


@cache
def mapped(name: str) -> Layer:
    """A layer after one loop of the simulation; not to be changed."""
    placed, scans = simulation()
    filled = layer(name)
    for scan in scans:
        filled.fuse(*told(placed, scan))
    return filled
