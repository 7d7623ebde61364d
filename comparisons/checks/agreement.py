"""The gaps between the EKF (E), the frozen smoothers (F1, F2) and the smoother (S).

All four are Gaussians over the same vector, the last pose and all landmarks, given the same data.
E - F1 is the filter's algebra, F1 - F2 the model, F2 - S the linearisation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated, Any, NamedTuple, Self, TypeVar

import numpy as np
from scipy.linalg import LinAlgError, eigvalsh

from comparisons.arrays import Array, Index
from comparisons.covariances import covariance_gap, eigenvalue_range, units
from comparisons.estimates.estimate import Estimate
from comparisons.figures import Aside, Figure, LeftOut, Less, Mark, Nominal, at, number
from comparisons.rounding import ROUNDING, Allowed
from comparisons.statistics import chi2_quantile
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.core.landmark_types import KINDS, POINT, POSE, LandmarkKind
from ekf_reference.core.layout import Layout

LARGEST_DISTANCE = 1.0
"""A block agrees when the filter deviates by no more than the optimum itself is uncertain."""
_FEW = 200
"""Landmarks up to which each must be as near as that; see `largest_distance`."""
LEAST_VARIANCE_RATIO = 0.25
"""A block agrees when no direction's variance is below this share of the smoother's (half its
sigma), nor above the inverse share."""


@dataclass(frozen=True)
class Gaussian:
    """mean: (n,), headings unwrapped. covariance: (n, n). layout: where pose and landmarks lie.

    ids: (L,) of the landmarks, by kind; none where these have no names.
    """

    mean: Array
    covariance: Array
    layout: Layout
    ids: Mapping[LandmarkKind, Index] = field(default_factory=dict)

    @classmethod
    def of(cls, estimate: Estimate) -> Gaussian:
        """Return that of an estimate's last pose and all landmarks."""
        ids = {POINT: estimate.landmark_id, POSE: estimate.pose_landmark_id}
        return cls(estimate.joint_mean, estimate.joint_covariance, estimate.layout, ids)

    @classmethod
    def of_pose(cls, pose: Array, covariance: Array) -> Gaussian:
        """Return that of a pose (3,) alone."""
        return cls(pose, covariance, Layout.of_pose(len(pose)))

    def blocks(self, kind: LandmarkKind) -> list[slice]:
        """Return the entries of each landmark of a kind."""
        return [slice(i, i + kind.width) for i in self.layout.first[kind].tolist()]

    def named_blocks(self, kind: LandmarkKind) -> Iterator[tuple[int, slice]]:
        """Yield these with the ids of the landmarks."""
        parts = self.blocks(kind)
        yield from zip(self.ids.get(kind, np.arange(len(parts))), parts, strict=True)


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
        return self.explained_by(Allowed(tolerance, tolerance))

    def explained_by(self, allowed: Allowed) -> bool:
        """Neither is more than allowed; never true for NaN."""
        return self.sigma <= allowed.sigma and self.covariance <= allowed.covariance

    def beside(self, allowed: Allowed) -> str:
        """Return both in words, and what is allowed."""
        limit = f"rounding allows {allowed.sigma:.2g} in both"
        if allowed.stored:
            limit = (
                f"storage in single precision allows {allowed.sigma:.2g} sigma and "
                f"{allowed.covariance:.2g}"
            )
        return (
            f"by {self.sigma:.2g} sigma in the mean and by {self.covariance:.2g} (relative) in the "
            f"covariance ({limit})"
        )


NO_GAP = Gap(math.nan, math.nan)


class VarianceBand(NamedTuple):
    """Variances over the smoother's within which a block agrees."""

    least: float = LEAST_VARIANCE_RATIO
    largest: float = 1.0 / LEAST_VARIANCE_RATIO

    def holds(self, least: float | None, largest: float | None) -> bool:
        """Both are within, as far as there are any."""
        return (least is None or least >= self.least) and (
            largest is None or largest <= self.largest
        )


