"""The search for high level landmarks, in a small yard seen from known poses."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ekf_reference.core.geometry import Array, to_frame, to_world
from ekf_reference.dense.layers.gaussians import Gaussians
from ekf_reference.dense.layers.occupancy import OccupancyGrid
from ekf_reference.dense.scan import Scan, ScanSensor
from ekf_reference.dense.triangles import turned
from ekf_reference.scan_landmarks.high_level import (
    Around,
    SearchOptions,
    overlapping,
    pairs,
    rectangle,
    search,
    within,
)
from tests.ekf_reference.dense.scenes import lattice, reported
from tests.ekf_reference.ray_casting import Solids, cast, sides

SENSOR = ScanSensor(0.05, math.radians(0.5), math.radians(0.5), math.radians(8.0))
BEAMS = np.radians(np.arange(-180.0, 180.0, 0.5))
CENTRES = np.array(((-11.0, 9.0), (11.0, 8.0), (0.0, -11.0)))
SIZE = np.array((9.0, 6.0))
POLE = np.array((0.0, 12.0))
HERE = np.array((1.0, 0.5, 0.7))
NONE = np.empty((0, 4, 2))
FEW = SearchOptions(least=60)
"""Exact poses leave thin walls, of fewer Gaussians than a drive's."""


def outline(centre: Array) -> Array:
    """(4, 2) counter-clockwise."""
    half = 0.5 * SIZE * ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return np.asarray(centre + half)


@cache
def yard() -> Solids:
    """Three boxes and a pole."""
    walls = np.vstack([sides(outline(c)) for c in CENTRES])
    return Solids(walls, disc=np.array(((*POLE, 0.4),)))


@cache
def around() -> Around:
    """The yard, driven round inside and outside; the pole is a landmark."""
    landmark, regions = lattice(np.full(2, -30.0), np.full(2, 30.0), 10.0)
    placed = regions.placed(landmark)
    occupancy, gaussians, rng = OccupancyGrid(), Gaussians(), np.random.default_rng(0)
    for turn in np.arange(0.0, 2.0 * np.pi, 0.15):
        for radius in (3.0, 20.0):
            pose = np.array((radius * math.cos(turn), radius * math.sin(turn), turn))
            seen = cast(BEAMS, pose, yard()) + 0.05 * rng.standard_normal(len(BEAMS))
            what = reported(placed, Scan.of_ranges(pose, BEAMS, seen, SENSOR))
            occupancy.fuse(*what)
            gaussians.fuse(*what)
    return Around(occupancy, gaussians, placed, HERE, POLE[None])


