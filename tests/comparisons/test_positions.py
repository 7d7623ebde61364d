"""Absolute positions through both estimators and both frozen smoothers."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import (
    LEAST_BLOCK_S,
    fused_positions,
    held_out_positions,
    hold_out_blocks,
    settle,
)
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.qualifiers import CONTRADICTED
from comparisons.checks.unused_positions import (
    UnusedPositionsFinding,
    unused_positions,
)
from comparisons.config import EkfConfig
from comparisons.estimates.estimate import Estimate
from comparisons.jobs.run import Modified
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log, Positions
from comparisons.statistics import independent
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.measurement_update import UpdateSplitter
from tests.helpers import Array, assert_followed, compared, present, simulated


def with_fixes(log: Log, antenna: tuple[float, float], outlier: int | None = None) -> Log:
    """A fix every second, 0.3 m, of an antenna; one of them 40 m off if asked for."""
    truth = present(log.truth.poses)
    rng = np.random.default_rng(5)
    pose, time = truth.pose[40::40], truth.time_s[40::40]
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    arm = np.column_stack(
        (cos * antenna[0] - sin * antenna[1], sin * antenna[0] + cos * antenna[1])
    )
    position = pose[:, :2] + arm + 0.3 * rng.standard_normal((len(pose), 2))
    if outlier is not None:
        position[outlier] += 40.0
    covariance = np.broadcast_to(0.09 * np.eye(2), (len(pose), 2, 2))
    return replace(log, positions=Positions(time, position, covariance, antenna))


@pytest.mark.parametrize("antenna", [(0.0, 0.0), (2.0, -0.8)])
@pytest.mark.parametrize("name", ["full", "compressed"])
def test_gaps_stay_at_rounding_with_positions(antenna: tuple[float, float], name: str) -> None:
    log = with_fixes(simulated(seed=3, loop_s=30.0), antenna, outlier=10)
    c = compared(log, filter=name, association="known", gps="on")
    assert_followed(c, 1e-8)
    assert c.ekf.rejected_fixes == 1
    assert 10 not in c.ekf.fix_number
    assert c.verdict.outcome == "agree"


def moved(log: Log, change: Callable[[Positions], Positions]) -> Log:
    return replace(log, positions=change(present(log.positions)))


def rotated(positions: Positions) -> Positions:
    turn = np.array(((np.cos(0.2), -np.sin(0.2)), (np.sin(0.2), np.cos(0.2))))
    return replace(positions, position_m=positions.position_m @ turn.T)


WRONG: dict[str, tuple[Callable[[Positions], Positions], str, tuple[float, ...]]] = {
    "antenna": (lambda p: replace(p, antenna_m=(-2.0, 1.0)), "m to the right", (2.0, 0.8)),
    "offset": (
        lambda p: replace(p, position_m=p.position_m + (4.0, -3.0)),
        "an offset of",
        (4.0, -3.0),
    ),
    "delay": (lambda p: replace(p, time_s=p.time_s + 2.0), "s too late", (2.0,)),
    "rotation": (rotated, "a frame turned by", (11.5, 0.0, 0.0)),
    "none of these": (
        lambda p: replace(
            p, position_m=20.0 * np.random.default_rng(1).standard_normal(p.position_m.shape)
        ),
        "were rejected",
        (),
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_positions_that_contradict_all_else_are_a_disagreement(name: str) -> None:
    """Said with the motion that makes them fit, where one does."""
    change, said, figures = WRONG[name]
    log = with_fixes(simulated(seed=3, loop_s=30.0), (2.0, -0.8))
    c = compared(moved(log, change), association="known", gps="on")
    assert c.verdict.outcome == "disagree"
    assert [one.gap for one in c.verdict.causes] == ["positions"]
    _, _, fitted = c.verdict.causes[0].evidence.partition("; they fit ")
    first = fitted.partition(", or ")[0]
    assert said in (first or c.verdict.causes[0].evidence)
    assert [float(n) for n in re.findall(r"-?\d+\.\d+", first)] == pytest.approx(figures, abs=1.0)


@pytest.mark.slow
def test_positions_reduce_the_covariance_of_vehicle_and_map() -> None:
    """Guivant 2002, Fig. 8: the deviations drop when absolute information arrives."""
    log = with_fixes(simulated(seed=3), (0.0, 0.0))
    without = compared(log, association="known")
    fused = compared(log, association="known", gps="on")
    before, after = (np.diag(c.ekf.estimate.joint_covariance) for c in (without, fused))
    assert np.all(after < before)
    assert np.median(after[3:] / before[3:]) < 0.2


def test_split_updates_are_replayed_part_by_part() -> None:
    """Bounds on every step, measurements included: the frozen smoothers follow the weights."""
    log = with_fixes(simulated(seed=3, loop_s=30.0), (0.0, 0.0))

    def gradual(ekf: Ekf) -> None:
        ekf.splitter = UpdateSplitter(largest_turn_rad=np.deg2rad(0.2), largest_move_m=0.05)
        ekf.fixes = replace(ekf.fixes, splitter=ekf.splitter)

    c = compared(log, Modified(gradual), association="known", gps="on")
    assert (c.ekf.trace.measurements[POINT].weight < 1.0).any()
    assert (c.ekf.trace.positions.weight < 1.0).any()
    assert_followed(c, 1e-8)


def closing_by_positions(log: Log, first_s: float, until_s: float) -> EkfRun:
    """SLAM alone until the first position, then positions until the end."""
    positions = present(log.positions)
    late = (positions.time_s >= first_s) & (positions.time_s <= log.end_s)
    log = replace(log, positions=positions.chosen(late))
    timeline = build_timeline(log, log.positions)
    timeline = timeline.prefix(int(np.searchsorted(timeline.epoch_time_s, until_s)))
    return run_ekf(
        log, timeline, settle(EkfConfig(filter="compressed", gps="on"), log), log.positions
    )


def parts_of_first_fix(run: EkfRun) -> tuple[Array, Array]:
    """Innovations [m] before each part, and the parts' weights."""
    fixes = run.trace.positions
    first = fixes.number == fixes.number[0]
    return np.linalg.norm(fixes.innovation[first], axis=1), fixes.weight[first]


