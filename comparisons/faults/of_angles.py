"""Angles in a filter's updates: means of them that were not taken round the circle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.faults.formulas import alike
from comparisons.faults.recursion import Remembering
from comparisons.statistics import chi2_tail
from comparisons.trace.events import Update

_EQUAL = 1e-6
"""Relative, of the largest shift, as rounding."""
_LEAST_TURN = 1e-3
"""Least shift of a mean [rad] that is told from another noise."""
_UNLIKELY = 1e-4
"""A residual that is larger with less probability does not fit its covariance."""


class AngleMean(NamedTuple):
    """A mean of angles that lie on both sides of +-pi, by their numbers.

    Points of weight w on the far side shift it by 2 pi w. Differences from it that are wrapped
    then have a second moment that is larger by the square of this shift.

    Attributes:
        component: Of the measurement, which is the angle.
        shift: How far the residual is off by it [rad].
        spread: (m, m) the innovation's covariance that follows.
        gain: (n, m) Kalman's for that.
    """

    component: int
    shift: float
    spread: Array
    gain: Array

    @property
    def words(self) -> str:
        """What an update was done with."""
        of = "" if len(self.spread) == 1 else f" of component {self.component}"
        off = abs(self.shift)
        return (
            f"gain and covariance are Kalman's for a variance{of} that is {off:.4g}^2 more, and "
            f"the residual is off by {off:.4g}: fits a mean of angles on both sides of +-pi that "
            f"was taken without wrapping them, {off / (2.0 * np.pi):.3g} of the weight beyond"
        )


def angle_mean(event: Update, replay: Remembering) -> AngleMean | None:
    """Return the mean of angles by which an update has its gain and its residual; None without one.

    The gain must be Kalman's, P H^T S^-1, of an S that is larger by a square in one component
    alone, and the residual must fit S once it is off by the root of that, as it does not before:
    any other gain of one residual has such an S, so that shifts below four sigma are not told.

    Args:
        event: With a gain, or with one residual and its correction.
        replay: As before the update.
    """
    gain = told_gain(event)
    if gain is None or not np.isfinite(gain).all() or not gain.any():
        return None
    matrices = replay.matrices(event)
    across = matrices["P"] @ matrices["H"].T
    sound = matrices["H"] @ across + matrices["R"]
    spread: Array = np.asarray(np.linalg.lstsq(gain, across)[0], dtype=np.float64)
    if not alike(gain @ spread, across):
        return None
    more = spread - sound
    component = int(np.argmax(np.abs(np.diag(more))))
    square = float(more[component, component])
    alone = np.zeros_like(more)
    alone[component, component] = square
    if not (_LEAST_TURN**2 < square <= (np.pi * (1.0 + _EQUAL)) ** 2) or not alike(
        sound + alone, spread
    ):
        return None
    shift = float(np.copysign(np.sqrt(square), event.residual[component]))
    off = np.zeros(len(sound))
    off[component] = shift
    if not _fits(event.residual - off, sound) or _fits(event.residual, sound):
        return None
    return AngleMean(component, shift, sound + alone, gain)


def by_angle_mean(replay: Remembering, event: Update) -> None:
    """Do an update with such a mean where it was taken, and as it is where not."""
    mean, before = angle_mean(event, replay), replay.covariance
    replay.apply(event)
    if mean is not None:
        replay.covariance = before - mean.gain @ mean.spread @ mean.gain.T


def told_gain(event: Update) -> Array | None:
    """Return (n, m) the gain of an update: recorded, or told by the correction of one residual."""
    if event.gain is not None or event.correction is None:
        return event.gain
    if len(event.residual) != 1 or not event.residual[0]:
        return None
    told: Array = event.correction[:, None] / event.residual[0]
    return told


def _fits(residual: Array, covariance: Array) -> bool:
    squared = float(residual @ np.linalg.solve(covariance, residual))
    return chi2_tail(squared, len(residual)) > _UNLIKELY
