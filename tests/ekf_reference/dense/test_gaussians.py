import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ekf_reference.core.geometry import Array
from ekf_reference.dense.layers.gaussians import (
    Gaussians,
    in_local_axes,
    in_world_axes,
    largest_sigma,
)
from ekf_reference.dense.layers.layer import Hits
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.triangles import local_jacobians
from tests.ekf_reference.dense.scenes import field, mapped, place, reported, simulation, wall_scan
from tests.ekf_reference.numerics import random_covariance

NOWHERE = np.empty(0, dtype=np.intp)
START = np.array([(7.0, 3.0)])


def hits(placed: RegionsAtMap, point: Array, sigma: tuple[float, float]) -> Hits:
    """Returns with standard deviations [m] in east and north."""
    found = placed.locate(point)
    covariance = np.tile(np.diag(np.square(sigma)), (len(point), 1, 1))
    return Hits(region=found.region, local=found.local, point=point, covariance=covariance)


def fused(shift_m: float, prior: tuple[float, float], seen: tuple[float, float]) -> Gaussians:
    """One Gaussian and then one return so far east of it."""
    placed, layer = place(), Gaussians()
    layer.fuse(hits(placed, START, prior), placed, None, NOWHERE)
    layer.fuse(hits(placed, START + (shift_m, 0.0), seen), placed, None, NOWHERE)
    return layer


def test_close_and_narrow_ones_fuse_and_widen() -> None:
    """N 4.17 to 4.19: 0.07 + 0.09 = k d_min = 0.16."""
    layer = fused(0.1, (0.07, 0.03), (0.05, 0.08999))
    found = layer.ellipses(place())
    assert np.allclose(found.mean, START + (0.05, 0.0))
    assert np.allclose(
        found.covariance[0], np.diag((0.07**2 + 0.05**2, 0.03**2 + 0.08999**2)), atol=1e-9
    )


def test_wide_ones_fuse_and_keep_their_width() -> None:
    """N 4.20. The largest sigma decides, whichever its direction."""
    found = fused(0.1, (0.07, 0.03), (0.05, 0.09001)).ellipses(place())
    assert np.allclose(found.mean, START + (0.05, 0.0))
    assert np.allclose(found.covariance[0], np.diag((0.07**2, 0.03**2)), atol=1e-9)


def test_variances_in_place_of_sigmas_would_always_add() -> None:
    """As printed, 4.18 compares "the Gaussian variance" with k d_min, a length."""
    prior, seen = 0.3, 0.25
    assert prior**2 + seen**2 <= 0.8 * 0.2
    found = fused(0.1, (prior, 0.1), (seen, 0.1)).ellipses(place())
    assert np.allclose(found.covariance[0], np.diag((prior**2, 0.01)))
    growing = fused(0.1, (0.05, 0.05), (0.05, 0.05)).ellipses(place())
    assert not np.allclose(growing.covariance[0], 0.05**2 * np.eye(2))


def test_far_ones_are_added() -> None:
    assert len(fused(0.199, (0.1, 0.1), (0.1, 0.1))) == 1
    both = fused(0.201, (0.1, 0.1), (0.1, 0.1)).ellipses(place())
    assert np.allclose(both.mean, np.vstack((START, START + (0.201, 0.0))))
    assert np.allclose(both.covariance, 0.01 * np.eye(2))


def test_an_old_one_takes_the_nearest_of_many() -> None:
    placed, layer = place(), Gaussians()
    layer.fuse(hits(placed, START, (0.1, 0.1)), placed, None, NOWHERE)
    seen = START + np.array([(0.15, 0.0), (-0.05, 0.0), (0.0, 0.12)])
    layer.fuse(hits(placed, seen, (0.1, 0.1)), placed, None, NOWHERE)
    assert np.allclose(layer.samples(placed).point, START - (0.025, 0.0))


