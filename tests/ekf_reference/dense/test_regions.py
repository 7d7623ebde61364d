from dataclasses import replace
from functools import cache
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ekf_reference.core.geometry import Array
from ekf_reference.dense.conditions import Conditions, overlap
from ekf_reference.dense.region_store import RegionRows, RegionStore
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.triangles import contains, solve
from tests.ekf_reference.dense.scenes import flipped
from tests.ekf_reference.dense.test_conditions import shared
from tests.ekf_reference.worlds import circuit, follow

ANY_SIZE = Conditions(longest_edge_m=1e3)


def scattered(rng: np.random.Generator, count: int, side_m: float = 100.0) -> Array:
    """Landmarks with some distance from each other."""
    points = np.empty((0, 2))
    while len(points) < count:
        new = rng.uniform(0, side_m, 2)
        if (np.linalg.norm(points - new, axis=1) > 0.4 * side_m / np.sqrt(count)).all():
            points = np.vstack((points, new))
    return points


def grown(landmark: Array, reach_m: float = 30.0) -> LocalRegions:
    """Regions as they come up when landmarks arrive one by one, seen from the newest."""
    regions = LocalRegions()
    for count in range(3, len(landmark) + 1):
        near = np.linalg.norm(landmark[:count] - landmark[count - 1], axis=1) < reach_m
        landmark_index = np.flatnonzero(near)
        regions.extend(landmark[:count], landmark_index, shared(3.0, 0.3, len(landmark_index)))
    return regions


def brute_force(triangle: Array, point: Array) -> Array:
    """(N, R) whether a point is in a region."""
    return np.stack([contains(solve(t, point), 1e-12) for t in triangle], axis=1)


@pytest.mark.parametrize("seed", range(4))
def test_each_point_lies_in_at_most_one_region(seed: int) -> None:
    rng = np.random.default_rng(seed)
    landmark = scattered(rng, 60)
    regions = grown(landmark)
    assert len(regions.base) > 40
    point = rng.uniform(-5, 105, (20_000, 2))
    inside = brute_force(landmark[regions.base], point)
    assert inside.sum(axis=1).max() == 1
    triangle = landmark[regions.base]
    assert not np.triu(overlap(triangle[:, None], triangle), 1).any()


@pytest.mark.parametrize("moved_m", [0.0, 1.0, 15.0])
def test_location_equals_brute_force(moved_m: float) -> None:
    """Also where landmarks have moved so far that regions overlap or turn over."""
    rng = np.random.default_rng(5)
    landmark = scattered(rng, 80)
    regions = grown(landmark)
    landmark = landmark + moved_m * rng.standard_normal(landmark.shape)
    triangle = landmark[regions.base]
    corners = landmark[rng.integers(len(landmark), size=500)]
    edge = regions.base[rng.integers(len(regions.base), size=500)]
    share = rng.uniform(0, 1, (500, 1))
    on_edges = share * landmark[edge[:, 0]] + (1 - share) * landmark[edge[:, 1]]
    point = np.vstack((rng.uniform(-20, 120, (10_000, 2)), corners, on_edges))
    inside = brute_force(triangle, point)
    expected = np.where(inside.any(axis=1), inside.argmax(axis=1), -1)
    located = regions.placed(landmark).locate(point)
    assert np.array_equal(located.region, expected)
    assert (located.region[-500:] >= 0).all()
    assert np.array_equal(np.isnan(located.local[:, 0]), expected < 0)
    found = expected >= 0
    assert np.array_equal(located.local[found], solve(triangle[expected[found]], point[found]))
    assert (len(flipped(regions, landmark)) > 0) == (moved_m > 5)


def test_points_on_the_outer_edge_belong_to_the_region() -> None:
    """Edges along the axes, where rounding takes points out of the region's box."""
    landmark = np.array([(100.7, 1.3), (107.9, 1.3), (100.7, 9.1)])
    regions = LocalRegions()
    regions.extend(landmark, np.arange(3), shared(3.0, 0.1))
    share = np.random.default_rng(0).uniform(0, 1, (5_000, 1))
    for first, second in ((0, 1), (0, 2), (1, 2)):
        point = share * landmark[first] + (1.0 - share) * landmark[second]
        assert (regions.placed(landmark).locate(point).region == 0).all()


