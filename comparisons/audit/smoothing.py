"""The filter against the linear smoother of its own events, and against the truth.

For a linear Gaussian problem Cov(filtered - smoothed) = P_f - P_s. The smoother is the event
smoother's, run back from the last snapshot over some snapshots on the way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtr, chdtrc, gammaincinv

from comparisons.arrays import Array, Index
from comparisons.statistics import CLEAR, independent
from graphslam.arrays import Marginal
from graphslam.event_smoother import Link

_LEAST_VARIANCE = 1e-12
"""Eigenvalue of a correlation matrix, relative to the largest, of a direction that counts."""


class Averaged(NamedTuple):
    """Squared errors per degree of freedom: 1 is right.

    band: that 95 % of sound runs keep, by the effective number of independent ones. p_value: the
    same, two-sided. snapshots: how many. worst: number of the snapshot where it is largest.
    """

    mean: float
    band: tuple[float, float]
    p_value: float
    snapshots: int
    worst: int


class Anchors:
    """Filtered marginals at some snapshots, and the links from each to the next."""

    def __init__(self) -> None:
        """Start empty."""
        self._event: list[int] = []
        self._filtered: list[Marginal] = []
        self._links: list[Link] = []

    def add(self, event: int, filtered: Marginal, link: Link | None) -> None:
        """Keep a snapshot's. link: of the one before to this one."""
        self._event.append(event)
        self._filtered.append(filtered)
        if link is not None:
            self._links.append(link)

    def against_smoother(self) -> Averaged | None:
        """Return (x_f - x_s)^T (P_f - P_s)^-1 (x_f - x_s) per clear direction, None of too few.

        A direction is clear in which the future took away at least 5 % of the variance.
        """
        if len(self._filtered) < 2:
            return None
        smoothed, squared, dof = self._filtered[-1], list[float](), list[int]()
        for filtered, link in zip(self._filtered[-2::-1], self._links[::-1], strict=True):
            smoothed = Marginal(
                link.mean_then + link.gain @ (smoothed.mean - link.mean_now),
                link.covariance + link.gain @ smoothed.covariance @ link.gain.T,
            )
            value, clear = _difference(filtered, smoothed)
            squared.append(value)
            dof.append(clear)
        events = np.array(self._event[-2::-1])
        return averaged(np.array(squared), np.array(dof), events)


def _difference(filtered: Marginal, smoothed: Marginal) -> tuple[float, int]:
    """The normalised difference, and the directions it has."""
    sigma = np.sqrt(np.maximum(np.diag(filtered.covariance), 0.0))
    unit = np.where(sigma > 0.0, sigma, 1.0)
    p = filtered.covariance / np.outer(unit, unit)
    values, axes = np.linalg.eigh(p)
    some = values > _LEAST_VARIANCE * values[-1]
    white = axes[:, some] / np.sqrt(values[some])
    left = white.T @ (smoothed.covariance / np.outer(unit, unit)) @ white
    share, turn = np.linalg.eigh(0.5 * (left + left.T))
    clear = 1.0 - share > CLEAR
    along = turn.T @ (white.T @ ((filtered.mean - smoothed.mean) / unit))
    return float((along[clear] ** 2 / (1.0 - share[clear])).sum()), int(clear.sum())


def averaged(squared: Array, dof: Index, event: Index) -> Averaged | None:
    """Of squared errors (n,) with `dof` (n,) directions each, in the order of time."""
    some = dof > 0
    if not some.any():
        return None
    squared, dof, event = squared[some], dof[some], event[some]
    per = squared / dof
    total = independent(per - 1.0) * float(dof.mean())
    mean = float(squared.sum() / dof.sum())
    low, high = (2.0 * gammaincinv(0.5 * total, q) / total for q in (0.025, 0.975))
    p = 2.0 * min(float(chdtr(total, mean * total)), float(chdtrc(total, mean * total)))
    return Averaged(
        mean, (float(low), float(high)), min(p, 1.0), len(per), int(event[np.argmax(per)])
    )
