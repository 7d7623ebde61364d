"""The bands that a run reports, and whether they cover their nominal share over many runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import stats

from comparisons.checks.consistency.filter_smoother import FilterAgainstSmoother
from comparisons.checks.consistency.nees import TruthConsistency
from comparisons.innovations import SensorInnovations
from comparisons.jobs.run import Comparison
from comparisons.statistics import Normalised, Whiteness, mean_band
from graphslam.optimum import ChiSquareTest

LEVEL = 0.01
"""Chance that any of the bands of a table is called wrong although all are right."""
_TWO_SIGMA = float(stats.chi2.cdf(4.0, 1))
_CHI_SQUARE = 0.998


class RunFigure(NamedTuple):
    """One figure of one run. nominal: what it is on average over sound runs.

    value: of a band 1 where it holds and 0 where not; of an average, the average. band: which.
    """

    nominal: float
    value: float
    band: bool


Figures = Mapping[str, RunFigure]


@dataclass(frozen=True, kw_only=True)
class BandCoverage:
    """A figure over many runs. found: its average. p_value: of one so far from nominal.

    Two-sided: binomial for a band, by Student's t over the runs for an average.
    """

    name: str
    nominal: float
    found: float
    runs: int
    p_value: float


def figures_of(c: Comparison) -> dict[str, RunFigure]:
    """Every band of a run's consistency check, by name, and the averages shown beside them.

    Epochs of one run are correlated, so of a band that holds for each the figures are whether it
    holds halfway and at the end, and the share of epochs inside, whose average over runs is
    nominal however they are correlated.
    """
    found: dict[str, RunFigure] = {}
    for name, truth in (("EKF", c.consistency.ekf), ("smoother", c.consistency.smoother)):
        if truth is not None:
            found |= {f"{name} NEES, {key}": figure for key, figure in _of_truth(truth)}
    for sensor in c.consistency.sensors:
        found |= {f"{sensor.sensor}, {key}": figure for key, figure in _of_sensor(sensor)}
    if c.consistency.smoothed is not None:
        found |= {
            f"filter against smoother, {key}": figure
            for key, figure in _of_poses(c.consistency.smoothed)
        }
    return found | dict(_of_residuals(c.smoother.optimality.chi_square))


def coverage(runs: Sequence[Figures]) -> list[BandCoverage]:
    """Compare with nominal, name by name; a figure may be missing from some runs."""
    names = list(dict.fromkeys(name for run in runs for name in run))
    return [_covered(name, [run[name] for run in runs if name in run]) for name in names]


def wrong(table: Sequence[BandCoverage], level: float = LEVEL) -> list[BandCoverage]:
    """Those farther from nominal than chance allows, with Bonferroni's limit for their number."""
    return [one for one in table if one.p_value < level / len(table)]


def _covered(name: str, figures: Sequence[RunFigure]) -> BandCoverage:
    nominal, values = figures[0].nominal, np.array([figure.value for figure in figures])
    if figures[0].band:
        p_value = float(stats.binomtest(int(values.sum()), len(values), nominal).pvalue)
    elif np.ptp(values) == 0.0:  # no share of all runs varies, such as one that is always zero
        p_value = float(values[0] == nominal)
    else:
        p_value = float(stats.ttest_1samp(values, nominal).pvalue)
    return BandCoverage(
        name=name, nominal=nominal, found=float(values.mean()), runs=len(values), p_value=p_value
    )


def _of_truth(truth: TruthConsistency) -> Iterator[tuple[str, RunFigure]]:
    for name in ("pose", "position", "heading"):
        yield from _of_many(name, getattr(truth, name), epochs=True)
    for name in ("landmarks", "distance"):
        yield from _of_many(name, getattr(truth, name), epochs=False)
    for name in ("map", "whole", "distances"):
        joint: Normalised | None = getattr(truth, name)
        if joint is not None and len(joint.squared):
            value = float(joint.squared[0])
            yield name, _band(joint.single_band.holds(value))
            yield f"{name}, mean per dof", _average(1.0, value / joint.dof)


def _of_many(name: str, n: Normalised | None, *, epochs: bool) -> Iterator[tuple[str, RunFigure]]:
    if n is None or n.mean is None or n.inside is None:
        return
    if epochs:
        for when, k in (("halfway", len(n.squared) // 2), ("at the end", -1)):
            yield f"{name} {when}", _band(n.single_band.holds(float(n.squared[k])))
    yield f"{name}, share inside", _average(0.95, n.inside)
    yield f"{name}, mean per dof", _average(1.0, n.mean / n.dof)


def _of_sensor(sensor: SensorInnovations) -> Iterator[tuple[str, RunFigure]]:
    for nis in sensor.nis:
        yield f"NIS of {nis.name}", _band(nis.reading == "plausible")
        yield f"NIS of {nis.name}, mean per dof", _average(1.0, nis.mean / nis.dof)
    for white in sensor.whiteness:
        yield from _of_whiteness(white)
    w = sensor.windows
    inside = float(np.mean((w.mean >= w.low) & (w.mean <= w.high)))
    yield "NIS of windows, share inside", _average(0.95, inside)


def _of_whiteness(w: Whiteness) -> Iterator[tuple[str, RunFigure]]:
    name = f"whiteness of {w.component} by {w.order}"
    within = np.abs(w.autocorrelation) <= np.array(w.band)
    yield f"{name}, next", _band(bool(within[0]), _TWO_SIGMA)
    yield f"{name}, share of lags", _average(_TWO_SIGMA, float(within.mean()))
    yield f"{name}, p-value over 0.05", _band(w.p_value > 0.05)
    yield f"{name}, mean", _band(abs(w.mean) <= w.mean_band, _TWO_SIGMA)


def _of_poses(f: FilterAgainstSmoother) -> Iterator[tuple[str, RunFigure]]:
    if f.squared_per_dof is None or f.inside is None:
        return
    clear = np.flatnonzero(f.dof > 0)
    k = int(clear[len(clear) // 2])
    yield "halfway", _band(mean_band(1, int(f.dof[k])).holds(float(f.squared[k])))
    yield "share inside", _average(0.95, f.inside)
    yield "mean per dof", _average(1.0, f.squared_per_dof)
    yield "share not overconfident", _average(1.0, 1.0 - len(f.overconfident) / len(f.time_s))


def _of_residuals(test: ChiSquareTest) -> Iterator[tuple[str, RunFigure]]:
    yield "chi-square of the smoother", _band(test.reading == "plausible", _CHI_SQUARE)
    yield "chi-square of the smoother, mean per dof", _average(1.0, test.chi2 / test.dof)


def _band(holds: bool, nominal: float = 0.95) -> RunFigure:
    return RunFigure(nominal, float(holds), band=True)


def _average(nominal: float, value: float) -> RunFigure:
    return RunFigure(nominal, value, band=False)
