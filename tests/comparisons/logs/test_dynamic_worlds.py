"""Worlds in which something moves: where things are, and what is said of it."""

import numpy as np
import pytest

from comparisons.logs.simulate.dynamic_worlds import (
    CHANGE_S,
    LANES_M,
    Displaced,
    lanes_world,
    moved_over,
    places_world,
)
from comparisons.logs.simulate.scan_drive import dynamic_lanes, dynamic_places, simulate
from comparisons.logs.simulate.scan_worlds import Mover
from tests.comparisons.logs.test_scanners import exact
from tests.helpers import present


def test_traffic_begins_anew_where_it_came_from() -> None:
    mover = Mover(start=(0.0, 0.0), end=(4.0, 0.0), speed_mps=2.0, back=False)
    place = mover.place(np.array((0.0, 1.0, 1.75, 2.25, 4.0)))
    assert np.allclose(place[:, 0], (0.0, 2.0, 3.5, 0.5, 0.0), atol=1e-12)


def test_what_is_brought_is_nowhere_before() -> None:
    place = Displaced(None, (2.0, 8.0), 5.0).place(np.array((4.9, 5.0)))
    assert np.isnan(place[0]).all()
    assert place[1].tolist() == [2.0, 8.0]


def test_ground_is_moved_over_where_it_is_covered_at_times() -> None:
    point = np.array(((0.0, 0.0), (2.0, 0.3), (2.0, 0.6), (9.0, 0.0)))
    movers = (
        Mover(start=(0.0, 0.0), end=(4.0, 0.0), speed_mps=1.0, diameter_m=1.0),
        Displaced((9.0, 0.0), (9.0, 0.0), 0.0),
    )
    moved = moved_over(movers, point, np.arange(0.0, 8.0, 0.05))
    assert moved.tolist() == [True, True, False, False]  # the last stands there all the time


def test_the_lanes_are_driven_on_in_both_directions() -> None:
    time = np.arange(0.0, 1.0, 0.1)
    way = {north: set[float]() for north in LANES_M}
    for mover in lanes_world().movers:
        place = mover.place(time)
        step = np.diff(place[:, 0])
        way[LANES_M[0] if place[0, 1] > 0.0 else LANES_M[1]] |= {
            float(np.sign(s)) for s in step if abs(s) < 1.0
        }
    assert way == {LANES_M[0]: {1.0}, LANES_M[1]: {-1.0}}


@pytest.mark.slow
def test_a_carried_landmark_is_seen_where_its_vehicle_is() -> None:
    """And is not among the truth's, which has one place for each."""
    experiment = exact(dynamic_lanes(carried=True))
    log = simulate(np.random.default_rng(0), experiment)
    seen, world = log.measurements, experiment.world
    label = len(world.landmark)
    rows = np.flatnonzero(seen.landmark == label)
    assert len(rows) > 50
    assert label not in present(log.truth.landmarks).id
    pose = present(log.truth.poses).at(seen.time_s[rows])
    angle = pose[:, 2] + seen.bearing_rad[rows]
    place = pose[:, :2] + seen.range_m[rows, None] * np.column_stack((np.cos(angle), np.sin(angle)))
    assert np.allclose(place, world.movers[world.carrier[0]].place(seen.time_s[rows]), atol=1e-9)
    without = simulate(np.random.default_rng(0), exact(dynamic_lanes()))
    assert without.measurements.landmark.max() == label - 1


def test_three_places_change_between_two_passes() -> None:
    """One object is taken away, two are brought; the scans show it, the standing things stay."""
    before, after = (
        {tuple(p) for m in places_world().movers for p in m.place(np.array((t,))) if p[0] == p[0]}
        for t in (CHANGE_S - 1.0, CHANGE_S + 1.0)
    )
    assert (len(before - after), len(after - before)) == (1, 2)
    experiment = dynamic_places()
    log = simulate(np.random.default_rng(0), experiment)
    assert log.duration_s == pytest.approx(2.0 * experiment.world.loop_m / 3.0, abs=0.1)
    assert experiment.world.loop_m / 3.0 < CHANGE_S
