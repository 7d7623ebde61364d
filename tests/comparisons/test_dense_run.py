"""A dense map beside the filter: it is fed all scans, and the filter does not feel it."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.planar_scans import PlanarScans
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig, Filter, MapConfig
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.source import DenseRun, DenseWatcher, build_map
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import LandmarkMeasurements, Log
from comparisons.logs.scans import Clouds
from ekf_reference.dense.conditions import ellipse_margin, flip_margin
from ekf_reference.dense.virtual_landmarks import VirtualLandmarks
from tests.helpers import Array, present


@pytest.mark.parametrize(
    ("source", "virtual"), [("scan-loop", False), ("occupancy-loop", False), ("other", True)]
)
def test_as_published_the_regions_are_the_thesis_own(source: str, virtual: bool) -> None:
    """Section 3.5 as printed; 3.9 and 4.1.3 had no virtual corners, 3.10 had."""
    config = MapConfig.of(
        preset="nieto-2005",
        log={"source": source},
        extensions={"dense_maps": {"layers": ["points"]}},
    )
    options = config.extensions["dense_maps"]
    assert isinstance(options, DenseMapsConfig)
    made = build_map(options)
    rule = made.regions.conditions
    assert (rule.known_apart_m, rule.least_correlation) == (0.0, 0.9)
    assert rule.longest_edge_m == np.inf
    assert rule.margin is ellipse_margin
    assert not made.delayed
    assert made.virtual == virtual == (made.waiting is not None)
    assert build_map(DenseMapsConfig()).regions.conditions.margin is flip_margin


def test_regions_between_scan_landmarks_say_their_own_bound() -> None:
    """Three times the bound between points."""
    usual = DenseMapsConfig()
    assert "relative sigma <= 1.5 m" in usual.settled(points=False).first_condition
    assert "relative sigma <= 0.5 m" in usual.settled().first_condition == usual.first_condition
    assert usual.settled(points=False).bounds == (1.5, 60.0, 50.0, 64, 20_000)


def test_settings_that_are_given_hold_between_scan_landmarks_too() -> None:
    """Also where they are smaller than the usual ones between scan landmarks."""
    given = (0.2, 20.0, 30.0, 3, 100)
    names = ("known_apart_m", "longest_edge_m", "reach_m", "patience", "capacity")
    options = DenseMapsConfig.of(**dict(zip(names, given, strict=True)))
    assert options.settled(points=False).bounds == options.bounds == given
    literal = DenseMapsConfig(known_apart_m=0.0, longest_edge_m=np.inf).settled(points=False)
    assert literal.first_condition == "pairs with correlation >= 0.9 (Nieto 2005, 3.5)"
    assert literal.bounds.longest_edge_m == np.inf


@pytest.fixture(scope="module")
def log() -> Log:
    return open_log("occupancy-loop", choices=SimulationChoices(seed=4))


def driven(log: Log, filter_name: str = "full", *, dense: bool = True) -> tuple[EkfRun, DenseRun]:
    watcher = DenseWatcher(log, DenseMapsConfig(layers=("points", "occupancy")))
    config = settle(EkfConfig.model_validate({"filter": filter_name}), log)
    setup = FilterSetup(observers=[watcher] if dense else [])
    run = run_ekf(log, build_timeline(log), config, setup=setup)
    return run, watcher.run()


def bits(run: EkfRun) -> list[Array]:
    e = run.estimate
    return [run.departed, run.arrived, e.pose_covariance, e.landmark, e.joint_covariance]


@pytest.mark.slow
@pytest.mark.parametrize("name", get_args(Filter))
def test_the_filter_is_the_same_to_the_bit(log: Log, name: str) -> None:
    """Information flows one way (Nieto 2005, section 3.7)."""
    with_map, dense = driven(log, name)
    without, nothing = driven(log, name, dense=False)
    assert len(dense.dense.regions.base) > 20
    assert not len(nothing.dense.regions.base)
    for ours, theirs in zip(bits(with_map), bits(without), strict=True):
        assert np.array_equal(ours, theirs)


@pytest.mark.slow
def test_a_watcher_that_writes_would_be_noticed(log: Log) -> None:
    """What the test above rejects: a view that brings a compressed filter up to date."""

    class Meddler(DenseWatcher):
        def on_update(self, ekf) -> None:  # type: ignore[no-untyped-def]
            ekf.state.covariance.sum()
            super().on_update(ekf)

    config = settle(EkfConfig(filter="compressed-suboptimal"), log)
    meddler = Meddler(log, DenseMapsConfig(layers=("points", "occupancy")))
    run = run_ekf(log, build_timeline(log), config, setup=FilterSetup(observers=[meddler]))
    without, _ = driven(log, "compressed-suboptimal", dense=False)
    assert not all(np.array_equal(a, b) for a, b in zip(bits(run), bits(without), strict=True))


@pytest.mark.slow
def test_every_return_is_accounted_for(log: Log) -> None:
    _, run = driven(log)
    dense = run.dense
    tally, room = dense.tally, dense.waiting
    assert room is not None
    assert tally.scans == len(run.scan_time_s) == len(present(log.scans).time_s)
    assert tally.returns == np.isfinite(present(log.scans).range_m).sum()
    waiting, counts = len(room.points.scan), room.counts
    assert tally.late == counts.released
    assert (
        tally.fused + tally.late + tally.outside + waiting + counts.dropped + counts.vanished
        == tally.returns
    )
    held = len(dense.layers["points"].samples(dense.regions.placed(run.landmark)).point)
    assert held == tally.fused + tally.late
    assert tally.fused + tally.late > 0.5 * tally.returns


@pytest.mark.slow
def test_scans_at_any_time_are_seen_from_where_the_vehicle_then_is(log: Log) -> None:
    """The same scans with clocks of their own, between odometry samples and epochs."""
    assert log.truth.poses is not None
    shifted = replace(present(log.scans), time_s=present(log.scans).time_s + 0.0131)
    later = replace(log, scans=shifted)
    run, dense = driven(later)
    at_epochs, plain = driven(log)
    kept = slice(0, len(dense.scan_time_s))
    moved = np.linalg.norm(dense.scan_pose[:, :2] - plain.scan_pose[kept, :2], axis=1)
    speed = 3.0 * 0.0131
    assert np.median(moved) == pytest.approx(speed, rel=0.2)
    assert moved.max() < 2.0 * speed
    for ours, theirs in zip(bits(run), bits(at_epochs), strict=True):
        assert np.array_equal(ours, theirs)


def collinear(log: Log, landmarks: int = 6) -> Log:
    """The same drive past landmarks in a row, none hidden, in place of its own."""
    time = np.unique(log.measurements.time_s)
    pose = present(log.truth.poses).at(time)
    east, north, heading = pose[0]
    ahead, left = np.array((np.cos(heading), np.sin(heading))), (-np.sin(heading), np.cos(heading))
    along = 5.0 + 7.0 * np.arange(landmarks)[:, None]
    landmark = (east, north) + 6.0 * np.array(left) + along * ahead
    apart = landmark - pose[:, None, :2]
    range_m, bearing = np.hypot(*apart.T).T, np.arctan2(apart[..., 1], apart[..., 0])
    bearing = np.mod(bearing - pose[:, 2:] + np.pi, 2.0 * np.pi) - np.pi
    row, number = np.nonzero((range_m < 25.0) & (np.abs(bearing) < np.pi / 2))
    count = len(row)
    seen = LandmarkMeasurements(
        time_s=time[row],
        range_m=range_m[row, number],
        bearing_rad=bearing[row, number],
        sigma_range_m=np.full(count, 0.1),
        sigma_bearing_rad=np.full(count, 0.02),
        landmark=number,
        diameter_m=np.full(count, np.nan),
    )
    return replace(log, measurements=seen, truth=replace(log.truth, landmarks=None))


@pytest.mark.slow
def test_landmarks_in_a_row_have_regions_with_virtual_corners_alone(log: Log) -> None:
    """A shift of the map is that of its landmarks, of which there may be fewer than virtual ones.

    The virtual ones are told from the end of the map, where a real one stands too.
    """
    _, run = driven(collinear(log))
    base = run.dense.regions.base
    assert ((base < 0).sum(axis=1) == 1).all()
    assert len(base) > 0
    watcher = DenseWatcher(log, DenseMapsConfig(layers=("points", "occupancy")))
    virtual = VirtualLandmarks(np.repeat([[0, 1]], 5, axis=0), np.arange(1.0, 6.0))
    watcher._dense.regions.virtual = virtual
    watcher._dense.regions.base = np.array([(0, 1, -1 - k) for k in range(5)])
    watcher._dense.regions._order = np.arange(5)
    old = np.array([(0.0, 0.0), (4.0, 0.0), (9.0, 9.0)])
    watcher._note_shift(old, old + [(0.3, 0.4), (0.3, 0.4), (50.0, 0.0)])
    before = present(watcher.run().before)
    assert before.shift_m == pytest.approx(0.5)


def test_planar_scans_keep_mount_and_returns() -> None:
    """A scanner that looks left from half a metre ahead."""
    log = open_log("occupancy-loop")
    assert log.scans is not None
    mount = replace(log.scans.mount, forward_m=0.5, heading_rad=np.pi / 2)
    ranges = np.full_like(log.scans.range_m, np.nan)
    ahead = int(np.argmin(np.abs(log.scans.angle_rad)))
    ranges[:, ahead] = 2.0
    changed = replace(log.scans, mount=mount, range_m=ranges)
    scan = PlanarScans(replace(log, scans=changed)).scan(0, np.array((10.0, 20.0, 0.0)))
    assert np.allclose(scan.point, [(10.5, 22.0)], atol=1e-9)
    assert np.allclose(scan.origin, (10.5, 20.0))


def test_two_beams_tell_no_noise_and_get_the_least() -> None:
    log = open_log("occupancy-loop")
    assert log.scans is not None
    few = {name: getattr(log.scans, name)[:, :2] for name in ("range_m", "intensity")}
    changed = replace(log.scans, angle_rad=log.scans.angle_rad[:2], **few)
    sensor = PlanarScans(replace(log, scans=changed)).sensor
    assert sensor.sigma_range_m == 0.02


@pytest.mark.slow
def test_clouds_are_seen_as_scans() -> None:
    """Of a simulated 3D log, near the surfaces that truth has."""
    log = open_log("scan-loop-3d")
    scans = PlanarScans(log)
    pose = present(log.truth.poses).at(scans.time_s[5:6])[0]
    scan = scans.scan(5, pose)
    assert 30 < len(scan.range_m) <= 720
    from comparisons.extensions.dense_maps.accuracy import distance_to_segments

    off = distance_to_segments(scan.point, present(log.truth.surfaces).segment)
    assert np.median(off) < 0.05


def test_a_cloud_of_next_to_nothing_is_a_scan_too() -> None:
    """Scan odometry refuses it; a map takes what there is."""
    log = open_log("scan-loop-3d")
    point = np.array([(4.0, 3.0, 1.0)])
    clouds = Clouds(present(log.clouds).time_s[:2], np.array((0, 1, 1)), point, np.zeros(1))
    scans = PlanarScans(replace(log, clouds=clouds))
    pose = np.zeros(3)
    assert np.allclose(scans.scan(0, pose).point, [(4.0, 3.0)])
    assert not len(scans.scan(1, pose).point)


def test_a_log_without_scans_is_refused() -> None:
    log = open_log("simulated-loop")
    with pytest.raises(InputError, match="holds no scans"):
        DenseWatcher(log, DenseMapsConfig(layers=("points", "occupancy")))


@pytest.mark.slow
def test_blank_scans_leave_an_empty_map(log: Log) -> None:
    scans = present(log.scans)
    blank = replace(scans, range_m=np.full_like(scans.range_m, np.nan))
    _, run = driven(replace(log, scans=blank))
    assert run.dense.tally.returns == 0
    assert len(run.dense.regions.base) > 10
    placed = run.dense.regions.placed(run.landmark)
    assert all(not len(layer.samples(placed).point) for layer in run.dense.layers.values())
