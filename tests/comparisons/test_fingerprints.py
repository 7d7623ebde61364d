"""Faults without a trace: each planted one is named, and a sound filter has none."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.filter_loop import FilterObservers
from comparisons.arrays import Array
from comparisons.checks.grade import likeness
from comparisons.checks.spread import within_spread
from comparisons.config import CheckConfig
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.reference import Reference
from comparisons.faults.catalogue import NAMED, own_start
from comparisons.faults.fault import NONE, Family, Fault, together
from comparisons.faults.tried import TriedFaults
from comparisons.fingerprints.estimate_motion import integrations_by_steps
from comparisons.fingerprints.fault_sets import LinearEffects
from comparisons.fingerprints.search import fault_cause, fingerprints
from comparisons.fingerprints.trial import (
    LEAST_SHARE,
    FaultTrial,
    Fingerprint,
    Way,
    filter_with,
    stamp_rounding,
)
from comparisons.jobs.check import check
from comparisons.jobs.grading import check_external
from comparisons.logs.log import Log
from comparisons.logs.odometry import VelocityOdometry
from comparisons.pipeline.clock import no_progress
from comparisons.pipeline.references import APART, EKF, KINDS, SoundFilters, filter_named
from comparisons.pipeline.solve import Solution, solve
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.invariant_state import RobocentricState
from ekf_reference.core.landmark_types import NewLandmarks
from research.filter_steps import counted_steps
from slamcheck import load_log
from tests.comparisons.newcomers import Course, simulate
from tests.comparisons.test_stamps import of_speeds_and_yaw_rates
from tests.ekf_reference.numerics import central_difference
from tests.helpers import present, without_labels


@pytest.fixture(scope="module")
def solution() -> Solution:
    return solve(of_speeds_and_yaw_rates(6.0))


def tried(solution: Solution, fault: Fault, name: str = EKF) -> Reference | None:
    """A filter with a fault; None where it breaks down."""
    times = solution.estimate.time_s
    return filter_with(fault, name, solution.prepared, times, FilterObservers())


def run(solution: Solution, fault: Fault, name: str = EKF) -> Reference:
    return present(tried(solution, fault, name))


def handed_in(reference: Reference) -> ExternalEstimate:
    rows = np.arange(len(reference.landmark))
    return ExternalEstimate(
        time_s=reference.time_s,
        pose=reference.pose,
        landmark_id=reference.landmark_id,
        landmark=reference.landmark,
        pose_covariance=reference.pose_covariance,
        landmark_covariance=reference.landmark_covariances(rows),
        joint_covariance=reference.joint_covariance,
        information="filtered",
    )


PLANTED = (
    "the pose part of the range row of H has the opposite sign",
    "the heading column of H has the opposite sign",
    "the heading column of G_x has the opposite sign",
    "in the initialisation of landmarks, the new block's covariance with the others is zero",
    "measurements of landmarks in the map are used twice in one update",
    "the heading term of the x row of F is multiplied by the turn over the distance",
    "the predicted velocity is along the heading of plain dead reckoning",
    "the innovation is zero",
    "Q is turned by the heading once too often",
    "in the update by the form P - K S K^T, the covariance is P - K R K^T",
    "in the update, the correction of the landmarks is zero",
    "in the prediction, the covariance of the pose with the landmarks is as before",
    "the measurements are fused 1 odometry sample early",
    "the measurements are fused two predictions late",
    "the yaw rate is used 2 samples late, the first twice",
    "of the scans every third, from the second on, is left out",
    "the controls' part of Q grows with the interval",
    "the prior's covariance is zero, and the stabilisation noise is left out",
    "the prior's covariance is 1e-08 I, and the stabilisation noise",
)
FITTED = (
    "R of new landmarks is {}",
    "R of updates, or of the gain alone",
    "in the update by Joseph's form, S is computed with {} times R",
    "a landmark is initialised with the covariance {} m^2 I, and without",
    "the turn's part of Q is {}",
)


def assert_named(solution: Solution, fault: Fault, name: str = EKF, way: str = "") -> None:
    given = handed_in(run(solution, fault, name))
    sound = likeness(given, run(solution, NONE), labelled=True)
    (found,) = fingerprints(given, solution.prepared, sound, no_progress)
    assert fault.what in (found.fault, *found.others)
    assert (found.way, found.whole) == (way, True)


@pytest.mark.slow
@pytest.mark.parametrize("words", PLANTED)
def test_a_planted_fault_is_named(solution: Solution, words: str) -> None:
    assert_named(solution, TriedFaults(solution.log).named(words))


@pytest.mark.slow
@pytest.mark.parametrize("words", FITTED)
def test_a_number_is_fitted(solution: Solution, words: str) -> None:
    """To four digits, of a number that nobody would try."""
    assert_named(solution, family(solution.log, words).member(2.345))


def test_no_two_faults_that_are_tried_have_the_same_words(solution: Solution) -> None:
    searched = TriedFaults(solution.log)
    words = [one.what for one in (*searched.single, *searched.joined)]
    assert len(set(words)) == len(words)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_of_a_filter_of_another_kind_is_named(solution: Solution, kind: str) -> None:
    """Whose sound filter is farther from it than the reference EKF is from most faults."""
    noise = family(solution.log, "R is {}")
    assert_named(solution, noise.member(2.345), kind, f"it is {kind}")


def family(log: Log, words: str) -> Family:
    return TriedFaults(log).family(words)


def member(log: Log, words: str, number: float) -> Fault:
    """The first with a number whose words begin so."""
    members = (family.member(number) for family in TriedFaults(log).numbered)
    return next(fault for fault in members if fault.what.startswith(words))


BIASED, NOISY = ("the yaw rate has a bias", 0.01), ("R of the range is", 2.345)
APART_FROM_THE_HEADING = "the predicted velocity is along the heading of plain dead reckoning"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("planted", "numbers"),
    [
        ("", (BIASED, NOISY)),
        ("", (BIASED, NOISY, ("the speed's part of Q is", 0.6))),
        (APART_FROM_THE_HEADING, (BIASED,)),
        # Of which the first choice is wrong: far from linear.
        ("", (("the y column of H is", 2.444), ("the odometry is 0.434 times", 0.434))),
    ],
)
def test_faults_are_named_together(
    solution: Solution, planted: str, numbers: tuple[tuple[str, float], ...]
) -> None:
    """No one of them explains the estimate; each number is right to four digits."""
    log = solution.log
    base = [TriedFaults(log).named(planted)] if planted else []
    members = [member(log, words, number) for words, number in numbers]
    given = handed_in(run(solution, together(*base, *members)))
    sound = likeness(given, run(solution, NONE), labelled=True)
    (found,) = fingerprints(given, solution.prepared, sound, no_progress)
    assert found.whole
    assert found.several
    assert set(found.fault.split(", and ")) == {one.what for one in (*base, *members)}


@pytest.mark.slow
def test_faults_together_do_not_explain_what_is_random(solution: Solution) -> None:
    """With three numbers, and one fault of a hundred, least squares fit much."""
    sound = run(solution, NONE)
    spread = np.sqrt(np.diagonal(sound.pose_covariance, 0, 1, 2))
    moved = np.random.default_rng(0).normal(size=spread.shape) * spread
    given = replace(handed_in(sound), pose=sound.pose + moved)
    near = likeness(given, sound, labelled=True)
    assert fingerprints(given, solution.prepared, near, no_progress) == []


@pytest.mark.slow
def test_a_start_that_differs_does_not_hide_what_follows(solution: Solution) -> None:
    """A prior three times as wide differs by one in the logarithm, and yet nothing has diverged."""
    log = solution.log
    wide = family(log, "the prior's covariance").member(3.0)
    noise = family(log, "the speed's part of Q").member(2.0)
    given = handed_in(run(solution, together(wide, noise)))
    sound = likeness(given, run(solution, NONE), labelled=True)
    (found,) = fingerprints(given, solution.prepared, sound, no_progress)
    assert found.whole
    assert noise.what in found.fault


def test_a_fault_may_leave_a_motion_without_full_rank(tmp_path: Path) -> None:
    """No smoother can use such a log, but the filter runs. Each sample has a scan."""
    simulate(Course("each", rate_hz=5.0, scan_every=1, duration_s=4.0), 1, tmp_path / "log")
    each = solve(load_log(tmp_path / "log"))
    fault = TriedFaults(each.log).named("the stabilisation noise is left out")
    without = replace(each.prepared, log=present(fault.feed)(each.log))
    with pytest.raises(InputError, match="is singular"):
        _ = without.timeline
    assert_named(each, fault)


@pytest.mark.slow
def test_no_fault_stops_a_filter_that_associates_for_itself() -> None:
    """Whatever a fault does to the numbers: the estimate of a stranger is to be judged."""
    blind = solve(without_labels(of_speeds_and_yaw_rates(3.0)))
    searched = TriedFaults(blind.log)
    members = (one.member(1.5 * one.neutral + 0.1) for one in searched.numbered[::3])
    faults = (*searched.single[::8], *members)
    with np.errstate(all="ignore"):
        found = [tried(blind, one) for one in faults]
    assert sum(one is not None for one in found) > 0.9 * len(faults)


@pytest.mark.parametrize(("beside", "named"), [("fed", "planted"), ("planted", "fed")])
def test_a_plant_is_looked_for_beside_numbers_that_are_not_planted(beside: str, named: str) -> None:
    """The planted fault leaves the least, but two plants may be in the same place."""

    def plant(ekf: Ekf) -> None:
        """Nothing is run."""

    left = np.array((1.0, 1.0, 1.0))
    faults = [
        (Fault("planted", plant=plant), np.array((-1.0, -1.0, 0.1))),
        (Fault("fed", feed=lambda log: log), np.array((-1.0, -1.0, 0.2))),
    ]
    number = {
        "fed": Family("a log's number {}", feed=lambda log, number: log),
        "planted": Family("a filter's number {}", plant=lambda number: plant),
    }[beside]
    slope = np.array((0.1, 0.0, 1.0))
    first = next(iter(LinearEffects(faults, [(number, slope)], 3).likely(left)))
    assert (first.base.what, first.families) == (named, (number,))


def test_sets_of_faults_leave_the_least() -> None:
    """Of all that there are; a greedy choice begins with one that is in none of the best."""
    rng = np.random.default_rng(5)
    slopes = rng.normal(size=(12, 30))
    left = slopes[[2, 5, 9]].sum(axis=0) + 0.1 * rng.normal(size=30)
    slopes[0] = left + 0.9 * np.linalg.norm(left) * np.eye(30)[0]
    families = [Family(f"{{}} {k}", feed=lambda log, number: log) for k in range(12)]
    effects = LinearEffects([], list(zip(families, slopes, strict=True)), 30)

    def rest(rows: Sequence[int]) -> float:
        some = slopes[list(rows)].T
        return float(np.linalg.norm(left - some @ np.linalg.lstsq(some, left)[0]))

    chosen = [tuple(map(families.index, one.families)) for one in effects.likely(left)]
    for count in (2, 3):
        best = min(combinations(range(12), count), key=rest)
        assert next(one for one in chosen if len(one) == count) == best
    assert min(range(12), key=lambda row: rest([row])) not in best


SHIFT_M = np.array((5.0, -3.0, 0.0))


@pytest.mark.parametrize(
    ("gap", "moved"),
    [
        ("time", lambda given: replace(given, time_s=given.time_s + 0.2)),
        (
            "frame",
            lambda given: replace(
                given, pose=given.pose + SHIFT_M, landmark=given.landmark + SHIFT_M[:2]
            ),
        ),
    ],
)
def test_a_motion_that_leaves_rounding_ends_the_search(
    solution: Solution, gap: str, moved: Callable[[ExternalEstimate], ExternalEstimate]
) -> None:
    """Before any filter but the reference EKF is run."""
    given = moved(handed_in(run(solution, NONE)))
    with counted_steps() as counter:
        found = check(solution.log, given)
    assert counter.steps <= 5 * len(solution.prepared.timeline.control)
    assert found.causes[0].gap == gap
    assert "with this corrected, the estimate equals the reference EKF" in found.causes[0].evidence


def test_a_motion_that_leaves_more_does_not() -> None:
    """Nor is an estimate beside it said to be equal: its covariances are wider."""
    solution = solve(of_speeds_and_yaw_rates(3.0))
    sound = handed_in(run(solution, NONE))
    given = replace(
        sound, time_s=sound.time_s + 0.2, pose_covariance=1.5 * present(sound.pose_covariance)
    )
    assert check_external(given, solution).motion is None


def test_steps_without_a_turn_say_nothing_of_their_integration() -> None:
    """Nearly half of a drive is straight."""
    log = of_speeds_and_yaw_rates(6.0)
    assert isinstance(log.odometry, VelocityOdometry)
    turns = log.odometry.yaw_rate_radps * (np.arange(len(log.odometry.time_s)) % 20 >= 9)
    log = replace(log, odometry=replace(log.odometry, yaw_rate_radps=turns))
    prepared = solve(log).prepared
    timeline = prepared.timeline
    times_s = np.append(timeline.step_begin_s[0], timeline.step_end_s)
    euler = replace(prepared, log=replace(log, integration="euler"))
    given = handed_in(present(filter_named(EKF, euler, times_s, lambda ekf: FilterObservers())))
    assert integrations_by_steps(given, prepared) == ("euler",)


def test_what_lasts_longest_explains_most() -> None:
    """Whatever is left until then."""
    short = Fingerprint("f", "short", 1e-8, until_s=1.0)
    long = Fingerprint("f", "long", 1e-7, until_s=6.0)
    whole = Fingerprint("f", "whole", 1e-5)
    assert sorted((short, long, whole), key=lambda one: one.rank) == [whole, long, short]


@pytest.mark.parametrize("share", [0.4, 0.7])
def test_what_parts_in_the_first_half_is_no_explanation(solution: Solution, share: float) -> None:
    """An estimate of a fault up to a share of the time, and of nothing from there on."""
    fault = present(next(one for one in NAMED if one.name == "innovation subtracted"))
    given, sound = handed_in(run(solution, fault)), run(solution, NONE)
    late = np.arange(len(given.time_s)) > share * len(given.time_s)
    given = replace(given, pose=given.pose + 1e3 * late[:, None])
    near = likeness(given, sound, labelled=True)
    trial = FaultTrial(given, solution.prepared, near, Way("", solution.log, EKF))
    found = trial.of(fault).explained
    assert (found is not None) == (share > LEAST_SHARE)
    if found is not None:
        assert not found.whole
        assert found.share == pytest.approx(share, abs=0.05)
        until = f"over {100.0 * found.share:.0f} % of the time, until another difference begins"
        assert until in fault_cause(found, near).evidence


def test_stamps_since_1970_leave_a_part_of_a_sigma(solution: Solution) -> None:
    """Some last places of a stamp, at the estimate's speed; none where times count from 0."""
    reference = run(solution, NONE)
    given = handed_in(reference)
    sound = likeness(given, reference, labelled=True)
    assert stamp_rounding(given, sound, 0.0) == 0.0
    assert 1e-6 < stamp_rounding(given, sound, 1.7e9) <= 1e-3
    fast = replace(given, pose=given.pose * (1e6, 1.0, 1.0))
    assert stamp_rounding(fast, sound, 1.7e9) == 1e-3


