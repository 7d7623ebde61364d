import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.dense.layers.association import Associated, associate, doubled
from ekf_reference.dense.layers.points import AllReturns
from tests.ekf_reference.dense.scenes import field


def brute_force(old: Array, new: Array, d_min_m: float) -> Associated:
    apart = np.linalg.norm(old[:, None] - new, axis=-1)
    row = np.flatnonzero(apart.min(axis=1, initial=np.inf) < d_min_m)
    nearest = apart[row].argmin(axis=1) if len(new) else row
    return Associated(row, nearest, apart[row, nearest], apart.min(0, initial=np.inf) < d_min_m)


@pytest.mark.parametrize("size_m", [1.0, 10.0, 3000.0])
@pytest.mark.parametrize("counts", [(400, 300), (0, 5), (5, 0), (0, 0), (1, 1)])
def test_equals_brute_force(size_m: float, counts: tuple[int, int]) -> None:
    """Also over more than the hash's 102 m, and on a raster, where distances tie."""
    rng = np.random.default_rng(0)
    for raster in (1e-9, 0.1):
        old, new = (
            np.round(rng.uniform(-size_m, size_m, (n, 2)) / raster) * raster for n in counts
        )
        if min(counts) > 10:
            old[:50] = new[:50] + rng.uniform(-0.2, 0.2, (50, 2))
        found, expected = associate(old, new, 0.2), brute_force(old, new, 0.2)
        assert np.array_equal(found.old, expected.old)
        assert np.array_equal(found.met, expected.met)
        assert np.allclose(found.apart_m, expected.apart_m)
        chosen = np.linalg.norm(old[found.old] - new[found.new], axis=1)
        assert np.allclose(chosen, expected.apart_m)


def test_one_new_point_serves_many_old_ones_and_ties_go_to_the_first() -> None:
    """N Fig. 4.9."""
    old = np.array([(0.0, 0.0), (0.1, 0.0), (5.0, 5.0), (-0.05, 0.05)])
    found = associate(old, np.array([(0.05, 0.0), (0.05, 0.0), (9.0, 9.0)]), 0.2)
    assert found.old.tolist() == [0, 1, 3]
    assert found.new.tolist() == [0, 0, 0]
    assert found.met.tolist() == [True, True, False]


def test_distance_must_be_below_d_min() -> None:
    old, new = np.zeros((1, 2)), np.array([(0.25, 0.0)])
    assert not len(associate(old, new, 0.25).old)
    assert len(associate(old, new, 0.2500001).old)


def test_of_doubles_the_one_of_most_worth_stays() -> None:
    pair = Associated(
        np.array([2, 5, 6, 8, 9]),
        np.array([0, 0, 0, 1, 0]),
        np.array([0.01, 0.015, 0.005, 0.001, 0.1]),
        np.ones(2, dtype=bool),
    )
    worth = np.array([1.0, 3.0, 2.0, 0.0, 0.5])
    assert sorted(doubled(pair, 0.2, worth).tolist()) == [2, 6]
    assert not len(doubled(pair, 0.02, worth))


def test_flat_and_lost_regions_are_left_out() -> None:
    landmark, regions = field()
    landmark[regions.base[3, 0]] = np.nan
    landmark[regions.base[20]] = landmark[regions.base[20, 0]]
    layer, number = AllReturns(), np.arange(len(regions.base))
    layer._store.append(number, np.full((len(number), 2), 0.3))
    left = layer._placed(regions.placed(landmark), number)[0].region
    assert 3 not in left
    assert 20 not in left
    assert len(left) > 10
