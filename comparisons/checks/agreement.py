"""The gaps between the EKF (E), the frozen smoothers (F1, F2) and the smoother (S).

All four are Gaussians over the same vector, the last pose and all landmarks, given the same data.
E - F1 is the filter's algebra, F1 - F2 the model, F2 - S the linearisation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, eigvalsh

from comparisons.arrays import Array
from comparisons.estimates.estimate import Estimate
from comparisons.statistics import ROUNDING, covariance_gap, eigenvalue_range, units
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.core.landmark_types import KINDS, POINT, POSE, LandmarkKind
from ekf_reference.core.layout import Layout

LOST = 64 * float(np.finfo(float).eps)
"""Share of a variance that a filter loses to rounding at most: ten times what filters of 20 to 120
states lost when their prior was wide."""
LARGEST_DISTANCE = 1.0
"""A block agrees when the filter deviates by no more than the optimum itself is uncertain."""
LEAST_VARIANCE_RATIO = 0.25
"""A block agrees when no direction's variance is below this share of the smoother's (half its
sigma), nor above the inverse share."""


@dataclass(frozen=True)
class Gaussian:
    """mean: (n,), headings unwrapped. covariance: (n, n). layout: where pose and landmarks lie."""

    mean: Array
    covariance: Array
    layout: Layout

    @classmethod
    def of(cls, estimate: Estimate) -> Gaussian:
        """Return that of an estimate's last pose and all landmarks."""
        return cls(estimate.joint_mean, estimate.joint_covariance, estimate.layout)

    @classmethod
    def of_pose(cls, pose: Array, covariance: Array) -> Gaussian:
        """Return that of a pose (3,) alone."""
        return cls(pose, covariance, Layout.of_pose(len(pose)))

    def blocks(self, kind: LandmarkKind) -> list[slice]:
        """Return the entries of each landmark of a kind."""
        return [slice(i, i + kind.width) for i in self.layout.first[kind].tolist()]


@dataclass(frozen=True)
class Allowed:
    """The largest gap that rounding explains, in sigma and in covariance.

    stored: the rounding is that of a filter's records, which were stored in single precision.
    """

    sigma: float = ROUNDING
    covariance: float = ROUNDING
    stored: bool = False

    def at_least(self, lost: float) -> Allowed:
        """Return what this explains as well in both; NaN explains nothing."""
        if not lost > ROUNDING:
            return self
        return replace(self, sigma=max(self.sigma, lost), covariance=max(self.covariance, lost))

    def times(self, factor: float) -> Allowed:
        """Return so many times as much."""
        return Allowed(factor * self.sigma, factor * self.covariance, self.stored)

    def plus(self, other: Allowed) -> Allowed:
        """Return what both explain together; it is of storing."""
        return Allowed(self.sigma + other.sigma, self.covariance + other.covariance, stored=True)


EXACT = Allowed()
"""What rounding explains where everything is done and stored in double precision."""


def rounding_of(prior: Array, last: Gaussian) -> Allowed:
    """What double precision explains where numbers far apart stand side by side.

    A filter subtracts from variances as large as the prior's, see `lost_of`. Positions lose as much
    of their distance from the origin.

    Args:
        prior: (3, 3) of the first pose.
        last: S, the last pose and all landmarks.
    """
    places = np.ones(len(last.mean), dtype=bool)
    places[last.layout.angles] = False
    with np.errstate(invalid="ignore", divide="ignore"):
        far = np.abs(last.mean) / np.sqrt(np.diag(last.covariance))
    lost = lost_of(max(prior[0, 0], prior[1, 1]), prior[2, 2], last.covariance)
    return EXACT.at_least(lost).at_least(LOST * float(far[places].max()))


def lost_of(position: float, heading: float, last: Array) -> float:
    """What a filter loses of what it knows best, relative, once it knew as little as this.

    It loses `LOST` of the variances that it subtracts from, and is left with that error: of each
    state this is its variance over what is left of it once all others are known.

    Args:
        position: Variance.
        heading: Variance.
        last: (n, n) of the last pose and all landmarks, S's.
    """
    large = np.maximum(np.diag(last), position)
    large[2] = max(last[2, 2], heading)
    try:
        return LOST * float(np.max(large * np.diag(np.linalg.inv(last))))
    except np.linalg.LinAlgError:
        return 0.0


@dataclass(frozen=True)
class Gap:
    """The distance of two Gaussians.

    sigma: largest difference of a component, in units of S's standard deviation, or of F1's for
    the algebra gap, as `audit` has it.
    covariance: largest |lambda - 1| over the generalised eigenvalues of the covariance pair, or
    the largest asymmetry of either in units of sigma^2 if that is more; infinite when a
    covariance is not positive definite.
    least: the smallest of those eigenvalues; at least 1 says the first covariance is conservative.
    asymmetry: the largest asymmetry alone.
    """

    sigma: float
    covariance: float
    least: float = 1.0
    asymmetry: float = 0.0

    def within(self, tolerance: float) -> bool:
        """Both are at most the tolerance; never true for NaN."""
        return self.sigma <= tolerance and self.covariance <= tolerance

    def explained_by(self, allowed: Allowed) -> bool:
        """Neither is more than allowed; never true for NaN."""
        return self.sigma <= allowed.sigma and self.covariance <= allowed.covariance