def test_a_start_of_its_own_is_named(solution: Solution) -> None:
    """Whatever its size, which a fit from the log's would not reach."""
    prior = np.diag((0.3, 0.2, 0.1)) * np.diag(solution.log.prior.covariance) * 1e5
    fault = own_start(solution.log, prior)
    assert "is 3e+04, 2e+04, 1e+04 times the log's" in fault.what
    assert_named(solution, fault)


def test_a_start_with_exchanged_rows_is_named_by_them(solution: Solution) -> None:
    """Of a prior whose rows differ; what is near it is named by its size."""
    prior = np.diag((1e-4, 4e-4, 1e-6))
    log = replace(solution.log, prior=replace(solution.log.prior, covariance=prior))
    order = [2, 1, 0]
    exchanged = prior[np.ix_(order, order)]
    assert "rows of x and the heading" in own_start(log, exchanged).what
    assert "is 0.0101, 1, 100 times the log's" in own_start(log, exchanged * (1.01, 1, 1)).what
    assert own_start(log, np.sqrt(prior)).what.endswith("contains sigmas, not their squares")


def sound_filters(solution: Solution) -> list[Reference]:
    others = SoundFilters(solution.prepared).variants(solution.estimate.time_s)
    return [run(solution, NONE), *(one for one in others if one.name not in APART)]