AGREEING = VarianceBand()


@cache
def largest_distance(count: int, dof: int) -> float:
    """Return within how many sigma each of so many landmarks agrees.

    Of many landmarks the worst lies farther out though none is worse. Beyond 200 the limit grows as
    the largest of `count` draws does beside that of 200: it is `LARGEST_DISTANCE` times the root of
    the ratio of their medians, 2^(-1 / count) quantiles of chi-square. 1.08 sigma for 500 points,
    1.19 for 2,000.
    """
    if count <= _FEW:
        return LARGEST_DISTANCE
    many, few = chi2_quantile(0.5 ** (1.0 / np.array((count, _FEW))), dof).tolist()
    return LARGEST_DISTANCE * math.sqrt(many / few)


@dataclass(frozen=True, kw_only=True)
class BlockAgreement:
    """An estimate compared with the smoother's, in one block of the state: pose, landmark, or all.

    Attributes:
        difference_m: distance of the positions.
        distance_sigma: Mahalanobis distance over the root of the block's dimension, in the
            smoother's sigma; 1: as far as the optimum itself is uncertain.
        variance_ratio_least: least variance of the estimate over the smoother's, of all directions;
            below 1 is overconfident; None without covariances.
        variance_ratio_largest: largest such ratio; None without covariances.
        agrees: whether the block agrees, in mean and covariance.
        limit_sigma: the distance up to which it does.
    """

    difference_m: Less[float]
    distance_sigma: Less[Figure]
    variance_ratio_least: Nominal[Figure | None]
    variance_ratio_largest: Nominal[Figure | None]
    agrees: bool
    limit_sigma: Aside[float] = LARGEST_DISTANCE

    @property
    def near(self) -> bool:
        """As near as the optimum itself is certain."""
        return self.distance_sigma <= self.limit_sigma

    @property
    def ratios(self) -> tuple[float, ...]:
        """The ratios of variances that there are."""
        both = (self.variance_ratio_least, self.variance_ratio_largest)
        return tuple(one for one in both if one is not None)

    @classmethod
    def of(
        cls,
        difference: Array,
        smoother: Array,
        given: Array | None,
        band: VarianceBand = AGREEING,
        among: int = 1,
        **own: Any,
    ) -> Self:
        """Compare a block.

        difference: (d,) of the means. smoother, given: (d, d) covariances. among: how many such
        blocks are compared. own: further fields.
        Raises LinAlgError when the smoother's is not positive definite.
        """
        apart_m = float(np.hypot(difference[0], difference[1]))
        if not _positive(smoother):  # perhaps only as metres and radians are far apart
            unit = 1.0 / np.sqrt(np.abs(np.diag(smoother)))
            difference, smoother = difference * unit, smoother * np.outer(unit, unit)
            given = None if given is None else given * np.outer(unit, unit)
            if not _positive(smoother):
                raise LinAlgError("the smoother's covariance is not positive definite to rounding")
        squared = float(difference @ np.linalg.solve(smoother, difference))
        distance = float(np.sqrt(squared / len(difference)))
        limit = largest_distance(among, len(difference))
        ratios = (None, None) if given is None else eigenvalue_range(given, smoother)
        return cls(
            difference_m=apart_m,
            distance_sigma=distance,
            variance_ratio_least=ratios[0],
            variance_ratio_largest=ratios[1],
            agrees=distance <= limit and band.holds(*ratios),
            limit_sigma=limit,
            **own,
        )


@dataclass(frozen=True, kw_only=True)
class LandmarkAgreement(BlockAgreement):
    """One landmark that the estimate and the smoother have.

    Attributes:
        id: id of the landmark in the log.
    """

    id: int


