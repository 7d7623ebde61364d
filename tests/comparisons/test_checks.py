from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from comparisons import covariances, statistics
from comparisons.checks.accuracy import aligned, assess, match_by_distance, relative_errors
from comparisons.checks.agreement import (
    BlockAgreement,
    Gap,
    Gaussian,
    compare,
    gap,
    largest_distance,
)
from comparisons.checks.check import Answers
from comparisons.checks.registry import OF_FILTER
from comparisons.checks.verdict import Verdict, judge
from comparisons.covariances import eigenvalue_range
from comparisons.jobs.run import Comparison, OwnRecords
from ekf_reference.core.layout import Layout
from graphslam.optimum import Optimality, Stationarity, chi_square_test
from tests.helpers import compared, present, random_covariance, simulated


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compared(simulated(seed=2, loop_s=30.0))


def judged(c: Comparison, *, kind: str = "full", **changed: object) -> Verdict:
    """The verdict on the gaps of a run, of which some are others, and on another filter's."""
    gaps = replace(c.known.gaps, **changed)  # type: ignore[arg-type]
    prepared = replace(c.prepared, ekf=c.prepared.ekf.model_copy(update={"filter": kind}))
    before = replace(
        c.known,
        prepared=prepared,
        solved=(gaps.result, gaps.smoothed),
        kept=OwnRecords(gaps, prepared),
        findings={},
        absent={},
    )
    return judge(Answers(before, OF_FILTER).known)


def gaussian(seed: int) -> Gaussian:
    rng = np.random.default_rng(seed)
    return Gaussian(rng.standard_normal(7), random_covariance(rng, 7), Layout.packed(3, 2))


def test_a_gaussian_has_no_gap_to_itself() -> None:
    same = gaussian(0)
    nothing = compare(same, same, same, same)
    for found in (nothing.algebra, nothing.model, nothing.linearisation):
        assert found.within(1e-12)
    assert nothing.map.distance_sigma == 0.0
    assert np.isclose(nothing.optimism, 1.0)


def test_gaps_land_where_they_arise() -> None:
    e = gaussian(0)
    shifted = replace(e, mean=e.mean + np.eye(7)[4])
    wider = replace(e, covariance=2.0 * e.covariance)
    sigma = np.sqrt(np.diag(e.covariance))
    assert np.isclose(compare(e, shifted, shifted, e).algebra.sigma, 1.0 / sigma[4])
    assert compare(e, shifted, shifted, e).model.sigma == 0.0
    assert np.isclose(compare(e, e, wider, e).model.covariance, 0.5)
    assert np.isclose(compare(e, e, e, wider).optimism, 0.5)
    assert np.isclose(compare(e, e, e, wider).linearisation.covariance, 0.5)


def test_headings_are_compared_on_the_circle() -> None:
    e = gaussian(0)
    turned = replace(e, mean=e.mean + 2 * np.pi * np.eye(7)[2])
    assert compare(e, turned, e, e).algebra.sigma < 1e-12


def test_asymmetry_and_indefiniteness_are_gaps() -> None:
    e = gaussian(0)
    skew = e.covariance.copy()
    skew[0, 5] += 0.1
    sigma = np.sqrt(np.diag(e.covariance))
    assert gap(replace(e, covariance=skew), e, sigma).covariance > 1e-3
    skew = e.covariance.copy()  # even in all that eigenvalues of the even part see
    skew[0, 5] += 0.1
    skew[5, 0] -= 0.1
    odd = replace(e, covariance=skew)
    for found in (gap(odd, e, sigma), gap(e, odd, sigma)):
        assert np.isclose(found.asymmetry, 0.2 / (sigma[0] * sigma[5]))
        assert found.covariance >= found.asymmetry
    assert gap(e, replace(e, covariance=-e.covariance), sigma).covariance == float("inf")
    assert not gap(replace(e, mean=e.mean * np.nan), e, sigma).within(1.0)


@pytest.mark.parametrize(
    ("distance", "least", "largest", "agrees"),
    [
        (0.9, 0.3, 3.0, True),
        (1.1, 0.9, 1.1, False),
        (0.1, 0.2, 1.1, False),
        (0.1, 0.9, 4.5, False),
        (float("nan"), 0.9, 1.1, False),
    ],
)
def test_block_limits(distance: float, least: float, largest: float, agrees: bool) -> None:
    apart, given = np.array((distance * 2**0.5, 0.0)), np.diag((least, largest))
    assert BlockAgreement.of(apart, np.eye(2), given).agrees is agrees


def test_what_lies_on_a_limit_agrees() -> None:
    """One sigma, a quarter of the variance and four times as much."""
    assert BlockAgreement.of(np.ones(2), np.eye(2), np.diag((0.25, 4.0))).agrees


