"""Landmarks begun both ways, and how the map's correlations develop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ekf_reference.core.correlation import correlation_coefficients

from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig
from comparisons.logs.log import Positions
from comparisons.pipeline.compare import Comparison, Modified
from ekf_reference.core.ekf import Ekf
from tests.helpers import Array, compared, first_seconds, random_covariance, simulated


def begun_boundless(variance: float) -> Comparison:
    def plant(ekf: Ekf) -> None:
        ekf.boundless_variance = variance

    return compared(simulated(seed=1, loop_s=30.0), Modified(plant))


def test_both_ways_agree_and_both_are_replayed() -> None:
    """Nieto 2005: eq. 2.56 with a large P_LL* gives what eq. 2.53 gives, nearly."""
    exact, boundless = compared(simulated(seed=1, loop_s=30.0)), begun_boundless(1e6)
    p, q = (c.ekf.estimate.joint_covariance for c in (exact, boundless))
    sigma = np.sqrt(np.diag(p))
    assert np.max(np.abs(p - q) / np.outer(sigma, sigma)) < 1e-4
    assert boundless.agreement.algebra.within(1e-6)
    assert (
        np.max(np.abs(exact.ekf.estimate.joint_mean - boundless.ekf.estimate.joint_mean) / sigma)
        < 1e-2
    )


@pytest.mark.slow
def test_the_thesis_warning_about_the_large_prior_holds() -> None:
    """The difference in magnitude costs digits: the larger P_LL*, the larger the algebra gap."""
    gaps = [begun_boundless(variance).agreement.algebra.covariance for variance in (1e4, 1e10)]
    assert gaps[1] > 100 * gaps[0]
    assert begun_boundless(1e10).agreement.algebra.covariance > 100 * (
        compared(simulated(seed=1, loop_s=30.0)).agreement.algebra.covariance
    )


def test_a_small_prior_is_an_error_that_shows() -> None:
    """With P_LL* of 1 m^2 the filter claims knowledge it has not; the model gap finds it."""
    c = begun_boundless(1.0)
    assert c.agreement.algebra.within(1e-6)
    assert c.agreement.model.covariance > 1e-3
    assert [cause.gap for cause in c.verdict.causes] == ["model"]


def test_correlation_coefficients() -> None:
    p = random_covariance(np.random.default_rng(0), 5)
    rho = correlation_coefficients(p)
    assert np.allclose(np.diag(rho), 1.0)
    assert np.isclose(rho[1, 3], abs(p[1, 3]) / np.sqrt(p[1, 1] * p[3, 3]))
    assert rho.max() <= 1.0 + 1e-12


def map_correlation(covariance: Array) -> float:
    """Mean correlation between entries of different landmarks, same axis."""
    rho = correlation_coefficients(covariance)[3:, 3:]
    east = rho[::2, ::2]
    return float(east[np.triu_indices(len(east), 1)].mean())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_closing_the_loop_correlates_the_map(seed: int) -> None:
    """Nieto 2005, Fig. 2.11: (b) before, (c) after the first closing, (d) after several loops."""
    log = simulated(seed=seed, loops=4)
    found = []
    for end in (75.0, 95.0, 340.0):
        part = first_seconds(log, end)
        run = run_ekf(part, build_timeline(part), EkfConfig(association="known"))
        found.append(map_correlation(run.estimate.joint_covariance))
    before, after, several = found
    assert before < after < several


@pytest.mark.slow
def test_absolute_observations_decorrelate_the_map() -> None:
    """Nieto 2005, Fig. 2.12: a few absolute positions of the vehicle, and the map falls apart."""
    log = simulated(seed=0, loops=2)
    # A doubtful start makes the map's errors common, which absolute positions then take away.
    log = replace(log, prior=replace(log.prior, covariance=np.diag((1.0, 1.0, 0.01))))
    truth = log.truth.poses
    assert truth is not None
    rows = np.arange(400, len(truth.time_s), 400)
    noise = 0.2 * np.random.default_rng(0).standard_normal((len(rows), 2))
    covariance = np.broadcast_to(0.04 * np.eye(2), (len(rows), 2, 2))
    positions = Positions(truth.time_s[rows], truth.pose[rows, :2] + noise, covariance)
    log = replace(log, positions=positions)
    plain, fixed = (
        map_correlation(compared(log, association="known", gps=gps).ekf.estimate.joint_covariance)
        for gps in ("off", "on")
    )
    assert fixed < 0.8 * plain
