"""What makes absolute positions fit a path: an offset, another antenna, a delay, a rotation."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from comparisons.arrays import Array
from comparisons.logs.log import Poses
from comparisons.plane import turned
from comparisons.statistics import mean_band
from graphslam.sensor_frame import in_words

_OUTSIDE = 0.001
"""Share of positions, of a right motion, whose chi-square is outside the band that is asked for."""
_AS_LIKELY = -2.0 * float(np.log(1e-6))
"""Chi-square above the least that another motion leaves, which then fits as well."""
_FEWEST = 4
"""Positions; fewer are fitted by anything."""


class PositionObservations(NamedTuple):
    """Positions (N, 2) at times (N,), with the covariances (N, 2, 2) of what they differ by.

    antenna_m: where the log has it, forward and left of the pose.
    """

    time_s: Array
    position: Array
    covariance: Array
    antenna_m: tuple[float, float]


class _Motion(NamedTuple):
    """expected: positions (N, 2) by `size` parameters, zero for none. words: of these."""

    size: int
    expected: Callable[[Array], Array]
    words: Callable[[Array], str]


def position_fit(seen: PositionObservations, path: Poses) -> str:
    """Return the motions that make positions fit a path, in words, with their figures.

    By weighted least squares, each motion alone. One explains them that leaves a chi-square in its
    band; those that are about as likely as the best are named, the one with the fewest parameters
    first. Empty where none explains them. path: by odometry and landmarks.
    """
    if len(seen.time_s) < _FEWEST:
        return ""
    whiten = np.linalg.inv(np.linalg.cholesky(seen.covariance))

    def residual(expected: Array) -> Array:
        found: Array = np.einsum("nij,nj->ni", whiten, seen.position - expected).ravel()
        return found

    found = []
    for one in _motions(seen, path):
        fit = least_squares(lambda p, one=one: residual(one.expected(p)), np.zeros(one.size))
        found.append((one.size, 2.0 * float(fit.cost), one.words(fit.x)))
    count = 2 * len(seen.time_s)
    found = [
        (size, left, words)
        for size, left, words in found
        if mean_band(1, count - size, _OUTSIDE).holds(left)
    ]
    least = min((left for _, left, _ in found), default=0.0)
    return ", or ".join(words for _, left, words in sorted(found) if left <= least + _AS_LIKELY)


def _motions(seen: PositionObservations, path: Poses) -> list[_Motion]:
    poses = path.at(seen.time_s)
    own = _antenna(poses, seen.antenna_m)

    def rotated(p: Array) -> Array:
        cos, sin = np.cos(p[0]), np.sin(p[0])
        return np.asarray(own @ ((cos, sin), (-sin, cos)) + p[1:])

    def placed(p: Array) -> str:
        return f"an antenna at {in_words(*(p + seen.antenna_m))} of the pose"

    return [
        _Motion(
            2, lambda p: own + p, lambda p: f"an offset of {p[0]:.2f} m east, {p[1]:.2f} m north"
        ),
        _Motion(2, lambda p: _antenna(poses, tuple(p + seen.antenna_m)), placed),
        _Motion(
            1,
            lambda p: _antenna(path.at(seen.time_s - p[0]), seen.antenna_m),
            lambda p: f"time stamps {abs(p[0]):.2f} s too {'late' if p[0] > 0.0 else 'early'}",
        ),
        _Motion(
            3,
            rotated,
            lambda p: (
                f"a frame turned by {np.degrees(p[0]):.2f} degrees about the origin, then "
                f"moved by {p[1]:.2f} m east, {p[2]:.2f} m north"
            ),
        ),
    ]


def _antenna(poses: Array, antenna_m: tuple[float, ...]) -> Array:
    return poses[:, :2] + turned(np.array(antenna_m), poses[:, 2])
