"""Each band that a run reports covers its nominal share of sound runs; wrong ones do not."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from comparisons import innovations, statistics
from comparisons.checks.consistency import consistency
from comparisons.checks.consistency.consistency import Consistency, check_consistency
from comparisons.checks.consistency.filter_smoother import (
    FilterAgainstSmoother,
    filter_against_smoother,
)
from comparisons.checks.consistency.finding import ConsistencyFinding
from comparisons.jobs.run import Comparison
from comparisons.logs.odometry import RelativePoses
from comparisons.statistics import Band, Whiteness, mean_band, whiteness
from graphslam.optimum import chi_square_test
from research.trust.coverage import BandCoverage, RunFigure, coverage, figures_of, wrong
from research.trust.drives import sound_log, sound_run
from tests.helpers import Array, altered

RUNS = 80
SECONDS = 10.0


@cache
def sound_runs() -> tuple[Comparison, ...]:
    """Those with positions have every sensor."""
    return tuple(sound_run(seed, SECONDS, positions=True) for seed in range(RUNS))


def with_consistency(c: Comparison, found: Consistency) -> Comparison:
    findings = {**c.findings, "consistency": ConsistencyFinding(found)}
    return altered(c, "known.findings", findings)


def judged_anew() -> list[BandCoverage]:
    """The table, with all bands computed by what stands in the modules now."""
    return coverage(
        [
            figures_of(
                with_consistency(c, check_consistency(c.log, c.ekf, c.smoothed, labelled=True))
            )
            for c in sound_runs()
        ]
    )


def names(table: list[BandCoverage]) -> str:
    return "; ".join(one.name for one in wrong(table))


def test_a_coverage_far_from_nominal_is_wrong_and_chance_is_not() -> None:
    def table(held: int, value: float) -> list[BandCoverage]:
        return coverage(
            [
                {
                    "band": RunFigure(0.95, float(i < held), band=True),
                    "average": RunFigure(1.0, value + 0.1 * (-1) ** i, band=False),
                }
                for i in range(100)
            ]
        )

    assert names(table(95, 1.0)) == names(table(90, 1.02)) == ""
    assert names(table(80, 1.0)) == "band"
    assert names(table(95, 1.1)) == "average"
    never = coverage([{"never": RunFigure(1.0, 1.0, band=False)}] * 5)
    assert never[0].p_value == 1.0


def test_a_sound_log_states_the_noise_that_it_has() -> None:
    log = sound_log(0, SECONDS)
    assert not isinstance(log.odometry, RelativePoses)
    assert log.odometry.noise.variance_rate_position == 0.0
    assert log.odometry.noise.sigma_speed_mps == pytest.approx(0.003)
    assert log.measurements.sigma_range_m[0] == pytest.approx(0.0015)


@pytest.mark.slow
def test_every_band_covers_its_nominal_share() -> None:
    """research/trust/bands.py has 400 longer drives, with and without positions."""
    table = judged_anew()
    assert len(table) > 60
    assert {one.runs for one in table} == {RUNS}
    assert names(table) == ""


def another_level(count: int, dof: int, outside: float = 0.05) -> Band:
    """80 % in place of 95, and so on."""
    return mean_band(count, dof, outside=4.0 * outside)


def one_more_dof(count: int, dof: int, outside: float = 0.05) -> Band:
    return mean_band(count, dof + 1, outside)


def as_if_independent(count: int, dof: int, outside: float = 0.05) -> Band:
    """Each number counted four times."""
    low, high = mean_band(4 * count, dof, outside)
    return Band(low, high)


def narrower(*given: object, **options: object) -> Whiteness | None:
    """One and a half standard deviations said to be two."""
    w = whiteness(*given, **options)  # type: ignore[arg-type]
    if w is None:
        return None
    return replace(w, band=tuple(0.75 * b for b in w.band), mean_band=0.75 * w.mean_band)


def half_the_dof(*given: object, **options: object) -> Whiteness | None:
    """The p-value with a degree of freedom for every other lag."""
    w = whiteness(*given, **options)  # type: ignore[arg-type]
    if w is None:
        return None
    squared = float(np.sum((2.0 * np.divide(w.autocorrelation, w.band)) ** 2))
    return replace(w, p_value=float(chi2.sf(squared, (len(w.band) + 1) // 2)))


def by_the_filters_alone(
    time_s: Array, mean: Array, covariance: Array, smoothed: Array, smoothed_covariance: Array
) -> FilterAgainstSmoother:
    """P_E where P_E - P_S belongs."""
    return filter_against_smoother(time_s, mean, covariance, smoothed, 1e-6 * smoothed_covariance)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "name", "broken", "reported"),
    [
        (statistics, "mean_band", another_level, "EKF NEES, pose, share inside"),
        (statistics, "mean_band", one_more_dof, "smoother NEES, heading, share inside"),
        (statistics, "mean_band", as_if_independent, "measurements, NIS of range"),
        (statistics, "mean_band", as_if_independent, "positions, NIS of east"),
        (innovations, "whiteness", narrower, "whiteness of bearing by landmark, share of lags"),
        (innovations, "whiteness", half_the_dof, "by landmark, p-value over 0.05"),
        (consistency, "filter_against_smoother", by_the_filters_alone, "smoother, mean per dof"),
    ],
)
def test_a_wrong_level_or_dof_falls_outside(
    module: object,
    name: str,
    broken: Callable[..., object],
    reported: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, name, broken)
    assert reported in names(judged_anew())


@pytest.mark.slow
def test_a_chi_square_that_counts_no_unknowns_falls_outside() -> None:
    """Degrees of freedom are measurements less unknowns; here the landmarks are forgotten."""
    found = []
    for c in sound_runs():
        test = c.smoother.optimality.chi_square
        forgotten = chi_square_test(0.5 * test.chi2, test.dof + c.smoothed.landmark.size)
        result = altered(c.smoother, "optimality.chi_square", forgotten)
        found.append(figures_of(altered(c, "known.solved", (result, c.smoothed))))
    assert "chi-square of the smoother, mean per dof" in names(coverage(found))
