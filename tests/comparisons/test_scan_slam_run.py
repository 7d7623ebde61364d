"""Scan-SLAM over logs: a short drive through the whole chain, and what cannot be used."""

from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from comparisons.adapters.beam_noise import sensor_of
from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.errors import InputError
from comparisons.extensions.scan_landmarks.config import ScanLandmarksConfig
from comparisons.extensions.scan_landmarks.extension import ScanLandmarksFinding
from comparisons.extensions.scan_landmarks.figure import template_points
from comparisons.extensions.scan_landmarks.result import (
    TemplateRule,
    published_rule,
    rule_text,
    template_rule,
)
from comparisons.extensions.scan_landmarks.source import LogScans, ScanSlamSource, scan_slam_options
from comparisons.figures import stored
from comparisons.jobs.run import Comparison, Modified, run_filter
from comparisons.logs.log import Log
from comparisons.pipeline.prepare import prepare
from comparisons.pipeline.prepared import Preparation, Prepared
from comparisons.report.run import RunReport
from comparisons.settings import run_config
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.measurements import DynamicGuard
from ekf_reference.models.motion import MotionModel, MotionStep
from ekf_reference.scan_landmarks.scan_slam import MOVES, USED, ScanLandmarks, ScanSlamOptions
from ekf_reference.scan_landmarks.template_extraction import SingleSegments
from ekf_reference.scan_landmarks.templates import BLANK
from tests.helpers import (
    Array,
    assert_followed,
    compared,
    first_seconds,
    present,
    simulated,
    written,
)
from tests.scenarios import scenario

log = partial(scenario, "scan-slam", seed=3, seconds=15.0)


@cache
def drawn() -> Comparison:
    return compared(log(), landmarks="scans")


def driven(log: Log, *extensions: Preparation) -> tuple[EkfRun, ScanLandmarks]:
    """The filter's run on scan landmarks, and what it saw of them."""
    config = run_config(landmarks="scans")
    run, setup = run_filter(prepare(log, config, also=extensions))
    source = present(setup.find(ScanSlamSource))
    return run, source.found


def nees(c: Comparison, factor: float = 1.0) -> float:
    """Of the poses with scans, over 3; factor: on the variances."""
    e = c.ekf.estimate
    error = e.pose - present(c.log.truth.poses).at(e.time_s)
    inverse = np.linalg.inv(factor * e.pose_covariance[5:])
    return float(np.einsum("ki,kij,kj->k", error[5:], inverse, error[5:]).mean() / 3.0)


def test_settings_left_alone_are_those_of_scan_slam() -> None:
    usual = ScanLandmarksConfig()
    assert scan_slam_options(usual, mapped=False) == ScanSlamOptions()
    assert scan_slam_options(usual, mapped=True) == ScanSlamOptions(extraction=SingleSegments())


def test_as_published_is_the_thesis_form() -> None:
    """One segment, tried once within 10 %, nine tenths in view, all aligned, P by eq. 5.16.

    Section 5.6 has no number of returns for its simulation, 5.7 has 100 on the car park.
    """
    config = run_config(landmarks="scans", preset="nieto-2005").extensions["scan_landmarks"]
    assert isinstance(config, ScanLandmarksConfig)
    rule = template_rule(scan_slam_options(config, mapped=False))
    assert rule == TemplateRule(
        pieces="single",
        least_returns=30,
        in_view=0.9,
        residual=0.1,
        open_directions=0,
        trials=1,
        tried=0,
        every=1,
        aligned=0,
        gate=7.815,
        alignment_covariance="curvature",
    )
    assert published_rule("simulated") == rule
    assert published_rule("acfr-car-park") == rule.model_copy(update={"least_returns": 100})
    assert rule_text(rule, rule) == (
        "one segment, 30 returns, trial within 10% with no direction open, 90% in view, "
        "all aligned, gate 7.815, covariance by curvature (Nieto 2005, sections 5.4 to 5.7)"
    )
    # broken: a rule that is not the thesis' must not pass for it
    assert "(Nieto 2005, sections 5.4 to 5.7)" not in rule_text(
        rule.model_copy(update={"trials": 2}), rule
    )


