"""Stretches in which the filter used no observation: coverage, and the error beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.estimates.estimate import Estimate

_TIMES_USUAL = 10.0
"""A stretch without observations is a dropout when it is so many times the median interval."""
_LEAST_S = 1.0


@dataclass(frozen=True, kw_only=True)
class Dropout:
    """One stretch, from the last observation used to the next one, or to the log's end.

    way_m: driven meanwhile. refused: measurements that came and were not used. sigma_m,
    sigma_heading_rad: at its begin and as predicted for its end: of the position (root of the sum
    of the variances of x and y) and of the heading. error_m: of the predicted pose at its end, from
    the smoother.
    """

    begin_s: float
    end_s: float
    way_m: float
    refused: int
    sigma_m: tuple[float, float]
    sigma_heading_rad: tuple[float, float]
    error_m: float

    @property
    def growth(self) -> float:
        """How many times as large the position's sigma became."""
        return self.sigma_m[1] / self.sigma_m[0]


@dataclass(frozen=True)
class Dropouts:
    """All of a run, in order. coverage: share of the log's time outside of them.

    error_outside_m: root mean square distance of the filter from the smoother, over the epochs at
    which neither a dropout ends nor one goes on.
    """

    stretches: tuple[Dropout, ...]
    coverage: float
    error_outside_m: float

    @property
    def worst(self) -> Dropout | None:
        """The one over which the position's sigma grew the most."""
        return max(self.stretches, key=lambda stretch: stretch.growth, default=None)


def find_dropouts(run: EkfRun, smoothed: Estimate) -> Dropouts:
    """Stretches without measurements or positions used. smoothed: S, at the same epochs."""
    time_s, until = run.estimate.time_s, run.timeline.steps_until()
    trace = run.trace
    records = *trace.measurements.values(), *trace.initialisations.values(), trace.positions
    seen = np.searchsorted(until, np.concatenate([r.step for r in records]))
    marks = np.unique(np.concatenate(([0], seen, [len(time_s) - 1])))
    interval = np.diff(time_s[marks])
    limit = max(_TIMES_USUAL * float(np.median(interval)) if len(interval) else 0.0, _LEAST_S)
    long = interval > limit
    within, found = np.zeros(len(time_s), dtype=bool), []
    for i in np.flatnonzero(long):
        within[marks[i] + 1 : marks[i + 1] + 1] = True
        found.append(_stretch(run, smoothed, int(marks[i]), int(marks[i + 1])))
    apart = np.linalg.norm(run.departed[~within, :2] - smoothed.pose[~within, :2], axis=1)
    whole = float(time_s[-1] - time_s[0])
    return Dropouts(
        tuple(found),
        1.0 - float(interval[long].sum()) / whole if whole > 0.0 else 1.0,
        float(np.sqrt(np.mean(apart**2))),
    )


def _stretch(run: EkfRun, smoothed: Estimate, first: int, last: int) -> Dropout:
    until, before = run.timeline.steps_until(), run.estimate.pose_covariance[first]
    steps = slice(int(until[first]), int(until[last]))
    own, heading = run.trace.departed.shape[1], float(run.departed[first, 2])
    spread = np.eye(own, 3)  # the pose's x, y, heading to what the filter keeps of them
    if own == 4:
        spread[2:, 2] = -np.sin(heading), np.cos(heading)
    covariance = spread @ before @ spread.T
    for f, q in zip(run.trace.f[steps], run.trace.q[steps], strict=True):
        covariance = f @ covariance @ f.T + q
    turn = np.zeros(own)
    turn[2:] = (-np.sin(run.arrived[last, 2]), np.cos(run.arrived[last, 2])) if own == 4 else 1.0
    way = np.linalg.norm(run.trace.arrived[steps, :2] - run.trace.departed[steps, :2], axis=1).sum()
    epoch = run.timeline.measurement_epoch
    return Dropout(
        begin_s=float(run.estimate.time_s[first]),
        end_s=float(run.estimate.time_s[last]),
        way_m=float(way),
        refused=int(np.count_nonzero((epoch > first) & (epoch < last))),
        sigma_m=(_root(before[0, 0] + before[1, 1]), _root(covariance[0, 0] + covariance[1, 1])),
        sigma_heading_rad=(_root(before[2, 2]), _root(turn @ covariance @ turn)),
        error_m=float(np.linalg.norm(run.arrived[last, :2] - smoothed.pose[last, :2])),
    )


def _root(variance: float) -> float:
    """Of a variance, tiny where a filter made it negative."""
    return float(np.sqrt(max(variance, 1e-18)))
