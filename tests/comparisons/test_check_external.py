"""slamcheck check: estimates from elsewhere, right and wrong, as their makers hand them in."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.checks.agreement import BlockAgreement, VarianceBand
from comparisons.checks.diagnosis.diagnosis import Paths, diagnose
from comparisons.checks.external_agreement import _widened, clock_words, coverage
from comparisons.config import CheckConfig, EkfConfig
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import ExternalEstimate, read_external
from comparisons.estimates.folder import read_estimate, tum_text, write_estimate
from comparisons.estimates.trajectory_files import in_seconds, retimed
from comparisons.jobs.check import check
from comparisons.jobs.grading import check_external
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log
from comparisons.pipeline.references import filter_named
from comparisons.pipeline.solve import Solution, solve
from comparisons.report.check import CheckResult
from research.trust.exports import EXPORTS
from tests.commands import slamcheck, works
from tests.helpers import present
from tests.test_own_project import missing


@pytest.fixture(scope="module")
def log() -> Log:
    return open_log("simulated-loop")


@pytest.fixture(scope="module")
def solution(log: Log) -> Solution:
    return solve(log, CheckConfig())


@pytest.fixture(scope="module")
def right(log: Log) -> Estimate:
    """The reference EKF's, standing in for somebody's filter."""
    return run_ekf(log, build_timeline(log), settle(EkfConfig(), log)).estimate


@pytest.fixture(scope="module")
def whole(right: Estimate) -> ExternalEstimate:
    return replace(ExternalEstimate.of(right), information=None)


def bare(given: ExternalEstimate) -> ExternalEstimate:
    return ExternalEstimate(time_s=given.time_s, pose=given.pose)


def about_origin(pose: Array, angle: float, shift: tuple[float, float]) -> Array:
    """Poses (K, 3) in another frame."""
    cos, sin = np.cos(angle), np.sin(angle)
    place = pose[:, :2] @ np.array(((cos, sin), (-sin, cos))) + shift
    return np.column_stack((place, pose[:, 2] + angle))


def turned(given: ExternalEstimate, angle: float, shift: tuple[float, float]) -> ExternalEstimate:
    """The same in another frame, landmarks and all."""
    landmark = present(given.landmark)
    posed = np.column_stack((landmark, np.zeros(len(landmark))))
    return replace(
        given,
        pose=about_origin(given.pose, angle, shift),
        landmark=about_origin(posed, angle, shift)[:, :2],
    )


def test_a_right_estimate_agrees(log: Log, whole: ExternalEstimate) -> None:
    found = check(log, whole)
    assert found.outcome == "agree"
    assert not found.causes
    assert not found.remarks
    assert found.agreement.outside == 0.0
    assert found.consistency.unjudged == ""


def test_what_is_absent_narrows_the_verdict_and_is_told(log: Log, whole: ExternalEstimate) -> None:
    found = check(log, bare(whole))
    assert found.outcome == "agree"
    assert "the estimate has no landmarks, no pose covariances" in found.remarks[0]
    assert "; compared poses" in found.remarks[0]
    assert found.consistency.unjudged == "the estimate has no pose covariances"


Defect = Callable[[ExternalEstimate], ExternalEstimate]


def delayed(time_s: Array, pose: Array, delay: float) -> Array:
    return np.column_stack([np.interp(time_s - delay, time_s, column) for column in pose.T])


def of_point(pose: Array, forward: float, left: float) -> Array:
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    arm = (forward * cos - left * sin, forward * sin + left * cos, np.zeros(len(pose)))
    return pose + np.column_stack(arm)


Move = Callable[[Array, Array], Array]
MOTIONS: dict[str, tuple[Move, str, str]] = {
    "nothing": (lambda t, p: p, "", ""),
    "shift": (lambda t, p: p + (5.0, -3.0, 0.0), "frame", r"is shifted by \([45]\.\d+, -[23]"),
    "small shift": (lambda t, p: p + (-1.5, 0.0, 0.0), "frame", r"is shifted by \(-1\."),
    "turn": (lambda t, p: about_origin(p, 0.1, (0.0, 0.0)), "frame", "is rotated by 5.* origin;"),
    "turn and shift": (lambda t, p: about_origin(p, -0.3, (-6.0, 9.0)), "frame", "and shifted"),
    "time": (
        lambda t, p: delayed(t, p, 0.2),
        "time",
        r"the time stamps are 0\.[12]\d+ s too late;",
    ),
    "time and shift": (lambda t, p: delayed(t, p, 0.4) + (5.0, -3.0, 0.0), "time", "shifted"),
    "mirrored": (
        lambda t, p: p * (1.0, -1.0, -1.0),
        "mirrored",
        "mirrored: y has the opposite sign",
    ),
    "scale": (lambda t, p: p * (1.05, 1.05, 1.0), "scale", r"is 1\.0[45]"),
    "centimetres": (lambda t, p: p * (100.0, 100.0, 1.0), "scale", r"is (99|100)\.\d+ times"),
    "heading": (lambda t, p: p + (0.0, 0.0, np.pi / 2), "heading", r"differ by (89|90)\.\d deg"),
    "point": (lambda t, p: of_point(p, 0.8, 0.3), "lever", r"point 0\.[78]\d+ m ahead"),
    "a sensor's frame": (
        lambda t, p: about_origin(of_point(p, 0.8, 0.3) + (0.0, 0.0, np.pi / 2), -0.3, (2.0, 1.0)),
        "lever",
        r"frame 0\.[78]\d m ahead and 0\.[23]\d m to the left .* turned by (89|90)\.\d degrees, "
        r"rotated",
    ),
    "shift without headings": (
        lambda t, p: p * (1.0, 1.0, 0.0) + (5.0, -3.0, 0.0),
        "frame",
        "is shifted by",
    ),
}
"""Motions of a path, the cause, and what its words have to match."""


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("kind", ["filter", "smoother"])
def test_the_simplest_motion_is_named(
    solution: Solution, right: Estimate, kind: str, noisy: bool, name: str
) -> None:
    """Beside both references, of which each is 0.64 m off the other and turned by 0.7 degrees."""
    smoothed, (move, gap, words) = solution.estimate, MOTIONS[name]
    path = right.pose if kind == "filter" else smoothed.pose
    if noisy:
        sigma = (0.05, 0.05, 0.005)
        path = path + np.random.default_rng(11).normal(0.0, sigma, path.shape)
    moved, t = move(right.time_s, path), right.time_s
    whole, partly = diagnose(
        [
            Paths(t, moved, other.pose, right.pose_covariance, other_name)
            for other_name, other in (("the smoother", smoothed), ("the reference EKF", right))
        ]
    )
    found = [*whole, *partly]
    assert [one.gap for one in found] == ([gap] if gap else [])
    if gap and not noisy and gap != "time":  # a late path is interpolated
        assert whole == found
    if gap:
        assert re.search(words, found[0].evidence), found[0].evidence
        nearest = "the smoother" if kind == "smoother" else "the reference EKF"
        words = "those of" if gap == "heading" else "from"
        assert f"{words} {nearest}" in found[0].evidence


@pytest.mark.parametrize(("rest_m", "named"), [(0.0, True), (0.8, False)])
def test_a_motion_that_leaves_some_of_a_difference_is_evidence_and_no_cause(
    solution: Solution, whole: ExternalEstimate, rest_m: float, named: bool
) -> None:
    """A tenth of the difference is of another kind, which no motion is blamed for."""
    t = whole.time_s / whole.time_s[-1]
    rest = rest_m * np.column_stack((np.sin(9.0 * t), np.sin(7.0 * t), np.zeros(len(t))))
    moved = replace(bare(whole), pose=whole.pose + rest + (5.0, -3.0, 0.0))
    found = check_external(moved, solution)
    assert (found.causes[0].gap == "frame") is named
    assert ("frame" in [one.gap for one in found.causes]) is named
    if not named:
        assert "in part, the trajectory is rotated by" in found.causes[0].evidence
        assert "this explains 88 %" in found.causes[0].evidence


def test_a_shift_is_no_turn(solution: Solution) -> None:
    """Of a smoothed path that does not say what it is; beside the EKF's alone it was a turn."""
    smoothed = solution.estimate
    moved = ExternalEstimate(time_s=smoothed.time_s, pose=smoothed.pose + (5.0, -3.0, 0.0))
    found = check_external(moved, solution)
    assert [one.gap for one in found.causes] == ["frame", "optimum"]
    assert found.causes[0].evidence.startswith(
        "the trajectory is shifted by (5.000, -3.000) m; with this corrected"
    )


