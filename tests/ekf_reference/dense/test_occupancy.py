import math
from dataclasses import replace

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.dense.layers.classic_grid import ClassicGrid
from ekf_reference.dense.layers.grid_update import GridUpdate
from ekf_reference.dense.layers.occupancy import Coarsening, OccupancyGrid, RegionGrid
from ekf_reference.dense.scan import Scan
from ekf_reference.dense.sensor_model import InverseSensorModel, log_odds, probability
from tests.ekf_reference.dense.scenes import HERE, SENSOR, WALL_M, field, place, reported, wall_scan

MODELS = (InverseSensorModel(), InverseSensorModel(0.8, 0.4, with_bearing=True))


def in_cells(grid: ClassicGrid, point: Array) -> Array:
    """(N,) occupancy of the cells that points (N, 2) lie in; NaN where nothing is known."""
    seen = grid.samples()
    known = dict(zip(map(tuple, np.floor(seen.point / 0.2).tolist()), seen.occupancy, strict=True))
    return np.array([known.get(tuple(at), math.nan) for at in np.floor(point / 0.2).tolist()])


def one_cell(scan: Scan, point: Array, model: InverseSensorModel, sigma_m: float) -> float:
    """What a scan adds to one cell, NaN where directions to the lookup's width decide."""
    apart = point - scan.origin
    bearing = math.atan2(apart[1], apart[0]) - scan.pose[2]
    off = np.abs(np.array([math.remainder(bearing - b, 2 * math.pi) for b in scan.bearing_rad]))
    first, second = np.sort(off)[:2]
    if second - first < 4e-3 or abs(first - scan.sensor.reach_rad) < 2e-3:
        return math.nan
    if first > scan.sensor.reach_rad:
        return 0.0
    ahead = scan.range_m[off.argmin()] - math.hypot(*apart)
    if ahead < -4.0 * sigma_m:
        return 0.0
    if ahead > 4.0 * sigma_m:
        return float(log_odds(model.p_free))
    return float(
        log_odds(
            model.probability(
                np.array([ahead]), np.array([first]), sigma_m, scan.sensor.sigma_bearing_rad
            )
        )[0]
    )


@pytest.mark.parametrize("model", MODELS)
def test_one_scan_equals_a_loop_over_the_cells(model: InverseSensorModel) -> None:
    placed = place()
    rng = np.random.default_rng(0)
    bearing = np.arange(-1.0, 1.2, 0.03)
    sensor = replace(SENSOR, beam_rad=0.03)
    scan = Scan.of_ranges(HERE, bearing, rng.uniform(4, 15, len(bearing)), sensor)
    grid = OccupancyGrid(0.5, model)
    grid.fuse(*reported(placed, scan))
    sigma = math.hypot(sensor.sigma_range_m, 0.25)
    gap, compared = 0.0, 0
    broken = 0.0
    for number, cells in grid.grids.items():
        origin, a, b = (f[number] for f in placed.frames)
        for weight, odds in zip(cells.weight.T.astype(float), cells.odds, strict=True):
            point = origin + weight[1] * a + weight[2] * b
            expected = one_cell(scan, point, model, sigma)
            if not math.isnan(expected):
                compared += 1
                gap = max(gap, abs(expected - float(odds)))
                wrong = one_cell(scan, point, model, sigma**2)  # N 4.2's sigma for its square
                broken = max(broken, abs(wrong - float(odds)))
    assert compared > 1000
    assert gap < 2e-3
    assert broken > 0.5


def test_updates_are_bayes_within_bounds() -> None:
    update = GridUpdate(confidence=0.95)
    said = np.array([0.7, 0.4, 0.9, 0.9, 0.9])
    odds = np.zeros(1, dtype=np.float32)
    occupied = 0.5
    for p in said[:3]:
        update.add(odds, log_odds(np.array([p])).astype(np.float32))
        occupied = occupied * p / (occupied * p + (1.0 - occupied) * (1.0 - p))
        assert probability(odds.astype(float))[0] == pytest.approx(occupied, abs=1e-6)
    for p in said[3:]:
        update.add(odds, log_odds(np.array([p])).astype(np.float32))
    assert probability(odds.astype(float))[0] == pytest.approx(0.95, abs=1e-6)
    for _ in range(12):
        update.add(odds, log_odds(np.array([0.3])).astype(np.float32))
    assert probability(odds.astype(float))[0] == pytest.approx(0.05, abs=1e-6)