def test_the_worst_of_many_landmarks_is_no_worse_than_that_of_two_hundred() -> None:
    """Sound maps of any size pass alike; with one limit for all the large ones pass hardly ever."""
    rng, passing = np.random.default_rng(0), {}
    for count in (200, 600, 2000):
        square = rng.chisquare(2, (500, count)) / 2.0
        worst = np.sqrt(square.max(axis=1)) / np.sqrt(np.log(200.0 / np.log(2.0)))
        passing[count] = np.mean(worst <= largest_distance(count, 2)), np.mean(worst <= 1.0)
    assert all(abs(own - 0.5) < 0.1 for own, _ in passing.values()), passing
    assert passing[2000][1] < 0.02
    assert {largest_distance(count, 2) for count in (0, 1, 200)} == {1.0}
    assert [round(largest_distance(count, 2), 2) for count in (500, 2000)] == [1.08, 1.19]


def test_each_landmark_is_judged_as_one_of_all() -> None:
    """One of 500 may be farther off than one of 200; the pose may not."""
    for count, agrees in ((200, False), (500, True)):
        layout = Layout.packed(3, count)
        s = Gaussian(np.zeros(layout.size), np.eye(layout.size), layout)
        off = replace(s, mean=s.mean.copy())
        off.mean[[0, 3]] = 1.05 * np.sqrt((3.0, 2.0))
        found = compare(off, off, off, s)
        assert found.landmarks[0].distance_sigma == pytest.approx(1.05)
        assert found.landmarks[0].near == found.landmarks[0].agrees == agrees
        assert not found.pose.near


@pytest.mark.parametrize("value", [0.5, 3.0, 9.0])
def test_a_two_sided_probability_counts_both_tails(value: float) -> None:
    below = 1.0 - np.exp(-0.5 * value)  # chi-square with two degrees of freedom
    assert statistics.two_sided(value, 2.0) == pytest.approx(2.0 * min(below, 1.0 - below))


def test_the_map_as_a_whole_is_judged(comparison: Comparison) -> None:
    """Each landmark may agree while all of them together do not."""
    far = BlockAgreement.of(np.full(2, 10.0), np.eye(2), np.eye(2))
    a = replace(comparison.agreement, map=far)
    verdict = judged(comparison, agreement=a)
    assert verdict.outcome == "disagree"
    assert [cause.gap for cause in verdict.causes] == ["linearisation"]


@pytest.mark.parametrize(
    ("gap_of_algebra", "fails"),
    [
        (Gap(0.01, 0.5, least=1.0), False),
        (Gap(0.06, 0.5, least=1.0), True),
        (Gap(0.01, 0.5, least=0.99), True),
        (Gap(0.01, 0.5, least=1.0, asymmetry=1e-3), True),
    ],
)
def test_a_conservative_filter_may_have_too_much_covariance_alone(
    comparison: Comparison, gap_of_algebra: Gap, fails: bool
) -> None:
    a = replace(comparison.agreement, algebra=gap_of_algebra)
    verdict = judged(comparison, agreement=a, kind="compressed-suboptimal")
    assert (verdict.outcome == "disagree") is fails
    exact = judged(comparison, agreement=a)
    assert exact.outcome == "disagree"


def test_without_proof_there_is_no_agreement(comparison: Comparison) -> None:
    assert comparison.verdict.outcome == "agree"
    plausible = chi_square_test(50.0, 100)
    unverified = Optimality(
        stationarity=Stationarity(0.0, definite=True),
        chi_square=plausible,
        agreeing=("ekf",),
        agreed=False,
    )
    result = replace(comparison.smoother, optimality=unverified)
    verdict = judged(comparison, result=result)
    assert verdict.outcome == "unverified"
    assert [cause.gap for cause in verdict.causes] == ["oracle"]
    assert "only the start ekf reached the lowest error" in verdict.causes[0].evidence


def test_a_red_algebra_gap_needs_no_oracle(comparison: Comparison) -> None:
    unverified = Optimality(
        stationarity=Stationarity(1.0, definite=False),
        chi_square=chi_square_test(9e9, 100),
        agreeing=(),
        agreed=False,
    )
    a = comparison.agreement
    red = replace(a, algebra=replace(a.algebra, covariance=float("inf")))
    result = replace(comparison.smoother, optimality=unverified)
    verdict = judged(comparison, agreement=red, result=result)
    assert verdict.outcome == "disagree"
    assert [cause.gap for cause in verdict.causes] == ["algebra"]


@pytest.mark.parametrize(("sigma", "named"), [(1e-9, []), (1.0, ["model"])])
def test_a_model_gap_is_named_where_rounding_does_not_explain_it(
    comparison: Comparison, sigma: float, named: list[str]
) -> None:
    a = replace(comparison.agreement, model=Gap(sigma, 0.0))
    verdict = judged(comparison, agreement=a)
    assert [cause.gap for cause in verdict.causes] == named


