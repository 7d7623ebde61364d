"""Bands, places, intervals."""

import numpy as np
import pytest
from scipy import stats

from comparisons.experiments.montecarlo.runs import RunRecords, recorded_steps
from comparisons.experiments.montecarlo.statistics import (
    compare_pairs,
    figures_of,
    tally,
)
from comparisons.statistics import mean_band


def records(rng: np.random.Generator, runs: int, scale: float = 1.0, steps: int = 40) -> RunRecords:
    """Errors that are what they should be, for scale 1."""
    pose, position, heading, landmark = (
        scale * rng.chisquare(dof, (runs, steps)) for dof in (3, 2, 1, 2)
    )
    square = scale * rng.chisquare(1, (runs, steps))
    return RunRecords(pose, position, heading, landmark, square, square.copy(), square.copy())


@pytest.mark.parametrize(("runs", "dof"), [(50, 3), (50, 2), (20, 1), (1, 2)])
def test_bands_hold_what_they_say(runs: int, dof: int) -> None:
    low, high = mean_band(runs, dof)
    inside = stats.chi2.cdf(runs * high, runs * dof) - stats.chi2.cdf(runs * low, runs * dof)
    assert inside == pytest.approx(0.95)
    assert stats.chi2.sf(runs * high, runs * dof) == pytest.approx(0.025)
    means = np.random.default_rng(1).chisquare(dof, (4000, runs)).mean(axis=1)
    assert ((low < means) & (means < high)).mean() == pytest.approx(0.95, abs=0.015)


@pytest.mark.parametrize(("scale", "place"), [(1.0, "inside"), (1.6, "above"), (0.5, "below")])
def test_places(scale: float, place: str) -> None:
    figures = figures_of(tally([records(np.random.default_rng(2), 50, scale)]))
    assert {c.place for c in figures.consistency.values()} == {place}
    assert figures.rmse["position"] == pytest.approx(np.sqrt(scale), rel=0.05)
    assert (figures.consistency["pose"].share_above > 0.5) == (scale > 1)


def test_lost_runs_are_counted_and_left_out() -> None:
    whole = records(np.random.default_rng(3), 50)
    broken = RunRecords(*(r.copy() for r in whole))
    for figure in broken:
        figure[4, 30:] = np.nan
    figures = figures_of(tally([broken]))
    rest = figures_of(tally([RunRecords(*(np.delete(r, 4, axis=0) for r in whole))]))
    assert figures.lost == 1
    assert figures.rmse == pytest.approx(rest.rmse)
    assert figures.consistency["pose"].band == mean_band(49, 3)
    everything = figures_of(tally([RunRecords(*(np.full((3, 5), np.nan) for _ in whole))]))
    assert everything.lost == 3
    assert np.isnan(everything.rmse["position"])


def test_pairs_find_the_difference_and_only_that() -> None:
    rng = np.random.default_rng(4)
    a, c = records(rng, 50), records(rng, 50)
    b = a._replace(pose_nees=a.pose_nees + 0.5)
    pairs = {
        (p.first, p.second, p.what): p
        for p in compare_pairs({"a": tally([a]), "b": tally([b]), "c": tally([c])})
    }
    assert len(pairs) == 12
    moved = pairs["a", "b", "pose_nees"]
    assert moved.mean == pytest.approx(-0.5)
    assert moved.interval == pytest.approx((-0.5, -0.5))
    assert pairs["a", "b", "position_rmse"].mean == 0.0
    independent = pairs["a", "c", "pose_nees"]
    d = a.pose_nees.mean(axis=1) - c.pose_nees.mean(axis=1)
    expected = stats.ttest_1samp(d, 0.0).confidence_interval(0.95)
    assert independent.interval == pytest.approx((expected.low, expected.high))


def test_chunks_tally_like_one() -> None:
    whole = records(np.random.default_rng(5), 50)
    for figure in whole:
        figure[:, 0] = np.nan if figure is whole.landmark_nees else figure[:, 0]
        figure[27, 7:] = np.nan
    parts = [RunRecords(*(r[at] for r in whole)) for at in (slice(0, 20), slice(20, 50))]
    one, two = figures_of(tally([whole])), figures_of(tally(parts))
    assert one.lost == two.lost == 1
    assert one.rmse == pytest.approx(two.rmse)
    assert one.consistency["landmarks"].mean == pytest.approx(two.consistency["landmarks"].mean)
    assert np.isnan(one.nees_curve["landmarks"][0])
    assert np.isfinite(one.nees_curve["landmarks"][1:]).all()


def test_recorded_steps() -> None:
    assert recorded_steps(7) == [1, 2, 3, 4, 5, 6, 7]
    for steps in (500, 501, 2500, 3599):
        recorded = recorded_steps(steps)
        assert len(recorded) <= 500
        assert recorded[-1] == steps
        assert recorded[0] >= 1