def test_occupancy_has_no_bound_where_none_is_asked_for() -> None:
    """As eq. 4.7: what was seen so often stays, however often it is then looked past."""
    bounded, free = (np.zeros(1, dtype=np.float32) for _ in range(2))
    for weight, times in ((0.9, 400), (0.3, 40)):
        for _ in range(times):
            for odds, update in ((bounded, GridUpdate()), (free, GridUpdate(confidence=1.0))):
                update.add(odds, log_odds(np.array([weight])).astype(np.float32))
    assert probability(free.astype(float))[0] == 1.0
    assert probability(bounded.astype(float))[0] == pytest.approx(0.02, abs=1e-6)


def test_every_grid_stays_within_its_confidence() -> None:
    placed = place()
    local, classic = OccupancyGrid(confidence=0.95), ClassicGrid(confidence=0.95)
    for _ in range(12):
        local.fuse(*reported(placed, wall_scan()))
        classic.fuse(wall_scan())
    for known in (local.samples(placed), classic.samples()):
        assert known.occupancy.min() == pytest.approx(0.05, abs=1e-6)
        assert known.occupancy.max() == pytest.approx(0.95, abs=1e-6)


@pytest.mark.parametrize("resolution_m", [0.0, -1.0, math.nan])
def test_bad_resolutions_are_refused(resolution_m: float) -> None:
    for grid in (OccupancyGrid, ClassicGrid):
        with pytest.raises(ValueError, match="the resolution is"):
            grid(resolution_m)
    with pytest.raises(ValueError, match="the confidence is"):
        OccupancyGrid(confidence=0.4)


def test_cells_cover_their_region_and_nothing_else() -> None:
    triangle = np.array([(1.0, 2.0), (9.0, 3.0), (2.0, 7.0)])
    grid = RegionGrid.over(triangle, 0.3)
    edge = np.linalg.norm(triangle[1:] - triangle[0], axis=1)
    assert (edge / grid.cells <= 0.3).all()
    local = np.random.default_rng(0).dirichlet((1, 1, 1), 200_000)[:, :2]
    cell = grid.cell(local)
    assert cell.min() >= 0
    assert len(np.unique(cell)) == len(grid.odds)
    apart = np.abs(local - grid.weight[1:].T[cell]) * grid.cells
    assert apart.max() <= 0.5 + 1e-5
    corners = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.5), (0.6, 0.6), (-0.1, 0.2)])
    assert (grid.cell(corners) >= 0).all()


def test_almost_empty_regions_coarsen_and_keep_their_surfaces() -> None:
    """N 4.1.3: more than 99 % of the cells below 0.2."""
    placed = place()
    grid = OccupancyGrid(0.2)
    everywhere = np.arange(len(placed.triangle))
    empty = Scan.of_ranges(HERE, np.array([3.0]), np.array([1.0]), SENSOR)
    grid.fuse(*reported(placed, empty)[:3], everywhere)
    for number, cells in grid.grids.items():
        cells.odds[:] = log_odds(0.05)
        surface = {0: 0, 1: 2, 2: 10}.get(number, 0)
        cells.odds[:surface] = log_odds(0.95)
    fine = {number: len(cells.odds) for number, cells in grid.grids.items()}
    assert 2 / fine[1] < 0.01 < 10 / fine[2]
    before = grid.samples(placed)
    grid.coarsening = Coarsening(0.5, every=1)
    grid.fuse(*reported(placed, empty)[:3], everywhere)
    after = grid.samples(placed)
    for number, cells in grid.grids.items():
        assert (len(cells.odds) == fine[number]) == (number == 2)
    was, now = before.point[before.occupancy > 0.8], after.point[after.occupancy > 0.8]
    apart = np.linalg.norm(was[:, None] - now, axis=-1)
    assert apart.min(axis=1).max() < 0.36  # half a coarse cell's diagonal
    assert (grid.occupancy(was, placed) > 0.9).all()
    plain = {n: c.odds.copy() for n, c in grid.grids.items()}
    averaged = plain[1].mean()  # what averaging cells would leave of a surface
    assert averaged < log_odds(0.2)


def test_the_classic_grid_agrees_where_poses_are_right() -> None:
    placed = place()
    local, classic, rng = OccupancyGrid(0.2), ClassicGrid(0.2), np.random.default_rng(0)
    for _ in range(6):
        scan = wall_scan(rng=rng)
        local.fuse(*reported(placed, scan))
        classic.fuse(scan)
    for known, other in ((local.samples(placed), classic), (classic.samples(), local)):
        free, wall = known.occupancy < 0.1, known.occupancy > 0.8
        asked = (
            in_cells(other, known.point)
            if isinstance(other, ClassicGrid)
            else other.occupancy(known.point, placed)
        )
        assert np.nanmean(asked[free] < 0.2) > 0.95
        assert np.nanmean(asked[wall] > 0.5) > 0.85
    assert np.isnan(in_cells(classic, np.array([(-500.0, 3.0), (np.nan, 0.0)]))).all()
    assert (classic.samples().region == -1).all()