@dataclass(frozen=True, kw_only=True)
class LandmarksTogether:
    """Landmarks in a few figures, of those that have any."""

    count: Annotated[int, Mark(exact=True)]
    agreeing: Annotated[int, Mark("more", exact=True)]
    difference_rms_m: Less[float | None]
    distance_sigma: Less[float | None]
    variance_ratio_least: Nominal[float | None]
    variance_ratio_largest: Nominal[float | None]

    @classmethod
    def of(cls, rows: Sequence[Any]) -> LandmarksTogether:
        """Return them of `LandmarkAgreement`, or of what a file holds of it."""

        def each(name: str) -> list[float]:
            return [value for row in rows if (value := number(at(row, name))) is not None]

        places, sigmas = each("difference_m"), each("distance_sigma")
        return cls(
            count=len(rows),
            agreeing=sum(at(row, "agrees") is True for row in rows),
            difference_rms_m=float(np.sqrt(np.mean(np.square(places)))) if places else None,
            distance_sigma=max(sigmas, default=None) if len(sigmas) == len(rows) else None,
            variance_ratio_least=min(each("variance_ratio_least"), default=None),
            variance_ratio_largest=max(each("variance_ratio_largest"), default=None),
        )


T = TypeVar("T")
Together = Annotated[T, Mark(together=LandmarksTogether.of)]


@dataclass(frozen=True, kw_only=True)
class PlacedAgreement(LandmarkAgreement):
    """One landmark of filter and smoother.

    Attributes:
        ekf_m: position by the EKF.
        smoother_m: position by the smoother.
    """

    ekf_m: tuple[float, float]
    smoother_m: tuple[float, float]


_ALGEBRA = Mark("less", within="algebra_limit_sigma")
_MODEL = Mark("less", within="model_limit_sigma")


@dataclass(frozen=True, kw_only=True)
class AlgebraFigures:
    """How far a filter is from the solution of its own equations.

    Attributes:
        algebra_gap_sigma: largest difference of the means of EKF and F1, in sigma.
        algebra_gap_covariance: largest deviation from 1 of the generalised eigenvalues of their
            covariances; None where one is not positive definite.
        algebra_limit_sigma: largest algebra gap that rounding explains.
    """

    algebra_gap_sigma: Annotated[Figure | None, _ALGEBRA]
    algebra_gap_covariance: Annotated[Figure | None, _ALGEBRA]
    algebra_limit_sigma: LeftOut[float] = ROUNDING


@dataclass(frozen=True, kw_only=True)
class ModelFigures:
    """How far a filter's models lead from the smoother's, linearised at the same points.

    Attributes:
        model_gap_sigma: largest difference of the means of F1 and F2, in sigma.
        model_gap_covariance: the same for the covariances of F1 and F2, as of the algebra gap.
        model_limit_sigma: largest model gap that rounding explains.
    """

    model_gap_sigma: Annotated[Figure, _MODEL]
    model_gap_covariance: Annotated[Figure, _MODEL]
    model_limit_sigma: LeftOut[float] = ROUNDING


@dataclass(frozen=True, kw_only=True)
class LinearisationFigures:
    """How far the points of linearisation lead.

    Attributes:
        linearisation_gap_sigma: largest difference of the means of F2 and the smoother, in sigma.
        linearisation_gap_covariance: the same for the covariances of F2 and the smoother.
    """

    linearisation_gap_sigma: Less[Figure]
    linearisation_gap_covariance: Less[Figure]


@dataclass(frozen=True, kw_only=True)
class GapFigures(LinearisationFigures, ModelFigures, AlgebraFigures):
    """The gaps between a filter and the smoother."""


def gap_figures(algebra: Gap | None, model: Gap, linearisation: Gap) -> dict[str, Any]:
    """Return the fields of GapFigures but for the limits. algebra: None where it is unknown."""
    found: dict[str, Any] = {}
    for name, difference in (
        ("algebra", algebra),
        ("model", model),
        ("linearisation", linearisation),
    ):
        found[f"{name}_gap_sigma"] = None if difference is None else difference.sigma
        found[f"{name}_gap_covariance"] = None if difference is None else difference.covariance
    return found


