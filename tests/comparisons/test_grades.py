"""Grades of external estimates: what is equal to a filter, like it, plausible, or wrong."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.filter_variants import (
    BackwardEkf,
    FirstEstimatesEkf,
    InvariantEkf,
    IteratedEkf,
    NewFirstEkf,
    NewFirstSequentialEkf,
    SequentialEkf,
    SigmaPoints,
    UnknownFirstSequentialEkf,
    UnscentedEkf,
    unscented,
)
from comparisons.adapters.reference_filter import run_reference
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.checks.agreement import Gap, VarianceBand
from comparisons.checks.diagnosis.covariance_signatures import fit
from comparisons.checks.external_agreement import _whole, compare_external
from comparisons.checks.grade import (
    GRADES,
    EstimatePart,
    Grade,
    Graded,
    _missing,
    joint_pair,
    outcome_of,
)
from comparisons.config import EkfConfig, RequiredGrade
from comparisons.covariances import eigenvalue_ranges
from comparisons.estimates.external import ExternalEstimate, read_external
from comparisons.estimates.folder import write_estimate
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.grading import by_trace, check_external
from comparisons.logs.log import Log
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.pipeline.references import reference_ekf
from comparisons.pipeline.solve import Solution, solve
from comparisons.words import Cause
from ekf_reference.core.ekf import Ekf
from research.trust.check import of_run
from research.trust.exports import EXPORTS, FEEDS
from tests.commands import slamcheck
from tests.helpers import present


@pytest.fixture(scope="module")
def solution() -> Solution:
    return solve(simulate(np.random.default_rng(0), Drive(noise_scale=0.3, loop_s=15.0)))


def filtered(log: Log, solution: Solution, kind: type[Ekf] = Ekf) -> ExternalEstimate:
    """What a filter that was fed a log knew at the solution's instants."""
    run = run_reference(log, build_timeline(log), settle(EkfConfig(), log), kind=kind)
    return of_run(run, solution.estimate.time_s)


@pytest.fixture(scope="module")
def right(solution: Solution) -> ExternalEstimate:
    return filtered(solution.log, solution)


def nearest(found: ExternalCheck) -> str:
    return present(found.grade.by).reference.name


def evidence(found: ExternalCheck) -> str:
    return " ".join([*(one.evidence for one in found.causes), *found.remarks])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (Ekf, "the reference EKF"),
        (IteratedEkf, "an iterated EKF"),
        (SequentialEkf, "an EKF with sequential (one landmark at a time) updates"),
        (BackwardEkf, "an EKF with sequential (one landmark at a time) updates, last first"),
        (NewFirstEkf, "an EKF that initialises new landmarks before it updates"),
        (
            NewFirstSequentialEkf,
            "an EKF with sequential (one landmark at a time) updates, "
            "new landmarks initialised first",
        ),
        (
            UnknownFirstSequentialEkf,
            "an EKF with sequential (one landmark at a time) updates, "
            "new landmarks initialised with a vast covariance",
        ),
        (FirstEstimatesEkf, "a first-estimates EKF"),
        (InvariantEkf, "a right-invariant EKF"),
        (UnscentedEkf, "an unscented Kalman filter"),
    ],
)
def test_a_sound_filter_is_equal_to_its_own_kind(
    solution: Solution, kind: type[Ekf], name: str
) -> None:
    found = check_external(filtered(solution.log, solution, kind), solution, "equal")
    assert (found.grade.value, nearest(found), found.outcome) == ("equal", name, "agree")
    assert not found.causes


class Once(IteratedEkf):
    most_iterations = 1


def test_one_iteration_is_the_ekf(solution: Solution, right: ExternalEstimate) -> None:
    once = filtered(solution.log, solution, Once)
    assert np.allclose(once.pose, right.pose, rtol=0.0, atol=1e-10)
    assert not np.allclose(filtered(solution.log, solution, IteratedEkf).pose, right.pose)


def quadratic(x: Array) -> Array:
    return x**2 + 3.0 * x


