"""The layer of what is measured of surfaces (Nieto 2005, section 6.4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.dense.dense_map import DenseMap
from ekf_reference.dense.layers.layer import Hits
from ekf_reference.dense.layers.values import Values
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan
from tests.ekf_reference.dense.scenes import field
from tests.ekf_reference.dense.test_dense_map import PATIENCE, TRUSTING, drive, room, view, wall
from tests.ekf_reference.numerics import relative_error

NOWHERE = np.empty(0, dtype=np.intp)


def hits(placed: RegionsAtMap, point: Array, value: Array) -> Hits:
    found = placed.locate(point)
    covariance = np.tile(1e-4 * np.eye(2), (len(point), 1, 1))
    return Hits(
        region=found.region, local=found.local, point=point, covariance=covariance, value=value
    )


@pytest.mark.parametrize("centre", [(7.0, 3.0), (10.0, 5.0)], ids=["inside", "at a corner"])
def test_mean_and_scatter_are_those_of_all_returns_around(centre: tuple[float, float]) -> None:
    landmark, regions = field()
    placed, rng, made = regions.placed(landmark), np.random.default_rng(3), Values()
    points, values = [], []
    for _ in range(20):
        point = np.array(centre) + rng.uniform(-0.1, 0.1, (9, 2))
        value = rng.normal(5.0, 2.0, 9)
        value[0] = np.nan
        made.fuse(hits(placed, point, value), placed, None, NOWHERE)
        points.append(point[1:])
        values.append(value[1:])
    every = np.concatenate(values)
    there = made.around(np.array((centre, (0.5, 9.0), (np.nan, 1.0))), placed, 0.3)
    assert there.returns.tolist() == [160, 0, 0]
    assert relative_error(there.mean[:1], every.mean(keepdims=True)) < 1e-12
    assert relative_error(there.variance[:1], every.var(keepdims=True)) < 1e-12
    assert np.isnan(there.mean[1:]).all()
    assert np.isnan(there.variance[1:]).all()
    assert len(made) < 20  # however many scans


def test_neighbours_keep_apart_and_the_map_takes_them_along() -> None:
    landmark, regions = field()
    placed, made, rng = regions.placed(landmark), Values(), np.random.default_rng(0)
    poles = np.array(((7.0, 3.0), (7.0, 3.6)))
    for _ in range(5):
        point = np.repeat(poles, 4, axis=0) + rng.uniform(-0.08, 0.08, (8, 2))
        made.fuse(hits(placed, point, np.repeat((1.0, 3.0), 4)), placed, None, NOWHERE)
    shift = np.array((40.0, -7.0))
    moved = regions.placed(landmark + shift)
    assert made.around(poles, placed, 0.3).mean.tolist() == [1.0, 3.0]
    assert np.isclose(made.around(poles + shift, moved, 0.3).mean, [1.0, 3.0], rtol=1e-12).all()
    assert np.isnan(made.around(poles, moved, 0.3).mean).all()


@pytest.mark.parametrize("reported", [True, False])
def test_returns_that_wait_keep_their_values(reported: bool) -> None:
    """A return's value follows it by its number; by its row it would get another's."""
    dense = DenseMap(
        layers={"values": Values()}, regions=LocalRegions(conditions=TRUSTING), waiting=room()
    )

    def scan() -> Scan:
        seen = wall()
        return replace(seen, value=seen.bearing_rad.copy()) if reported else seen

    line = view(np.column_stack((np.full(4, 6.0), (-9.0, -3.0, 3.0, 9.0))))
    drive(dense, line, *[scan()] * (PATIENCE + 6))
    assert dense.tally.late > 20
    layer = dense.layers["values"]
    assert isinstance(layer, Values)
    if not reported:
        assert not len(layer)
        return
    placed, seen = dense.place(line), scan()
    there = layer.around(seen.point, placed, 0.05)
    assert seen.value is not None
    known = there.returns > 0
    assert known.mean() > 0.3
    assert np.abs(there.mean - seen.value)[known].max() < 0.05


def test_a_distance_must_be_above_zero() -> None:
    with pytest.raises(ValueError, match="above zero"):
        Values(0.0)
