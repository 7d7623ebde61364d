"""Casting against oracles that share no formula with it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from comparisons.logs.simulate.ray_casting import Solids, cast, cast_rings

Array = NDArray[np.float64]

RINGS = np.deg2rad(np.linspace(-15.0, 15.0, 16))
SENSOR_M = 1.8


def random_solids(seed: int, outlines: int = 16, discs: int = 10) -> Solids:
    """Convex polygons and discs about the origin, clear of it; every other one is low."""
    rng = np.random.default_rng(seed)
    segment, owner = [], []
    for i in range(outlines):
        turn = np.sort(rng.uniform(0.0, 2 * np.pi, int(rng.integers(4, 8))))
        corner = rng.uniform(1.0, 3.0) * np.column_stack((np.cos(turn), np.sin(turn)))
        far, at = rng.uniform(8.0, 25.0), rng.uniform(0.0, 2 * np.pi)
        corner = corner + far * np.array((np.cos(at), np.sin(at)))
        segment.append(np.hstack((corner, np.roll(corner, -1, axis=0))))
        owner += [i] * len(corner)
    away, turns = rng.uniform(7.0, 25.0, discs), rng.uniform(0.0, 2 * np.pi, discs)
    disc = np.column_stack(
        (away * np.cos(turns), away * np.sin(turns), rng.uniform(0.1, 3.0, discs))
    )
    return Solids(
        np.vstack(segment),
        np.array(owner),
        rng.uniform(0.3, np.resize((1.0, 4.0), outlines)),
        disc,
        rng.uniform(0.3, 4.0, discs),
    )


def moved(solids: Solids, pose: Array) -> Solids:
    """As seen from the origin before, now from a pose."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, sin], [-sin, cos]])
    ends = solids.segment.reshape(-1, 2) @ turn + pose[:2]
    disc = np.column_stack((solids.disc[:, :2] @ turn + pose[:2], solids.disc[:, 2]))
    return replace(solids, segment=ends.reshape(-1, 4), disc=disc)


def scalar_range(x: float, y: float, direction: float, solids: Solids) -> float:
    """One beam: Cramer's rule for the segments, the quadratic formula for the circles."""
    dx, dy = math.cos(direction), math.sin(direction)
    best = math.inf
    for x1, y1, x2, y2 in solids.segment.tolist():
        ex, ey = x2 - x1, y2 - y1
        determinant = dx * -ey + ex * dy
        if determinant == 0.0:
            continue
        t = ((x1 - x) * -ey + ex * (y1 - y)) / determinant
        u = (dx * (y1 - y) - dy * (x1 - x)) / determinant
        if t > 0.0 and 0.0 <= u <= 1.0:
            best = min(best, t)
    for cx, cy, diameter in solids.disc.tolist():
        b = dx * (x - cx) + dy * (y - cy)
        c = (x - cx) ** 2 + (y - cy) ** 2 - 0.25 * diameter**2
        if b * b >= c and c > 0.0 and -b - math.sqrt(b * b - c) > 0.0:
            best = min(best, -b - math.sqrt(b * b - c))
    return best