@pytest.mark.slow
def test_another_filter_is_known_in_another_frame(log: Log, solution: Solution) -> None:
    """What a shift leaves of it is how it differs from the EKF: more than one percent."""
    ukf = present(
        filter_named("an unscented Kalman filter", solution.prepared, solution.estimate.time_s)
    )
    moved = ExternalEstimate(
        time_s=ukf.time_s, pose=ukf.pose + (-0.3, 0.2, 0.0), information="filtered"
    )
    first = check(log, moved, CheckConfig(require="like")).causes[0]
    assert first.gap == "frame"
    assert "with this corrected, the estimate equals an unscented" in first.evidence


@pytest.mark.slow
def test_a_fault_is_named_beside_another_frame(log: Log, right: Estimate) -> None:
    """R halved, and all turned and shifted: the frame first, then the fault."""
    seen = log.measurements
    half = replace(
        seen,
        sigma_range_m=np.sqrt(0.5) * seen.sigma_range_m,
        sigma_bearing_rad=np.sqrt(0.5) * seen.sigma_bearing_rad,
    )
    faulty = replace(log, measurements=half)
    run = run_ekf(faulty, build_timeline(faulty), settle(EkfConfig(), faulty)).estimate
    given = turned(ExternalEstimate.of(run), 0.1, (2.0, -1.0))
    given = ExternalEstimate(time_s=given.time_s, pose=given.pose, information="filtered")
    found = check(log, given, CheckConfig(require="like"))
    assert [one.gap for one in found.causes[:2]] == ["frame", "fault"], found.causes
    assert "R is 0.5 times the log's" in found.causes[1].evidence


