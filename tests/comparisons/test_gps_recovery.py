"""Positions beyond the gate: what is said of them, and how a filter that is locked out recovers."""

from dataclasses import replace

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.position_gate import RejectedFixes, rejected_fixes, streaks
from comparisons.config import EkfConfig, RunConfig
from comparisons.jobs.run import compare
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import SteeringOdometry
from comparisons.report.run import RunReport
from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array as EkfArray
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.position import PositionFixes, Streak
from tests.comparisons.test_positions import with_fixes
from tests.helpers import Array, present, simulated

SLIP_S, SLIP_M = 20.0, 10.0


def blind_after(log: Log, time_s: float) -> Log:
    """A log without measurements from some time on."""
    return replace(log, measurements=log.measurements.chosen(log.measurements.time_s < time_s))


def slipped() -> Log:
    """Wheels that spin once, with nothing but positions afterwards."""
    log = blind_after(with_fixes(simulated(seed=3, loop_s=60.0), (0.0, 0.0)), SLIP_S)
    odometry = log.odometry
    assert isinstance(odometry, SteeringOdometry)
    speed, at = odometry.speed_mps.copy(), int(np.searchsorted(odometry.time_s, SLIP_S + 0.5))
    speed[at] += SLIP_M / float(np.median(np.diff(odometry.time_s)))
    return replace(log, odometry=replace(odometry, speed_mps=speed))


def scattered() -> Log:
    """Twenty positions in a row that are wild, each in its own way."""
    log = blind_after(with_fixes(simulated(seed=3, loop_s=60.0), (0.0, 0.0)), SLIP_S)
    given = present(log.positions)
    position, wild = given.position_m.copy(), np.flatnonzero(given.time_s > SLIP_S)[:20]
    angle = 2.4 * np.arange(20)
    position[wild] += 30.0 * np.column_stack((np.cos(angle), np.sin(angle)))
    return replace(
        log, positions=Positions(given.time_s, position, given.covariance, given.antenna_m)
    )


def run(log: Log, recovery: int | None, name: str = "full") -> EkfRun:
    choices = settle(EkfConfig.of(filter=name, gps="on", gps_recovery=recovery), log)
    return run_ekf(log, build_timeline(log, log.positions), choices, log.positions)


def error_m(log: Log, found: EkfRun) -> Array:
    """Distances (K,) from the truth."""
    estimate = found.estimate
    apart = estimate.pose[:, :2] - present(log.truth.poses).at(estimate.time_s)[:, :2]
    distance: Array = np.linalg.norm(apart, axis=1)
    return distance


@pytest.mark.slow
@pytest.mark.parametrize("name", ["full", "compressed", "misono-full"])
def test_a_filter_that_is_locked_out_recovers_with_the_option_only(name: str) -> None:
    log = slipped()
    locked, freed = run(log, None, name), run(log, 5, name)
    late = locked.estimate.time_s > SLIP_S + 20.0
    late &= locked.estimate.time_s < SLIP_S + 35.0
    assert np.all(error_m(log, locked)[late] > 5.0)
    assert np.all(error_m(log, freed)[late] < 1.5)
    assert locked.rejected_fixes > 25
    assert freed.rejected_fixes == 5


def test_wild_positions_that_disagree_are_not_admitted() -> None:
    log = scattered()
    without, offered = run(log, None), run(log, 2)
    assert without.rejected_fixes == offered.rejected_fixes == 20
    assert np.array_equal(without.estimate.pose, offered.estimate.pose)


@pytest.mark.slow
def test_a_recovery_that_only_counts_would_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    def counted(self: Streak, innovation: EkfArray, covariance: EkfArray, gate: float) -> int:
        return self.length + 1

    monkeypatch.setattr(Streak, "length_with", counted)
    with pytest.raises(AssertionError):
        test_wild_positions_that_disagree_are_not_admitted()


