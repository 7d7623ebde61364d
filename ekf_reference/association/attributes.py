"""What distinguishes landmarks besides their positions (Nieto 2005, section 6.4).

A trunk's diameter or a reflector's brightness is constant (Guivant 2002, eq. 16): every landmark
keeps an estimate of each. The density of a pairing is the product of the position's Gaussian and
the attributes', so nis, ln |S| (Nieto 2005, eqs. 2.58 and 2.60) and degrees of freedom add up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from scipy.special import gammainccinv

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.measurements import Association, MeasuredAttributes, Measurements
from ekf_reference.core.state import KalmanState


class AttributeDistances(NamedTuple):
    """What attributes add to distances, all (m, L). n: nis + ln of variances. dof: compared."""

    nis: Array
    n: Array
    dof: Index


class Attributes(Protocol):
    """Contract of what an association rule asks about attributes."""

    def distances(self, landmark_index: Index, seen: Measurements) -> AttributeDistances:
        """Return how far measurements are from landmarks by their attributes.

        Args:
            landmark_index: (L,) landmark indices.
            seen: m measurements.

        Returns:
            (m, L) normalised squares, what they add to N (Nieto 2005, eq. 2.60), and degrees of
            freedom.
        """


class NoAttributes:
    """Landmarks are distinguished by position alone."""

    def distances(self, landmark_index: Index, seen: Measurements) -> AttributeDistances:
        """Add nothing."""
        nothing = np.zeros((len(seen), len(landmark_index)))
        return AttributeDistances(nothing, nothing, nothing.astype(np.intp))


NO_ATTRIBUTES = NoAttributes()


class AttributeEstimates:
    """Mean, variance and count of every landmark's attributes, from the measurements it was given.

    repeats: (A,) measurements with the information of an independent one, as their errors are
    correlated; 1 is the Kalman filter of a constant. No variance exceeds the best measurement's.
    """

    def __init__(self, repeats: Array) -> None:
        """Start without landmarks.

        Args:
            repeats: (A,) measurements with the information of an independent one; 1 where errors
                are independent.
        """
        nothing = np.zeros((0, len(repeats)))
        self.repeats, self.count = repeats, nothing.astype(np.intp)
        self._information = self._weighted = self._least = nothing

    @property
    def mean(self) -> Array:
        """(L, A), NaN where nothing is known; L counts up to the last landmark seen."""
        return self._weighted / np.where(self.count > 0, self._information, np.nan)

    @property
    def variance(self) -> Array:
        """(L, A), NaN where nothing is known."""
        pooled = self.repeats / np.where(self.count > 0, self._information, np.nan)
        return np.where(pooled > self._least, self._least, pooled)

    def distances(self, landmark_index: Index, seen: Measurements) -> AttributeDistances:
        """Return the distances by what both have; nis and dof of nothing else.

        In n a landmark that lacks what was measured stands with the mean and spread of all that
        have it: without the term a density per unit of the attribute would be weighed against one
        without, and the unit would decide.
        """
        self._reach(landmark_index)
        if not seen.attributes.value.shape[1]:
            return NO_ATTRIBUTES.distances(landmark_index, seen)
        mean, variance = self.mean, self.variance
        return compared(
            seen.attributes,
            mean[landmark_index],
            variance[landmark_index],
            population(mean, variance),
        )

    def note(self, landmark_indices: Index, measured: MeasuredAttributes) -> None:
        """Average in the attributes of measurements that were associated.

        Args:
            landmark_indices: (m,) landmark indices; negative codes are passed over.
            measured: Attributes of these m measurements; NaN where not measured.

        Source: Guivant 2002, eq. 16.
        """
        row, column = np.nonzero(np.isfinite(measured.value) & (landmark_indices >= 0)[:, None])
        landmark_index, variance = landmark_indices[row], measured.variance[row, column]
        self._reach(landmark_index)
        np.add.at(self.count, (landmark_index, column), 1)
        np.add.at(self._information, (landmark_index, column), 1.0 / variance)
        np.add.at(self._weighted, (landmark_index, column), measured.value[row, column] / variance)
        np.minimum.at(self._least, (landmark_index, column), variance)

    def _reach(self, landmark_index: Index) -> None:
        more = int(landmark_index.max(initial=-1)) + 1 - len(self.count)
        if more > 0:
            below = ((0, more), (0, 0))
            self.count = np.pad(self.count, below)
            self._information = np.pad(self._information, below)
            self._weighted = np.pad(self._weighted, below)
            self._least = np.pad(self._least, below, constant_values=np.inf)


@dataclass(frozen=True)
class RememberedAttributes:
    """Wraps all other rules: notes in `memory`, which they ask, what a landmark was given."""

    rule: Association
    memory: AttributeEstimates

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Assign by the rule."""
        landmark_indices = self.rule.assign(state, model, seen)
        self.memory.note(landmark_indices, seen.attributes)
        return landmark_indices


def compared(
    seen: MeasuredAttributes, mean: Array, variance: Array, anyone: tuple[Array, Array]
) -> AttributeDistances:
    """Return how far measurements are from landmarks with known attributes.

    Args:
        seen: Attributes of m measurements.
        mean: (L, A) of the landmarks, NaN where unknown.
        variance: (L, A), NaN where unknown.
        anyone: (A,) mean and variance of what a landmark that lacks one stands with.

    Returns:
        (m, L) normalised squares and degrees of freedom of what both have, and what they add to N.
    """
    known = np.isfinite(mean)
    spread = np.where(known, variance, anyone[1]) + seen.variance[:, None]
    nis = (seen.value[:, None] - np.where(known, mean, anyone[0])) ** 2 / spread  # (m, L, A)
    both = np.isfinite(seen.value)[:, None] & known
    n = np.nansum(nis + np.log(spread), axis=2)
    dof = np.count_nonzero(both, axis=2)
    return AttributeDistances(np.where(both, nis, 0.0).sum(axis=2), n, dof)


def population(mean: Array, variance: Array) -> tuple[Array, Array]:
    """Return mean and variance of each attribute over all landmarks that have it.

    Args:
        mean: (L, A), NaN where unknown.
        variance: (L, A), NaN where unknown.

    Returns:
        (A,) and (A,): spread between landmarks and their own variance together; NaN while none has
        it.
    """
    known = np.isfinite(mean)
    landmarks = known.sum(axis=0)
    share = known / np.where(landmarks, landmarks, np.nan)
    mean = np.where(known, mean, 0.0)
    centre = (share * mean).sum(axis=0)
    own = np.where(known, variance, 0.0)
    return centre, (share * ((mean - centre) ** 2 + own)).sum(axis=0)


def same_tail(gate: float, dof: Index) -> Array:
    """Return the chi-square bounds that are exceeded as often as a gate with 2 degrees of freedom.

    Args:
        gate: For 2 degrees of freedom.
        dof: Degrees of freedom, each 2 or more, of any shape.

    Returns:
        Bounds of the same shape.
    """
    more = np.arange(3, int(dof.max(initial=2)) + 1)
    wider = 2.0 * gammainccinv(0.5 * more, math.exp(-0.5 * gate))
    return np.concatenate((np.full(3, gate), wider))[dof]