def chosen(given: ExternalEstimate, rows: NDArray[np.bool_]) -> ExternalEstimate:
    return ExternalEstimate(time_s=given.time_s[rows], pose=given.pose[rows])


INCOMPLETE: dict[str, tuple[Callable[[Array], NDArray[np.bool_]], str]] = {
    "one pose": (lambda t: t == t[0], "covers 0.0 of 85.0 s: it has a single pose, at 0.0 s"),
    "first and last pose": (
        lambda t: (t == t[0]) | (t == t[-1]),
        "covers 0.0 of 85.0 s: it has no poses from 0.0 to 85.0 s",
    ),
    "stops": (lambda t: t < 30.0, "covers 30.0 of 85.0 s: it ends at 29.8 s"),
    "hole": (
        lambda t: (t < 30.0) | (t > 50.0),
        "covers 64.6 of 85.0 s: it has no poses from 29.8 to 50.2 s",
    ),
    "starts late": (lambda t: t > 20.0, "covers 65.0 of 85.0 s: it begins at 20.2 s"),
    "holes": (lambda t: t % 20.0 > 5.0, "it begins at 5.2 s, it ends at 79.8 s, it has 3 gaps"),
}


@pytest.mark.parametrize("name", INCOMPLETE)
def test_an_incomplete_path_disagrees(
    solution: Solution, whole: ExternalEstimate, name: str
) -> None:
    """Each is right as far as it goes."""
    choose, said = INCOMPLETE[name]
    part = chosen(whole, choose(whole.time_s))
    found = check_external(part, solution)
    assert (found.grade.value, found.outcome) == (None, "disagree")
    assert [one.gap for one in found.causes] == ["coverage"]
    assert said in found.causes[0].evidence
    assert check_external(part, solution, min_coverage=0.0).outcome == "agree"


@pytest.mark.parametrize("every", [1, 5, 25])
def test_a_regular_path_covers_the_log_at_any_rate(
    solution: Solution, whole: ExternalEstimate, every: int
) -> None:
    """5 Hz, 1 Hz, and a pose each 5 s; twice the last is a hole in between."""
    found = check_external(chosen(whole, np.arange(len(whole.time_s)) % every == 0), solution)
    assert found.outcome == "agree"
    assert found.coverage.share == pytest.approx(1.0)


def test_a_map_that_was_lost_is_told(solution: Solution, whole: ExternalEstimate) -> None:
    one = replace(
        bare(whole),
        landmark_id=present(whole.landmark_id)[:1],
        landmark=present(whole.landmark)[:1],
    )
    found = check_external(one, solution)
    assert found.outcome == "agree"
    assert any(
        "59 of 60 landmarks of the log are missing in the map" in text for text in found.remarks
    )
    claimed = check_external(replace(one, estimator="ekf"), solution)
    assert claimed.outcome == "disagree"
    (hint,) = [cause.hint for cause in claimed.causes if cause.gap == "map"]
    assert hint.endswith("with the ids of the log's measurements")


