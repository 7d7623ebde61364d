"""Defects of what the filter takes the noise to be."""

from __future__ import annotations

import numpy as np

from comparisons.adapters.defects.defect import Defect, with_observation, with_steps
from comparisons.arrays import Array
from ekf_reference.core.ekf import Ekf
from ekf_reference.models.range_bearing import RangeBearing


class SigmaSquaredTwice(RangeBearing):
    """R from variances that were squared again."""

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """R with sigma^4."""
        return super().measured(z, sigma**2)


class SigmaForVariance(RangeBearing):
    """R from sigmas that were not squared."""

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """R with sigma."""
        return super().measured(z, np.sqrt(sigma))


class TwiceTheVariance(RangeBearing):
    """R counted twice."""

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """R, and again."""
        return z, 2.0 * super().measured(z, sigma)[1]


class DegreesForRadians(RangeBearing):
    """The bearing's sigma was given in degrees and taken for radians."""

    def measured(self, z: Array, sigma: Array) -> tuple[Array, Array]:
        """R with the bearing's sigma 57 times as large."""
        return super().measured(z, sigma * (1.0, np.degrees(1.0)))


class ControlSigmaForVariance(Ekf):
    """Q from sigmas that were not squared."""

    def predict(self, control: Array, covariance: Array, duration_s: float) -> None:
        """Q with sigma."""
        super().predict(control, np.sqrt(covariance), duration_s)


class TwiceTheControlVariance(Ekf):
    """Q counted twice."""

    def predict(self, control: Array, covariance: Array, duration_s: float) -> None:
        """Q, and again."""
        super().predict(control, 2.0 * covariance, duration_s)


DEFECTS = (
    Defect(
        "sigma squared twice",
        "R holds sigma^4",
        ("model", "the noise covariance", "square of the variances"),
        with_observation(SigmaSquaredTwice),
    ),
    Defect(
        "sigma for variance in R",
        "R holds sigma",
        ("model", "the noise covariance", "R contains sigma"),
        with_observation(SigmaForVariance),
    ),
    Defect(
        "twice the variance in R",
        "R holds 2 sigma^2",
        ("model", "the noise covariance", "R is 2 times"),
        with_observation(TwiceTheVariance),
    ),
    Defect(
        "degrees for radians in R",
        "the bearing's sigma is in degrees",
        ("model", "the noise covariance", "degrees"),
        with_observation(DegreesForRadians),
    ),
    Defect(
        "sigma for variance in Q",
        "the control's covariance holds sigma",
        ("model", "the noise covariance", "Q contains sigma"),
        with_steps(ControlSigmaForVariance),
    ),
    Defect(
        "twice the variance in Q",
        "the control's covariance is doubled",
        ("model", "the noise covariance", "Q is 2 times"),
        with_steps(TwiceTheControlVariance),
    ),
)