def test_the_classic_grid_grows_west_and_south_of_the_origin() -> None:
    classic = ClassicGrid(0.2)
    pose = np.array([-100.0, -50.0, 0.3])
    scan = wall_scan(pose, wall_m=-90.0)
    for _ in range(3):
        classic.fuse(scan)
    assert (in_cells(classic, scan.point) > 0.8).mean() > 0.9
    known = classic.samples()
    assert np.array_equal(in_cells(classic, known.point), known.occupancy)
    classic.fuse(Scan.of_ranges(pose, np.zeros(1), np.full(1, np.nan), SENSOR))
    assert np.array_equal(classic.samples().point, known.point)


def test_corrected_poses_double_a_wall_in_the_classic_grid_alone() -> None:
    """N Fig. 4.5, the shadow effect: landmarks and pose are corrected by 1.5 m after a while."""
    landmark, regions = field()
    rng = np.random.default_rng(1)
    error = np.array([1.5, 0.0])
    local, classic = OccupancyGrid(0.2), ClassicGrid(0.2)
    for wrong in (error, np.zeros(2)):
        placed = regions.placed(landmark + wrong)
        for _ in range(3):
            scan = wall_scan(HERE + (*wrong, 0.0), rng, WALL_M + wrong[0])
            local.fuse(*reported(placed, scan))
            classic.fuse(scan)
    there = np.column_stack((np.full(20, WALL_M), np.linspace(3.0, 8.0, 20)))
    assert np.nanmean(local.occupancy(there, placed)) > 0.8
    assert np.nanmean(in_cells(classic, there + error)) > 0.8
    ghost = local.occupancy(there + error, placed)
    assert (np.isnan(ghost) | (ghost < 0.5)).all()


@pytest.mark.parametrize("grazing_rad", [0.0, math.radians(5.0)])
def test_a_scan_changes_no_cell_that_it_does_not_reach(grazing_rad: float) -> None:
    """Discs everywhere, one around the scanner too: what is left out would not have changed."""
    rng, update = np.random.default_rng(3), GridUpdate(0.2)
    sensor = replace(SENSOR, grazing_rad=grazing_rad)
    left_out = broken = 0
    for count in (1, 7, 90, 361):
        bearing, distance = rng.uniform(-np.pi, np.pi, count), rng.uniform(0.3, 12.0, count)
        scan = Scan.of_ranges(HERE, bearing, distance, sensor)
        middle = rng.uniform(-14.0, 14.0, (3000, 2))
        radius = rng.uniform(0.05, 2.0, 3000)
        middle[:20] *= 0.05
        turn, away = rng.uniform(-np.pi, np.pi, 3000), np.sqrt(rng.uniform(0.0, 1.0, (50, 3000)))
        cell = middle + (away * radius)[..., None] * np.stack((np.cos(turn), np.sin(turn)), axis=-1)
        ahead, left = middle.T.astype(np.float32)
        change = update.change(scan, *cell.reshape(-1, 2).T.astype(np.float32)).reshape(50, -1)
        changed = (change != 0.0).any(axis=0)
        reached = update.reached(scan, ahead, left, radius.astype(np.float32))
        assert not (changed & ~reached).any()
        left_out += int(np.count_nonzero(~reached))
        points = update.reached(scan, ahead, left, np.zeros(3000, dtype=np.float32))
        broken += int(np.count_nonzero(changed & ~points))  # by the discs' middles alone
    assert left_out > 1000
    assert broken > 100
    empty = Scan.of_ranges(HERE, np.zeros(0), np.zeros(0), SENSOR)
    assert not update.reached(empty, ahead, left, 1.0).any()


def test_blocks_hold_each_cell_once_and_lie_around_their_middles() -> None:
    triangle = np.array([(1.0, 2.0), (19.0, 3.0), (2.0, 17.0)])
    grid = RegionGrid.over(triangle, 0.3)
    assert np.array_equal(np.sort(np.concatenate(grid.block)), np.arange(len(grid.odds)))
    apart = [
        np.abs((grid.weight[1:, cells].T - middle) * grid.cells).max()
        for cells, middle in zip(grid.block, grid.middle, strict=True)
    ]
    assert max(apart) <= 7.5 + 1e-3
