"""A dense map given what it was not made for: it stays whole, and every return is accounted for.

The filter is a made-up one, a pose and landmarks with a covariance, so that each case is a few
lines. Where the landmarks hang together, regions come at once; where not, returns wait.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.dense.box_tree import BoxTree
from ekf_reference.dense.conditions import Conditions
from ekf_reference.dense.delayed_initialisation import DelayedInitialisation
from ekf_reference.dense.dense_map import DenseMap
from ekf_reference.dense.layers.layer import Hits, Layer
from ekf_reference.dense.regions import LocalRegions
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan
from ekf_reference.dense.view import FilterView
from tests.ekf_reference.dense.scenes import LAYERS, SENSOR, flipped, layer

POSE = np.array([0.0, 0.0, 0.0])
SQUARE = np.array([(2.0, -8.0), (18.0, -8.0), (18.0, 8.0), (2.0, 8.0)])
BEARING = np.linspace(-1.2, 1.2, 121)
TRUSTING = Conditions(known_apart_m=0.5)
PATIENCE = 3


def view(landmark: Array, pose: Array = POSE, apart_m: float = 0.05) -> FilterView:
    """Landmarks as uncertain as the pose, and by `apart_m` on their own."""
    landmark_index = np.flatnonzero(np.isfinite(landmark).all(axis=1))
    size = 3 + 2 * len(landmark_index)
    common = np.zeros((size, 2))
    common[:2] = np.eye(2)
    common[3::2, 0] = common[4::2, 1] = 1.0
    own = np.concatenate(((0.02**2, 0.02**2, 1e-4), np.full(2 * len(landmark_index), apart_m**2)))
    return FilterView(pose, landmark, landmark_index, 0.2**2 * common @ common.T + np.diag(own))


def wall(pose: Array = POSE, range_m: float = 12.0) -> Scan:
    """Returns all around at one range."""
    return Scan.of_ranges(pose, BEARING, np.full(len(BEARING), range_m), SENSOR)


def dense_map(*names: str, waiting: DelayedInitialisation | None = None) -> DenseMap:
    """A map of some layers, those of the contract test."""
    return DenseMap(
        layers={n: layer(n) for n in names},
        regions=LocalRegions(conditions=TRUSTING),
        waiting=waiting,
    )


def room(capacity: int = 5_000) -> DelayedInitialisation:
    return DelayedInitialisation(capacity=capacity, patience=PATIENCE)


def drive(dense: DenseMap, seen: FilterView, *scans: Scan) -> None:
    """One instant of the filter per scan."""
    for scan in scans:
        dense.predicted(seen)
        dense.updated(seen)
        dense.insert(seen, scan)


def accounted(dense: DenseMap) -> bool:
    """Whether every return offered is in one place."""
    tally, room = dense.tally, dense.waiting
    elsewhere = 0
    if room is not None:
        assert tally.late == room.counts.released
        elsewhere = len(room.points.scan) + room.counts.dropped + room.counts.vanished
    return tally.fused + tally.late + tally.outside + elsewhere == tally.returns


def held(dense: DenseMap) -> int:
    """Points in the layer that keeps them all."""
    placed = RegionsAtMap(
        np.zeros((len(dense.regions.base), 3, 2)), BoxTree(np.empty(0, dtype=np.intp), ())
    )
    return len(dense.layers["points"].samples(placed).point)


def held_by(layer: Layer, placed: RegionsAtMap) -> bytes:
    return b"".join(column.tobytes() for column in layer.samples(placed))


def content(dense: DenseMap, seen: FilterView) -> bytes:
    """All that a map knows."""
    placed, note = dense.place(seen), dense.neglected
    parts = [held_by(each, placed) for each in dense.layers.values()]
    arrays = [placed.triangle, dense.regions.base, note.mean_m, note.largest_m, note.count]
    if dense.waiting is not None:
        arrays += dense.waiting.points
    return b"".join(parts + [a.tobytes() for a in arrays]) + str(dense.tally).encode()


def test_regions_take_what_lies_in_them() -> None:
    dense = dense_map(*LAYERS, waiting=room())
    drive(dense, view(SQUARE), wall(), wall())
    assert len(dense.regions.base) >= 2
    assert dense.tally.fused > 100
    assert accounted(dense)
    assert held(dense) == dense.tally.fused + dense.tally.late


@pytest.mark.parametrize("waits", [False, True])
@pytest.mark.parametrize(
    "landmark",
    [
        np.empty((0, 2)),
        SQUARE[:1],
        np.repeat(SQUARE[:1], 3, axis=0),
        np.full((3, 2), np.nan),
        np.vstack((SQUARE[:1], np.full((2, 2), np.nan))),
    ],
    ids=["none", "one", "one place three times", "all gone", "all but one gone"],
)
def test_no_two_places_no_region(landmark: Array, waits: bool) -> None:
    dense = dense_map("points", waiting=room() if waits else None)
    drive(dense, view(landmark), *[wall()] * (2 * PATIENCE))
    assert not len(dense.regions.base)
    assert dense.tally.outside == dense.tally.returns > 0
    assert accounted(dense)


def test_waiting_and_virtual_corners_can_be_left_out_each() -> None:
    """Returns that may not wait are outside in the end; what waits still shows where corners go."""
    dense, neither, real = (
        replace(dense_map("points", waiting=room()), delayed=delayed, virtual=virtual)
        for delayed, virtual in ((True, True), (False, True), (True, False))
    )
    for each in (dense, neither, real):
        drive(each, view(SQUARE[:2]), *[wall()] * (PATIENCE + 6))
    assert accounted(dense)
    assert len(neither.regions.base) == len(dense.regions.base) > 0
    assert neither.tally.late == 0 < dense.tally.late
    assert neither.tally.fused == dense.tally.fused == held(neither) > 0
    assert neither.tally.outside == dense.tally.outside + dense.tally.late
    assert not len(real.regions.base)
    assert real.tally.fused == real.tally.late == 0


def test_collinear_landmarks_get_no_region_of_their_own() -> None:
    """Virtual corners stand behind every pair of neighbours, more of them than landmarks."""
    line = np.column_stack((np.full(4, 6.0), (-9.0, -3.0, 3.0, 9.0)))
    dense = dense_map("points", waiting=room())
    drive(dense, view(line), *[wall()] * (PATIENCE + 6))
    assert (dense.regions.base < 0).sum() == len(dense.regions.base) > 0
    assert accounted(dense)
    assert held(dense) == dense.tally.fused + dense.tally.late > 0
    without = dense_map("points")
    drive(without, view(line), wall())
    assert not len(without.regions.base)


def test_a_landmark_mapped_twice_makes_no_flat_region() -> None:
    twice = np.vstack((SQUARE, SQUARE))
    dense = dense_map(*LAYERS, waiting=room())
    drive(dense, view(twice), wall(), wall())
    placed = dense.regions.placed(twice)
    assert len(dense.regions.base) == 2
    assert not len(flipped(dense.regions, twice))
    for each in dense.layers.values():
        assert np.isfinite(each.samples(placed).point).all()
    assert accounted(dense)


def test_data_of_a_vertex_that_leaves_the_map_stay_where_it_was_last() -> None:
    dense = dense_map(*LAYERS, waiting=room())
    drive(dense, view(SQUARE), wall(), wall())
    before = [s.samples(dense.place(view(SQUARE))).point for s in dense.layers.values()]
    gone = SQUARE.copy()
    gone[1] = np.nan
    placed = dense.place(view(gone))
    assert np.isfinite(placed.triangle).all()
    after = [s.samples(placed).point for s in dense.layers.values()]
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
    fused, noted = dense.tally.fused, dense.neglected.count.copy()
    drive(dense, view(gone), wall(), wall())
    assert dense.tally.fused > fused  # the region takes in more, at its last place
    with_it = (dense.regions.base[: len(noted)] == 1).any(axis=1)
    assert (dense.neglected.count[: len(noted)] == noted)[with_it].all()  # its doubt is unknown
    assert accounted(dense)


def test_returns_vanish_when_the_two_landmarks_of_their_frame_become_one_place() -> None:
    waiting = room()
    dense = dense_map("points", waiting=waiting)
    drive(dense, view(SQUARE, apart_m=1.0), wall())
    drive(dense, view(np.repeat(SQUARE[:1], 4, axis=0), apart_m=1.0), wall())
    assert waiting.counts.vanished > 0
    assert not len(waiting.points.scan)
    assert accounted(dense)


@pytest.mark.parametrize("names", [LAYERS, ()], ids=["every layer", "no layer"])
def test_an_empty_scan_is_counted_and_changes_nothing_else(names: tuple[str, ...]) -> None:
    dense = dense_map(*names, waiting=room())
    empty = Scan.of_ranges(POSE, np.empty(0), np.empty(0), SENSOR)
    drive(dense, view(SQUARE), empty)
    placed = dense.regions.placed(SQUARE)
    assert (dense.tally.scans, dense.tally.returns) == (1, 0)
    assert all(not len(s.samples(placed).point) for s in dense.layers.values())
    assert not dense.neglected.count.any()
    assert accounted(dense)


def test_a_scan_before_the_first_landmark_and_before_any_update() -> None:
    dense = dense_map(*LAYERS, waiting=room())
    nothing = view(np.empty((0, 2)))
    dense.insert(nothing, wall())
    dense.predicted(nothing)
    dense.updated(nothing)
    dense.insert(nothing, wall())
    assert dense.tally.outside == dense.tally.returns == 2 * len(BEARING)
    drive(dense, view(SQUARE), wall())
    assert dense.tally.fused > 0
    assert accounted(dense)


def test_without_a_layer_the_regions_are_the_same() -> None:
    dense, full = dense_map(waiting=room()), dense_map(*LAYERS, waiting=room())
    for each in (dense, full):
        drive(each, view(SQUARE), wall(), wall())
    assert np.array_equal(dense.regions.base, full.regions.base)
    assert dense.tally == full.tally


@pytest.mark.parametrize("name", LAYERS)
def test_layers_do_not_feel_each_other(name: str) -> None:
    """Particles draw from a generator of their own, here the same one twice."""
    alone, among = dense_map(name, waiting=room()), dense_map(*LAYERS, waiting=room())
    for each in (alone, among):
        drive(each, view(SQUARE[:3]), *[wall()] * (PATIENCE + 6))
    assert alone.tally.late > 0
    placed = alone.place(view(SQUARE[:3]))
    assert held_by(alone.layers[name], placed) == held_by(among.layers[name], placed)


def random_drive(seed: int, dense: DenseMap) -> FilterView:
    """Landmarks that come, move, coincide and go; scans of any size; returns the last view."""
    rng = np.random.default_rng(seed)
    landmark = np.empty((0, 2))
    seen = view(landmark)
    for step in range(25):
        if rng.random() < 0.5:
            landmark = np.vstack((landmark, rng.uniform(-20, 20, (rng.integers(1, 4), 2))))
        landmark = landmark + rng.normal(0.0, 0.3, landmark.shape)
        if len(landmark) > 4 and rng.random() < 0.15:
            landmark[rng.integers(len(landmark))] = np.nan
        if len(landmark) > 4 and rng.random() < 0.1:
            landmark[0] = landmark[rng.integers(len(landmark))]
        pose = np.array((*rng.uniform(-15, 15, 2), rng.uniform(-3, 3)))
        seen = view(landmark, pose, apart_m=float(rng.choice((0.05, 0.4, 3.0))))
        ranges = rng.uniform(-1.0, 25.0, rng.integers(0, 80))
        ranges[rng.random(len(ranges)) < 0.1] = np.nan
        bearing = rng.uniform(-np.pi, np.pi, len(ranges))
        dense.predicted(seen)
        dense.updated(seen)
        for _ in range(rng.integers(0, 3)):
            dense.insert(seen, Scan.of_ranges(pose, bearing, ranges, SENSOR))
        assert accounted(dense), f"seed {seed}, step {step}"
    return seen


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_returns_add_up_whatever_happens(seed: int) -> None:
    dense = dense_map(*LAYERS, waiting=room(capacity=300))
    random_drive(seed, dense)
    assert held(dense) == dense.tally.fused + dense.tally.late


def test_two_runs_give_the_same_bytes() -> None:
    one, other = (dense_map(*LAYERS, waiting=room(300)) for _ in range(2))
    seen = [random_drive(3, each) for each in (one, other)]
    assert one.tally.late > 0
    assert content(one, seen[0]) == content(other, seen[1])


def test_lost_returns_would_be_noticed() -> None:
    """What the accounting rejects: a map that forgets what no region can take."""
    dense = dense_map("points")
    drive(dense, view(SQUARE), wall(range_m=30.0))
    dense.tally = replace(dense.tally, outside=0)
    assert not accounted(dense)


def known_occupancy(dense: DenseMap, seen: FilterView) -> dict[tuple[float, ...], float]:
    """The grid's cells by place."""
    held = dense.layers["occupancy"].samples(dense.place(seen))
    return dict(zip(map(tuple, held.point.round(6).tolist()), held.occupancy.tolist(), strict=True))