def from_outline(point: Array, corner: Array) -> Array:
    """(N,) distance of points to the sides of a polygon."""
    side = np.roll(corner, -1, axis=0) - corner
    apart = point[:, None] - corner
    along = np.clip((apart * side).sum(axis=2) / np.square(side).sum(axis=1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(apart - along[..., None] * side, axis=2).min(axis=1))


def test_every_box_is_found_with_the_gaussians_on_it() -> None:
    made = search(around(), NONE, FEW)
    assert len(made.found) == 3
    boxes = set()
    for one in made.found:
        shape = one.template.shape
        place = to_world(one.place, shape.mean)
        box = int(np.linalg.norm(CENTRES - one.place[:2], axis=1).argmin())
        boxes.add(box)
        assert from_outline(place, outline(CENTRES[box])).max() < 0.5
        assert np.abs(shape.mean.mean(axis=0)).max() < 1e-9  # the axis is at the centroid
        assert one.place[2] == HERE[2]  # and has the vehicle's heading
        corners = to_world(one.place, one.corner)
        true = np.linalg.norm(corners[:, None] - outline(CENTRES[box]), axis=2).min(axis=1)
        assert true.max() < 1.2
        assert within(to_world(one.place, one.rectangle), place).all()
    assert boxes == {0, 1, 2}


def test_what_is_known_is_not_taken_twice() -> None:
    made = search(around(), NONE, FEW)
    known = np.array([to_world(one.place, one.rectangle) for one in made.found])
    again = search(around(), known, FEW)
    assert not again.found
    assert again.known >= 3
    one_missing = search(around(), known[1:], FEW)
    assert np.allclose([one.place for one in one_missing.found], [made.found[0].place])


def test_too_few_gaussians_are_not_enough_and_the_count_is_before_thinning() -> None:
    made = search(around(), NONE, SearchOptions(least=10**6))
    assert not made.found
    assert made.poor == len(made.candidate) >= 3
    bare = search(around(), NONE, replace(FEW, thin_m=0.0)).found
    for thin, whole in zip(search(around(), NONE, FEW).found, bare, strict=True):
        assert len(thin.template.shape) < 0.8 * len(whole.template.shape)


def test_a_landmark_of_the_filter_is_no_corner() -> None:
    """Broken: were the pole not known, it would be one."""
    apart = np.linalg.norm(search(around(), NONE, FEW).corner - POLE, axis=1)
    assert apart.min() > 3.0
    stranger = replace(around(), landmark=np.full((1, 2), np.nan))
    assert np.linalg.norm(search(stranger, NONE).corner - POLE, axis=1).min() < 0.3


def test_what_is_out_of_reach_is_not_looked_at() -> None:
    far = replace(around(), pose=np.array((1000.0, 0.0, 0.0)))
    made = search(far, NONE)
    assert not len(made.corner)
    near = search(around(), NONE, SearchOptions(reach_m=3.0, least=60))
    assert not near.found


def test_pairs_are_the_nearest_that_are_left() -> None:
    rng = np.random.default_rng(3)
    corner = rng.uniform(0.0, 40.0, (25, 2))
    chosen = pairs(corner, 9.0)
    assert len(np.unique(chosen)) == chosen.size > 10
    left, expected = list(range(25)), []
    while True:
        options = [
            (float(np.hypot(*(corner[i] - corner[j]))), i, j) for i in left for j in left if i < j
        ]
        if not options or min(options)[0] > 9.0:
            break
        _, i, j = min(options)
        expected.append((i, j))
        left = [k for k in left if k not in (i, j)]
    assert chosen.tolist() == [list(pair) for pair in expected]
    assert pairs(corner[:1], 9.0).shape == pairs(np.empty((0, 2)), 9.0).shape == (0, 2)


def test_a_rectangle_keeps_its_margin() -> None:
    pair = np.array(((1.0, 2.0), (4.0, 6.0)))
    drawn = rectangle(pair, 5.0)
    side = np.roll(drawn, -1, axis=0) - drawn
    assert np.allclose(np.linalg.norm(side, axis=1), (15.0, 10.0, 15.0, 10.0))
    after = np.roll(side, -1, axis=0)
    assert (side[:, 0] * after[:, 1] - side[:, 1] * after[:, 0] > 0.0).all()
    inwards = np.einsum("kj,ckj->ck", turned(side), pair[:, None] - drawn)
    assert np.isclose((inwards / np.linalg.norm(side, axis=1)).min(), 5.0)


@pytest.mark.parametrize("seed", range(3))
def test_overlap_equals_common_points(seed: int) -> None:
    """Against a fine lattice of points, where the common ground is not too small for it."""
    rng = np.random.default_rng(seed)
    at = np.stack(np.meshgrid(*[np.arange(-25.0, 25.0, 0.25)] * 2), axis=-1).reshape(-1, 2)
    both = 0
    for _ in range(60):
        one, other = (rectangle(rng.uniform(-9.0, 9.0, (2, 2)), 2.0) for _ in range(2))
        common = np.count_nonzero(within(one, at) & within(other, at))
        assert overlapping(one, other) == overlapping(other, one)
        if common or not overlapping(one, other):
            assert overlapping(one, other) == (common > 0)
            both += int(common > 0)
    assert 10 < both < 50


def test_frames_and_world() -> None:
    pose, point = np.array((3.0, -2.0, 2.5)), np.array(((1.0, 0.0), (0.0, 2.0)))
    placed = pose[:2] + [
        (math.cos(2.5), math.sin(2.5)),
        (-2.0 * math.sin(2.5), 2.0 * math.cos(2.5)),
    ]
    assert np.allclose(to_world(pose, point), placed)
    assert np.allclose(to_frame(pose, placed), point)
