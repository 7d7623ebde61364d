"""Beams cast exactly into a world of walls, poles and a ground, in the plane and in space.

In the plane a beam is a ray among segments and circles. In space every wall and pole is upright
and the sensor level, so a beam's way over the ground is the same planar ray: it meets at distance
d what the planar ray meets there, if the thing is at least as high as the beam, h + d tan(e).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index

_PAIRS = 2**18
"""So many pairs of beam and thing are tried at once: their arrays stay in the cache."""


@dataclass(frozen=True)
class Solids:
    """What beams meet: O closed outlines of S segments, and L discs, all standing on the ground.

    segment: (S, 4) x1, y1, x2, y2 [m]. outline: (S,) which one each segment belongs to.
    outline_height_m: (O,). disc: (L, 3) x, y, diameter [m], or (B, L, 3) as each of B beams finds
    them. disc_height_m: (L,). Heights matter in space only.
    """

    segment: Array = field(default_factory=lambda: np.zeros((0, 4)))
    outline: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    outline_height_m: Array = field(default_factory=lambda: np.zeros(0))
    disc: Array = field(default_factory=lambda: np.zeros((0, 3)))
    disc_height_m: Array = field(default_factory=lambda: np.zeros(0))

    def within(self, centre: Array, reach_m: float) -> Solids:
        """Those of the segments and of the discs (L, 3) that come as near to a point (2,)."""
        start, way = self.segment[:, :2] - centre, self.segment[:, 2:] - self.segment[:, :2]
        square = np.maximum(np.einsum("ij,ij->i", way, way), np.finfo(float).tiny)
        part = np.clip(-np.einsum("ij,ij->i", start, way) / square, 0.0, 1.0)
        wall = np.hypot(*(start + part[:, None] * way).T) <= reach_m
        away = np.hypot(*(self.disc[:, :2] - centre).T) - 0.5 * self.disc[:, 2]
        disc = away <= reach_m
        return Solids(
            self.segment[wall],
            self.outline[wall],
            self.outline_height_m,
            self.disc[disc],
            self.disc_height_m[disc],
        )


class _Crossings(NamedTuple):
    """Where beams cross things: row of the beam, column of the thing, distance in and out."""

    beam: Index
    thing: Index
    enter_m: Array
    leave_m: Array


def cast(angle_rad: Array, pose: Array, solids: Solids) -> Array:
    """Ranges (B,) along beams to the nearest of walls and discs, infinite for none.

    angle_rad: (B,) from the heading. pose: (3,) of the sensor, or (B, 3) of each beam. Inside a
    disc the sensor does not see it. A beam along a wall does not meet that wall.
    """
    poses = np.broadcast_to(pose, (len(angle_rad), 3))
    nearest = np.full(len(angle_rad), np.inf)
    for found in (_walls(angle_rad, poses, solids), _discs(angle_rad, poses, solids)):
        np.minimum.at(nearest, found.beam, found.enter_m)
    return nearest


def cast_rings(
    angle_rad: Array, elevation_rad: Array, height_m: float, pose: Array, solids: Solids
) -> Array:
    """Ranges (B, R) of R rings to walls, discs, tops and ground, infinite for none.

    angle_rad: (B,) azimuths from the heading. elevation_rad: (R,) upwards, within a right angle.
    height_m: of the level sensor over the ground. pose: (3,) or (B, 3). Outlines and discs lower
    than the sensor are closed on top; the sensor must stand outside of them.
    """
    poses = np.broadcast_to(pose, (len(angle_rad), 3))
    walls, discs = _walls(angle_rad, poses, solids), _discs(angle_rad, poses, solids)
    owner = solids.outline[walls.thing]
    wall_top, disc_top = solids.outline_height_m[owner], solids.disc_height_m[discs.thing]
    low = np.flatnonzero(solids.outline_height_m < height_m)
    column = np.full(len(solids.outline_height_m), -1)
    column[low] = np.arange(len(low))
    over = np.flatnonzero(column[owner] >= 0)
    over_beam, over_column, over_m = walls.beam[over], column[owner[over]], walls.enter_m[over]
    way = np.full((len(angle_rad), len(elevation_rad)), np.inf)
    for ring, slope in enumerate(np.tan(elevation_rad).tolist()):
        nearest = way[:, ring]
        for crossings, top in ((walls, wall_top), (discs, disc_top)):
            met = height_m + crossings.enter_m * slope <= top
            np.minimum.at(nearest, crossings.beam[met], crossings.enter_m[met])
        if slope >= 0.0:
            continue
        nearest[:] = np.minimum(nearest, height_m / -slope)
        # A beam that comes down to the height of a top meets it if it is inside the outline there.
        down_m = (height_m - solids.outline_height_m[low]) / -slope
        crossed = np.zeros((len(angle_rad), len(low)), dtype=np.int64)
        before = over_m < down_m[over_column]
        np.add.at(crossed, (over_beam[before], over_column[before]), 1)
        beam, top_of = np.nonzero(crossed % 2)
        np.minimum.at(nearest, beam, down_m[top_of])
        down_m = (height_m - disc_top) / -slope
        met = (discs.enter_m < down_m) & (down_m < discs.leave_m)
        np.minimum.at(nearest, discs.beam[met], down_m[met])
    return way / np.cos(elevation_rad)


def _walls(angle_rad: Array, pose: Array, solids: Solids) -> _Crossings:
    """Every crossing of beams and segments, ahead of the sensor.

    Seen along the beam, a segment is crossed if its ends lie on different sides. Both segments
    at a corner judge it by the same number, so no beam slips through between them.
    """
    x1, y1, x2, y2 = solids.segment.T
    parts = []
    for rows in blocks(len(angle_rad), len(x1), _PAIRS):
        direction = pose[rows, 2] + angle_rad[rows]
        cos, sin = np.cos(direction)[:, None], np.sin(direction)[:, None]
        x, y = pose[rows, 0, None], pose[rows, 1, None]
        side1 = (y1 - y) * cos - (x1 - x) * sin
        side2 = (y2 - y) * cos - (x2 - x) * sin
        beam, wall = np.nonzero((side1 < 0.0) != (side2 < 0.0))
        part = side1[beam, wall] / (side1[beam, wall] - side2[beam, wall])
        across_x = x1[wall] + part * (x2 - x1)[wall] - x[beam, 0]
        across_y = y1[wall] + part * (y2 - y1)[wall] - y[beam, 0]
        way = across_x * cos[beam, 0] + across_y * sin[beam, 0]
        ahead = way > 0.0
        parts.append((rows.start + beam[ahead], wall[ahead], way[ahead]))
    beam, wall, way = (np.concatenate(column) for column in zip(*parts, strict=True))
    return _Crossings(beam, wall, way, way)


def _discs(angle_rad: Array, pose: Array, solids: Solids) -> _Crossings:
    """Every crossing of beams and discs, ahead of the sensor."""
    parts = []
    for rows in blocks(len(angle_rad), solids.disc.shape[-2], _PAIRS):
        disc = solids.disc[rows] if solids.disc.ndim == 3 else solids.disc
        direction = pose[rows, 2] + angle_rad[rows]
        cos, sin = np.cos(direction)[:, None], np.sin(direction)[:, None]
        x, y = disc[..., 0] - pose[rows, 0, None], disc[..., 1] - pose[rows, 1, None]
        along = x * cos + y * sin
        across = y * cos - x * sin
        inside = (0.5 * disc[..., 2]) ** 2 - across**2
        half = np.sqrt(np.maximum(inside, 0.0))
        beam, thing = np.nonzero((inside >= 0.0) & (along > half))
        middle, half = along[beam, thing], half[beam, thing]
        parts.append((rows.start + beam, thing, middle - half, middle + half))
    return _Crossings(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def blocks(count: int, things: int, pairs: int) -> list[slice]:
    """So many rows in blocks of at most so many pairs with things, one block at least."""
    size = max(1, pairs // max(things, 1))
    return [slice(first, min(first + size, count)) for first in range(0, max(count, 1), size)]
