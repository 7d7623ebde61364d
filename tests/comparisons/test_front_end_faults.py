"""Logs at the edge of what the scan front end and the run on scans can serve."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import hold_out_blocks
from comparisons.adapters.motion import motion_between
from comparisons.adapters.scan_odometry import ScanMotion, run_scan_odometry
from comparisons.checks.map_agreement import compare_maps
from comparisons.checks.verdict import judge
from comparisons.config import FrontEndConfig, Gps, OdometryConfig
from comparisons.errors import InputError
from comparisons.extensions.scan_motion.extension import ScanMotionFinding
from comparisons.extensions.scan_motion.increments import check_increments
from comparisons.extensions.scan_motion.job import run_front_end
from comparisons.extensions.scan_motion.report import FrontEndReport
from comparisons.jobs.run import Modified
from comparisons.logs.bundled import open_log
from comparisons.logs.hashing import log_hash
from comparisons.logs.log import Landmarks, Log, Positions, Truth
from comparisons.logs.odometry import RelativePoses
from comparisons.pipeline.solve import solve
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.state import FilterDivergedError
from tests.comparisons.test_front_end import three_of
from tests.helpers import compared, first_seconds, present, without_labels
from tests.scenarios import scenario

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_END_S = 25.0


@cache
def short() -> Log:
    """The beginning of the simulated loop with scans."""
    log = scenario("scan-loop-fine", seconds=_END_S)
    return with_scans(log, present(log.scans).time_s <= _END_S - 1.0)


def with_scans(log: Log, rows: Mask | slice) -> Log:
    """Some of the scans only."""
    s = present(log.scans)
    scans = replace(s, time_s=s.time_s[rows], range_m=s.range_m[rows], intensity=s.intensity[rows])
    return replace(log, scans=scans)


def without_odometry(log: Log) -> Log:
    """Scans are all that tells of motion."""
    nothing = RelativePoses(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    return replace(log, odometry=nothing)


def with_positions(log: Log, first_s: float = 0.0) -> Log:
    """A position every 0.4 s, at none of the scans' instants, 0.1 m of noise each."""
    poses = present(log.truth.poses)
    time_s = np.arange(first_s + 0.013, _END_S, 0.4)
    place = np.column_stack([np.interp(time_s, poses.time_s, poses.pose[:, i]) for i in (0, 1)])
    noise = np.random.default_rng(3).normal(0.0, 0.1, place.shape)
    covariance = np.tile(0.01 * np.eye(2), (len(time_s), 1, 1))
    return replace(log, positions=Positions(time_s, place + noise, covariance))


def with_surveyed(log: Log) -> Log:
    """Every third landmark is surveyed, and seen 13 ms after the others; some are never seen."""
    table, seen = log.truth.landmarks, log.measurements
    assert table is not None
    ids = table.id[::3]
    own = np.isin(seen.landmark, ids)
    assert not np.isin(ids, seen.landmark).all()
    known = seen.chosen(own)
    return replace(
        log,
        measurements=seen.chosen(~own),
        known_measurements=replace(known, time_s=known.time_s + 0.013),
        known_landmarks=Landmarks(
            ids, table.position_m[::3], np.tile(1e-4 * np.eye(2), (len(ids), 1, 1))
        ),
    )


def with_gps(gps: Gps) -> OdometryConfig:
    return OdometryConfig(front_end=FrontEndConfig(gps=gps))


def test_surveyed_landmarks_keep_their_places_on_scans() -> None:
    """Those that nobody saw, too, or the others would be held to their places."""
    three = three_of(compared(with_surveyed(short()), motion="both"))
    assert three.ekf.agrees
    assert present(present(three.accuracy).ate_m) < 0.1


def test_positions_held_back_are_held_back_from_the_smoother_on_scans_too() -> None:
    log = with_positions(short())
    half = compared(log, gps="half", motion="both")
    times = three_of(half).estimate.time_s
    blocks = hold_out_blocks(present(log.positions).time_s)
    fused = present(log.positions).time_s[blocks % 2 == 0][half.ekf.fix_number]
    held_out = present(log.positions).time_s[blocks % 2 == 1]
    assert np.isin(fused[fused <= times[-1]], times).all()
    assert not np.isin(held_out, times).any()


def test_smoother_on_scans_meets_a_filter_that_broke_down() -> None:
    def damage(ekf: Ekf) -> None:
        update, count = ekf.observe, iter(range(10**6))

        def observe(*arguments: Any) -> Any:
            if next(count) == 20:
                raise FilterDivergedError("made to fail")
            return update(*arguments)

        ekf.observe = observe  # type: ignore[assignment]

    c = compared(short(), Modified(damage), motion="both")
    assert c.ekf.breakdown is not None
    assert three_of(c).estimate.time_s[-1] > c.ekf.estimate.time_s[-1]


