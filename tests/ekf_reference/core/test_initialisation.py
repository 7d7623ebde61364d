"""Landmarks initialised both ways, and how the map's correlations develop."""

import numpy as np
import pytest

from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array
from ekf_reference.core.state import correlation_coefficients
from ekf_reference.core.trace import RecordedTrace
from tests.ekf_reference.replay import Gaussian, eigenvalue_range, gap, replay
from tests.ekf_reference.worlds import LOOP_S, build, circuit, follow, followed


def initialised(boundless_variance: float | None) -> tuple[Gaussian, Gaussian]:
    """The filter's estimate, and the exact solution of what it recorded."""
    trace = RecordedTrace()
    ekf = build(trace=trace)
    ekf.boundless_variance = boundless_variance
    followed(circuit(seed=1, duration_s=30.0), ekf)
    return Gaussian(ekf.state.mean, ekf.state.covariance), replay(trace.arrays())


def test_both_ways_agree_and_both_are_replayed() -> None:
    """Nieto 2005: eq. 2.56 with a large P_LL* gives what eq. 2.53 gives, nearly."""
    (exact, exact_replayed), (boundless, boundless_replayed) = initialised(None), initialised(1e6)
    sigma = np.sqrt(np.diag(exact.covariance))
    difference = np.abs(exact.covariance - boundless.covariance)
    assert np.max(difference / np.outer(sigma, sigma)) < 1e-4
    assert np.max(np.abs(exact.mean - boundless.mean) / sigma) < 1e-2
    assert gap(exact, exact_replayed) < 1e-6
    assert gap(boundless, boundless_replayed) < 1e-6


def test_the_thesis_warning_about_the_large_prior_holds() -> None:
    """The difference in magnitude costs digits: the larger P_LL*, the larger the algebra gap."""
    exact, large, huge = (gap(*initialised(variance)) for variance in (None, 1e4, 1e10))
    assert huge > 100 * large
    assert huge > 100 * exact


def test_a_small_prior_claims_knowledge_that_the_filter_has_not() -> None:
    """With P_LL* of 1 m^2 the algebra is right, and the covariance below that of eq. 2.53."""
    (exact, _), (small, replayed) = initialised(None), initialised(1.0)
    assert gap(small, replayed) < 1e-6
    assert eigenvalue_range(small.covariance, exact.covariance)[0] < 1.0 - 1e-3


def map_correlation(ekf: Ekf) -> float:
    """Mean correlation between entries of different landmarks, same axis."""
    rho = correlation_coefficients(ekf.state.covariance)[3:, 3:]
    east = rho[::2, ::2]
    return float(east[np.triu_indices(len(east), 1)].mean())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_closing_the_loop_correlates_the_map(seed: int) -> None:
    """Nieto 2005, Fig. 2.11: (b) before, (c) after the first closing, (d) after several loops."""
    before, after, several = (
        map_correlation(followed(circuit(seed, duration_s)))
        for duration_s in (75.0, 95.0, 4 * LOOP_S)
    )
    assert before < after < several


@pytest.mark.slow
def test_absolute_observations_decorrelate_the_map() -> None:
    """Nieto 2005, Fig. 2.12: a few absolute positions of the vehicle, and the map falls apart."""
    drive, rng = circuit(seed=0, duration_s=2 * LOOP_S), np.random.default_rng(0)
    # A doubtful start makes the map's errors common, which absolute positions then take away.
    plain, fixed = (build(prior_covariance=np.diag((1.0, 1.0, 0.01))) for _ in range(2))
    followed(drive, plain)
    for done, ekf in follow(drive, fixed):
        if done % 100 == 0:
            place: Array = drive.pose[done, :2] + 0.2 * rng.standard_normal(2)
            assert ekf.fix_position(place, 0.04 * np.eye(2))
    assert map_correlation(fixed) < 0.8 * map_correlation(plain)
