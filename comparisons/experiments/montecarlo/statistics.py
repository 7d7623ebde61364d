"""What many runs say: ANEES with its band, RMSE, and filters compared run by run."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from comparisons.arrays import Array
from comparisons.experiments.montecarlo.runs import RunRecords
from comparisons.figures import Aside
from comparisons.statistics import LEVEL, Band, Place, inside, mean_band

DOF = {"pose": 3, "position": 2, "heading": 1, "landmarks": 2}
ERRORS = {"position": "m", "heading": "rad", "landmarks": "m"}
"""What errors are of, and their units."""


@dataclass(frozen=True)
class BlockNees:
    """Average NEES over runs and time, of one block of the state.

    A mean over steps (or landmarks) has a narrower true band than one step, so that outside is
    certain at the stated level, and inside is not.

    Attributes:
        anees: average normalised estimation error squared.
        band: its two-sided band at the study's level.
        place: where it is relative to the band; not given: an external filter left no covariances.
        share_above: share of the steps whose own average over the runs is above the band.
    """

    anees: float
    band: Band
    place: Place | Literal["not given"]
    share_above: float

    @property
    def mean(self) -> float:
        """The average."""
        return self.anees


@dataclass(frozen=True)
class LastPoses:
    """NEES of the runs' last poses. Both bands are exact: chi-square of 3, and the binomial.

    Attributes:
        inside: runs whose value is within its band.
        of: runs that have a value.
        band: band of the number of such runs.
    """

    inside: int
    of: int
    band: tuple[int, int]


@dataclass(frozen=True, kw_only=True)
class FilterFigures:
    """One filter of the study.

    Attributes:
        lost: runs in which it was lost; they count nowhere else.
        consistency: by pose, position, heading and landmarks.
        rmse_position_m: root mean square error of the positions.
        rmse_heading_rad: root mean square error of the headings.
        rmse_landmark_m: root mean square error of the landmarks.
        last_pose_inside: NEES of the last poses.
        nees_curve: (T,) by DOF, over the runs; no part of a result file, as what follows.
        rmse_curve: (T,) by ERRORS.
        kept: what all of this is of.
    """

    lost: int
    consistency: dict[str, BlockNees]
    rmse_position_m: float
    rmse_heading_rad: float
    rmse_landmark_m: float
    last_pose_inside: LastPoses
    nees_curve: Aside[dict[str, Array]]
    rmse_curve: Aside[dict[str, Array]]
    kept: Aside[FilterTally]

    @property
    def rmse(self) -> dict[str, float]:
        """By ERRORS."""
        found = (self.rmse_position_m, self.rmse_heading_rad, self.rmse_landmark_m)
        return dict(zip(ERRORS, found, strict=True))


@dataclass(frozen=True, kw_only=True)
class FilterPair:
    """Two filters compared run by run: first minus second, over the runs that neither lost.

    Attributes:
        first: name of the first filter.
        second: name of the second filter.
        what: quantity of a run that is compared, its mean NEES of the pose or an RMSE.
        mean: average difference.
        interval: confidence interval of the average, by Student's t.
        runs: runs that both completed.
        lower: runs in which the first is lower.
        higher: runs in which the first is higher.
        family_interval: the interval, corrected for the number of pairs (Bonferroni, over both
            tests of all pairs, so that at the stated level none of them is wrong).
        sign_p: chance of such numbers if neither is lower (sign test), corrected alike.
    """

    first: str
    second: str
    what: str
    mean: float
    interval: tuple[float, float]
    runs: int
    lower: int
    higher: int
    family_interval: tuple[float, float]
    sign_p: float


@dataclass(frozen=True)
class FilterTally:
    """What is kept of one filter's records.

    step_mean: (T,) over the runs not lost. step_runs: how many of them have such a figure at the
    last step. run_mean: (N,) over the steps, NaN for lost runs. last: (N,) at the last step. All
    by field of RunRecords. final_map: figures of landmarks are those of the last step alone.
    """

    step_mean: RunRecords
    step_runs: tuple[int, ...]
    run_mean: RunRecords
    last: RunRecords
    final_map: bool = False

    @property
    def lost(self) -> int:
        """Runs that broke down."""
        return int(np.isnan(self.run_mean.position_square).sum())


def tally(
    chunks: Iterable[RunRecords],
    used: NDArray[np.bool_] | slice = slice(None),
    *,
    final_map: bool = False,
) -> FilterTally:
    """Chunk by chunk, in order, so that only one is held at a time.

    used: (T,) recorded steps that count; the last is among them.
    """
    total: list[Array] = [np.zeros(())] * len(RunRecords._fields)
    count: list[Array] = [np.zeros((), dtype=int)] * len(RunRecords._fields)
    run_mean: list[RunRecords] = []
    ends: list[RunRecords] = []
    for whole in chunks:
        records = RunRecords(*(np.ascontiguousarray(r[:, used]) for r in whole))
        lost = _lost(records)
        total = [t + np.nansum(r[~lost], axis=0) for t, r in zip(total, records, strict=True)]
        count = [n + np.isfinite(r[~lost]).sum(axis=0) for n, r in zip(count, records, strict=True)]
        means = RunRecords(*(_mean(r, axis=1) for r in records))
        last = RunRecords(*(r[:, -1].copy() for r in records))
        for values in (*means, *last):
            values[lost] = np.nan
        if final_map:
            means = means._replace(
                landmark_nees=last.landmark_nees, landmark_square=last.landmark_square
            )
        run_mean.append(means)
        ends.append(last)
    with np.errstate(invalid="ignore", divide="ignore"):
        step_mean = RunRecords(*(t / n for t, n in zip(total, count, strict=True)))
    return FilterTally(
        step_mean, tuple(int(n[-1]) for n in count), _joined(run_mean), _joined(ends), final_map
    )


def _lost(records: RunRecords) -> NDArray[np.bool_]:
    """Runs that broke down on the way; one without any covariances did not."""
    nees = np.isnan(records.pose_nees)
    partly = nees.any(axis=1) & ~nees.all(axis=1)
    return np.asarray(np.isnan(records.position_square).any(axis=1) | partly)


def _joined(parts: list[RunRecords]) -> RunRecords:
    return RunRecords(*(np.concatenate(one) for one in zip(*parts, strict=True)))


def figures_of(kept: FilterTally) -> FilterFigures:
    """One filter's figures over all its runs."""
    nees = dict(zip(DOF, kept.step_mean[:4], strict=True))
    square = dict(zip(ERRORS, kept.step_mean[4:], strict=True))

    def counted(name: str, curve: Array) -> Array:
        return curve[-1:] if kept.final_map and name == "landmarks" else curve

    def consistency(name: str, runs: int) -> BlockNees:
        block_nees = _consistency(counted(name, nees[name]), runs, DOF[name])
        given = runs or kept.lost == len(kept.run_mean.pose_nees)
        return block_nees if given else replace(block_nees, place="not given")

    position, heading, landmark = (
        float(np.sqrt(_mean(counted(name, curve)))) for name, curve in square.items()
    )
    return FilterFigures(
        lost=kept.lost,
        consistency={n: consistency(n, runs) for n, runs in zip(DOF, kept.step_runs, strict=False)},
        rmse_position_m=position,
        rmse_heading_rad=heading,
        rmse_landmark_m=landmark,
        last_pose_inside=_last_poses(kept),
        nees_curve=nees,
        rmse_curve={name: np.sqrt(curve) for name, curve in square.items()},
        kept=kept,
    )