def test_the_unscented_transform_is_exact_to_second_order() -> None:
    """Of x^2 + 3 x: mean m^2 + s^2 + 3 m, slope 2 m + 3, and 2 s^4 that the slope leaves over."""
    m, variance = 0.7, 0.04
    points = SigmaPoints(spread=1e-4, central=2.0 - 1e-4)
    y = unscented(np.array([m]), np.array([[variance]]), quadratic, points=points)
    assert y.mean[0] == pytest.approx(m**2 + variance + 3.0 * m)
    assert y.slope[0, 0] == pytest.approx(2.0 * m + 3.0)
    assert y.rest[0, 0] == pytest.approx(2.0 * variance**2, rel=1e-6)
    assert y.mean[0] != pytest.approx(quadratic(np.array([m]))[0])  # as without the shift


def test_the_reference_speaks_of_any_instant(solution: Solution) -> None:
    """Half way into a step as the filter that stops there; not as at the step's beginning."""
    log = solution.log
    config, plain = settle(EkfConfig(), log), build_timeline(log)
    run = present(run_reference(log, plain, config))
    at = np.array([5.0125])
    stopping = present(run_reference(log, build_timeline(log, None, at), config))
    row = int(np.argmin(np.abs(stopping.time_s - at)))
    pose, covariance = run.at(at)
    assert np.allclose(pose[0], stopping.pose[row], atol=1e-12)
    assert np.allclose(covariance[0], stopping.covariance[row], rtol=1e-9)
    assert not np.allclose(pose[0], run.at(np.array([5.0]))[0][0], atol=1e-4)


NAMED = {
    "all covariances 3 times": "your covariance is 3.0 times that of the reference EKF",
    "all covariances a third": "your covariance is 0.33 times",
    "pose covariances in the body's frame": "in the body frame instead of the log's frame",
    "pose covariances 10 times, all but the last": "10.0 times those of the reference EKF, in all "
    "directions, all but the last",
    "pose covariances without correlations": "without the correlations",
    "sigmas for variances of poses": "standard deviations instead of variances",
    "information of poses": "information matrices",
    "pose covariances in the order heading, x, y": "in the order heading, x, y",
    "heading's covariance in degrees": "the heading is in degrees",
    "pose covariances one scan late": "those of the previous pose",
    "the last covariance for all poses": "the same for all poses",
    "pose covariances' upper triangle": "not symmetric",
    "pose covariances negative": "none is positive definite",
    "landmark covariances 3 times": "your landmark covariances are 3.0 times",
    "covariances of pose and map dropped": "without the cross-covariances of pose and landmarks",
    "all cross-covariances dropped": "without any cross-covariances",
    "covariances of pose and map negated": "of opposite sign",
    "landmark covariances in another order": "those of other landmarks",
    "frame shifted by 0.1 m": "the trajectory is shifted by (0.100, 0.100) m; with this corrected",
    "headings off by 1 degree": "all headings differ by 1.0 degrees",
    "headings clockwise": "clockwise",
    "mirrored path": "is mirrored",
    "stamps one scan late": "the time stamps are 0.2",
    "path of another point": "0.300 m behind",
    "one pose off by 0.5 m": "1 of 76 poses",
    "path cut at 60 %": "of 15.0 s: it ends at",
    "path starts at 40 %": "of 15.0 s: it begins at",
    "two landmarks exchanged": "2 landmarks coincide with others: ",
    "a third of the map missing": "landmarks of the log are missing in the map",
}
"""Faults of exports, and what the report has to say of them."""


@pytest.mark.parametrize("name", NAMED)
def test_a_fault_is_not_like_a_filter_and_is_named(
    solution: Solution, right: ExternalEstimate, name: str
) -> None:
    found = check_external(EXPORTS[name](right), solution, "like")
    assert found.grade.value in ("plausible", "wrong", None)
    assert found.outcome == "disagree"
    assert NAMED[name] in evidence(found)