def test_a_loop_is_closed_by_a_position_in_parts() -> None:
    """Guivant 2002, Fig. 9: after a blind stretch, one fix counts as a sequence of weaker ones."""
    log = with_fixes(simulated(seed=3), (0.0, 0.0))
    seen = log.measurements
    blind = seen.chosen((seen.time_s < 10.0) | (seen.time_s > 70.0))
    run = closing_by_positions(replace(log, measurements=blind), 60.0, 62.0)
    innovation, weight = parts_of_first_fix(run)
    assert innovation[0] > 1.5
    assert len(weight) > 2
    assert weight.sum() == 1.0
    assert np.all(-np.diff(innovation) < 1.0 + 1e-9)  # no part moves the vehicle by more


@pytest.mark.slow
def test_victoria_park_loop_closed_by_gps(shared_data: Path) -> None:
    """The same on real data: 300 s of SLAM alone, then GPS, 2.4 m away and fused in parts."""
    log = open_log(str(shared_data / "victoria_park"))
    innovation, weight = parts_of_first_fix(closing_by_positions(log, 300.0, 330.0))
    assert 1.5 < innovation[0] < 4.0
    assert len(weight) > 1
    assert np.all(np.diff(innovation) < 0.0)


@pytest.mark.parametrize("antenna", [(0.0, 0.0), (3.0, -1.0)])
def test_held_back_positions_judge(antenna: tuple[float, float]) -> None:
    """The antenna's place is compared with the fixes, wherever it sits."""
    log = with_fixes(simulated(seed=3, loop_s=30.0), antenna)
    c = compared(log, association="known", gps="half")
    for accuracy in (c.accuracy.ekf, c.accuracy.smoother):
        assert present(present(accuracy).gps_median_m) < 0.6


def test_no_position_judges_what_it_was_given_to() -> None:
    log = with_fixes(simulated(seed=3, loop_s=30.0), (0.0, 0.0))
    every = present(log.positions).time_s.tolist()
    half = np.count_nonzero(hold_out_blocks(np.array(every)) % 2 == 0)
    assert abs(half - len(every) / 2) <= 2
    for gps, fused_count in (("off", 0), ("half", half), ("on", len(every))):
        choices = EkfConfig(association="known", gps=gps)
        fused, judging = fused_positions(log, choices), held_out_positions(log, choices)
        given = [] if fused is None else fused.time_s.tolist()
        judges = [] if judging is None else judging.time_s.tolist()
        assert len(given) == fused_count
        assert sorted(given + judges) == every
    c = compared(log, association="known", gps="on")
    assert present(c.accuracy.ekf).gps_median_m is None


@pytest.mark.parametrize(
    ("duration_s", "blocks", "block_s"), [(1600.0, 26, 61.5), (30.0, 4, 7.5), (240.0, 4, 60.0)]
)
def test_positions_are_held_out_in_blocks(duration_s: float, blocks: int, block_s: float) -> None:
    """Of a minute at least; four of a short log. No single position is left at the end."""
    time_s = 100.0 + np.linspace(0.0, duration_s, 401)
    block = hold_out_blocks(time_s)
    assert np.unique(block).tolist() == list(range(blocks))
    counts = np.bincount(block)
    assert counts.max() - counts.min() <= 1
    lengths = [np.ptp(time_s[block == k]) for k in range(blocks)]
    assert max(lengths) == pytest.approx(block_s, abs=duration_s / 400)
    assert block_s >= LEAST_BLOCK_S or blocks == 4


def test_positions_at_one_instant_are_one_block() -> None:
    assert hold_out_blocks(np.full(3, 5.0)).tolist() == [0, 0, 0]