def test_keyframes_by_distance_leave_no_hole_where_the_vehicle_stands() -> None:
    """30 s of standing without a keyframe; a vehicle that drives on there leaves a hole."""
    t = np.arange(0.0, 90.05, 0.1)
    way = np.where(t < 30.0, t, np.where(t < 60.0, 30.0, t - 30.0))
    path = np.column_stack((way, np.zeros((len(t), 2))))
    moving = np.column_stack((t, np.zeros((len(t), 2))))
    frames = np.unique(np.searchsorted(way, np.arange(0.0, 60.0, 2.0)))
    assert coverage((t[frames], path[frames]), (t, path), t).share > 0.97
    assert coverage((t[frames], moving[frames]), (t, moving), t).share < 0.7
    still = coverage((t, path), (t, path), t)  # standing, it repeats its pose
    assert (still.share, still.repeated) == (1.0, False)


def test_where_the_smoother_has_no_pose_there_is_no_hole() -> None:
    """A log's own silence is nobody's fault; a hole of the same length elsewhere is."""
    epochs = np.concatenate((np.arange(0.0, 20.0, 0.1), np.arange(50.0, 80.05, 0.1)))
    heard = np.arange(0.0, 80.05, 0.1)
    given, all_along = ((t, np.column_stack((t, t, t))) for t in (epochs, heard))
    assert coverage(given, given, epochs).share == 1.0
    assert coverage(given, all_along, heard).share == pytest.approx(1.0 - 30.1 / 80.0)
    assert coverage(given, all_along, epochs).share == 1.0  # nothing is observed in the hole


@pytest.mark.slow
def test_a_covariance_that_is_none_is_found(log: Log, whole: ExternalEstimate) -> None:
    """Not positive definite: no pose lies within such a region."""
    negative = -present(whole.pose_covariance)
    found = check(log, replace(whole, pose_covariance=negative))
    assert found.outcome == "disagree"
    assert found.agreement.outside == 1.0


def test_folders_and_files_are_read_as_far_as_they_go(tmp_path: Path, right: Estimate) -> None:
    write_estimate(right, tmp_path)
    again = read_estimate(tmp_path)
    assert np.allclose(again.pose, right.pose, rtol=0, atol=1e-12)
    assert np.array_equal(again.joint_covariance, right.joint_covariance)
    given = read_external(tmp_path)
    assert given.absent == []
    assert given.information == "filtered"
    for name, absent in (("covariances.npz", 3), ("estimate.toml", 3), ("landmarks.csv", 4)):
        (tmp_path / name).unlink()
        assert len(read_external(tmp_path).absent) == absent
    assert np.allclose(read_external(tmp_path / "trajectory.tum").pose, right.pose)


def edited(file: str, old: str, new: str) -> Callable[[Path], object]:
    def change(folder: Path) -> None:
        text = (folder / file).read_text()
        assert old in text
        (folder / file).write_text(text.replace(old, new, 1))

    return change


