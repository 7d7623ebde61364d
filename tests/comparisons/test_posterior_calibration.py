"""Simulation-based calibration of the draws, as research/posterior_sampling.py does it."""

from dataclasses import replace

import numpy as np
import pytest

from research.posterior_sampling import (
    SIGNIFICANCE,
    THINNED,
    draw_problem,
    drawn_motion,
    null_statistics,
    ranks,
    solve,
    straight,
    uniform_p,
)


def test_uniform_ranks_pass_as_often_as_they_should() -> None:
    rng = np.random.default_rng(0)
    null = null_statistics(100, rng)
    p = np.array([uniform_p(rng.integers(0, THINNED + 1, 100), null) for _ in range(200)])
    for level in (0.05, 0.5):
        assert abs(np.mean(p <= level) - level) < 4.0 * np.sqrt(level * (1.0 - level) / 200)


def test_ranks_of_another_spread_fail() -> None:
    rng = np.random.default_rng(0)
    wide = np.clip(64.0 + 55.0 * rng.standard_normal(100), 0, THINNED).astype(np.intp)
    assert uniform_p(wide, null_statistics(100, rng)) < SIGNIFICANCE


def test_a_drawn_motion_has_the_factors_density() -> None:
    """Its turn has density exp(-turn^2 / 2 s^2) 2 (1 - cos) / turn^2: narrower than the sigma."""
    rng, sigma = np.random.default_rng(0), 1.5
    turns = [drawn_motion(np.zeros(3), np.array((0.1, 0.1, sigma)), rng)[2] for _ in range(4000)]
    grid = np.linspace(-np.pi, np.pi, 10_001)
    density = np.exp(-0.5 * (grid / sigma) ** 2) * np.sinc(grid / (2.0 * np.pi)) ** 2
    variance = np.sum(density * grid**2) / np.sum(density)
    assert np.var(turns) == pytest.approx(variance, rel=0.06)
    assert variance < 0.75 * sigma**2


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "uniform"), [(0.2, True), (0.6, False)])
def test_ranks_are_uniform_unless_the_stated_prior_is_wrong(sigma: float, uniform: bool) -> None:
    """The problems say 0.2 rad of the heading at the start."""
    rng = np.random.default_rng(1)
    found = []
    for _ in range(24):
        drawn = draw_problem(straight(heading=sigma), rng)
        covariance = np.diag((0.1, 0.1, 0.2)) ** 2
        log = replace(drawn.log, prior=replace(drawn.log.prior, covariance=covariance))
        one = solve(drawn._replace(log=log), rng)
        assert one.draws.converged
        found.append(ranks(one, rng)["draws"][:3])
    null = null_statistics(len(found), rng)
    least = 3.0 * min(uniform_p(column, null) for column in np.array(found).T)
    assert (least > SIGNIFICANCE) == uniform
