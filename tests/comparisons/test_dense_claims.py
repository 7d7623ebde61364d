"""Nieto 2005, Figs. 3.17, 4.3 and 4.5: closing a loop corrects a dense map, and no other grid."""

import numpy as np
import pytest

from comparisons.config import MapConfig
from comparisons.extensions.dense_maps.accuracy import surface_error
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.job import DenseMapping, map_log
from comparisons.logs.bundled import SimulationChoices, open_log

SEEDS = (1, 2, 5)


@pytest.fixture(scope="module")
def maps() -> list[DenseMapping]:
    """Drives of one loop through section 3.9's environment.

    Beams are exact: what errs are the landmarks.
    """
    config = MapConfig(extensions={"dense_maps": DenseMapsConfig(layers=("occupancy",))})
    logs = [open_log("scan-loop-fine", choices=SimulationChoices(seed=seed)) for seed in SEEDS]
    return [map_log(log, config) for log in logs]


@pytest.mark.slow
def test_closing_the_loop_brings_the_map_to_where_the_objects_are(maps: list[DenseMapping]) -> None:
    """With no call to any layer: what moves are the landmarks. Half of the map was right before."""
    closings = [m for m in maps if m.dense.before is not None and m.dense.before.shift_m > 0.3]
    assert closings
    for m in closings:
        before, surfaces = m.dense.before, m.log.truth.surfaces
        assert before is not None
        assert surfaces is not None
        assert before.time_s > 60.0
        then = surface_error(before.layers["occupancy"], surfaces.segment)
        now = m.errors["occupancy"]
        assert now.p95_m < 0.7 * then.p95_m


@pytest.mark.slow
def test_one_grid_keeps_its_double_walls(maps: list[DenseMapping]) -> None:
    """The worst twentieth of its occupied cells is twice as far off as the dense map's."""
    dense = np.array([m.errors["occupancy"].p95_m for m in maps])
    classic = np.array([m.errors["classic"].p95_m for m in maps])
    assert (dense < 0.6 * classic).all()
    assert dense.mean() < 0.35 * classic.mean()
    median = [m.errors["occupancy"].median_m for m in maps]
    assert max(median) < 0.35
    assert np.mean(median) < 0.6 * np.mean([m.errors["classic"].median_m for m in maps])


@pytest.mark.slow
def test_returns_that_waited_are_a_good_part_of_the_map(maps: list[DenseMapping]) -> None:
    for m in maps:
        tally = m.dense.dense.tally
        assert tally.late > 0.2 * tally.returns
        assert tally.fused + tally.late > 0.6 * tally.returns
