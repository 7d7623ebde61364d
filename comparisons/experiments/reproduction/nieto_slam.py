"""Nieto 2005, section 2.9: feature SLAM in simulation, Figs. 2.8 to 2.12, and Fig. 3.4.

The drive is that of Table 2.2. Where its landmarks stand and where it starts is ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.consistency.nees import PoseErrors, pose_errors
from comparisons.estimates.estimate import landmark_blocks
from comparisons.experiments.reproduction.interface import Experiment, Sources
from comparisons.experiments.reproduction.watched_run import truth_in_order, watched_run
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log, Positions
from comparisons.logs.simulate.drive import Drive
from comparisons.statistics import normalise
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.state import correlation_coefficients

LOOPS = 3
"""The thesis goes round "several times"."""
LOOP_S = Drive().loop_s
_AWAY_S = 30.0
_CLOCK_S = 1e-6
_FIXES, _EVERY_S, _SIGMA_FIX_M = 5, 17.0, 0.1


@dataclass(frozen=True)
class Moment:
    """The filter after a scan. landmark, true: (L, 2). covariance: (3 + 2 L, 3 + 2 L)."""

    time_s: float
    landmark: Array
    true: Array
    covariance: Array

    @classmethod
    def of(cls, time_s: float, ekf: Ekf, true: Array) -> Moment:
        """true: (K, 2) of all landmarks, in the filter's order, K at least its number."""
        place = ekf.state.landmarks.copy()
        return cls(time_s, place, true[: len(place)], ekf.state.covariance.copy())

    @property
    def blocks(self) -> Array:
        """(L, 2, 2) covariances of the landmarks."""
        return landmark_blocks(self.covariance)

    @property
    def error_m(self) -> Array:
        """(L,) distances to the truth."""
        error: Array = np.linalg.norm(self.landmark - self.true, axis=1)
        return error

    @property
    def squared(self) -> Array:
        """(L,) normalised errors squared."""
        error = self.landmark - self.true
        return normalise(error, self.blocks).squared

    @property
    def sigma_m(self) -> Array:
        """(L,) root of the sum of a landmark's variances."""
        sigma: Array = np.sqrt(np.trace(self.blocks, axis1=1, axis2=2))
        return sigma

    @property
    def coefficients(self) -> Array:
        """Correlation coefficients of the whole state (eq. 2.62)."""
        return correlation_coefficients(self.covariance)

    @property
    def mean_correlation(self) -> float:
        """Of two landmarks along the same axis, all pairs."""
        rho, n = self.coefficients[3:, 3:], len(self.landmark)
        pairs = np.triu_indices(n, 1)
        return float(np.mean([rho[axis::2, axis::2][pairs] for axis in (0, 1)]))

    def far(self, start: Array) -> Array:
        """(L,) which landmarks are among the third that is farthest from a place (2,)."""
        distance = np.linalg.norm(self.true - start, axis=1)
        chosen: Array = distance >= np.quantile(distance, 2.0 / 3.0)
        return chosen


@dataclass(frozen=True, kw_only=True)
class LoopDrive:
    """One drive. poses: at the scans. pose: (T, 3). first_landmark_m: (T, 2) sigmas of the first.

    quarter, before, after, end: the filter after a quarter of the loop, with the last scan before
    the start is seen again, at the end of the first loop, and after all loops.
    """

    source: Log
    pose: Array
    poses: PoseErrors
    first_landmark_m: Array
    quarter: Moment
    before: Moment
    after: Moment
    end: Moment

    @property
    def true_path(self) -> Array:
        """(T, 2) at the scans."""
        path: Array = (self.pose - self.poses.error)[:, :2]
        return path


@dataclass(frozen=True)
class Loops:
    """Several drives; the first is drawn."""

    log: str
    drives: tuple[LoopDrive, ...]


@dataclass(frozen=True, kw_only=True)
class Fixed:
    """A map while a few absolute positions arrive.

    fix_s: their times. before, after: all of them. time_s, mean_correlation: (T,) at the scans.
    """

    log: str
    fix_s: Array
    before: Moment
    after: Moment
    time_s: Array
    mean_correlation: Array


def loops(sources: Sources) -> Loops:
    """Drives of three loops, seeds from 0."""
    each = [
        open_log("simulated-loop", choices=SimulationChoices(seed, LOOPS))
        for seed in range(sources.drives)
    ]
    name = f"simulated-loop --loops {LOOPS}, {len(each)} drives from seed 0"
    return Loops(name, tuple(loop_drive(log) for log in each))


def loop_drive(log: Log) -> LoopDrive:
    """Run the filter over a labelled simulated log of at least one loop."""
    until = {
        "quarter": 0.25 * LOOP_S,
        "before": closing_s(log) - _CLOCK_S,
        "after": LOOP_S,
        "end": log.end_s,
    }
    poses, true = truth_in_order(log)
    kept: dict[str, Moment] = {}
    time, pose, spread, first = [], [], [], []
    for time_s, ekf in watched_run(log):
        covariance = ekf.state.covariance
        time.append(time_s)
        pose.append(ekf.state.pose)
        spread.append(covariance[:3, :3].copy())
        first.append(np.sqrt(np.diag(covariance)[3:5]))
        for name, latest in until.items():
            if time_s <= latest + _CLOCK_S:
                kept[name] = Moment.of(time_s, ekf, true)
    at = np.array(time)
    errors = pose_errors(at, np.array(pose), np.array(spread), poses.at(at))
    return LoopDrive(
        source=log, pose=np.array(pose), poses=errors, first_landmark_m=np.array(first), **kept
    )


def fixed(sources: Sources) -> Fixed:
    """One loop, then a few positions on the next, evenly along it."""
    log = open_log("simulated-loop", choices=SimulationChoices(0, 2))
    poses, true = truth_in_order(log)
    time = LOOP_S + _EVERY_S * np.arange(_FIXES, dtype=float)
    noise = np.random.default_rng(1).standard_normal((_FIXES, 2))
    place = poses.at(time)[:, :2] + _SIGMA_FIX_M * noise
    fixes = Positions(time, place, np.broadcast_to(_SIGMA_FIX_M**2 * np.eye(2), (_FIXES, 2, 2)))
    seen = []
    for time_s, ekf in watched_run(log, positions=fixes):
        if time_s > time[-1] + _CLOCK_S:
            break
        if time_s > time[0] - 1.0:
            seen.append(Moment.of(time_s, ekf, true))
    return Fixed(
        log="simulated-loop, seed 0, with positions of our own",
        fix_s=time,
        before=next(m for m in reversed(seen) if m.time_s < time[0] - _CLOCK_S),
        after=seen[-1],
        time_s=np.array([m.time_s for m in seen]),
        mean_correlation=np.array([m.mean_correlation for m in seen]),
    )


LOOP_EXPERIMENT = Experiment("section 2.9", loops)
FIXED_EXPERIMENT = Experiment("section 2.9 with positions", fixed)


def closing_s(log: Log) -> float:
    """When the first scan's landmarks are seen again after a while."""
    seen = log.measurements
    early = seen.landmark[seen.time_s <= seen.time_s[0]]
    time = seen.time_s[np.isin(seen.landmark, early)]
    return float(time[1:][np.diff(time) > _AWAY_S][0])
