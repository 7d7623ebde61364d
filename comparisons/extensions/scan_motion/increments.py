"""Whether scan odometry is as sure of its increments as it may be, by truth or by positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import minimize

from comparisons.adapters.scan_odometry import ScanMotion
from comparisons.arrays import Array
from comparisons.checks.accuracy import aligned
from comparisons.extensions.scan_motion.log_by_scans import divide
from comparisons.figures import Named, Nominal
from comparisons.logs.log import Log, Poses, Positions
from comparisons.statistics import Band, chi2_quantile, mean_band, squared_distance
from graphslam.increments import MotionSamples, dead_reckoned
from graphslam.scan import planar

WINDOW_S = 5.0
"""Increments are judged by positions over windows of this length."""
_LEAST_FIXES = 4
_LEAST_SPREAD_M = 1e-3
"""Places closer together give a window no heading."""
_WIDEST = 5.0
"""Largest factor looked for, as a logarithm."""
_FITS = "that fits the errors best"


@dataclass(frozen=True, kw_only=True)
class IncrementCheck:
    """Entry `increments`: how the errors of the motion from scans compare with its covariances.

    By positions both factors are the most likely ones together, since the positions' sigmas may be
    stated too wide as well.

    Attributes:
        against: reference: truth, or positions.
        nees: average normalised squared error per degree of freedom; 1 is right.
        dof: degrees of freedom of the average.
        band: 95 % band of the average, for independent errors.
        factor: factor on the sigmas that would fit.
        reference_factor: factor on the sigmas of the positions, where these are the reference.
        median: median normalised squared error over the median of its distribution, which single
            bad matches do not pull; by truth only.
    """

    against: str
    nees: Nominal[float]
    dof: int
    band: Band
    factor: Annotated[Nominal[float], Named(f"factor on their sigmas {_FITS}", "{:.2f}")]
    reference_factor: Annotated[
        Nominal[float | None], Named(f"factor on the positions' sigmas {_FITS}", "{:.2f}")
    ] = None
    median: Nominal[float | None] = None


def check_increments(motion: ScanMotion, log: Log) -> IncrementCheck | None:
    """By true poses if the log has them, else by its positions, else None."""
    if log.truth.poses is not None:
        return _by_truth(motion, log.truth.poses)
    if log.positions is not None:
        return _by_positions(motion, log.positions)
    return None


def normalised_errors(motion: ScanMotion, poses: Poses) -> Array:
    """(N,) squared errors of the increments against true poses, three degrees of freedom each."""
    known = (motion.time_s >= poses.time_s[0]) & (motion.time_s <= poses.time_s[-1])
    true = poses.at(motion.time_s)
    rows = np.flatnonzero(known[1:] & known[:-1] & ~motion.bridged[1:]) + 1
    errors = [
        planar.between(planar.between(true[k - 1], true[k]), motion.displacement[k])
        for k in rows.tolist()
    ]
    error = np.array([planar.wrapped(e) for e in errors]).reshape(-1, 3)
    return squared_distance(error, motion.covariance[rows])


def _by_truth(motion: ScanMotion, poses: Poses) -> IncrementCheck | None:
    squared = normalised_errors(motion, poses)
    if not len(squared):
        return None
    nees = float(squared.mean()) / 3.0
    return IncrementCheck(
        against="truth",
        nees=nees,
        dof=3 * len(squared),
        band=mean_band(3 * len(squared), 1),
        factor=float(np.sqrt(nees)),
        median=float(np.median(squared) / chi2_quantile(0.5, 3)),
    )


def _by_positions(motion: ScanMotion, fixes: Positions) -> IncrementCheck | None:
    """Windows of increments, each laid onto its own positions, so that nothing else matters.

    The covariance of a window's places is what the increments and the positions say; the window's
    own pose, three unknowns, is fitted with it. Windows with motion that is not the scans', and
    those in which the vehicle stood still, tell nothing.
    """
    windows = []
    fixes = fixes.chosen(fixes.time_s <= motion.time_s[-1])
    for begin in np.arange(motion.time_s[0], motion.time_s[-1], WINDOW_S).tolist():
        some = fixes.chosen((fixes.time_s >= begin) & (fixes.time_s < begin + WINDOW_S))
        few = len(some.time_s) < _LEAST_FIXES
        if few or motion.bridged[_steps(motion, some.time_s)].any():
            continue
        window = _Window(motion, some)
        if window.spread_m > _LEAST_SPREAD_M:
            windows.append(window)
    if not windows:
        return None
    dof = sum(window.dof for window in windows)
    plain = sum(window.likelihood(1.0, 1.0)[0] for window in windows) / dof

    def surprise(log_factors: Array) -> float:
        own, fix = np.exp(2.0 * np.clip(log_factors, -_WIDEST, _WIDEST))
        return -sum(window.likelihood(own, fix)[1] for window in windows)

    found = minimize(surprise, np.zeros(2), method="Nelder-Mead").x
    best = np.exp(np.clip(found, -_WIDEST, _WIDEST))
    return IncrementCheck(
        against="positions",
        nees=plain,
        dof=dof,
        band=mean_band(dof, 1),
        factor=float(best[0]),
        reference_factor=float(best[1]),
    )


def _steps(motion: ScanMotion, time_s: Array) -> slice:
    """The increments that span times (n,)."""
    first = int(np.searchsorted(motion.time_s, time_s[0], side="right")) - 1
    return slice(first + 1, int(np.searchsorted(motion.time_s, time_s[-1], side="left")) + 1)


class _Window:
    """Places of an antenna by chained increments, against n positions."""

    def __init__(self, motion: ScanMotion, fixes: Positions) -> None:
        time_s, position = fixes.time_s, fixes.position_m
        steps = _steps(motion, time_s)
        knots = motion.time_s[steps.start - 1 : steps.stop]
        times = np.unique(np.concatenate((knots, time_s)))
        whole = MotionSamples(motion.displacement[steps], motion.covariance[steps])
        pieces = divide(whole, knots, times)
        path = dead_reckoned(np.zeros(3), pieces.displacement)
        at = np.searchsorted(times, time_s)
        lever = np.array(fixes.antenna_m)
        places = path[at, :2] + _turned(path[at, 2], lever)
        fitted = aligned(places, position)
        turn = _angle(places, fitted)
        self._residual = (fitted - position).ravel()
        self._own = _places_covariance(path, pieces.covariance, at, places, turn)
        self._fixes = block_diag(*fixes.covariance)
        centred = fitted - fitted.mean(axis=0)
        gauge = np.zeros((2 * len(at), 3))
        gauge[0::2, 0] = gauge[1::2, 1] = 1.0
        gauge[0::2, 2], gauge[1::2, 2] = -centred[:, 1], centred[:, 0]
        self._gauge = gauge
        self.dof = 2 * len(at) - 3
        self.spread_m = float(np.sqrt(np.mean(np.sum(centred**2, axis=1))))

    def likelihood(self, own_factor: float, fix_factor: float) -> tuple[float, float]:
        """Squared normalised residual, and logarithm of the restricted likelihood.

        The factors multiply the variances. The window's own pose is fitted by the same weights.
        """
        total = own_factor * self._own + fix_factor * self._fixes
        weighed = np.linalg.solve(total, np.column_stack((self._gauge, self._residual)))
        normal = self._gauge.T @ weighed[:, :3]
        right = self._gauge.T @ weighed[:, 3]
        squared = float(self._residual @ weighed[:, 3] - right @ np.linalg.solve(normal, right))
        volume = np.linalg.slogdet(total)[1] + np.linalg.slogdet(normal)[1]
        return squared, -0.5 * (squared + float(volume))


def _places_covariance(
    path: Array, covariance: Array, at: NDArray[np.intp], places: Array, turn: float
) -> Array:
    """(2 n, 2 n) of places along a path (K, 3), in axes turned by an angle.

    An increment's error, right of its arrival, moves all later places with that pose.
    """
    count = len(at)
    total = np.zeros((2 * count, 2 * count))
    for k, spread in enumerate(covariance, start=1):
        later = at >= k
        if not later.any():
            continue
        axes = path[k, 2] + turn
        cos, sin = np.cos(axes), np.sin(axes)
        swing = places - path[k, :2]
        cos_t, sin_t = np.cos(turn), np.sin(turn)
        east = cos_t * swing[:, 0] - sin_t * swing[:, 1]
        north = sin_t * swing[:, 0] + cos_t * swing[:, 1]
        jacobian = np.zeros((count, 2, 3))
        jacobian[:, :, :2] = np.array(((cos, -sin), (sin, cos)))
        jacobian[:, 0, 2], jacobian[:, 1, 2] = -north, east
        jacobian[~later] = 0.0
        stacked = jacobian.reshape(2 * count, 3)
        total += stacked @ spread @ stacked.T
    return total


def _turned(heading: Array, lever: Array) -> Array:
    cos, sin = np.cos(heading), np.sin(heading)
    return np.column_stack((cos * lever[0] - sin * lever[1], sin * lever[0] + cos * lever[1]))


def _angle(points: Array, moved: Array) -> float:
    """By how much a rigid motion turned points (n, 2)."""
    before = (points - points.mean(axis=0)) @ np.array([1.0, 1.0j])
    after = (moved - moved.mean(axis=0)) @ np.array([1.0, 1.0j])
    return float(np.angle(np.vdot(before, after)))