def test_sound_filters_are_within_the_spread_of_the_others(solution: Solution) -> None:
    """All but those two that are the most apart."""
    sound, apart = sound_filters(solution), []
    for one in sound:
        others = [other for other in sound if other is not one]
        found = [likeness(handed_in(one), other, labelled=True) for other in others]
        near = min(found, key=lambda each: each.farthest)
        if not within_spread(near, others, labelled=True):
            apart.append(one.name)
    assert set(apart) <= {"a first-estimates EKF", "a right-invariant EKF"}


@pytest.mark.parametrize(
    "broken",
    [
        lambda given: replace(given, pose=given.pose + np.array((0.0, 0.0, 0.01))),
        lambda given: replace(given, pose_covariance=1.5 * given.pose_covariance),
        lambda given: replace(given, landmark=given.landmark[::-1].copy()),
        lambda given: replace(given, joint_covariance=1.5 * given.joint_covariance),
        lambda given: replace(
            given, landmark_id=given.landmark_id[1:], landmark=given.landmark[1:],
            landmark_covariance=None, joint_covariance=None,
        ),
    ],
)  # fmt: skip
def test_what_no_sound_filter_does_is_beyond_their_spread(
    solution: Solution, broken: Callable[[ExternalEstimate], ExternalEstimate]
) -> None:
    sound = sound_filters(solution)
    given = handed_in(sound[1])
    near = likeness(given, sound[0], labelled=True)
    assert within_spread(near, sound, labelled=True)
    near = likeness(broken(given), sound[0], labelled=True)
    assert not within_spread(near, sound, labelled=True)


