"""Simulation: exact without noise, consistent with it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from comparisons.compare import Comparison, compare_estimators
from comparisons.runs.estimate import Estimate
from tests.helpers import Array, simulated

SEEDS = 20


@cache
def run(seed: int) -> Comparison:
    return compare_estimators(simulated(seed=seed))


def true_state(c: Comparison) -> Array:
    """Last pose and landmarks, in the estimates' order."""
    truth = c.log.truth
    assert truth.poses is not None
    assert truth.landmarks is not None
    landmarks = truth.landmarks.position_m[c.ekf.estimate.landmark_id]
    return np.concatenate((truth.poses.pose[-1], landmarks.ravel()))


def nees(estimate: Estimate, truth: Array, part: slice) -> float:
    error = (estimate.joint_mean - truth)[part]
    return float(error @ np.linalg.solve(estimate.joint_covariance[part, part], error))


def test_without_noise_both_are_exact() -> None:
    c = compare_estimators(simulated(noise_scale=0.0))
    truth = c.log.truth.poses
    assert truth is not None
    at = truth.pose[np.searchsorted(truth.time_s, c.ekf.estimate.time_s - 1e-9)]
    for estimate in (c.ekf.estimate, c.smoothed):
        assert np.max(np.abs(estimate.pose - at)) < 1e-9
        assert np.max(np.abs(estimate.joint_mean - true_state(c))) < 1e-9
    assert c.smoother.error < 1e-15
    assert c.verdict.outcome == "agree"


@pytest.mark.parametrize("seed", range(SEEDS))
def test_gaps_are_rounding_at_the_documents_noise(seed: int) -> None:
    c = run(seed)
    assert c.agreement.algebra.within(1e-8)
    assert c.agreement.model.within(1e-8)
    assert c.verdict.outcome == "agree"


@pytest.mark.parametrize(("part", "dimension"), [(slice(0, 3), 3), (slice(0, None), 123)])
def test_smoother_is_consistent(part: slice, dimension: int) -> None:
    """Average NEES over the seeds lies in its two-sided 95 % band, pose alone and with the map."""
    values = [nees(run(s).smoothed, true_state(run(s)), part) for s in range(SEEDS)]
    low, high = chi2.ppf((0.025, 0.975), SEEDS * dimension) / SEEDS
    assert low < np.mean(values) < high


def test_the_band_rejects_a_smoother_with_wrong_sigmas() -> None:
    """The same errors against covariances a fifth too small, or too large, fall outside."""
    values = [nees(run(s).smoothed, true_state(run(s)), slice(0, None)) for s in range(SEEDS)]
    low, high = chi2.ppf((0.025, 0.975), SEEDS * 123) / SEEDS
    assert np.mean(values) / 0.8 > high
    assert np.mean(values) / 1.2 < low