@pytest.mark.parametrize("seed", range(6))
def test_equals_one_beam_after_the_other(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    pose = rng.uniform(-50.0, 50.0, 3)
    solids = moved(random_solids(seed), pose)
    angle = rng.uniform(-np.pi, np.pi, 150)
    expected = [scalar_range(pose[0], pose[1], pose[2] + a, solids) for a in angle]
    found = cast(angle, pose, solids)
    assert np.isfinite(found).any()
    assert np.isinf(found).any()
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_beams_from_poses_of_their_own_among_discs_that_move() -> None:
    """One call with (B, 3) poses and (B, L, 3) discs equals B calls."""
    rng = np.random.default_rng(7)
    still = random_solids(7)
    angle = rng.uniform(-np.pi, np.pi, 60)
    pose = rng.normal(0.0, 0.5, (60, 3))
    disc = still.disc + rng.normal(0.0, 0.2, (60, 1, 1)) * (1.0, 1.0, 0.0)
    together = cast(angle, pose, replace(still, disc=disc))
    for k in range(60):
        alone = replace(still, disc=disc[k])
        assert cast(angle[k : k + 1], pose[k], alone)[0] == together[k]


def test_no_beam_slips_through_a_corner() -> None:
    """Aimed at the corners of a closed polygon from within, all return."""
    rng = np.random.default_rng(3)
    for _ in range(200):
        turn = np.sort(rng.uniform(0.0, 2 * np.pi, 40))
        corner = 20.0 * np.column_stack((np.cos(turn), np.sin(turn))) + rng.uniform(-90, 90, 2)
        pose = np.array((*corner.mean(axis=0), 0.0))
        ring = Solids(np.hstack((corner, np.roll(corner, -1, axis=0))), np.zeros(40, dtype=int))
        angle = np.arctan2(corner[:, 1] - pose[1], corner[:, 0] - pose[0])
        found = cast(angle, pose, ring)
        np.testing.assert_allclose(found, np.hypot(*(corner - pose[:2]).T), rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_out_of_reach_makes_no_difference(seed: int) -> None:
    solids, pose = random_solids(seed), np.array((0.3, -0.4, 1.0))
    near = solids.within(pose[:2], 12.0)
    assert 0 < len(near.segment) < len(solids.segment)
    assert 0 < len(near.disc) < len(solids.disc)
    angle = np.linspace(-np.pi, np.pi, 721)
    every, some = cast(angle, pose, solids), cast(angle, pose, near)
    assert np.array_equal(
        np.where(every <= 12.0, every, np.inf), np.where(some <= 12, some, np.inf)
    )


def test_an_empty_world_returns_nothing_but_ground() -> None:
    angle = np.linspace(-1.0, 1.0, 5)
    assert np.isinf(cast(angle, np.zeros(3), Solids())).all()
    found = cast_rings(angle, np.deg2rad([-30.0, 0.0, 10.0]), 2.0, np.zeros(3), Solids())
    assert np.allclose(found[:, 0], 4.0, rtol=1e-14)
    assert np.isinf(found[:, 1:]).all()


@pytest.mark.parametrize("seed", range(4))
def test_the_level_ring_is_the_planar_scan_of_what_is_high_enough(seed: int) -> None:
    solids, pose = random_solids(seed), np.array((0.1, 0.2, -2.0))
    angle = np.linspace(-np.pi, np.pi, 300)
    wall = solids.outline_height_m[solids.outline] >= SENSOR_M
    pole = solids.disc_height_m >= SENSOR_M
    high = replace(
        solids,
        segment=solids.segment[wall],
        outline=solids.outline[wall],
        disc=solids.disc[pole],
        disc_height_m=solids.disc_height_m[pole],
    )
    level = cast_rings(angle, np.zeros(1), SENSOR_M, pose, solids)[:, 0]
    np.testing.assert_allclose(level, cast(angle, pose, high), rtol=1e-12)
    assert not np.array_equal(level, cast(angle, pose, solids))


def triangles(solids: Solids, closed: bool = True) -> Array:
    """(T, 3, 3): two for each wall, a fan for each top, and two for a ground of 2 km."""
    found = []
    for (x1, y1, x2, y2), owner in zip(solids.segment, solids.outline, strict=True):
        h = solids.outline_height_m[owner]
        found.append([(x1, y1, 0), (x2, y2, 0), (x2, y2, h)])
        found.append([(x1, y1, 0), (x2, y2, h), (x1, y1, h)])
        first = solids.segment[solids.outline == owner][0]
        if closed:
            found.append([(first[0], first[1], h), (x1, y1, h), (x2, y2, h)])
    far = 1e3
    found.append([(-far, -far, 0), (far, -far, 0), (far, far, 0)])
    found.append([(-far, -far, 0), (far, far, 0), (-far, far, 0)])
    return np.array(found, dtype=float)


def moeller_trumbore(origin: Array, direction: Array, mesh: Array) -> Array:
    """(N,) nearest distances along rays (N, 3) from one origin to triangles (T, 3, 3)."""
    corner, edge1, edge2 = mesh[:, 0], mesh[:, 1] - mesh[:, 0], mesh[:, 2] - mesh[:, 0]
    p = np.cross(direction[:, None], edge2[None])
    determinant = np.einsum("ntk,tk->nt", p, edge1)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = origin - corner
        u = np.einsum("tk,ntk->nt", s, p) / determinant
        q = np.cross(s, edge1)
        v = np.einsum("nk,tk->nt", direction, q) / determinant
        t = np.einsum("tk,tk->t", edge2, q) / determinant
        hit = (u >= -1e-12) & (v >= -1e-12) & (u + v <= 1 + 1e-12) & (t > 0)
    nearest: Array = np.where(hit, t, np.inf).min(axis=1)
    return nearest


def scalar_cylinder(origin: Array, direction: Array, disc: Array, height: float) -> float:
    """One ray on an upright cylinder with a top."""
    hits = []
    a = direction[0] ** 2 + direction[1] ** 2
    offset = origin[:2] - disc[:2]
    b = 2.0 * float(offset @ direction[:2])
    c = float(offset @ offset) - 0.25 * disc[2] ** 2
    if b * b - 4 * a * c >= 0:
        hits.append((-b - math.sqrt(b * b - 4 * a * c)) / (2 * a))
        hits = [t for t in hits if 0 <= origin[2] + t * direction[2] <= height]
    if direction[2]:
        t = (height - origin[2]) / direction[2]
        place = offset + t * direction[:2]
        hits += [t] if place @ place <= 0.25 * disc[2] ** 2 else []
    return min((t for t in hits if t > 0), default=math.inf)


def rays(angle: Array, pose: Array) -> Array:
    azimuth, elevation = np.meshgrid(pose[2] + angle, RINGS, indexing="ij")
    level = np.cos(elevation)
    return np.stack(
        (level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)), axis=-1
    ).reshape(-1, 3)


@pytest.mark.parametrize("seed", range(5))
def test_rings_equal_triangles_and_cylinders(seed: int) -> None:
    pose = np.array((4.0, -3.0, 0.7))
    solids = moved(random_solids(seed), pose)
    angle = np.random.default_rng(seed).uniform(-np.pi, np.pi, 120)
    origin, direction = np.array((*pose[:2], SENSOR_M)), rays(angle, pose)
    mesh = moeller_trumbore(origin, direction, triangles(solids))
    poles = [
        min(
            scalar_cylinder(origin, ray, disc, height)
            for disc, height in zip(solids.disc, solids.disc_height_m, strict=True)
        )
        for ray in direction
    ]
    expected = np.minimum(mesh, poles)
    found = cast_rings(angle, RINGS, SENSOR_M, pose, solids).ravel()
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    height = SENSOR_M + found * direction[:, 2]
    tops = np.isin(height.round(9), solids.outline_height_m.round(9))
    assert tops.any()
    opened = moeller_trumbore(origin, direction, triangles(solids, closed=False))
    assert not np.allclose(found, np.minimum(opened, poles), rtol=1e-3)  # boxes without lids
    assert np.count_nonzero(mesh < poles) > 100
    assert np.count_nonzero(mesh > poles) > 20


def test_a_cross_is_closed_on_top_between_its_arms_only() -> None:
    """Outlines need not be convex: over the notch a beam goes down to the ground."""
    a, b = 1.0, 3.0
    corner = np.array(
        [(-a, -b), (a, -b), (a, -a), (b, -a), (b, a), (a, a), (a, b), (-a, b), (-a, a), (-b, a),
         (-b, -a), (-a, -a)]
    )  # fmt: skip
    cross = Solids(
        np.hstack((corner, np.roll(corner, -1, axis=0))), np.zeros(12, dtype=int), np.ones(1)
    )
    pose, height = np.array((-10.0, 2.0, 0.0)), 2.0
    for x, y, z in ((-0.5, 2.0, 1.0), (-2.0, 2.0, 0.0), (2.0, 0.5, 1.0), (0.0, -2.0, 1.0)):
        aim = np.array((x, y)) - pose[:2]
        down = math.atan2(z - height, np.hypot(*aim))
        found = cast_rings(
            np.array([math.atan2(aim[1], aim[0])]), np.array([down]), height, pose, cross
        )
        assert found[0, 0] == pytest.approx(math.hypot(*aim, z - height), rel=1e-12)