def test_growing_never_changes_what_there_is() -> None:
    """What an incremental Delaunay triangulation would do: see the module's docstring."""
    landmark = scattered(np.random.default_rng(6), 50)
    regions, before = LocalRegions(), np.empty((0, 3), dtype=np.intp)
    for count in range(3, len(landmark) + 1):
        landmark_index = np.flatnonzero(
            np.linalg.norm(landmark[:count] - landmark[count - 1], axis=1) < 40
        )
        new = regions.extend(
            landmark[:count], landmark_index, shared(3.0, 0.3, len(landmark_index))
        )
        assert np.array_equal(regions.base[: len(before)], before)
        assert np.array_equal(new, np.arange(len(before), len(regions.base)))
        before = regions.base.copy()
    again = regions.extend(landmark, landmark_index, shared(3.0, 0.3, len(landmark_index)))
    assert len(again) == 0  # all that fits is there


def test_no_gap_is_left_that_a_permitted_triple_fills() -> None:
    landmark = scattered(np.random.default_rng(7), 20, 50.0)
    conditions = Conditions(least_angle_rad=0.05, longest_edge_m=1e3)
    regions = LocalRegions(conditions=conditions)
    regions.extend(landmark, np.arange(20), shared(3.0, 1e-3, 20))
    inside = np.random.default_rng(8).dirichlet(np.ones(20), 5_000) @ landmark
    assert np.mean(regions.placed(landmark).locate(inside).region >= 0) > 0.999


def test_points_that_are_no_numbers_are_outside() -> None:
    landmark = scattered(np.random.default_rng(9), 10, 30.0)
    regions = grown(landmark)
    point = np.array([(np.nan, 5.0), (np.inf, 5.0), (-np.inf, np.inf), landmark.mean(axis=0)])
    assert (regions.placed(landmark).locate(point).region[:3] == -1).all()
    assert (regions.placed(landmark).locate(np.empty((0, 2))).region).shape == (0,)


THREE = np.array([(0.0, 0.0), (10.0, 0.0), (3.0, 8.0)])


def added(conditions: Conditions, landmark: Array, covariance: Array) -> int:
    return len(
        LocalRegions(conditions=conditions).extend(landmark, np.arange(len(landmark)), covariance)
    )


def test_first_condition_refuses_landmarks_that_hang_together_too_little() -> None:
    """Small deviations, so that the second condition has no say."""
    loose, tight = shared(0.3, 0.2), shared(0.3, 0.01)
    assert added(Conditions(), THREE, tight) == 1
    assert added(Conditions(), THREE, loose) == 0
    assert added(Conditions(least_correlation=-1.0), THREE, loose) == 1  # the check left out
    one_loose = tight.copy()
    one_loose[4:] *= 0.5
    one_loose[:, 4:] *= 0.5
    one_loose[4:, 4:] += 0.3 * np.eye(2)
    assert added(Conditions(), THREE, one_loose) == 0  # two out of three are not enough