def without_a_turn(folder: Path) -> None:
    path = folder / "trajectory.tum"
    first, *others = path.read_text().splitlines()
    path.write_text("\n".join([" ".join([*first.split()[:4], "0 0 0 0"]), *others]))


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (edited("estimate.toml", "version = 1", "version = 9"), "version: input should be 1"),
        (edited("estimate.toml", '"filtered"', '"guessed"'), "input should be 'filtered'"),
        (edited("estimate.toml", "version = 1", "version = 1\nvresion = 1"), "vresion: extra"),
        (edited("estimate.toml", "version = 1", "version ="), "not valid TOML"),
        (edited("trajectory.tum", "\n", "\n0.0 0 0 0 0 0 0 1\n"), "trajectory.tum:2: time"),
        (without_a_turn, r"quaternion's norm is 0\.0"),
        (lambda p: (p / "trajectory.tum").unlink(), "no such file"),
        (lambda p: (p / "trajectory.tum").write_text("0 1 2\n"), "trajectory.tum:1"),
        (lambda p: (p / "trajectory.tum").write_text(""), "no poses"),
        (lambda p: (p / "trajectory.tum").write_text("0 1 2 0 1 0 0 0\n"), "w last"),
        (lambda p: np.savez(p / "covariances.npz", pose=np.eye(3)), "pose has shape"),
        (
            lambda p: np.savez(p / "covariances.npz", pose=np.full((426, 3, 3), np.nan)),
            r"pose\[0\] holds a value that is not",
        ),
        (lambda p: (p / "covariances.npz").write_bytes(b"PK"), "not an archive"),
        (lambda p: (p / "estimate.toml").write_text("version = 2\n"), "estimate.toml"),
        (lambda p: (p / "landmarks.csv").write_text("id,x\n"), "expected the header"),
        (
            lambda p: (p / "landmarks.csv").write_text("id,x_m,y_m\n0.5,1,2\n"),
            r"landmarks.csv:2: id is 0.5, .* by which the log's measurements.csv names",
        ),
    ],
)
def test_damaged_estimates_are_named(
    tmp_path: Path, right: Estimate, change: object, fault: str
) -> None:
    write_estimate(right, tmp_path)
    assert callable(change)
    change(tmp_path)
    with pytest.raises(InputError, match=fault):
        read_external(tmp_path)
    with pytest.raises(InputError):
        read_estimate(tmp_path)


def test_another_clock_is_told(log: Log, whole: ExternalEstimate) -> None:
    with pytest.raises(InputError, match="expected times of the log's clock"):
        check(log, replace(whole, time_s=whole.time_s + 1.6e9))
    for unit, factor in (("milli", 1e3), ("micro", 1e6), ("nano", 1e9)):
        with pytest.raises(InputError, match=f"they look like {unit}seconds; in seconds: awk"):
            check(log, replace(whole, time_s=factor * whole.time_s))


@pytest.mark.parametrize(
    ("time_s", "said"),
    [
        ((1e5, 2e5), f"; they look like milliseconds; {in_seconds('milliseconds')}"),
        ((110.0, 212.0), f"; they look 10.0 s too late; on the log's clock: {retimed('- 10.0')}"),
        ((110.0, 212.1), ""),
    ],
)
def test_a_clock_is_named_where_the_time_is_as_long(time_s: tuple[float, float], said: str) -> None:
    """To 2 %, of a log from 100 to 200 s."""
    assert clock_words(np.array(time_s), (100.0, 200.0)) == said


@pytest.mark.parametrize(
    ("ratios", "band"),
    [((0.8, 1.5), (0.4, 3.0)), ((1.2, 0.9), (0.5, 2.0)), ((0.1, 9.0), (0.25, 4.0))],
)
def test_a_band_of_variances_is_as_wide_as_linearising_makes_it(
    ratios: tuple[float, float], band: tuple[float, float]
) -> None:
    """By a factor of two around what a right filter has, and never beyond four."""
    peer = BlockAgreement.of(np.zeros(2), np.eye(2), np.diag(ratios))
    peer = replace(peer, variance_ratio_least=ratios[0], variance_ratio_largest=ratios[1])
    assert _widened(VarianceBand(0.5, 2.0), peer) == pytest.approx(band)
    assert _widened(VarianceBand(0.5, 2.0), None) == VarianceBand()
    unsure = replace(peer, variance_ratio_least=-np.inf)
    assert _widened(VarianceBand(0.5, 2.0), unsure) == VarianceBand()


def stuck(given: ExternalEstimate) -> ExternalEstimate:
    late = given.time_s > 30.0
    return replace(bare(given), pose=np.where(late[:, None], given.pose[~late][-1], given.pose))


def lost(given: ExternalEstimate) -> ExternalEstimate:
    drawn = np.random.default_rng(0).normal(0.0, 0.15, given.pose.shape)
    wander = np.cumsum(drawn, axis=0) * (1.0, 1.0, 0.01)
    return replace(bare(given), pose=given.pose + wander)


def clock_off(by_s: float) -> Defect:
    return lambda given: replace(given, time_s=given.time_s + by_s)


def headed(change: Callable[[Array], Array]) -> Defect:
    """Right positions: nothing is 0.000 m off by 1e5 sigma."""
    return lambda given: replace(
        bare(given), pose=np.column_stack((given.pose[:, :2], change(given.pose[:, 2])))
    )