def test_the_rule_of_runs_names_the_thesis() -> None:
    said = rule_text(template_rule(ScanSlamOptions()), published_rule("acfr-car-park"))
    assert said.startswith("whole scan, 50 returns, trial within 15% with 2 directions open")
    assert "(Nieto 2005, sections 5.4 to 5.7: one segment, 100 returns" in said


@pytest.mark.slow
def test_the_short_drive_agrees_to_rounding_and_is_honest() -> None:
    c = drawn()
    assert c.verdict.outcome == "agree"
    assert_followed(c, 1e-6)
    assert len(c.ekf.estimate.pose_landmarks) > 3
    ours, wheels = present(c.accuracy.ekf).ate_m, present(c.accuracy.dead_reckoning).ate_m
    assert present(ours) < 0.7 * present(wheels)
    assert nees(c) < 3.0
    assert nees(c, 0.05) > 3.0  # broken: far too sure


@pytest.mark.slow
def test_it_is_reported_and_drawn(tmp_path: Path) -> None:
    c = drawn()
    result, slam = RunReport.build(c), c.find(ScanLandmarksFinding).result
    assert (result.model_extra or {})["scan_slam"] == stored(slam)
    assert slam.scans == len(LogScans(log()))
    assert len(slam.landmarks) == len(c.ekf.estimate.pose_landmarks)
    initialised = len(slam.landmarks)
    assert (
        sum(row.measurements for row in slam.landmarks) == slam.measurements["used"] + initialised
    )
    page = (written(c, tmp_path / "out") / "report.html").read_text()
    assert "EKF scan landmarks, 3 sigma" in page
    assert 'data-key="s0"' in page
    assert f"{len(slam.landmarks)} of {len(slam.landmarks)} agree" in page
    assert (tmp_path / "out" / "ekf" / "scan_landmarks.csv").exists()


class Broken:
    """A motion model whose Jacobian is no number from two metres on."""

    def __init__(self, sound: MotionModel) -> None:
        self.sound = sound

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        made = self.sound.step(pose, control, duration_s)
        far = np.hypot(*(made.pose[:2] - log().prior.pose[:2])) > 2.0
        return made._replace(jacobian_pose=made.jacobian_pose * (np.nan if far else 1.0))


def test_a_covariance_that_is_not_finite_breaks_the_filter_down() -> None:
    def plant(ekf: Ekf) -> None:
        ekf.motion = Broken(ekf.motion)

    run, _ = driven(log(), Modified(plant))
    assert "the pose's covariance is not finite" in present(run.breakdown)


def test_epochs_at_scans_are_added_only_when_asked_for() -> None:
    scans = LogScans(log())
    assert np.isin(scans.time_s, build_timeline(log(), None, scans.time_s).epoch_time_s).all()
    assert not np.isin(scans.time_s, build_timeline(log()).epoch_time_s).all()


def test_the_scanners_noise_is_told_by_its_scans() -> None:
    sensor = sensor_of(present(log().scans))
    assert sensor.sigma_range_m == pytest.approx(0.1, rel=0.25)  # Table 5.1
    assert np.rad2deg(sensor.sigma_bearing_rad) == pytest.approx(1.0, rel=0.25)


@pytest.mark.slow
def test_scans_that_hold_nothing_or_one_return_begin_nothing_and_the_run_goes_on() -> None:
    short = first_seconds(log(), 6.0)
    held = present(short.scans).range_m.copy()
    held[1::3] = np.nan
    held[2::3, 1:] = np.nan
    held[2::3, 0] = 5.0
    poor = replace(short, scans=replace(present(short.scans), range_m=held))
    found = {}
    for one in (poor, short):
        run, found[one is poor] = driven(one)
        assert run.breakdown is None
    assert found[True].scans == found[False].scans
    assert found[True].reasons[BLANK] > 0 == found[False].reasons[BLANK]
    assert 0 < found[True].reasons[USED] < found[False].reasons[USED]
    assert min(len(t.shape) for t in found[True].template.values()) >= 15


