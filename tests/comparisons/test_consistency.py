"""Simulation: exact without noise, consistent with it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from comparisons.checks.consistency.nees import TruthConsistency
from comparisons.estimates.estimate import Estimate
from comparisons.jobs.run import Comparison
from comparisons.statistics import mean_band
from tests.helpers import Array, assert_followed, compared, present, simulated

SEEDS = 20


@cache
def run(seed: int) -> Comparison:
    return compared(simulated(seed=seed))


def true_state(c: Comparison) -> Array:
    """Last pose and landmarks, in the estimates' order."""
    truth = c.log.truth
    landmarks = present(truth.landmarks).position_m[c.ekf.estimate.landmark_id]
    return np.concatenate((present(truth.poses).pose[-1], landmarks.ravel()))


def nees(estimate: Estimate, truth: Array, part: slice) -> float:
    error = (estimate.joint_mean - truth)[part]
    return float(error @ np.linalg.solve(estimate.joint_covariance[part, part], error))


def test_without_noise_both_are_exact() -> None:
    c = compared(simulated(exact=True))
    truth = present(c.log.truth.poses)
    at = truth.pose[np.searchsorted(truth.time_s, c.ekf.estimate.time_s - 1e-9)]
    for estimate in (c.ekf.estimate, c.smoothed):
        assert np.max(np.abs(estimate.pose - at)) < 1e-9
        assert np.max(np.abs(estimate.joint_mean - true_state(c))) < 1e-9
    assert c.smoother.error < 1e-15
    assert c.verdict.outcome == "agree"


def test_the_prior_is_not_among_the_estimates_that_are_judged() -> None:
    """It is often taken from the truth, so that its error is zero whatever it states."""
    c = compared(simulated(loop_s=10.0))
    for found in (c.consistency.ekf, c.consistency.smoother):
        assert found is not None
        assert present(found.poses).time_s.tolist() == c.ekf.estimate.time_s[1:].tolist()
        assert present(found.poses).pose.squared.min() > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(SEEDS))
def test_gaps_are_rounding_at_the_documents_noise(seed: int) -> None:
    c = run(seed)
    assert_followed(c, 1e-8)
    assert c.verdict.outcome == "agree"


@pytest.mark.slow
@pytest.mark.parametrize(("part", "dimension"), [(slice(0, 3), 3), (slice(0, None), 123)])
def test_smoother_is_consistent(part: slice, dimension: int) -> None:
    """Average NEES over the seeds lies in its two-sided 95 % band, pose alone and with the map."""
    values = [nees(run(s).smoothed, true_state(run(s)), part) for s in range(SEEDS)]
    low, high = chi2.ppf((0.025, 0.975), SEEDS * dimension) / SEEDS
    assert low < np.mean(values) < high


@pytest.mark.slow
def test_the_band_rejects_a_smoother_with_wrong_sigmas() -> None:
    """The same errors against covariances a fifth too small, or too large, fall outside."""
    values = [nees(run(s).smoothed, true_state(run(s)), slice(0, None)) for s in range(SEEDS)]
    low, high = chi2.ppf((0.025, 0.975), SEEDS * 123) / SEEDS
    assert np.mean(values) / 0.8 > high
    assert np.mean(values) / 1.2 < low


@pytest.mark.slow
def test_the_filters_innovations_fit_over_all_seeds() -> None:
    """Averages of some 37,000 numbers, each a standard normal one squared."""
    sensors = [run(s).consistency.sensors[0] for s in range(SEEDS)]
    for i in range(3):
        nis = [one.nis[i] for one in sensors]
        count = sum(one.count for one in nis)
        mean = sum(one.count * one.mean for one in nis) / count
        assert mean_band(count, nis[0].dof).holds(mean)
    least = min(white.p_value for one in sensors for white in one.whiteness)
    assert least > 0.01 / (4 * SEEDS)


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["ekf", "smoother"])
def test_nees_of_what_no_frame_touches(estimator: str) -> None:
    found = []
    for s in range(SEEDS):
        truth: TruthConsistency = getattr(run(s).consistency, estimator)
        whole = nees(
            run(s).ekf.estimate if estimator == "ekf" else run(s).smoothed,
            true_state(run(s)),
            slice(0, None),
        )
        assert present(truth.whole).squared[0] == pytest.approx(whole)
        found.append(present(truth.distances))
    dof = sum(one.dof for one in found)
    total = sum(float(one.squared[0]) for one in found)
    low, high = chi2.ppf((0.005, 0.995), dof)
    assert low < total < high
    assert not low < total / 0.8 < high
    assert not low < total / 1.25 < high


@pytest.mark.slow
def test_filter_against_smoother_over_all_seeds() -> None:
    """Runs are independent, epochs are not: one epoch of each, halfway."""
    squared, dof = 0.0, 0
    for s in range(SEEDS):
        compared = present(run(s).consistency.smoothed)
        middle = len(compared.time_s) // 2
        squared += float(compared.squared[middle])
        dof += int(compared.dof[middle])
        assert len(compared.overconfident) < 0.05 * len(compared.time_s)
    assert mean_band(1, dof).holds(squared)


@pytest.mark.parametrize(
    ("scale", "reading", "words"),
    [
        (0.5, "too low", "is too low: smaller innovations than"),
        (2.0, "too high", "is too high: larger innovations than"),
    ],
)
def test_wrong_sigmas_of_a_sensor_are_named_with_their_direction(
    scale: float, reading: str, words: str
) -> None:
    """The range's noise is another than the log states; the bearing's is right."""
    log = simulated(seed=0, loop_s=20.0)
    honest = simulated(seed=0, loop_s=20.0, sigma_range_m=0.15 * scale)
    seen = replace(honest.measurements, sigma_range_m=log.measurements.sigma_range_m)
    c = compared(replace(log, measurements=seen))
    both, by_range, bearing = c.consistency.sensors[0].nis
    assert (both.reading, by_range.reading, bearing.reading) == (reading, reading, "plausible")
    reported = [
        remark
        for remark in c.verdict.remarks
        if remark.startswith("mean NIS of range (measurements)")
    ]
    assert len(reported) == 1
    assert words in reported[0]
    assert not any(
        remark.startswith("mean NIS of bearing (measurements)") for remark in c.verdict.remarks
    )