@dataclass(frozen=True)
class BlockAgreement:
    """E against S in one block of the state: the pose's three numbers, a landmark's two or three.

    difference_m: distance of the positions. distance: root of d^T P_S^-1 d / dim; 1 means that
    the filter's deviation carries as much error as the optimum itself is uncertain.
    least, largest: generalised eigenvalues of the pair (P_E, P_S); below 1 is optimistic.
    """

    difference_m: float
    distance: float
    least: float
    largest: float


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """All gaps, and E against S for the pose, every landmark and the whole.

    landmark_difference_rms_m: root mean square distance of all landmarks. pose_landmarks: blocks
    of pose landmarks; landmarks: of points.
    """

    algebra: Gap
    model: Gap
    linearisation: Gap
    pose: BlockAgreement
    landmarks: tuple[BlockAgreement, ...]
    whole: BlockAgreement
    landmark_difference_rms_m: float
    pose_landmarks: tuple[BlockAgreement, ...] = ()


def block_agrees(block: BlockAgreement) -> bool:
    """Whether the pose, a landmark or the whole agrees in mean and covariance."""
    return (
        block.distance <= LARGEST_DISTANCE
        and block.least >= LEAST_VARIANCE_RATIO
        and block.largest <= 1.0 / LEAST_VARIANCE_RATIO
    )


def compare(ekf: Gaussian, recorded: Gaussian, own: Gaussian, smoother: Gaussian) -> Agreement:
    """Compare E, F1, F2 and S. Raises LinAlgError when S's covariance is not positive definite."""
    sigma = np.sqrt(np.diag(smoother.covariance))
    difference = _difference(ekf, smoother)
    landmarks, pose_landmarks = (
        tuple(_block(ekf, smoother, difference, part) for part in smoother.blocks(kind))
        for kind in (POINT, POSE)
    )
    distances = [block.difference_m for block in (*landmarks, *pose_landmarks)]
    return Agreement(
        algebra=gap(ekf, recorded, units(ekf.covariance, recorded.covariance)),
        model=gap(recorded, own, sigma),
        linearisation=gap(own, smoother, sigma),
        pose=_block(ekf, smoother, difference, slice(0, 3)),
        landmarks=landmarks,
        whole=_block(ekf, smoother, difference, slice(0, len(sigma))),
        landmark_difference_rms_m=float(np.sqrt(np.mean([d**2 for d in distances])))
        if distances
        else 0.0,
        pose_landmarks=pose_landmarks,
    )


def gap(first: Gaussian, second: Gaussian, sigma: Array) -> Gap:
    """The distance of two Gaussians, in units of sigma (n,)."""
    pair = covariance_gap(first.covariance, second.covariance, sigma)
    largest = float(np.max(np.abs(_difference(first, second)) / sigma))
    return Gap(largest, *pair)


def block_agreement(first: Gaussian, second: Gaussian) -> BlockAgreement:
    """Two Gaussians of one pose (3,), the second being the reference."""
    return _block(first, second, _difference(first, second), slice(0, 3))


def _block(ekf: Gaussian, smoother: Gaussian, difference: Array, part: slice) -> BlockAgreement:
    d = difference[part]
    covariance = smoother.covariance[part, part]
    other = ekf.covariance[part, part]
    apart_m = float(np.hypot(d[0], d[1]))
    if not _positive(covariance):  # perhaps only as metres and radians are far apart
        unit = 1.0 / np.sqrt(np.abs(np.diag(covariance)))
        d, covariance, other = (
            d * unit,
            covariance * np.outer(unit, unit),
            other * np.outer(unit, unit),
        )
        if not _positive(covariance):
            raise LinAlgError("the smoother's covariance is not positive definite to rounding")
    distance = float(np.sqrt(d @ np.linalg.solve(covariance, d) / len(d)))
    low, high = eigenvalue_range(other, covariance)
    return BlockAgreement(apart_m, distance, low, high)


def _positive(covariance: Array) -> bool:
    return bool(np.isfinite(covariance).all() and eigvalsh(covariance)[0] > 0.0)


def _difference(first: Gaussian, second: Gaussian) -> Array:
    """Of the means, headings wrapped. Raises ValueError where they mean different things."""
    for kind in KINDS:
        one, other = (len(g.blocks(kind)) for g in (first, second))
        if one != other:
            raise ValueError(f"{one} {kind.name} landmarks compared with {other}")
    difference, turns = first.mean - second.mean, second.layout.angles
    difference[turns] = wrap_angle(difference[turns])
    return difference