def waited(scans: int = 1, again: int = 0) -> DenseMap:
    """A map whose regions come after some scans. again: late returns are told as often more."""
    dense = dense_map("occupancy", waiting=room())
    two = np.where(np.arange(4)[:, None] < 2, np.roll(SQUARE, 1, axis=0), np.nan)
    drive(dense, view(two), *[wall()] * scans)
    assert not len(dense.regions.base)
    assert dense.waiting is not None
    assert len(dense.waiting.points.scan) > 30
    grid = dense.layers["occupancy"]
    first = grid.fuse

    def fuse(hits: Hits, *rest: Any) -> None:
        for _ in range(1 + again):
            first(hits, *rest)

    grid.fuse = fuse  # type: ignore[method-assign, assignment]
    dense.updated(view(np.roll(SQUARE, 1, axis=0)))
    assert dense.tally.late > 30
    return dense


def test_late_returns_change_cells_as_their_scan_would_have_done() -> None:
    """Free space too, and each cell once a scan; told twice, cells pass what a scan may do."""
    seen = view(np.roll(SQUARE, 1, axis=0))
    at_once = dense_map("occupancy")
    drive(at_once, seen, wall())
    there, late = known_occupancy(at_once, seen), known_occupancy(waited(), seen)
    shared = set(there) & set(late)
    assert len(shared) > 0.9 * len(late) > 100
    differing = [cell for cell in shared if abs(there[cell] - late[cell]) > 1e-6]
    assert len(differing) < 0.05 * len(shared)
    assert sum(p < 0.5 for p in late.values()) > 100  # nothing was free before
    assert max(late.values()) <= max(there.values()) + 1e-6
    twice = known_occupancy(waited(again=1), seen)
    assert max(twice.values()) > max(there.values()) + 0.01


def test_two_scans_that_waited_speak_twice() -> None:
    seen = view(np.roll(SQUARE, 1, axis=0))
    at_once = dense_map("occupancy")
    drive(at_once, seen, wall(), wall())
    there, late = known_occupancy(at_once, seen), known_occupancy(waited(2), seen)
    assert max(late.values()) == pytest.approx(max(there.values()), abs=1e-6)