COLUMN = "in CSV the column is named heading_rad, or heading_deg"
WRONG: dict[str, tuple[Defect, str, str, str]] = {
    # Were it not, none of its landmarks would be judged, and the verdict be `agree`.
    "map of other ids": (
        lambda given: replace(given, landmark_id=present(given.landmark_id) + 100), "map", "",
        "60 landmarks have another id in the log: 101 at landmark 1",
    ),
    "stopped": (stuck, "coverage", "its pose does not change after 30.0 s", ""),
    "lost": (lost, "estimate", "RMS", ""),
    "late clock": (clock_off(10.0), "coverage", "they look 10.0 s too late", "clock"),
    "early clock": (clock_off(-10.0), "coverage", "they look 10.0 s too early", "clock"),
    "degrees": (headed(np.degrees), "heading", "in degrees instead of radians", COLUMN),
    "degrees to 180": (
        headed(lambda h: np.degrees(np.angle(np.exp(1j * h)))),
        "heading", "the headings are in degrees", COLUMN,
    ),
    "no headings": (headed(lambda h: 0.0 * h), "heading", "all headings are 0 degrees", COLUMN),
    "headings not halved": (headed(lambda h: 2.0 * h), "heading", "is not halved", COLUMN),
    "exchanged": (EXPORTS["two landmarks exchanged"], "association", "coincide with others", ""),
    "too sure": (EXPORTS["all covariances a third"], "covariance", "is 0.33 times", ""),
    "called smoothed": (
        lambda given: replace(given, information="smoothed"),
        "information", "does not use later measurements", "",
    ),
}  # fmt: skip
"""What is handed in, and its first cause with words of the evidence and of the hint."""


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_the_first_cause(
    solution: Solution, whole: ExternalEstimate, name: str
) -> None:
    make, gap, evidence, hint = WRONG[name]
    found = check_external(make(whole), solution)
    assert found.outcome == "disagree"
    assert found.causes[0].gap == gap
    assert evidence in found.causes[0].evidence
    assert hint in found.causes[0].hint


@pytest.mark.slow
def test_the_command(tmp_path: Path, right: Estimate) -> None:
    (tmp_path / "mine.tum").write_text(tum_text(right.time_s, right.pose))
    wrong = right.pose * (1.0, 1.0, 1.0) + (3.0, 0.0, 0.0)
    (tmp_path / "wrong.tum").write_text(tum_text(right.time_s, wrong))
    works("check", "simulated-loop", "--estimate", "mine.tum", cwd=tmp_path)
    bad = slamcheck(
        "check", "simulated-loop", "--estimate", "wrong.tum", "--out", "c", cwd=tmp_path
    )
    assert bad.returncode == 1, bad.stderr
    assert "frame: " in bad.stdout
    result = CheckResult.model_validate_json((tmp_path / "c" / "check.json").read_text())
    assert result.verdict == "disagree"
    assert json.loads((tmp_path / "c" / "check.json").read_text())["outside"] is None
    (tmp_path / "one.tum").write_text(tum_text(right.time_s[:1], right.pose[:1]))
    one = slamcheck("check", "simulated-loop", "--estimate", "one.tum", cwd=tmp_path)
    assert one.returncode == 1, one.stderr
    assert "coverage: the estimate covers 0.0 of 85.0 s" in one.stdout
    most = ("--estimate", "one.tum", "--min-coverage", "0")
    assert slamcheck("check", "simulated-loop", *most, cwd=tmp_path).returncode == 0


@pytest.mark.slow
def test_the_example_is_found_out(tmp_path: Path, right: Estimate) -> None:
    """The script of the README, run as its docstring says."""
    (tmp_path / "ekf").mkdir()
    write_estimate(right, tmp_path / "ekf")
    script = Path(__file__).resolve().parents[2] / "examples" / "late_export.py"
    subprocess.run([sys.executable, script, "ekf", "late.tum"], cwd=tmp_path, check=True)
    works("check", "simulated-loop", "--estimate", "ekf", cwd=tmp_path)
    asked = ("--estimate", "late.tum", "--require", "like")
    late = slamcheck("check", "simulated-loop", *asked, cwd=tmp_path)
    assert late.returncode == 1, late.stderr
    shown = (script.parents[1] / "README.md").read_text(encoding="utf-8")
    shown = next(one for one in shown.split("```") if "0.200 s too late" in one)
    assert missing(shown, late.stdout) == []
