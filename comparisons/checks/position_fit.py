"""What makes absolute positions fit a path: every correction of positions in `faults.of_logs`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.faults.of_logs import LogCorrection, corrections
from comparisons.logs.log import LandmarkMeasurements, Log, Poses, Positions, Prior
from comparisons.logs.odometry import OdometryNoise, VelocityOdometry
from comparisons.plane import turned
from comparisons.statistics import mean_band

_OUTSIDE = 0.001
"""Share of positions, of a right correction, whose chi-square is outside the band asked for."""
_AS_LIKELY = -2.0 * float(np.log(1e-6))
"""Chi-square above the least that another correction leaves, which then fits as well."""
_FEWEST = 4
"""Positions; fewer are fitted by anything."""
_BESIDE_S = 10.0
"""Seconds that positions may be before or behind the path's ends."""
_NAMED = 0.02
"""Relative distance of a number from one that has a name."""
_UNFIT = 1e9
"""Whitened residual of what cannot be corrected so."""


class PositionObservations(NamedTuple):
    """Positions (N, 2) at times (N,), with the covariances (N, 2, 2) of what they differ by.

    antenna_m: where the log has it, forward and left of the pose.
    """

    time_s: Array
    position: Array
    covariance: Array
    antenna_m: tuple[float, float]


def position_fit(observations: PositionObservations, path: Poses) -> str:
    """Return the corrections that make positions fit a path, in words, with their figures.

    By weighted least squares, each alone. One explains them that leaves a chi-square in its band;
    those that are about as likely as the best are named, the one with the fewest numbers first.
    Empty where none explains them. path: by odometry and landmarks.
    """
    if len(observations.time_s) < _FEWEST:
        return ""
    log = _alone(observations, path)
    count = 2 * len(observations.time_s)
    fits: list[tuple[int, float, LogCorrection, str]] = []
    for correction in corrections(log):
        if "position" not in correction.slot:
            continue
        numbers, chi2 = _fitted(correction, log, path)
        if mean_band(1, count - len(numbers), _OUTSIDE).holds(chi2):
            fits.append((len(numbers), chi2, correction, _said(correction, numbers)))
    least = min((chi2 for _, chi2, *_ in fits), default=0.0)
    likely = [fit for fit in fits if fit[1] <= least + _AS_LIKELY]
    keys = {(one.slot, one.change) for *_, one, _ in likely}
    words = [
        said
        for *_, correction, said in sorted(likely, key=lambda one: one[:2])
        if not keys.intersection(correction.contains)
    ]
    return ", or ".join(dict.fromkeys(words))


def _alone(observations: PositionObservations, path: Poses) -> Log:
    """A log of the positions, within whose time they may be moved."""
    ends_s = path.time_s[[0, -1]] + (-_BESIDE_S, _BESIDE_S)
    still = np.zeros(2)
    positions = Positions(
        observations.time_s, observations.position, observations.covariance, observations.antenna_m
    )
    return Log(
        name="positions",
        format="",
        prior=Prior(float(ends_s[0]), np.zeros(3), np.eye(3)),
        odometry=VelocityOdometry(ends_s, still, still, OdometryNoise(1.0, 1.0)),
        measurements=LandmarkMeasurements.of(ends_s[1:], np.ones((1, 2)), np.ones(2), -1),
        positions=positions,
    )


def _fitted(correction: LogCorrection, log: Log, path: Poses) -> tuple[tuple[float, ...], float]:
    """The numbers of a correction that leave least, and the chi-square that they leave."""
    starts = [correction.neutral]
    starts += [(one,) for one in correction.grid]
    starts += [(name.number,) for name in correction.names]
    every = [(_chi2(correction, log, path, start), start) for start in starts]
    chi2, start = min(every)
    if not start:
        return start, chi2
    fit = least_squares(lambda p: _residuals(correction, log, path, p.tolist()), start)
    return tuple(fit.x.tolist()), min(chi2, 2.0 * float(fit.cost))


def _chi2(correction: LogCorrection, log: Log, path: Poses, numbers: tuple[float, ...]) -> float:
    return float(np.square(_residuals(correction, log, path, numbers)).sum())


def _residuals(
    correction: LogCorrection, log: Log, path: Poses, numbers: tuple[float, ...]
) -> Array:
    """Whitened residuals (2N,) of corrected positions."""
    count = 0 if log.positions is None else 2 * len(log.positions.time_s)
    try:
        positions = correction.correct(log, *numbers).positions
    except InputError:
        positions = None
    if positions is None or 2 * len(positions.time_s) != count:
        return np.full(count, _UNFIT)
    poses = path.at(positions.time_s)
    expected = poses[:, :2] + turned(np.array(positions.antenna_m), poses[:, 2])
    whiten = np.linalg.inv(np.linalg.cholesky(positions.covariance))
    residuals: Array = np.einsum("nij,nj->ni", whiten, positions.position_m - expected).ravel()
    return residuals


def _said(correction: LogCorrection, numbers: tuple[float, ...]) -> str:
    """What the positions fit with, or if."""
    for name in correction.names if len(numbers) == 1 else ():
        if abs(numbers[0] / name.number - 1.0) < _NAMED:
            return f"if {name.what}"
    return f"with {correction.what(*numbers)}" if numbers else f"if {correction.what()}"
