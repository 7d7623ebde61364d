"""Dynamic regions: differencing, low pass, threshold, union (Nieto 2005, section 6.3)."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.dense.dynamic import Differencing, DynamicLayer, LowPass, places
from ekf_reference.dense.layers.occupancy import RegionGrid
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan
from tests.ekf_reference.dense import scenes
from tests.ekf_reference.dense.scenes import field, place, reported

SENSOR = replace(scenes.SENSOR, sigma_range_m=0.2)
HERE = np.array([1.0, 5.0, 0.0])
BEARING = np.arange(-math.radians(40.0), math.radians(40.0), SENSOR.beam_rad)
BACK_M, CUBE_M = 15.0, 0.7
"""East of a wall behind everything, and half the side of a box before it."""


def scene(box: Array | None, rng: np.random.Generator, noise_m: float = 0.15) -> Scan:
    """A wall, and maybe a square box with its middle at (2,), seen from HERE."""
    cos, sin = np.cos(BEARING), np.sin(BEARING)
    range_m = (BACK_M - HERE[0]) / cos
    if box is not None:
        front = (box[0] - CUBE_M - HERE[0]) / cos
        met = np.abs(HERE[1] + front * sin - box[1]) <= CUBE_M
        range_m = np.where(met, front, range_m)
    noise = noise_m * rng.standard_normal(len(range_m))
    return Scan.of_ranges(HERE, BEARING, range_m + noise, SENSOR)


def see(layer: DynamicLayer, placed: RegionsAtMap, scan: Scan, time_s: float) -> None:
    hits, _, _, near = reported(placed, scan)
    layer.fuse(hits, placed, scan, near, time_s)


def watched(
    layer: DynamicLayer, north: list[float | None], seed: int = 0, again: int = 1000
) -> tuple[DynamicLayer, RegionsAtMap]:
    """Ten scans a second of a box so far north in each; from one on, a minute later."""
    rng, placed = np.random.default_rng(seed), place()
    for k, y in enumerate(north):
        scan = scene(None if y is None else np.array((8.0, y)), rng)
        see(layer, placed, scan, 0.1 * k + (60.0 if k >= again else 0.0))
    return layer, placed


def passing(turns: int = 1) -> list[float | None]:
    """A box that comes in from the south at 2 m/s and leaves in the north."""
    return [None] * 15 + turns * (np.arange(0.0, 10.0, 0.2).tolist() + [None] * 15)


def test_the_low_pass_is_the_weighted_mean_over_the_region() -> None:
    triangle = np.array(((0.0, 0.0), (6.0, 1.0), (1.0, 5.0)))
    grid = RegionGrid.over(triangle, 0.4)
    value = np.zeros(grid.place.shape)
    value[grid.place >= 0] = np.random.default_rng(1).standard_normal(len(grid.odds))
    ours = LowPass.over(grid, triangle, 0.5)(value)[grid.place >= 0]
    frame = np.stack((triangle[0], triangle[1] - triangle[0], triangle[2] - triangle[0]), axis=1)
    centre = (frame @ grid.weight).T
    square = np.square(centre[:, None] - centre[None]).sum(axis=2)
    weight = np.where(square <= (3.0 * 0.5) ** 2, np.exp(-0.5 * square / 0.5**2), 0.0)
    whole = 2.0 * np.pi * 0.5**2 / np.abs(np.linalg.det(frame[:, 1:])) * np.prod(grid.cells)
    inside = np.maximum(weight.sum(axis=1), 0.5 * whole)
    brute = weight @ value[grid.place >= 0] / inside
    assert ours == pytest.approx(brute, abs=0.03 * np.abs(brute).max())  # the kernel's far tail


def test_a_passing_box_leaves_its_lane() -> None:
    layer, placed = watched(DynamicLayer(), passing())
    cells = layer.points(placed)
    assert len(np.unique(places(cells))) == 1
    front = 8.0 - CUBE_M
    assert np.abs(cells[:, 0] - front).max() < 0.8
    for north in np.arange(1.5, 8.6, 0.5):
        assert layer.covers(np.array(((front, north),)), placed, 0.3).all()
    assert layer.counters.fast == len(cells)
    cell_m2 = 0.2 * 0.2 * math.sin(math.radians(45.0))  # regions are halves of squares
    assert layer.area_m2(placed) == pytest.approx(cell_m2 * len(cells), rel=0.05)


def test_what_stands_still_is_not_dynamic() -> None:
    for seed in range(3):
        layer, _ = watched(DynamicLayer(), [5.0] * 60, seed)
        assert not len(layer.regions)
        assert layer.counters.compared > 50


def test_without_the_low_pass_noise_is_taken_for_motion() -> None:
    """The broken variant: a kernel of less than a cell, and single cells count."""
    rule = Differencing(lowpass=0.1, least=0.0)
    layer, _ = watched(DynamicLayer(rule=rule), [5.0] * 60)
    assert layer.counters.fast > 20


def test_without_the_union_most_of_a_lane_is_missed() -> None:
    """The broken variant: only what the last difference showed."""

    class Forgetful(DynamicLayer):
        def fuse(self, *scan) -> None:  # type: ignore[no-untyped-def]
            for history in self._history.values():
                history.dynamic[:] = False
            super().fuse(*scan)

    whole, placed = watched(DynamicLayer(), passing())
    last, _ = watched(Forgetful(), passing())
    assert len(last.points(placed)) < 0.3 * len(whole.points(placed))


def test_slow_motion_shows_between_two_visits() -> None:
    """A box that is brought while nobody looks; looking again at once would not do."""
    slow = DynamicLayer(rule=Differencing(threshold=0.99))
    layer, placed = watched(slow, [*[None] * 20, *[5.0] * 20], 2, again=20)
    cells = layer.points(placed)
    assert layer.counters.fast == 0
    assert layer.counters.slow == len(cells)
    assert len(np.unique(places(cells))) == 1
    assert np.linalg.norm(cells.mean(axis=0) - (8.0 - CUBE_M, 5.0)) < 0.3


def test_a_visit_ends_when_a_region_is_not_seen_however_seldom_maps_are_compared() -> None:
    """A box brought in a gap of 6 s came within a visit, one in a gap of 12 s between two."""
    rule = Differencing(threshold=0.99, look_s=20.0)
    for back_s, slow in ((12.0, False), (18.0, True)):
        layer, rng, placed = DynamicLayer(rule=rule), np.random.default_rng(2), place()
        for time_s in (0.0, 5.5, 5.6, 5.7):
            see(layer, placed, scene(None, rng), time_s)
        for time_s in np.arange(back_s, 21.0, 0.25).tolist():
            see(layer, placed, scene(np.array((8.0, 5.0)), rng), time_s)
        assert (layer.counters.slow > 0) is slow


def test_a_scene_that_is_all_moving_is_all_dynamic() -> None:
    """The wall itself comes and goes: all that was seen both ways is flagged, and nothing else."""
    layer, rng, placed = DynamicLayer(), np.random.default_rng(3), place()
    for k in range(60):
        range_m = (9.0 if (k // 15) % 2 else 14.0) / np.cos(BEARING)
        noisy = range_m + 0.1 * rng.standard_normal(len(range_m))
        see(layer, placed, Scan.of_ranges(HERE, BEARING, noisy, SENSOR), 0.1 * k)
    north = np.linspace(-1.0, 11.0, 25)
    wall = np.column_stack((np.full(25, HERE[0] + 9.0), north))
    assert layer.covers(wall, placed, 0.3).all()
    assert not layer.covers(wall - (3.0, 0.0), placed, 0.3).any()


def test_a_region_that_changes_its_shape_is_not_compared() -> None:
    """One corner moves half a metre a second, and with it what is told in its coordinates."""
    layer, rng = DynamicLayer(), np.random.default_rng(4)
    landmark, regions = field()
    for k in range(40):
        moved = landmark + np.where(np.arange(len(landmark)) % 2, 0.05 * k, 0.0)[:, None]
        see(layer, regions.placed(moved), scene(np.array((8.0, 5.0)), rng), 0.1 * k)
    assert layer.counters.deformed > 5 * layer.counters.compared
    assert not len(layer.regions)


def test_flags_follow_the_landmarks() -> None:
    layer, placed = watched(DynamicLayer(), passing())
    landmark, regions = field()
    there = regions.placed(landmark + (3.0, -2.0))
    assert layer.points(there) == pytest.approx(layer.points(placed) + (3.0, -2.0))
    assert layer.covers(layer.points(there), there).all()
    assert not layer.covers(np.array(((np.nan, 0.0), (500.0, 0.0))), there, 0.5).any()
    region = int(layer.regions[0])
    assert layer.mask(region).sum() == len(layer.points(placed, [region]))
    assert not layer.mask(10_000).any()