def compare_pairs(kept: dict[str, FilterTally]) -> list[FilterPair]:
    """Every two filters, in the order given."""
    each = {name: per_run(filter_tally) for name, filter_tally in kept.items()}
    rows = [
        (first, second, what, a - each[second][what])
        for first, second in combinations(each, 2)
        for what, a in each[first].items()
    ]
    family = 2 * max(sum(bool(np.isfinite(row[-1]).any()) for row in rows), 1)
    return [_pair(*row, family) for row in rows]


def _pair(first: str, second: str, what: str, difference: Array, family: int) -> FilterPair:
    difference = difference[np.isfinite(difference)]
    mean, interval = _interval(difference, LEVEL)
    lower, higher = int((difference < 0).sum()), int((difference > 0).sum())
    p = np.nan
    if lower + higher:
        p = min(family * float(stats.binomtest(lower, lower + higher).pvalue), 1.0)
    return FilterPair(
        first=first,
        second=second,
        what=what,
        mean=mean,
        interval=interval,
        runs=len(difference),
        lower=lower,
        higher=higher,
        family_interval=_interval(difference, 1.0 - (1.0 - LEVEL) / family)[1],
        sign_p=p,
    )


def per_run(kept: FilterTally) -> dict[str, Array]:
    """(N,) of each run: mean NEES of the pose, and RMSE; that of the position is the ATE."""
    square = zip(ERRORS, kept.run_mean[4:], strict=True)
    rmse = {f"{name}_rmse": np.sqrt(values) for name, values in square}
    return {"pose_nees": kept.run_mean.pose_nees} | rmse


def _interval(difference: Array, level: float) -> tuple[float, tuple[float, float]]:
    runs = len(difference)
    if runs < 2:
        return (float(difference[0]) if runs else np.nan), (np.nan, np.nan)
    mean = float(difference.mean())
    spread = float(stats.sem(difference) * stats.t.ppf(0.5 + 0.5 * level, runs - 1))
    return mean, (mean - spread, mean + spread)


def _consistency(counted: Array, runs: int, dof: int) -> BlockNees:
    mean = float(_mean(counted))
    band = mean_band(runs, dof) if runs else Band(np.nan, np.nan)
    reported = counted[np.isfinite(counted)]
    share = float((reported > band.high).mean()) if len(reported) else np.nan
    return BlockNees(mean, band, band.place(mean), share)


def _last_poses(kept: FilterTally) -> LastPoses:
    nees = kept.last.pose_nees[np.isfinite(kept.last.pose_nees)]
    least, most = stats.binom.interval(LEVEL, len(nees), LEVEL) if len(nees) else (0, 0)
    count = int(inside(nees, np.asarray(DOF["pose"])).sum())
    return LastPoses(count, len(nees), (int(least), int(most)))


def _mean(values: Array, axis: int | None = None) -> Array:
    """Over what is known; there are no landmarks before the first is mapped."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # nothing reported: NaN is the answer
        return np.asarray(np.nanmean(values, axis=axis))