class Guarded(Preparation):
    """Puts a guard beside the filter."""

    def __init__(self, guard: DynamicGuard) -> None:
        self._guard = guard

    def attach(self, setup: FilterSetup, prepared: Prepared[Any]) -> None:
        setup.guard = self._guard


class NorthMoves:
    """A guard that holds everything north of the start to be moving."""

    def is_dynamic(self, point: Array) -> NDArray[np.bool_]:
        return np.asarray(point[:, 1] > 2.0)


@pytest.mark.slow
def test_returns_from_where_something_moves_are_left_out_and_counted() -> None:
    short = first_seconds(log(), 5.0)
    held = {}
    for guard in (NorthMoves(), None):
        run, found = driven(short, *(() if guard is None else (Guarded(guard),)))
        held[guard is None] = template_points(
            found, run.estimate.pose_landmark_id, run.estimate.pose_landmarks
        )
        assert (found.dynamic > 100) == (guard is not None)
    assert held[False][:, 1].max() < 3.0 < held[True][:, 1].max()


class NorthMovesLater(NorthMoves):
    """The same, but only from the fifth time that it is asked."""

    def __init__(self) -> None:
        self.asked = 0

    def is_dynamic(self, point: Array) -> NDArray[np.bool_]:
        self.asked += 1
        return super().is_dynamic(point) & (self.asked > 4)


@pytest.mark.slow
def test_landmarks_where_something_moves_are_deactivated() -> None:
    """Nieto 2005, section 6.5: those that were made before it was known are matched no more."""
    run, found = driven(first_seconds(log(), 5.0), Guarded(NorthMovesLater()))
    place = dict(
        zip(run.estimate.pose_landmark_id.tolist(), run.estimate.pose_landmarks, strict=True)
    )
    north = {s: (t.placed(place[s])[:, 1] > 2.0).mean() for s, t in found.template.items()}
    assert found.moving
    assert all(north[landmark_index] > 0.1 for landmark_index in found.moving)
    assert all(north[landmark_index] < 0.3 for landmark_index in set(north) - found.moving)
    assert found.reasons[MOVES] > 0


class Listener:
    """A guard that remembers where it was asked about, and holds nothing to be moving."""

    def __init__(self) -> None:
        self.asked: list[Array] = []

    def is_dynamic(self, point: Array) -> NDArray[np.bool_]:
        self.asked.append(point)
        return np.zeros(len(point), dtype=bool)


def test_the_guard_is_asked_about_the_world_whatever_the_scanners_mount() -> None:
    short = first_seconds(log(), 1.0)
    scans = present(short.scans)
    mounted = replace(scans, mount=replace(scans.mount, forward_m=0.7, heading_rad=0.3))
    guard = Listener()
    driven(replace(short, scans=mounted), Guarded(guard))
    pose, scan = present(short.truth.poses).at(mounted.time_s[:1])[0], mounted.range_m[0]
    way, heading = scan[np.isfinite(scan)], pose[2] + 0.3
    angle = mounted.angle_rad[np.isfinite(scan)] + heading
    at = pose[:2] + 0.7 * np.array((np.cos(pose[2]), np.sin(pose[2])))
    expected = at + way[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))
    away = np.linalg.norm(guard.asked[0][:, None] - expected[None], axis=2).min(axis=1)
    assert np.median(away) < 0.1


def test_what_cannot_be_used_is_said_in_a_line() -> None:
    with pytest.raises(InputError, match="has no planar scans"):
        compared(simulated(), landmarks="scans")
    with pytest.raises(InputError, match="holds no measurements of landmarks"):
        compared(log())
    scans = present(log().scans)
    blank = replace(scans, range_m=np.full_like(scans.range_m, np.nan))
    with pytest.raises(InputError, match="nothing that was observed could be used"):
        compared(replace(log(), scans=blank), landmarks="scans")