def test_a_region_keeps_by_which_form_of_the_first_condition_it_was_made() -> None:
    """All pairs by correlation, or one by its relative sigma alone; later covariances are late."""
    landmark = np.vstack((THREE, THREE + (40.0, 0.0), THREE + (80.0, 0.0)))
    covariance = np.zeros((18, 18))
    covariance[:6, :6] = covariance[12:, 12:] = shared(0.3, 0.01)
    covariance[6:12, 6:12] = loose = shared(0.02, 0.1)
    covariance[14:16, 14:16] += 0.1 * np.eye(2)  # one of three correlates too little
    regions = LocalRegions(conditions=Conditions(known_apart_m=0.5))
    landmark_index = np.array((3, 0, 1, 2, 5, 4, 8, 7, 6))
    columns = (2 * landmark_index[:, None] + np.arange(2)).ravel()
    regions.extend(landmark, landmark_index, covariance[columns[:, None], columns])
    first = (regions.base.min(axis=1) // 3).tolist()
    assert dict(zip(first, regions.by_correlation.tolist(), strict=True)) == {
        0: True,
        1: False,
        2: False,
    }
    assert Conditions().highly_correlated(shared(0.3, 0.01)).all()
    assert not Conditions(known_apart_m=0.5).highly_correlated(loose)[0, 1]
    regions.extend(landmark, np.arange(9), np.eye(18))
    assert len(regions.base) == len(regions.by_correlation) == 3
    literal = LocalRegions()
    literal.extend(landmark, landmark_index, covariance[columns[:, None], columns])
    assert literal.by_correlation.tolist() == [True]


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_every_edge_is_bounded(order: tuple[int, ...]) -> None:
    """Two edges of 20 m and one of 30 m, whichever landmark comes first."""
    wide = np.array([(0.0, 0.0), (20.0, 0.0), (-2.5, 19.8)])[list(order)]
    assert added(Conditions(), wide, shared(3.0, 0.1)) == 0
    assert added(Conditions(longest_edge_m=31.0), wide, shared(3.0, 0.1)) == 1


def test_second_condition_refuses_regions_that_could_flip_over() -> None:
    """Correlated landmarks, so that the first condition has no say."""
    flat = np.array([(0.0, 0.0), (10.0, 0.0), (5.0, 4.0)])
    covariance = shared(10.0, 1.2)
    assert added(Conditions(), flat * (2.0, 1.0), covariance) == 0
    assert added(Conditions(), flat * (2.0, 4.0), covariance) == 1
    lax = replace(Conditions(), flip_sigmas=0.0)
    assert added(lax, flat * (2.0, 1.0), covariance) == 1  # the check left out
    # Known to the millimetre a sliver cannot flip, but its axes are too close.
    sliver, certain = flat * (1.0, 0.2), shared(0.1, 1e-4)
    assert added(Conditions(), sliver, certain) == 0
    assert added(replace(Conditions(), least_angle_rad=0.0), sliver, certain) == 1


def test_third_condition_refuses_overlap(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four corners and the middle: six regions overlap, four do not."""
    landmark = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0), (4.0, 5.5)])
    covariance = shared(3.0, 0.1, 5)
    assert added(ANY_SIZE, landmark, covariance) == 4

    def apart(first: Array, second: Array) -> Array:
        return np.zeros(np.broadcast_shapes(first.shape, second.shape)[:-2], dtype=bool)

    for module in ("regions", "regions_at_map"):
        monkeypatch.setattr(f"ekf_reference.dense.{module}.overlap", apart)
    assert added(ANY_SIZE, landmark, covariance) > 4  # the check left out


def test_an_existing_region_keeps_its_ground() -> None:
    """A landmark that arrives inside a region is no corner; around it regions go on."""
    landmark = np.vstack((THREE, [(4.0, 3.0), (12.0, 9.0)]))
    regions = LocalRegions()
    regions.extend(landmark, np.arange(3), shared(3.0, 0.1, 3))
    regions.extend(landmark, np.arange(5), shared(3.0, 0.1, 5))
    assert sorted(map(tuple, np.sort(regions.base))) == [(0, 1, 2), (1, 2, 4)]


@pytest.mark.parametrize(
    "landmark",
    [
        [],
        [(1.0, 1.0)],
        [(1.0, 1.0), (5.0, 1.0)],
        [(1.0, 1.0), (5.0, 1.0), (9.0, 1.0)],
        [(1.0, 1.0), (1.0, 1.0), (9.0, 5.0)],
        [(1.0, 1.0), (1.0, 1.0), (1.0, 1.0)],
    ],
)
def test_landmarks_that_span_nothing_make_no_region(landmark: list[tuple[float, float]]) -> None:
    points = np.array(landmark, dtype=float).reshape(-1, 2)
    for least_angle in (0.0, 0.2):
        conditions = Conditions(least_angle_rad=least_angle, flip_sigmas=0.0)
        assert added(conditions, points, shared(3.0, 0.1, len(points))) == 0
    regions = LocalRegions()
    assert (regions.placed(points).locate(np.zeros((4, 2))).region == -1).all()


def test_regions_are_placed_anew_when_anything_moves_or_is_added() -> None:
    rng = np.random.default_rng(6)
    landmark = scattered(rng, 30)
    regions = grown(landmark)
    before = regions.placed(landmark)
    assert regions.placed(landmark.copy()) is before
    landmark[regions.base[0, 0]] += 1.0  # in place
    moved = regions.placed(landmark)
    assert np.array_equal(moved.triangle, landmark[regions.base])
    assert not np.array_equal(before.triangle, moved.triangle)
    apart = np.vstack((landmark, 500.0 + np.array([(0.0, 0.0), (10.0, 0.0), (0.0, 10.0)])))
    assert len(regions.placed(apart).triangle) == len(before.triangle)
    assert len(regions.extend(apart, np.arange(30, 33), shared(3.0, 0.3, 3)))
    assert np.array_equal(regions.placed(apart).triangle, apart[regions.base])


@pytest.mark.parametrize("seed", range(3))
def test_leaving_out_pairs_across_regions_changes_no_region(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    landmark = scattered(np.random.default_rng(seed), 50)
    landmark_index, pose = np.arange(50), np.array([50.0, 50.0, 0.0])
    covariance = np.pad(shared(3.0, 0.3, 50), ((3, 0), (3, 0)))
    covariance[:3, :3] = np.diag((0.09, 0.09, 1e-4))

    def all_there_is() -> tuple[NDArray[Any], ...]:
        regions = grown(landmark[:40])
        late = regions.potential(landmark, landmark_index, pose, covariance)
        made = regions.extend(landmark, landmark_index, covariance[3:, 3:])
        return regions.base, made, late.axis, late.placed.triangle

    short = all_there_is()
    monkeypatch.setattr(LocalRegions, "_open", lambda *a: np.triu(a[-1]))
    for with_fewer, with_all in zip(short, all_there_is(), strict=True):
        assert np.array_equal(with_fewer, with_all)


def filled(rng: np.random.Generator, batches: int = 20) -> tuple[RegionStore, dict[int, Array]]:
    """A store, and what it must hold."""
    store = RegionStore(2)
    expected: dict[int, Array] = {}
    for _ in range(batches):
        region = rng.choice(np.array([0, 3, 4, 9]), size=rng.integers(0, 30))
        value = rng.standard_normal((len(region), 2))
        store.append(region, value)
        for number in np.unique(region).tolist():
            before = expected.get(number, np.empty((0, 2)))
            expected[number] = np.vstack((before, value[region == number]))
    return store, expected


def test_rows_come_back_by_region_in_the_order_they_came() -> None:
    store, expected = filled(np.random.default_rng(0))
    assert np.unique(store.gather().region).tolist() == sorted(expected)
    assert len(store) == sum(len(rows) for rows in expected.values())
    asked = np.array([9, 5, 0])
    rows = store.gather(asked)
    assert np.array_equal(rows.value, np.vstack((expected[9], expected[0])))
    assert rows.region.tolist() == [9] * len(expected[9]) + [0] * len(expected[0])
    assert store.gather(np.array([7])).value.shape == (0, 2)


def test_written_back_rows_replace_theirs_alone() -> None:
    store, expected = filled(np.random.default_rng(1))
    rows = store.gather(np.array([4, 0]))
    rows.value[:] *= 2.0
    assert np.array_equal(store.gather(np.array([4])).value, expected[4])  # a copy until put
    store.put(rows)
    for number, factor in ((0, 2.0), (3, 1.0), (4, 2.0), (9, 1.0)):
        assert np.array_equal(store.gather(np.array([number])).value, factor * expected[number])
    store.put(RegionRows(np.empty(0, dtype=np.intp), np.empty((0, 2))))


def test_dropped_rows_leave_the_others_in_order() -> None:
    """Also with regions out of order, and all rows of a region dropped."""
    rng = np.random.default_rng(2)
    store, expected = filled(rng)
    rows = store.gather(np.array([9, 0, 4]))
    kept = rng.random(len(rows.region)) < 0.5
    kept[rows.region == 0] = False
    store.keep(rows, kept)
    for number in (9, 4):
        left = expected[number][kept[rows.region == number]]
        assert np.array_equal(store.gather(np.array([number])).value, left)
    assert len(store.gather(np.array([0])).value) == 0
    assert np.array_equal(store.gather(np.array([3])).value, expected[3])
    store.append(np.array([0]), np.ones((1, 2)))
    assert np.array_equal(store.gather(np.array([0])).value, np.ones((1, 2)))


@cache
def driven(conditions: Conditions) -> tuple[LocalRegions, list[int], Array]:
    """Regions, their number after every scan, and the filter's last landmarks (L, 2)."""
    regions, count = LocalRegions(conditions=conditions), []
    for _, ekf in follow(circuit(0, range_m=25.0)):
        near = ekf.state.local_map(30.0)
        regions.extend(ekf.state.landmarks, near.landmark_index, near.covariance[3:, 3:])
        count.append(len(regions.base))
    return regions, count, ekf.state.landmarks.copy()


def test_regions_survive_the_closing_of_the_loop() -> None:
    regions, count, landmark = driven(Conditions())
    assert len(regions.base) > 30
    assert not len(flipped(regions, landmark))
    triangle = landmark[regions.base]
    assert not np.triu(overlap(triangle[:, None], triangle), 1).any()
    assert (np.diff(count) >= 0).all()


def test_near_a_known_start_correlation_is_low_and_regions_would_not_deform() -> None:
    """Taken literally, the first condition leaves the beginning of a drive without regions."""
    _, literal, _ = driven(Conditions())
    _, known, _ = driven(Conditions(known_apart_m=0.3))
    eleven_seconds = 55
    assert literal[eleven_seconds] == 0
    assert known[eleven_seconds] > 5
    assert known[-1] > literal[-1]
