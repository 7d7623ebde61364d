"""What many runs say: ANEES with its band, RMSE, and filters compared run by run."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from scipy import stats

from comparisons.arrays import Array
from comparisons.experiments.montecarlo.runs import Records

LEVEL = 0.95
DOF = {"pose": 3, "position": 2, "heading": 1, "landmarks": 2}
ERRORS = ("position", "heading", "landmarks")

Place = Literal["below", "inside", "above"]


def anees_band(runs: int, dof: int, level: float = LEVEL) -> tuple[float, float]:
    """Two-sided band of the mean NEES of independent runs, by chi-square with runs * dof."""
    tail = 0.5 * (1.0 - level)
    low, high = stats.chi2.ppf((tail, 1.0 - tail), runs * dof) / runs
    return float(low), float(high)


@dataclass(frozen=True)
class Consistency:
    """Of one block of the state. curve: (T,) mean over the runs. mean: of the curve.

    place: of the mean in the band of one step. A mean over steps (or landmarks) spreads less than
    that, so outside is outside at the stated level, and inside is the weaker statement.
    share_above: of the steps whose own mean lies above the band.
    """

    curve: Array
    mean: float
    band: tuple[float, float]
    place: Place
    share_above: float


@dataclass(frozen=True)
class FilterFigures:
    """lost: runs that broke down; they count nowhere else. rmse_curve: (T,) by ERRORS."""

    lost: int
    consistency: dict[str, Consistency]
    rmse: dict[str, float]
    rmse_curve: dict[str, Array]


@dataclass(frozen=True, kw_only=True)
class Pair:
    """First filter minus second, per run, over the runs that neither lost.

    mean and interval: of the run's mean NEES of the pose, or of the run's RMSE, by Student's t.
    """

    first: str
    second: str
    what: str
    mean: float
    interval: tuple[float, float]
    runs: int


@dataclass(frozen=True)
class Tally:
    """What is kept of one filter's records.

    step_mean: (T,) over the runs not lost. run_mean: (N,) over the steps, NaN for lost runs. Both
    by field of Records.
    """

    step_mean: Records
    run_mean: Records

    @property
    def lost(self) -> int:
        """Runs that broke down."""
        return int(np.isnan(self.run_mean.pose_nees).sum())


def tally(chunks: Iterable[Records]) -> Tally:
    """Chunk by chunk, in order, so that only one is held at a time."""
    total: list[Array] = [np.zeros(())] * len(Records._fields)
    run_mean: list[Records] = []
    for records in chunks:
        lost = np.isnan(records.pose_nees).any(axis=1)
        total = [t + r[~lost].sum(axis=0) for t, r in zip(total, records, strict=True)]
        means = Records(*(_mean(r, axis=1) for r in records))
        for values in means:
            values[lost] = np.nan
        run_mean.append(means)
    joined = Records(*(np.concatenate(parts) for parts in zip(*run_mean, strict=True)))
    kept = int(np.isfinite(joined.pose_nees).sum())
    step_mean = Records(*(t / kept if kept else np.nan * t for t in total))
    return Tally(step_mean, joined)


def figures_of(kept: Tally) -> FilterFigures:
    """One filter's figures over all its runs."""
    runs = len(kept.run_mean.pose_nees) - kept.lost
    nees = dict(zip(DOF, kept.step_mean[:4], strict=True))
    square = dict(zip(ERRORS, kept.step_mean[4:], strict=True))
    return FilterFigures(
        kept.lost,
        {name: _consistency(curve, runs, DOF[name]) for name, curve in nees.items()},
        {name: float(np.sqrt(_mean(curve))) for name, curve in square.items()},
        {name: np.sqrt(curve) for name, curve in square.items()},
    )


def compare_pairs(kept: dict[str, Tally]) -> list[Pair]:
    """Every two filters, in the order given."""
    found = []
    for first, second in combinations(kept, 2):
        a, b = _per_run(kept[first]), _per_run(kept[second])
        for what in a:
            difference = a[what] - b[what]
            difference = difference[np.isfinite(difference)]
            mean, interval = _interval(difference)
            found.append(
                Pair(
                    first=first,
                    second=second,
                    what=what,
                    mean=mean,
                    interval=interval,
                    runs=len(difference),
                )
            )
    return found


def _per_run(kept: Tally) -> dict[str, Array]:
    square = zip(ERRORS, kept.run_mean[4:], strict=True)
    rmse = {f"{name}_rmse": np.sqrt(values) for name, values in square}
    return {"pose_nees": kept.run_mean.pose_nees} | rmse


def _interval(difference: Array) -> tuple[float, tuple[float, float]]:
    runs = len(difference)
    if runs < 2:
        return (float(difference[0]) if runs else np.nan), (np.nan, np.nan)
    mean = float(difference.mean())
    spread = float(stats.sem(difference) * stats.t.ppf(0.5 + 0.5 * LEVEL, runs - 1))
    return mean, (mean - spread, mean + spread)


def _consistency(curve: Array, runs: int, dof: int) -> Consistency:
    mean = float(_mean(curve))
    band = anees_band(runs, dof) if runs else (np.nan, np.nan)
    place: Place = "above" if not mean <= band[1] else "below" if mean < band[0] else "inside"
    told = curve[np.isfinite(curve)]
    share = float((told > band[1]).mean()) if len(told) else np.nan
    return Consistency(curve, mean, band, place, share)


def _mean(values: Array, axis: int | None = None) -> Array:
    """Over what is told; landmarks are not before the first is mapped."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # nothing told: NaN is the answer
        return np.asarray(np.nanmean(values, axis=axis))