def test_local_covariances_are_those_of_the_jacobians() -> None:
    placed, rng = place(), np.random.default_rng(0)
    region = rng.integers(len(placed.triangle), size=20)
    world = np.stack([random_covariance(rng, 2) for _ in region])
    jacobian = local_jacobians(placed.triangle[region], rng.uniform(0, 9, (20, 2))).by_point
    expected = jacobian @ world @ np.swapaxes(jacobian, 1, 2)
    local = in_local_axes(placed, region, world)
    assert np.allclose(local, expected[:, (0, 0, 1), (0, 1, 1)])
    assert not np.allclose(local, world[:, (0, 0, 1), (0, 1, 1)], rtol=0.1)  # world axes kept
    assert np.allclose(in_world_axes(placed, region, local), world)
    largest = np.sqrt(np.linalg.eigvalsh(world)[:, 1])
    assert np.allclose(largest_sigma(world), largest)


def test_ellipses_turn_and_shear_with_the_landmarks() -> None:
    landmark, regions = field()
    placed, layer, rng = regions.placed(landmark), Gaussians(), np.random.default_rng(0)
    for _ in range(4):
        layer.fuse(*reported(placed, wall_scan(rng=rng)))
    before = layer.ellipses(placed)
    matrix = np.array([(0.6, -0.9), (0.8, 0.5)])
    after = layer.ellipses(regions.placed(landmark @ matrix.T + (3.0, 0.0)))
    assert np.allclose(after.mean, before.mean @ matrix.T + (3.0, 0.0))
    assert np.allclose(after.covariance, matrix @ before.covariance @ matrix.T)
    assert (np.linalg.eigvalsh(after.covariance) > 0.0).all()


def test_occupancy_by_hand() -> None:
    placed, layer = place(), Gaussians()
    two = START + np.array([(0.0, 0.0), (0.4, 0.0)])
    layer.fuse(hits(placed, two, (0.1, 0.2)), placed, None, NOWHERE)
    between, single = math.exp(-0.5 * 4.0), math.exp(-0.5 * 1.0)
    far = math.exp(-0.5 * 16.0)
    asked = START + np.array([(0.0, 0.0), (0.2, 0.0), (0.0, 0.2), (0.0, 2.0)])
    found = layer.occupancy(asked, placed)
    assert found[0] == pytest.approx(1.0)
    assert found[1] == pytest.approx(1.0 - (1.0 - between) ** 2)
    assert found[2] == pytest.approx(1.0 - (1.0 - single) * (1.0 - single * far))
    assert np.isnan(found[3])
    assert np.array_equal(layer.samples(placed).occupancy, np.ones(2))


def test_numbers_and_widths_level_off_in_a_scene_that_stays() -> None:
    placed, layer, rng = place(), Gaussians(), np.random.default_rng(0)
    size = []
    for _ in range(300):
        layer.fuse(*reported(placed, wall_scan(rng=rng)))
        size.append(len(layer))
    assert max(size[200:]) < 1.15 * max(size[:100])
    growing = Gaussians(thinned=False)
    for _ in range(150):
        growing.fuse(*reported(placed, wall_scan(rng=rng)))
    assert len(growing) > 1.5 * max(size)
    assert largest_sigma(layer.ellipses(placed).covariance).max() < 0.2


def test_fewer_than_the_returns_of_the_simulation() -> None:
    placed, scans = simulation()
    returns = sum(len(scan.range_m) for scan in scans)
    assert len(mapped("gaussians").samples(placed).point) < 0.15 * returns


def test_covers_the_surfaces_that_the_occupancy_grids_do() -> None:
    """Nothing takes a Gaussian of a stray return away, so the second share is smaller."""
    placed, _ = simulation()
    cells, gaussians = (mapped(name).samples(placed) for name in ("occupancy", "gaussians"))
    wall = cells.point[cells.occupancy > 0.8]
    two_cells = 0.4
    assert (cKDTree(gaussians.point).query(wall)[0] < two_cells).mean() > 0.98
    assert (cKDTree(wall).query(gaussians.point)[0] < two_cells).mean() > 0.93
    shifted = gaussians.point + 1.0
    assert (cKDTree(shifted).query(wall)[0] < two_cells).mean() < 0.7


@pytest.mark.parametrize(("d_min_m", "widest"), [(0.0, 0.8), (0.2, 0.0), (math.nan, 0.8)])
def test_bad_settings_are_refused(d_min_m: float, widest: float) -> None:
    with pytest.raises(ValueError, match="must be above zero"):
        Gaussians(d_min_m, widest)