def test_alignment_is_rigid_and_without_scale() -> None:
    rng = np.random.default_rng(0)
    reference = rng.standard_normal((20, 2))
    cos, sin = np.cos(2.0), np.sin(2.0)
    moved = reference @ np.array(((cos, -sin), (sin, cos))) + (5.0, -3.0)
    assert np.allclose(aligned(moved, reference), reference, atol=1e-12)
    stretched = aligned(1.1 * moved, reference)
    assert np.isclose(np.ptp(stretched), 1.1 * np.ptp(reference), rtol=0.1)
    assert not np.allclose(stretched, reference, atol=0.05)


def test_robust_alignment_leaves_outliers_aside() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-20, 20, (40, 2))
    reference = points + (1.0, 2.0)
    reference[:8] += 30.0
    good = slice(8, None)
    robust = aligned(points, reference, robust=True)[good] - reference[good]
    plain = aligned(points, reference)[good] - reference[good]
    assert np.max(np.abs(robust)) < 0.01
    assert np.min(np.linalg.norm(plain, axis=1)) > 1.0


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (((0.0, 0.0), (0.4, 0.0), (9.0, 9.0)), ((0.1, 0.0), (50.0, 0.0))),
        # Pairs beyond the limit must not compete with those within.
        (((0.0, 0.0), (2.3, 0.0)), ((0.9, 0.0), (-1.4, 0.0))),
    ],
)
def test_matching_is_one_to_one_and_near(ours: tuple[Any, ...], theirs: tuple[Any, ...]) -> None:
    rows, columns = match_by_distance(np.array(ours), np.array(theirs))
    assert (rows.tolist(), columns.tolist()) == ([0], [0])


def test_accuracy_of_the_truth_is_perfect_and_coverage_counts(comparison: Comparison) -> None:
    log, estimate = comparison.log, comparison.ekf.estimate
    truth = log.truth
    perfect = replace(
        estimate,
        time_s=present(truth.poses).time_s,
        pose=present(truth.poses).pose,
        landmark=present(truth.landmarks).position_m[estimate.landmark_id],
    )
    found = present(assess(perfect, log, labelled=True))
    assert found.ate_m == 0.0
    assert found.landmark_rmse_m == 0.0
    assert found.coverage == 1.0
    assert found.landmarks_found == len(estimate.landmark)
    assert found.landmarks_true == 60
    half = replace(perfect, time_s=perfect.time_s[:601], pose=perfect.pose[:601])
    lost = present(assess(half, log, labelled=True))
    assert 0.45 < present(lost.coverage) < 0.55


def test_relative_errors_know_neither_a_frame_nor_what_was_before() -> None:
    """On a straight way of 50 m; a scale and a turn count over the 10 m of a pair alone."""
    x = np.arange(0.0, 50.0, 0.5)
    true = np.column_stack((x, 0.0 * x, 0.0 * x))
    cos, sin = np.cos(0.7), np.sin(0.7)
    moved = np.column_stack((cos * x + 5.0, sin * x - 3.0, 0.0 * x + 0.7 + 2.0 * np.pi))
    apart, turned = relative_errors(moved, true)
    assert len(apart) == 82  # the last two over 9.5 and 9 m
    assert apart == pytest.approx(0.0, abs=1e-9)
    assert turned == pytest.approx(0.0, abs=1e-9)
    apart, turned = relative_errors(true * (1.01, 1.0, 1.0), true)
    assert apart == pytest.approx(0.1, abs=0.0101)
    late = true.copy()
    late[x >= 30.0, 2] += 0.2
    apart, turned = relative_errors(late, true)
    assert np.count_nonzero(turned > 0.1) == 20
    assert len(relative_errors(true[:15], true[:15])[0]) == 0
    assert len(relative_errors(true[:0], true[:0])[0]) == 0


def test_no_reference_no_accuracy(comparison: Comparison) -> None:
    from comparisons.logs.log import Truth

    bare = replace(comparison.log, truth=Truth())
    assert assess(comparison.ekf.estimate, bare, labelled=True) is None


@pytest.mark.parametrize("apart", [1e-9, 0.3])
def test_the_ends_of_many_eigenvalues_are_those_of_all(
    apart: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(5)
    second = random_covariance(rng, 120)
    root = np.linalg.cholesky(second)
    turned = np.linalg.qr(rng.standard_normal((120, 120)))[0]
    spread = 1.0 + apart * np.linspace(-0.7, 1.0, 120) ** 3
    first = root @ (turned * spread) @ turned.T @ root.T
    every = np.array(eigenvalue_range(first, second)) - 1.0
    monkeypatch.setattr(covariances, "DENSE", 10)
    ends = np.array(eigenvalue_range(first, second)) - 1.0
    assert np.allclose(ends, every, rtol=1e-2, atol=0.0)
    assert not np.allclose(0.9 * ends, every, rtol=1e-2, atol=0.0)
    assert eigenvalue_range(first, -second) == (float("-inf"), float("inf"))
    assert eigenvalue_range(second, second) == pytest.approx((1.0, 1.0))
