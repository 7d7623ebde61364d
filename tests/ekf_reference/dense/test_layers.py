"""What every layer of a dense map has in common."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.dense.layers.layer import LateScan, Layer
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan
from tests.ekf_reference.dense.scenes import (
    HERE,
    LAYERS,
    SENSOR,
    WALL_M,
    field,
    layer,
    place,
    reported,
    wall_scan,
)

pytestmark = pytest.mark.parametrize("name", LAYERS)

ON_THE_WALL = np.column_stack((np.full(9, WALL_M), np.linspace(3.0, 9.0, 9)))
OUTSIDE = np.array([(-3.0, 2.0), (50.0, 50.0), (np.nan, 1.0), (1.0, np.inf)])


def filled(name: str, scans: int = 5, seed: int = 0) -> tuple[Layer, RegionsAtMap]:
    placed, made, rng = place(), layer(name, seed), np.random.default_rng(seed)
    for _ in range(scans):
        made.fuse(*reported(placed, wall_scan(rng=rng)))
    return made, placed


def spread(placed: RegionsAtMap) -> Array:
    """(N, 2) points all over the field."""
    return np.random.default_rng(8).uniform((0, -5), (20, 15), (2000, 2))


def nothing_known(made: Layer, placed: RegionsAtMap) -> bool:
    asked = made.occupancy(spread(placed), placed)
    return not len(made.samples(placed).point) and bool(np.isnan(asked).all())


def test_nothing_returned_nothing_known(name: str) -> None:
    made, placed = layer(name), place()
    assert nothing_known(made, placed)
    bearing = np.linspace(-1.0, 1.0, 50)
    for empty in (np.full(50, np.nan), np.full(50, np.inf), np.zeros(50), -np.ones(50)):
        made.fuse(*reported(placed, Scan.of_ranges(HERE, bearing, empty, SENSOR)))
    none = Scan.of_ranges(HERE, np.empty(0), np.empty(0), SENSOR)
    everywhere = np.arange(len(placed.triangle))
    made.fuse(*reported(placed, none)[:3], everywhere)
    made.fuse(*reported(placed, none, late=True)[:3], everywhere)
    assert nothing_known(made, placed)


def test_a_wall_is_occupied_where_it_is(name: str) -> None:
    made, placed = filled(name, scans=8)
    there = made.occupancy(ON_THE_WALL, placed)
    assert (there[~np.isnan(there)] > 0.8).mean() > 0.85
    assert np.isfinite(there).all()
    before = made.occupancy(ON_THE_WALL - (3.0, 0.0), placed)
    assert (np.isnan(before) | (before < 0.2)).all()
    certain = made.samples(placed)
    off = np.abs(certain.point[certain.occupancy > 0.8, 0] - WALL_M)
    assert np.percentile(off, 99) < 0.5


@pytest.mark.parametrize(
    "moved",
    [
        (np.eye(2), (700.0, -30.0)),
        (np.array([(0.0, -1.0), (1.0, 0.0)]), (3.0, 4.0)),
        (np.array([(1.0, 0.3), (0.0, 1.1)]), (0.0, 5.0)),
    ],
    ids=["shifted", "rotated", "sheared"],
)
def test_the_map_moves_with_its_landmarks(name: str, moved: tuple[Array, Array]) -> None:
    made, placed = filled(name)
    before = made.samples(placed)
    matrix, shift = moved
    landmark, regions = field()
    now = regions.placed(landmark @ matrix.T + shift)
    after = made.samples(now)
    assert np.allclose(after.point, before.point @ matrix.T + shift, atol=1e-9, rtol=0.0)
    assert np.array_equal(after.occupancy, before.occupancy)
    assert np.array_equal(after.region, before.region)
    assert not np.allclose(after.point, before.point + shift) or np.array_equal(matrix, np.eye(2))
    if np.allclose(matrix @ matrix.T, np.eye(2)):
        asked = spread(placed)
        then, later = made.occupancy(asked, placed), made.occupancy(asked @ matrix.T + shift, now)
        same = np.isclose(then, later, atol=1e-6, equal_nan=True)
        assert same.mean() > 0.999  # but where rounding takes a point over an edge


def test_samples_only_of_the_regions_asked_for(name: str) -> None:
    made, placed = filled(name)
    every = made.samples(placed)
    wanted = np.unique(every.region)[::-2]
    some = made.samples(placed, wanted)
    assert set(some.region) == set(wanted)
    kept = np.isin(every.region, wanted)
    assert len(some.point) == kept.sum() < len(every.point)
    assert np.allclose(np.sort(some.point, axis=0), np.sort(every.point[kept], axis=0))
    assert len(made.samples(placed, np.empty(0, dtype=np.intp)).point) == 0


def test_late_returns_are_taken_in_without_a_scan(name: str) -> None:
    made, placed = layer(name), place()
    hits, _, scan, near = reported(placed, wall_scan(), late=True)
    assert scan is None
    hits = replace(hits, late=(LateScan(wall_scan(), near),))
    for _ in range(3):
        made.fuse(hits, placed, None, np.empty(0, dtype=np.intp))
    assert (made.occupancy(hits.point, placed) > 0.5).mean() > 0.9
    known = made.samples(placed)
    if name == "occupancy":  # which knows free space, too, by the rule of any scan
        at_once = layer(name)
        for _ in range(3):
            at_once.fuse(*reported(placed, wall_scan()))
        assert np.array_equal(known.occupancy, at_once.samples(placed).occupancy)
        return
    assert (known.occupancy >= 0.5 - 1e-9).all()
    assert (np.abs(known.point[:, 0] - WALL_M) < 1.0).all()


def test_a_scan_outside_every_region_leaves_no_trace(name: str) -> None:
    made, placed = layer(name), place()
    far = HERE + (500.0, 0.0, 0.0)
    made.fuse(*reported(placed, wall_scan(far, wall_m=512.0)))
    assert nothing_known(made, placed)


def test_beams_without_return_change_nothing(name: str) -> None:
    placed = place()
    scan = wall_scan()
    bearing = np.concatenate((scan.bearing_rad, np.linspace(1.0, 3.0, 40), [np.nan]))
    ranges = np.concatenate((scan.range_m, np.full(40, np.nan), [3.0]))
    one, other = layer(name), layer(name)
    one.fuse(*reported(placed, scan))
    other.fuse(*reported(placed, Scan.of_ranges(HERE, bearing, ranges, SENSOR)))
    for a, b in zip(one.samples(placed), other.samples(placed), strict=True):
        assert np.array_equal(a, b)


def test_the_same_input_gives_the_same_bytes(name: str) -> None:
    one, other = filled(name), filled(name)
    for a, b in zip(one[0].samples(one[1]), other[0].samples(other[1]), strict=True):
        assert a.tobytes() == b.tobytes()
    different = filled(name, seed=1)
    assert different[0].samples(place()).point.tobytes() != one[0].samples(
        place()
    ).point.tobytes() or (name == "occupancy")


def test_nothing_is_known_outside_all_regions(name: str) -> None:
    made, placed = filled(name)
    assert np.isnan(made.occupancy(OUTSIDE, placed)).all()
    assert made.occupancy(np.empty((0, 2)), placed).shape == (0,)


def test_questions_and_flat_regions_change_nothing(name: str) -> None:
    made, placed = filled(name)
    before = pickle.dumps(made)
    made.samples(placed)
    made.samples(placed, np.arange(3))
    made.occupancy(np.vstack((ON_THE_WALL, OUTSIDE)), placed)
    assert pickle.dumps(made) == before
    landmark, regions = field()
    landmark[regions.base[0]] = landmark[regions.base[0, 0]]
    made.fuse(*reported(regions.placed(landmark), wall_scan()))
    assert np.isfinite(made.samples(placed).point).all()


def test_what_is_handed_out_is_a_copy(name: str) -> None:
    made, placed = filled(name)
    before = pickle.dumps(made)
    for array in made.samples(placed):
        array[:] = 0
    assert pickle.dumps(made) == before