@pytest.mark.parametrize(
    ("which", "said"),
    [
        (0, "those from before the measurement update"),
        (1, "those of the next prediction: the recorded array was overwritten"),
        (2, "those of the next pose: the recorded array was overwritten"),
    ],
)
def test_covariances_of_another_moment_are_named(
    solution: Solution, right: ExternalEstimate, which: int, said: str
) -> None:
    """Those of the next prediction, and of the next pose, are kept where P is not copied."""
    own = present(right.pose_covariance)
    before = present(reference_ekf(solution.prepared, right.time_s))[1][1]
    moments = (before, np.concatenate((before[1:], own[-1:])), np.concatenate((own[1:], own[-1:])))
    given = replace(right, pose_covariance=moments[which])
    assert said in evidence(check_external(given, solution, "like"))
    assert said not in evidence(check_external(right, solution, "like"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["R a third", "Q 3 times", "bearing off by 0.5 degrees"])
def test_a_filter_that_was_fed_something_else_is_not_like_one(
    solution: Solution, name: str
) -> None:
    found = check_external(filtered(FEEDS[name](solution.log), solution), solution, "like")
    assert found.outcome == "disagree"


@pytest.mark.parametrize(
    ("factor", "require", "outcome"),
    [
        (1.0, "equal", "agree"),
        (1.04, "equal", "disagree"),
        (1.04, "like", "agree"),
        (1.5, "like", "disagree"),
        (1.5, "plausible", "agree"),
        (3.0, "plausible", "disagree"),
        (1.0 / 3.0, "plausible", "disagree"),
    ],
)
def test_the_required_grade_decides(
    solution: Solution, right: ExternalEstimate, factor: float, require: RequiredGrade, outcome: str
) -> None:
    other = replace(right, pose_covariance=factor * present(right.pose_covariance))
    found = check_external(other, solution, require)
    assert found.outcome == outcome
    assert bool(found.causes) == (outcome == "disagree")


def test_what_calls_itself_an_ekf_has_to_be_like_one(
    solution: Solution, right: ExternalEstimate
) -> None:
    half_right = EXPORTS["all covariances 1.5 times"](right)
    assert check_external(half_right, solution).outcome == "agree"
    claimed = check_external(replace(half_right, estimator="ekf"), solution)
    assert (claimed.grade.required, claimed.outcome) == ("like", "disagree")


@pytest.fixture
def unverified(solution: Solution) -> Solution:
    optimality = solution.result.optimality
    test = replace(optimality.chi_square, chi2=1e9)
    result = replace(
        solution.result, optimality=replace(optimality, agreeing=("tracked",), chi_square=test)
    )
    assert not result.optimality.verified
    return replace(solution, result=result)


def test_an_optimum_that_is_not_verified_leaves_open_what_needs_it(
    unverified: Solution, right: ExternalEstimate
) -> None:
    assert check_external(right, unverified, "like").outcome == "agree"
    assert check_external(EXPORTS["all covariances 1.5 times"](right), unverified).outcome == (
        "unverified"
    )
    three_times = check_external(EXPORTS["all covariances 3 times"](right), unverified, "like")
    assert (three_times.grade.value, three_times.outcome) == (None, "disagree")
    smoothed = check_external(ExternalEstimate.of(unverified.estimate), unverified)
    assert smoothed.outcome == "unverified"


@pytest.mark.slow
def test_a_smoother_is_compared_with_the_smoother(solution: Solution) -> None:
    found = check_external(ExternalEstimate.of(solution.estimate), solution, "equal")
    assert (found.outcome, nearest(found)) == ("agree", "the smoother")
    as_filter = check_external(
        replace(ExternalEstimate.of(solution.estimate), information="filtered"), solution, "like"
    )
    assert as_filter.outcome == "disagree"
    assert "uses later measurements" in evidence(as_filter)
    bare = ExternalEstimate(time_s=solution.estimate.time_s, pose=solution.estimate.pose)
    assert check_external(bare, solution, "like").outcome == "agree"
    optimum = present(found.grade.by).reference
    alone = compare_external(
        ExternalEstimate.of(solution.estimate), optimum, peers=(), labelled=True
    )
    assert (alone.band, alone.against) == (VarianceBand(0.5, 2.0), ())


def test_a_filters_map_is_near_the_optimum_in_the_same_directions(
    solution: Solution, right: ExternalEstimate
) -> None:
    by = present(check_external(right, solution).grade.by)
    optimum = check_external(ExternalEstimate.of(solution.estimate), solution).grade.by
    found = present(_whole(by.reference, present(optimum).reference, labelled=True))
    assert found.agrees
    assert 0.0 < found.distance_sigma < 0.5
    tripled = EXPORTS["all covariances 3 times"](ExternalEstimate.of(solution.estimate))
    assert "3.0 times that of the smoother" in evidence(check_external(tripled, solution, "like"))


def test_single_precision_is_allowed_for(solution: Solution, right: ExternalEstimate) -> None:
    names = ("pose", "landmark", "pose_covariance", "landmark_covariance", "joint_covariance")
    stored = {name: getattr(right, name).astype(np.float32).astype(float) for name in names}
    found = check_external(replace(right, **stored), solution, "equal")
    assert found.outcome == "agree"
    assert "single precision" in evidence(found)
    nudged = replace(right, pose_covariance=present(right.pose_covariance) * (1.0 + 1e-5))
    assert check_external(nudged, solution, "equal").outcome == "disagree"


def test_a_start_that_is_known_exactly_has_no_covariance(solution: Solution) -> None:
    """Where the log knows it, too; a later pose without one is a fault."""
    log = solution.log
    exact = solve(replace(log, prior=replace(log.prior, covariance=1e-14 * np.eye(3))))
    given = filtered(exact.log, exact)
    for row, outcome in ((0, "agree"), (5, "disagree")):
        without = present(given.pose_covariance).copy()
        without[row] = 0.0
        found = check_external(replace(given, pose_covariance=without), exact, "like")
        assert found.outcome == outcome, evidence(found)


def test_eigenvalues_are_those_of_the_pair() -> None:
    second = np.array([[[2.0, 0.5], [0.5, 1.0]]])
    low, high = eigenvalue_ranges(3.0 * second, second)
    assert (low[0], high[0]) == (pytest.approx(3.0), pytest.approx(3.0))
    skewed = np.eye(2)[None] + np.array([[0.0, 0.2], [0.0, 0.0]])
    largest = eigenvalue_ranges(skewed, np.eye(2)[None])[1]
    assert largest[0] == pytest.approx(1.2)  # 1.1 of its even part
    low, high = eigenvalue_ranges(second, -second)
    assert (low[0], high[0]) == (-np.inf, np.inf)


def test_a_factor_is_fitted_where_one_covariance_is_negative() -> None:
    expected = np.tile(np.diag((1.0, 2.0)), (60, 1, 1))
    given = 3.0 * expected
    given[0] *= -1.0  # a broken variant takes the root of it
    found = present(fit(given, expected))
    assert found.factor == pytest.approx(3.0)
    assert np.flatnonzero(found.exceptions).tolist() == [0]


def test_what_is_not_a_number_is_not_like_anything() -> None:
    none = np.full(2, np.nan)
    assert EstimatePart("poses", np.zeros(2), none, none).within(0.05, 0.05)
    assert not EstimatePart("poses", none, none, none).within(0.05, 0.05)
    assert not EstimatePart("poses", np.zeros(2), np.zeros(2), np.full(2, np.inf)).within(
        0.05, 0.05
    )


def test_what_single_precision_may_change_is_added_to_each_limit() -> None:
    """The limits themselves are within."""
    at_the_limit = EstimatePart("poses", np.ones(1), np.ones(1), np.array([1.25]), (0.5, 0.125))
    assert at_the_limit.within(0.5, 0.125)
    assert not at_the_limit.within(0.25, 0.125)
    assert not at_the_limit.within(0.5, 0.0625)


@pytest.mark.parametrize(
    ("time_s", "said"),
    [
        ([5.0, 60.0, 100.0], []),
        ([5.5, 60.0, 100.0], ["the trajectory starts at 5.5 s, the log at 0.0 s"]),
        ([0.0, 60.0, 90.0], ["the trajectory ends at 90.0 s, the log at 100.0 s"]),
    ],
)
def test_a_path_may_start_a_twentieth_late(
    solution: Solution, right: ExternalEstimate, time_s: list[float], said: list[str]
) -> None:
    near = present(check_external(right, solution).grade.by).reference
    known = np.ones(len(time_s), dtype=bool)
    part = replace(near, span_s=(0.0, 100.0), time_s=np.array(time_s), known=known)
    assert list(_missing(part)) == said


def test_the_last_pose_is_compared_jointly_where_both_know_it(
    solution: Solution, right: ExternalEstimate
) -> None:
    found = present(check_external(right, solution).grade.by)
    rows, size = (found.ours, found.theirs), 2 * len(found.ours)
    assert not found.single
    for joint_s, more in ((found.reference.joint_s, 3), (found.reference.joint_s + 1.0, 0)):
        pair = present(joint_pair(right, replace(found.reference, joint_s=joint_s), rows))
        assert [one.shape for one in pair] == [(size + more, size + more)] * 2


@pytest.mark.slow
def test_the_command_takes_what_is_required(tmp_path: Path, solution: Solution) -> None:
    """Of an estimate folder that calls itself an EKF, but is 1.5 times as uncertain."""
    from comparisons.adapters.ekf_run import run_ekf
    from comparisons.logs.bundled import open_log

    log = open_log("simulated-loop")
    right = run_ekf(log, build_timeline(log), settle(EkfConfig(), log)).estimate
    wide = replace(
        right,
        pose_covariance=1.5 * right.pose_covariance,
        joint_covariance=1.5 * right.joint_covariance,
    )
    (tmp_path / "mine").mkdir()
    write_estimate(wide, tmp_path / "mine")
    arguments = ("check", "simulated-loop", "--estimate", "mine", "--out")
    assert slamcheck(*arguments, "a", cwd=tmp_path).returncode == 0
    strict = slamcheck(*arguments, "b", "--require", "like", cwd=tmp_path)
    assert strict.returncode == 1, strict.stderr
    assert "your covariance is 1.5 times that of the reference EKF" in strict.stdout
    meta = tmp_path / "mine" / "estimate.toml"
    meta.write_text('estimator = "ekf"\n' + meta.read_text())
    assert read_external(tmp_path / "mine").estimator == "ekf"
    assert slamcheck(*arguments, "c", cwd=tmp_path).returncode == 1


@pytest.mark.parametrize("association_known", [True, False])
@pytest.mark.parametrize("verified", [True, False])
@pytest.mark.parametrize("required", ["plausible", "like", "equal"])
@pytest.mark.parametrize("value", [*GRADES, None])
def test_grade_requirement_and_outcome_never_contradict(
    solution: Solution,
    right: ExternalEstimate,
    value: Grade | None,
    required: RequiredGrade,
    verified: bool,
    association_known: bool,
) -> None:
    """Enough is agreement, less is not; what is open has no grade and no verified reference."""
    near = present(check_external(right, solution).grade.by)
    like = value if value in ("equal", "like") else None
    graded = Graded(value=value, required=required, by=replace(near, grade=like))
    outcome = outcome_of(graded, verified=verified, association_known=association_known)
    if outcome == "agree":
        assert graded.enough
    elif outcome == "disagree":
        assert not graded.enough
        assert association_known or value is not None
    else:
        assert not (verified and association_known)
        assert value in (None, "plausible")


def test_a_trace_that_shows_a_fault_makes_the_grade_wrong() -> None:
    """Beyond 5 % of sigma, and of an estimate that is like no filter; else it is a note."""

    def traced(gap: Gap, *kinds: str) -> Any:
        causes = [Cause(kind, "evidence", "hint") for kind in kinds]
        agreement = SimpleNamespace(algebra=gap, model=Gap(0.0, 0.0))
        return SimpleNamespace(agreement=agreement, verdict=SimpleNamespace(causes=causes))

    def value(given: Grade, gap: Gap, *kinds: str) -> Grade | None:
        graded = Graded(value=given, required="like", by=None)
        return by_trace(graded, traced(gap, *kinds)).value

    assert value("like", Gap(0.06, 0.06), "algebra") == "like"
    assert value("plausible", Gap(0.04, 0.04), "algebra") == "plausible"
    assert value("plausible", Gap(0.0, 0.06), "algebra") == "wrong"
    assert value("plausible", Gap(float("nan"), 0.0), "algebra") == "wrong"
    assert value("like", Gap(0.0, 0.0), "data") == "like"
    assert value("plausible", Gap(0.0, 0.0), "data") == "wrong"
    assert value("plausible", Gap(9.0, 9.0), "linearisation") == "plausible"