def test_measurements_of_surveyed_landmarks_between_scans_count() -> None:
    """Their instants are no scan's and no other measurement's."""
    log = with_surveyed(short())
    nothing = np.zeros(len(log.measurements.time_s), dtype=bool)
    for given in (log, replace(log, measurements=log.measurements.chosen(nothing))):
        c = compared(given, motion="scan")
        within = present(log.known_measurements).time_s <= c.ekf.timeline.epoch_time_s[-1]
        instants = np.unique(present(log.known_measurements).time_s[within])
        assert np.isin(instants, c.ekf.timeline.epoch_time_s).all()
        assert present(present(c.accuracy.smoother).ate_m) < 0.1


@pytest.mark.slow
def test_scans_too_sure_of_themselves_are_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    """The maps may agree all the same, and a kernel over closures hides nothing."""

    def boasting(*arguments: Any, **options: Any) -> ScanMotion:
        motion = run_scan_odometry(*arguments, **options)
        wrong = np.random.default_rng(0).normal(0.0, (0.1, 0.1, 0.02), motion.displacement.shape)
        return replace(motion, displacement=motion.displacement + wrong)

    monkeypatch.setattr("comparisons.extensions.scan_motion.extension.run_scan_odometry", boasting)
    c = compared(open_log("scan-loop-fine"), motion="both")
    assert three_of(c).too_high
    assert any(remark.startswith("on scans, chi-square") for remark in c.verdict.remarks)


def test_an_unproven_smoother_on_scans_has_no_say() -> None:
    c = compared(short(), motion="both")
    three, motion = three_of(c), c.find(ScanMotionFinding).motion
    apart = replace(three, ekf=replace(three.ekf, outside=three.ekf.landmarks, agrees=False))
    lost = replace(apart, verified=False)
    found = [ScanMotionFinding(c.known, motion, third) for third in (apart, lost)]
    said = [judge(replace(c.known, findings={"scan motion": one})) for one in found]
    assert [v.outcome for v in said] == ["disagree", "agree"]
    assert any("not verified" in remark for remark in found[1].remarks)


def test_a_landmark_without_numbers_lies_outside() -> None:
    one = compared(short(), motion="both").smoothed
    lost = replace(one, landmark=np.where(np.arange(len(one.landmark))[:, None] < 3, np.nan,
                                          one.landmark))  # fmt: skip
    pair = compare_maps(lost, one)
    assert pair.outside == 3
    assert not pair.agrees


def test_chi_square_is_tested_where_no_loop_was_closed() -> None:
    front_end = run_front_end(short())
    assert not len(front_end.closed.loop_closures.first)
    problem = front_end.graph.problem
    test = front_end.graph.optimality.chi_square
    assert test.dof == problem.residual_dimension - problem.state_dimension > 0
    assert test.reading == "plausible"


def test_scans_before_the_prior_are_left_out_without_odometry_as_with_it() -> None:
    log = without_odometry(short())
    begin_s = 1.0
    later = log.measurements.chosen(log.measurements.time_s > begin_s)
    front_end = run_front_end(
        replace(log, prior=replace(log.prior, time_s=begin_s), measurements=later)
    )
    assert front_end.motion.time_s[0] >= begin_s
    assert front_end.motion.source.row[0] == np.searchsorted(present(log.scans).time_s, begin_s)


def test_no_scans_at_all_are_told_of() -> None:
    with pytest.raises(InputError, match="holds no scans"):
        run_front_end(with_scans(short(), slice(0)))
    with pytest.raises(InputError, match="no odometry, expected"):
        without_odometry(with_scans(short(), slice(0)))


@pytest.mark.slow
def test_positions_held_back_stay_so_where_scans_begin_late() -> None:
    """An odd number of positions, or an even one, comes before the first scan."""
    late = without_odometry(with_scans(short(), slice(2, None)))
    for first_s in (0.0, 0.4):
        front_end = run_front_end(with_positions(late, first_s), with_gps("half"))
        fused = front_end.time_s[front_end.graph.problem.position_pose]
        held = present(front_end.known.prepared.judged.positions)
        assert not np.isin(held.time_s, fused).any()
        assert 0.4 < len(fused) / (len(held.time_s) + len(fused)) < 0.6


@pytest.mark.slow
def test_positions_between_relative_poses_can_be_fused_with_scans() -> None:
    """The wheels' path is then drawn as if the vehicle had moved evenly in between."""
    log = with_positions(short())
    times = np.union1d(present(log.scans).time_s, log.measurements.time_s)
    times = times[times > log.prior.time_s]
    moved = motion_between(log, times)
    spread = moved.covariance + 1e-10 * np.eye(3)
    relative = replace(log, odometry=RelativePoses(times, moved.displacement, spread))
    choices = with_gps("on")
    paths = [run_front_end(given, choices).wheels for given in (log, relative)]
    assert np.abs(present(paths[0]) - present(paths[1])).max() < 0.1