@dataclass(frozen=True, kw_only=True)
class Agreement(GapFigures):
    """The gaps of the chain of estimates, and E against S for the pose, every landmark and all.

    Attributes:
        optimism: least variance of the EKF over the smoother's, of all directions; below 1 is
            overconfident.
        pessimism: largest such ratio.
        landmark_difference_rms_m: root mean square distance of the landmarks of EKF and smoother.
        pose: the last pose.
        map: all landmarks and the last pose together.
        landmarks: each landmark, of the points.
        pose_landmarks: each of the others.
        algebra: E - F1.
        model: F1 - F2.
        linearisation: F2 - S.
    """

    optimism: Nominal[Figure]
    pessimism: Nominal[Figure]
    landmark_difference_rms_m: Less[float]
    pose: BlockAgreement
    map: BlockAgreement
    landmarks: Together[tuple[PlacedAgreement, ...]]
    pose_landmarks: Aside[tuple[PlacedAgreement, ...]] = ()
    algebra: Aside[Gap] = NO_GAP
    model: Aside[Gap] = NO_GAP
    linearisation: Aside[Gap] = NO_GAP

    @property
    def agrees(self) -> bool:
        """Pose, every landmark and the map as a whole agree."""
        blocks = (self.pose, *self.landmarks, *self.pose_landmarks, self.map)
        return all(block.agrees for block in blocks)


def compare(ekf: Gaussian, recorded: Gaussian, modelled: Gaussian, smoother: Gaussian) -> Agreement:
    """Compare E, F1, F2 and S. Raises LinAlgError when S's covariance is not positive definite."""
    sigma = np.sqrt(np.diag(smoother.covariance))
    difference = _difference(ekf, smoother)
    landmarks, pose_landmarks = (
        tuple(
            PlacedAgreement.of(
                *_parts(ekf, smoother, difference, part),
                among=len(smoother.blocks(kind)),
                id=int(name),
                ekf_m=tuple(ekf.mean[part][:2].tolist()),
                smoother_m=tuple(smoother.mean[part][:2].tolist()),
            )
            for name, part in smoother.named_blocks(kind)
        )
        for kind in (POINT, POSE)
    )
    distances = [block.difference_m for block in (*landmarks, *pose_landmarks)]
    gaps = (
        gap(ekf, recorded, units(ekf.covariance, recorded.covariance)),
        gap(recorded, modelled, sigma),
        gap(modelled, smoother, sigma),
    )
    whole = BlockAgreement.of(*_parts(ekf, smoother, difference, slice(0, len(sigma))))
    return Agreement(
        **gap_figures(*gaps),
        optimism=whole.ratios[0],
        pessimism=whole.ratios[1],
        landmark_difference_rms_m=float(np.sqrt(np.mean([d**2 for d in distances or [0.0]]))),
        pose=BlockAgreement.of(*_parts(ekf, smoother, difference, slice(0, 3))),
        map=whole,
        landmarks=landmarks,
        pose_landmarks=pose_landmarks,
        algebra=gaps[0],
        model=gaps[1],
        linearisation=gaps[2],
    )


def gap(first: Gaussian, second: Gaussian, sigma: Array) -> Gap:
    """The distance of two Gaussians, in units of sigma (n,)."""
    pair = covariance_gap(first.covariance, second.covariance, sigma)
    largest = float(np.max(np.abs(_difference(first, second)) / sigma))
    return Gap(largest, *pair)


def block_agreement(first: Gaussian, second: Gaussian) -> BlockAgreement:
    """Two Gaussians of one pose (3,), the second being the reference."""
    parts = _parts(first, second, _difference(first, second), slice(0, 3))
    return BlockAgreement.of(*parts)


def _parts(
    ekf: Gaussian, smoother: Gaussian, difference: Array, part: slice
) -> tuple[Array, Array, Array]:
    return difference[part], smoother.covariance[part, part], ekf.covariance[part, part]


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