@pytest.mark.slow
def test_car_park_with_gps(shared_data: Path) -> None:
    """Landmark RMSE against the 15 beacons without alignment."""
    log = open_log(str(shared_data / "acfr_car_park"))
    c = compared(log, gps="on")
    assert_followed(c, 1e-6)
    for accuracy, limit in ((c.accuracy.ekf, 0.08), (c.accuracy.smoother, 0.05)):
        assert accuracy is not None
        assert accuracy.landmarks_found == 15
        assert present(accuracy.landmark_rmse_m) < limit


@pytest.mark.slow
def test_victoria_park_with_gps(shared_data: Path) -> None:
    """Every second minute is fused, the others are held out to judge by; outliers are gated."""
    log = open_log(str(shared_data / "victoria_park"))
    c = compared(log, filter="compressed", gps="half")
    assert_followed(c, 1e-6)
    assert c.ekf.rejected_fixes > 0
    assert present(present(c.accuracy.ekf).gps_median_m) < 1.1


def at_truth(log: Log) -> Estimate:
    """An optimum at the truth, sure to 0.1 m."""
    truth = present(log.truth.poses)
    covariance = np.tile(0.01 * np.eye(3), (len(truth.time_s), 1, 1))
    none = np.zeros(0, dtype=np.int64)
    return Estimate(
        time_s=truth.time_s,
        pose=truth.pose,
        pose_covariance=covariance,
        landmark_id=none,
        landmark=np.zeros((0, 2)),
        joint_covariance=np.eye(3),
        information="smoothed",
    )


UNUSED: dict[str, tuple[Callable[[Array], Array], bool]] = {
    "sound": (lambda t: 0.0 * t, False),
    "one lasting error of a sigma and a half": (lambda t: 0.45 + 0.0 * t, False),
    "a bad one in six": (lambda t: 30.0 * (np.arange(len(t)) % 6 == 0), False),
    "an offset of five sigma": (lambda t: 1.5 + 0.0 * t, True),
    "more than stated, each for itself": (
        lambda t: 1.5 * np.random.default_rng(1).standard_normal(len(t)), True
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", UNUSED)
def test_positions_that_nobody_used_are_judged_by_their_middle(name: str) -> None:
    """Broken variants: the mean lets one in six, independent ones a lasting error contradict."""
    change, contradict = UNUSED[name]
    log = with_fixes(simulated(seed=3, loop_s=30.0), (0.0, 0.0))
    positions = present(log.positions)
    error = np.column_stack((change(positions.time_s), np.zeros(len(positions.time_s))))
    wrong = replace(positions, position_m=positions.position_m + error)
    found = unused_positions(wrong, at_truth(log))
    assert found.contradict is contradict
    (row,) = UnusedPositionsFinding(found).rows()
    assert row.inside is not contradict
    assert (found.cause is None) is not contradict


def test_positions_that_contradict_have_an_exit_code() -> None:
    """A run's, of positions that are late; no sigma is blamed."""
    log = with_fixes(simulated(seed=3, loop_s=30.0), (0.0, 0.0))
    late = moved(log, lambda one: replace(one, time_s=one.time_s + 0.9))
    for used, wrong in ((log, False), (late, True)):
        verdict = compared(used, association="known").verdict
        assert verdict.outcome == "agree"
        assert (CONTRADICTED in verdict.qualifiers) is wrong
        assert verdict.failed_on == (("positions",) if wrong else ())
        assert [one.gap for one in verdict.causes] == (["contradiction"] if wrong else [])
        assert not any("sigma" in one.hint for one in verdict.causes)


def test_the_number_of_independent_errors() -> None:
    """An offset is one, white noise is its number, and a correlation of 0.9 takes 19 for one."""
    rng = np.random.default_rng(0)
    white = rng.standard_normal((4000, 2))
    assert independent(np.ones((40, 2))) == pytest.approx(1.0, abs=0.1)
    assert independent(white) == pytest.approx(4000.0, rel=0.15)
    slow = [white[0]]
    for one in white[1:]:
        slow.append(0.9 * slow[-1] + np.sqrt(1.0 - 0.81) * one)
    assert independent(np.array(slow)) == pytest.approx(4000.0 / 19.0, rel=0.25)


@pytest.mark.parametrize("name", ["late", "elsewhere"])
def test_a_motion_is_named_where_all_positions_fit_by_it(name: str) -> None:
    """Half of the positions turned, half moved: no motion leaves their noise, and none is named."""
    log = with_fixes(simulated(seed=3, loop_s=30.0), (0.0, 0.0))
    positions = present(log.positions)
    if name == "late":
        changed = replace(positions, time_s=positions.time_s + 0.9)
    else:
        turned = rotated(positions).position_m
        half = np.arange(len(turned)) % 2 == 0
        changed = replace(
            positions, position_m=np.where(half[:, None], turned, positions.position_m + 3.0)
        )
    found = unused_positions(changed, at_truth(log))
    assert found.contradict
    assert ("s too late" in found.fit) is (name == "late")
    assert bool(found.fit) is (name == "late")
