"""What rounding allows: of computing in double precision, of storing in single precision.

Every limit below which a difference is rounding, and says nothing of a filter, is one of these.
Where a limit is measured for one run, by moving its records in their last places,
`checks/diagnosis/single_precision.py` does so, with the factors of this module.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from comparisons.arrays import Array, Index

EPS = float(np.finfo(float).eps)

ROUNDING = 1e-6
"""Largest algebra and model gap, in sigma and in covariance, that rounding explains, unless a wide
prior explains more."""
LOST = 64 * EPS
"""Share of a variance that a filter loses to rounding at most, and of an estimate's numbers: ten
times what filters of 20 to 120 states lost when their prior was wide."""
SINGULAR = 1e-11
"""Eigenvalue of a correlation matrix, relative to the largest, below which it has no inverse."""
NOTHING = 1e-30
"""A variance, in whatever unit, that is none: rounding of what is known exactly."""
UNOBSERVED = 1e-18
"""Of what the sensors could tell if they were not blind: information below it is rounding."""
SAME_NUMBER = 1e-9
"""Of a residual, or of what a correction takes off it, two of which are one number."""

SINGLE = 2.0**-24
"""What storing in single precision does to a number, relative to it, at the most."""
SINGLE_SIGMA = 1e-3
"""Sigmas of what rounding leaves of covariances in single precision."""
_ALONG, _ALONG_SINGLE = 1e-9, 2.0**-23
"""Of a covariance in products of two sigmas, along any direction; in single precision so much by
entry."""

ALL_BUT, VANISHED, BESIDE = 1e-9, 1e-13, 1e-5
"""Of the variance before an update: what is left by one that tells nearly all; of what cancels in
it, what is left by one that tells all, and the unit in which that is measured, for it is rounding.
"""
LEFT = 4 * EPS
"""Of the largest variance that an entry has had, what is left where an update tells all."""

FORMS = 10.0
"""Rounding is at most so many times what two forms of the update differ by, or what a sound
recursion through the same matrices loses."""
STORED = 4.0
"""Times the rounding of the reference to single precision that is still equal to it."""
FACTOR = 3.0
"""What storing did may be so many times the largest of what several draws of it did."""
OPERATIONS = 4.0
"""A formula computed in a precision is off by so many times what storing its result does."""


@dataclass(frozen=True)
class Allowed:
    """The largest gap that rounding explains, in sigma and in covariance.

    stored: the rounding is that of a filter's records, which were stored in single precision.
    """

    sigma: float = ROUNDING
    covariance: float = ROUNDING
    stored: bool = False

    @property
    def largest(self) -> float:
        """The larger of both."""
        return max(self.sigma, self.covariance)

    def at_least(self, lost: float) -> Allowed:
        """Return what this explains as well in both; NaN explains nothing."""
        return self.at_least_of(Allowed(lost, lost)) if lost > ROUNDING else self

    def at_least_of(self, other: Allowed) -> Allowed:
        """Return what this or another explains."""
        return replace(
            self,
            sigma=max(self.sigma, other.sigma),
            covariance=max(self.covariance, other.covariance),
        )

    def times(self, factor: float) -> Allowed:
        """Return so many times as much."""
        return Allowed(factor * self.sigma, factor * self.covariance, self.stored)

    def plus(self, other: Allowed) -> Allowed:
        """Return what both explain together; it is of storing."""
        return Allowed(self.sigma + other.sigma, self.covariance + other.covariance, stored=True)


EXACT = Allowed()
"""What rounding explains where everything is done and stored in double precision."""


def rounding_of(prior: Array, mean: Array, covariance: Array, angles: Index) -> Allowed:
    """Return what double precision explains where numbers far apart stand side by side.

    A filter subtracts from variances as large as the prior's, see `lost_of`. Positions lose as much
    of their distance from the origin.

    Args:
        prior: (3, 3) of the first pose.
        mean: (n,) of the last pose and all landmarks, the smoother's.
        covariance: (n, n) likewise.
        angles: (a,) entries that are angles.
    """
    places = np.ones(len(mean), dtype=bool)
    places[angles] = False
    with np.errstate(invalid="ignore", divide="ignore"):
        far = np.abs(mean) / np.sqrt(np.diag(covariance))
    lost = lost_of(max(prior[0, 0], prior[1, 1]), prior[2, 2], covariance)
    return EXACT.at_least(lost).at_least(LOST * float(far[places].max()))


def lost_of(position: float, heading: float, last: Array) -> float:
    """What a filter loses of what it knows best, relative, once it knew as little as this.

    It loses `LOST` of the variances that it subtracts from, those of position and heading, and is
    left with that error: of each state this is its variance over what is left of it once all others
    are known. last: (n, n) of the last pose and all landmarks, S's.
    """
    large = np.maximum(np.diag(last), position)
    large[2] = max(last[2, 2], heading)
    try:
        return LOST * float(np.max(large * np.diag(np.linalg.inv(last))))
    except np.linalg.LinAlgError:
        return 0.0


def stored_rounding(*arrays: Array) -> float:
    """Return SINGLE where every number is exactly one of single precision, else 0.

    Arrays of numbers that half of it could hold, such as zeros and ones, are no evidence.
    """
    values = np.concatenate([np.ravel(array) for array in arrays])
    values = values[np.isfinite(values)]
    with np.errstate(over="ignore"):
        if not (values == values.astype(np.float32)).all():
            return 0.0
        plain = values == values.astype(np.float16)
    return 0.0 if plain.all() else SINGLE


def restored(
    arrays: list[Array], rng: np.random.Generator, precision: type = np.float32
) -> list[Array]:
    """Return arrays as they may have been before they were stored in a precision.

    Every number moves within half of its last place, equal ones together, so that what is symmetric
    stays so; by one place at most where that is the last of double precision. Numbers that half
    precision could hold, such as zeros and ones, stay.
    """
    flat = np.concatenate([array.ravel() for array in arrays])
    size, which = np.unique(np.abs(flat), return_inverse=True)
    with np.errstate(over="ignore"):
        plain = size == size.astype(np.float16)
    place = np.spacing(size.astype(precision)).astype(np.float64)
    share = 1.0 if precision is np.float64 else 0.5
    moved = np.where(plain, 0.0, share * place * rng.uniform(-1.0, 1.0, len(size)))
    flat = flat + np.sign(flat) * moved[which]
    ends = np.cumsum([array.size for array in arrays])[:-1]
    return [
        part.reshape(array.shape) for part, array in zip(np.split(flat, ends), arrays, strict=True)
    ]


def rounded_to_single(array: Array) -> Array:
    """Return numbers as single precision stores them."""
    return np.asarray(array.astype(np.float32).astype(float))


def along_directions(covariance: Array) -> float:
    """Return what rounding leaves of a covariance (n, n) along any direction [sigma^2].

    In products of two sigmas; more where its numbers are all of single precision.
    """
    return len(covariance) * _ALONG_SINGLE if stored_rounding(covariance) else _ALONG
