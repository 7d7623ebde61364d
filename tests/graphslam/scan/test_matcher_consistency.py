"""Covariances of matches against their errors, over seeds and rooms that no factor was found on."""

import numpy as np
import pytest
from scipy.stats import chi2

from graphslam.scan import planar
from graphslam.scan.registration import Matcher
from tests.graphslam.numerics import Array
from tests.graphslam.scan.shapes import COURT, ELL, LONG, YARD, scan_pair

SIGMA_M = 0.02
PAIRS = 200


def trials(matcher: Matcher, rooms: list[Array], seed: int, pairs: int) -> tuple[Array, Array]:
    """Errors (N, 3) as right perturbations, and covariances (N, 3, 3)."""
    rng = np.random.default_rng(seed)
    error, covariance = [], []
    for k in range(pairs):
        source, target, true = scan_pair(rng, rooms[k % len(rooms)], SIGMA_M)
        guess = true + rng.normal(size=3) * (0.1, 0.1, 0.03)
        found = matcher.match(source, target, guess)
        error.append(planar.between(found.motion, true))
        covariance.append(found.covariance)
    return np.array(error), np.array(covariance)


def average_nees(error: Array, covariance: Array) -> float:
    whitened = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
    return float(np.einsum("ni,ni->n", error, whitened).mean())


def within_band(value: float, pairs: int) -> bool:
    """Two-sided 95 % of an average of `pairs` chi-squares with three degrees of freedom."""
    low, high = chi2.ppf((0.025, 0.975), 3 * pairs) / pairs
    return bool(low < value < high)


@pytest.mark.slow
def test_covariances_are_as_wide_as_the_errors(matcher: Matcher) -> None:
    error, covariance = trials(matcher, [ELL, COURT, YARD], 2, PAIRS)
    assert within_band(average_nees(error, covariance), PAIRS)
    assert not within_band(average_nees(error, 0.5 * covariance), PAIRS)
    assert not within_band(average_nees(error, 2.0 * covariance), PAIRS)


@pytest.mark.slow
def test_covariances_lie_the_right_way(matcher: Matcher) -> None:
    """In a long hall: turned as the target's frame is, they no longer fit the errors."""
    error, covariance = trials(matcher, [LONG], 2, 60)
    rng = np.random.default_rng(2)
    right, wrong = average_nees(error, covariance), []
    for k in range(len(error)):
        *_, true = scan_pair(rng, LONG, SIGMA_M)
        rng.normal(size=3)
        cos, sin = np.cos(2.0 * true[2]), np.sin(2.0 * true[2])
        turn = np.array(((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)))
        wrong.append(average_nees(error[k : k + 1], turn @ covariance[k : k + 1] @ turn.T))
    assert np.mean(wrong) > 2.0 * right
