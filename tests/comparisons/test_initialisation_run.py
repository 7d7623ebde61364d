"""A boundless prior for new landmarks (Nieto 2005, eq. 2.56), as the comparison sees it."""

from __future__ import annotations

from comparisons.pipeline.compare import Comparison, Modified
from ekf_reference.core.ekf import Ekf
from tests.helpers import compared, simulated


def initialised_boundless(variance: float) -> Comparison:
    def plant(ekf: Ekf) -> None:
        ekf.boundless_variance = variance

    return compared(simulated(seed=1, loop_s=30.0), Modified(plant))


def test_a_large_prior_is_replayed() -> None:
    assert initialised_boundless(1e6).agreement.algebra.within(1e-6)


def test_a_small_prior_is_an_error_that_shows() -> None:
    """With P_LL* of 1 m^2 the filter claims knowledge it has not; the model gap finds it."""
    c = initialised_boundless(1.0)
    assert c.agreement.algebra.within(1e-6)
    assert c.agreement.model.covariance > 1e-3
    assert [cause.gap for cause in c.verdict.causes] == ["model"]