def test_a_streak_needs_fixes_that_are_alike() -> None:
    noise, streak = 0.25 * np.eye(2), Streak()
    for count, off in ((1, (3.0, 0.0)), (2, (3.3, 0.4)), (3, (3.0, 0.9)), (1, (-3.0, 0.0))):
        innovation = np.array(off)
        streak = Streak(streak.length_with(innovation, noise, 13.82), innovation, noise)
        assert streak.length == count


def test_a_streak_weighs_a_fix_by_its_own_covariance_and_the_last_ones() -> None:
    """Ten metres apart: of noises of 1 m and of 5 m that is one streak, of two of 1 m it is not."""
    far, rough, exact = np.array((10.0, 0.0)), 25.0 * np.eye(2), np.eye(2)
    lengths = [
        Streak(1, np.zeros(2), before).length_with(far, now, 13.82)
        for before, now in ((rough, exact), (exact, rough), (exact, exact))
    ]
    assert lengths == [2, 2, 1]


def test_a_streak_goes_on_from_what_a_fused_fix_has_left() -> None:
    """A filter as unsure as the fixes comes half the way with the third, and takes the fourth."""
    ekf = Ekf(UnicycleModel(), KnownAssociation(), np.zeros(3), np.diag((1.0, 1.0, 1e-4)))
    ekf.fixes = PositionFixes(recovery=2)
    fused = [ekf.fix_position(np.array((12.0, 0.0)), np.eye(2)) for _ in range(4)]
    assert fused == [False, False, True, True]
    assert ekf.state.pose[0] == pytest.approx(8.0, rel=1e-9)


def found_at_truth(log: Log) -> RejectedFixes:
    """What is found where the smoother is at the truth, sure to 0.1 m."""
    filtered = run(log, None)
    estimate = filtered.estimate
    smoothed = replace(
        estimate,
        pose=present(log.truth.poses).at(estimate.time_s),
        pose_covariance=np.tile(0.01 * np.eye(3), (len(estimate.time_s), 1, 1)),
    )
    return present(rejected_fixes(filtered, smoothed))


def test_lock_out_and_bad_positions_are_told_apart() -> None:
    """By the smoother's optimum: it accepts what a filter that is locked out rejects."""
    locked, bad = found_at_truth(slipped()), found_at_truth(scattered())
    assert locked.unfit_count == 0
    assert locked.in_streaks == locked.longest == len(locked.number) > 25
    assert "at the smoother's optimum" in locked.remarks[0]
    assert bad.unfit_count == len(bad.number) == bad.longest == 20


def test_streaks_are_counted() -> None:
    number = np.array((0, 3, 4, 5, 9, 10))
    assert streaks(number).tolist() == [1, 3, 3, 3, 2, 2]
    assert streaks(number[:0]).tolist() == []
    found = RejectedFixes(20, number, streaks(number), np.zeros(6, dtype=bool))
    assert (found.longest, found.in_streaks, found.remarks) == (3, 0, [])


def test_the_report_says_what_was_rejected_in_streaks() -> None:
    log = slipped()
    c = compare(log, RunConfig(ekf=EkfConfig.of(gps="on")))
    result = RunReport.build(c)
    assert result.ekf.longest_streak == result.ekf.fixes_in_streaks == result.ekf.fixes_rejected
    assert any("in series of 5 or more" in remark for remark in result.remarks)
    rows = {row.quantity: row.value for row in RunReport.of(c).summary().rows if row.group == "EKF"}
    assert rows["most GPS positions rejected in a row"] == str(result.ekf.longest_streak)


def test_the_remark_says_what_its_figures_say() -> None:
    """Broken variant: none of them fit, "so the filter should have used them"."""
    number = np.arange(6)
    for unfit, said, unsaid in (
        (6, "6 do not pass it there either", "of the rejected positions pass"),
        (0, "6 of the rejected positions pass the same gate", "do not pass"),
        (2, "4 of the rejected positions pass", ""),
    ):
        found = RejectedFixes(20, number, streaks(number), number < unfit)
        (remark,) = found.remarks
        assert said in remark
        assert not unsaid or unsaid not in remark
        assert "should have" not in remark