@pytest.mark.slow
def test_a_mean_of_two_sound_filters_is_like_them(solution: Solution) -> None:
    """What is twenty times as far is not."""
    by_name = {one.name: one for one in sound_filters(solution)}
    first = by_name["an iterated EKF"]
    apart = by_name["an unscented Kalman filter"].pose - first.pose
    for share, outcome in ((0.5, "agree"), (20.0, "disagree")):
        given = replace(handed_in(first), pose=first.pose + share * apart)
        found = check(solution.log, given, CheckConfig(require="like"))
        assert (found.outcome, found.grade.value == "like") == (outcome, outcome == "agree")


def seen_from_the_vehicle(x: Array) -> Array:
    """Origin and landmarks of (3 + 2 L,) in the vehicle's frame, and the map's heading."""
    places = np.concatenate(([0.0j], x[3:].reshape(-1, 2) @ (1.0, 1.0j)))
    own = (places - complex(x[0], x[1])) * np.exp(-1j * x[2])
    origin, *landmarks = np.column_stack((own.real, own.imag))
    return np.concatenate((origin, [-x[2]], np.ravel(landmarks)))


def test_a_robocentric_update_is_one_in_the_vehicles_frame() -> None:
    """Mean and covariance by the change of coordinates itself, its Jacobian by differences."""
    rng = np.random.default_rng(5)
    pose = np.array((3.0, -2.0, 0.7))
    root = rng.normal(size=(7, 7))
    state = RobocentricState(pose, 0.01 * root[:3, :3] @ root[:3, :3].T)
    by_pose, by_z = rng.normal(size=(2, 2, 3)), np.tile(np.eye(2), (2, 1, 1))
    noise = np.tile(0.02 * np.eye(2), (2, 1, 1))
    state.augment(NewLandmarks(np.array(((6.0, 1.0), (2.0, 5.0))), by_pose, by_z), noise)
    before, p = state.mean.copy(), state.covariance.copy()
    h, nu, r = rng.normal(size=(2, 7)), np.array((0.3, -0.2)), 0.05 * np.eye(2)
    state.update(np.arange(7), h, nu, r)

    to_own = central_difference(seen_from_the_vehicle, before)
    own_h, own_p = h @ np.linalg.inv(to_own), to_own @ p @ to_own.T
    gain = own_p @ own_h.T @ np.linalg.inv(own_h @ own_p @ own_h.T + r)
    expected = seen_from_the_vehicle(before) + gain @ nu
    assert np.allclose(seen_from_the_vehicle(state.mean), expected, rtol=0.0, atol=1e-9)
    after = central_difference(seen_from_the_vehicle, state.mean)
    reduced = own_p - gain @ own_h @ own_p
    assert np.allclose(after @ state.covariance @ after.T, reduced, rtol=0.0, atol=1e-8)
    assert not np.allclose(state.mean, before + p @ h.T @ np.linalg.solve(h @ p @ h.T + r, nu))