def test_surveyed_landmarks_hold_the_scan_graph_where_others_have_no_names() -> None:
    log = with_surveyed(short())
    front_end = run_front_end(without_labels(log))
    assert len(front_end.estimate.landmark) == len(present(log.known_landmarks).id)
    assert len(front_end.graph.problem.z)
    assert present(present(front_end.accuracy["scan graph"]).ate_m) < 0.1


def test_scan_odometry_needs_no_measurement_within_the_time_of_the_scans() -> None:
    log = without_odometry(with_scans(short(), slice(0, 40)))
    late = log.measurements.chosen(log.measurements.time_s > present(log.scans).time_s[-1])
    later = replace(log, measurements=late)
    for given in (later, without_labels(later)):
        front_end = run_front_end(given)
        assert not len(front_end.estimate.landmark)
        assert len(front_end.time_s) == len(front_end.motion.row)


def test_logs_that_differ_in_their_scans_have_different_hashes() -> None:
    log = short()
    scans = present(log.scans)
    other = replace(log, scans=replace(scans, range_m=scans.range_m + 0.01))
    assert len({log_hash(log), log_hash(other), log_hash(replace(log, scans=None))}) == 3


def test_the_smoother_alone_says_that_it_wants_odometry() -> None:
    with pytest.raises(InputError, match="holds no odometry"):
        solve(without_odometry(short()))


def test_a_vehicle_that_stands_still_tells_nothing_of_increments() -> None:
    log = with_positions(short())
    motion = replace(run_scan_odometry(log), wheels=None)
    check = present(check_increments(motion, replace(log, truth=Truth())))
    assert 0.3 < check.nees < 3.0
    still = replace(motion, displacement=np.zeros_like(motion.displacement))
    assert check_increments(still, replace(log, truth=Truth())) is None


def test_increments_of_the_wheels_are_not_judged_as_those_of_scans() -> None:
    log = with_positions(short())
    motion = run_scan_odometry(log)
    row = len(motion.time_s) // 2
    bridged, moved = motion.bridged.copy(), motion.displacement.copy()
    bridged[row], moved[row, 1] = True, 5.0
    check = check_increments(
        replace(motion, bridged=bridged, displacement=moved), replace(log, truth=Truth())
    )
    assert present(check).nees < 3.0


def test_a_stream_of_no_positions_cannot_be_fused() -> None:
    nothing = Positions(np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    with pytest.raises(InputError, match="holds no positions"):
        run_front_end(replace(short(), positions=nothing), with_gps("on"))


def test_scans_between_relative_poses_are_named_by_their_time() -> None:
    """Rows are counted among the scans that the odometry covers, which nobody knows."""
    log = short()
    seen_s = present(log.scans).time_s
    poses = RelativePoses(seen_s[[10, 12, 14]], np.ones((3, 3)), np.tile(np.eye(3), (3, 1, 1)))
    with pytest.raises(InputError, match=f"scans: time {seen_s[0]} s is no pose's"):
        run_front_end(replace(log, odometry=poses))


def test_what_was_left_out_is_told() -> None:
    log = with_scans(short(), slice(10, 50))
    front_end = run_front_end(replace(log, odometry=first_seconds(log, 15.0).odometry))
    remarks = FrontEndReport.build(front_end).remarks
    last_s = front_end.motion.time_s[-1]
    scans = np.count_nonzero(present(log.scans).time_s > last_s)
    seen = np.count_nonzero(log.measurements.time_s > last_s)
    assert f"{scans} scans lie outside" in remarks[0]
    assert f"{seen} measurements lie outside" in remarks[1]


@pytest.mark.slow
def test_a_run_on_scans_tells_of_failed_scans_gaps_and_measurements_left_out() -> None:
    log = with_scans(short(), slice(0, 60))
    assert log.scans is not None
    last_s = log.scans.time_s[-1]
    blind = log.scans.range_m.copy()
    blind[20:30] = np.nan
    log = replace(log, scans=replace(log.scans, range_m=blind))
    for motion, count in (("scan", 3), ("both", 2)):
        reported = compared(log, motion=motion).verdict.remarks[-count:]
        assert reported[0].startswith("10 scans gave no increment; the first, row 20")
        assert reported[1] == "1 gaps are bridged by the wheels' motion"
    reported = compared(log, motion="scan").verdict.remarks
    seen = np.count_nonzero(log.measurements.time_s > last_s)
    assert reported[-1].startswith(f"{seen} measurements lie outside")
