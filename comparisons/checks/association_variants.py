"""Whether an association made without labels depends on how it was made.

The same measurements, associated backwards in time, with other borders of the pieces and with other
settings, give other partitions and other optima. Two partitions differ where it matters when the
optima are apart by more than the optimum is uncertain. Such a variant speaks against the
association, unless it explains the measurements worse; of several that find it elsewhere, none need
explain them better. The figures are chosen by cross-validation over simulated sensors (see
research/trust/association.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.association import (
    LandmarkIndices,
    compare_partitions,
    counterparts,
    differing_measurements,
)
from comparisons.checks.finding import Of
from comparisons.figures import Figure, in_sigma
from comparisons.plane import pose_difference, rms
from comparisons.statistics import squared_distance
from comparisons.words import Row

if TYPE_CHECKING:
    from comparisons.adapters.smoother_association import AlternativeAssociation

APART = 0.7
"""Root mean square distance of the poses, in sigma, from which a difference matters."""
SEVERAL = 3
"""So many variants elsewhere speak against an association however they explain the measurements."""
UNUSED_COST = 13.8
"""Squared misfit that a measurement left out stands for: the gate, beyond which none is used."""
LANDMARK_COST = 10.0
"""Squared misfit that one more landmark must spare."""
_FEWEST_EPOCHS = 2
_NAMED = 3
"""Landmarks named whose measurements are in dispute, by each variant."""


@dataclass(frozen=True, kw_only=True)
class AssociationVariant:
    """An association made in another way.

    Attributes:
        name: what was done differently.
        agreement: share of the pairs of measurements of either that both put together.
        pairs_both: pairs that both put together.
        pairs_association: pairs that the association puts together.
        pairs_variant: pairs that the variant puts together.
        apart_sigma: root mean square distance of the poses at the two optima, in sigma.
        apart_m: the same in metres.
        excess: by how much the variant explains the measurements worse, as squared misfit with
            costs for landmarks and for measurements left out.
        disputed: measurements that the two give to different landmarks.
        elsewhere: the variant's optimum is at another place.
        against: the variant is evidence against the association.
    """

    name: str
    agreement: float
    pairs_both: int
    pairs_association: int
    pairs_variant: int
    apart_sigma: Figure
    apart_m: float
    excess: Figure
    disputed: int
    elsewhere: bool
    against: bool = False


@dataclass(frozen=True)
class Dispute:
    """Measurements of one landmark that a variant gives to others.

    Attributes:
        variant: the variant's name.
        landmark: id of the landmark; -1 for none.
        measurements: number of measurements.
        begin_s: time of the first one.
        end_s: time of the last one.
    """

    variant: str
    landmark: int
    measurements: int
    begin_s: float
    end_s: float


@dataclass(frozen=True, kw_only=True)
class AssociationCheck:
    """Whether an association depends on how it was made.

    Attributes:
        verified: no variant is evidence against it.
        variants: all variants.
        disputes: measurements in dispute by the variants against it, the largest group first.
    """

    verified: bool
    variants: tuple[AssociationVariant, ...]
    disputes: tuple[Dispute, ...]

    @property
    def against(self) -> tuple[AssociationVariant, ...]:
        """The variants that speak against the association."""
        return tuple(variant for variant in self.variants if variant.against)

    @property
    def remarks(self) -> list[str]:
        """What is in dispute, by each variant against."""
        return [self._remark(variant) for variant in self.against]

    def rows(self) -> list[Row]:
        """Return how the association compares with others of the same measurements."""
        group = "Association compared with other ways to associate"
        found = []
        for variant in self.variants:
            alike, far = f"{100.0 * variant.agreement:.1f} %", in_sigma(variant.apart_sigma)
            against = "yes" if variant.against else "no"
            contradicts = f"{variant.name}: contradicts the association"
            found += [
                Row(group, f"{variant.name}: pairs of measurements alike", alike),
                Row(group, f"{variant.name}: difference of the poses (rms)", far),
                Row(group, contradicts, against, "no", not variant.against),
            ]
        return found

    def _remark(self, variant: AssociationVariant) -> str:
        disputes = [d for d in self.disputes if d.variant == variant.name]
        named = "; ".join(
            f"{d.measurements} of {'no landmark' if d.landmark < 0 else f'landmark {d.landmark}'} "
            f"({d.begin_s:.1f} to {d.end_s:.1f} s)"
            for d in disputes[:_NAMED]
        )
        more = (
            f"; others of {len(disputes) - _NAMED} more landmarks" if len(disputes) > _NAMED else ""
        )
        return (
            f"the association is ambiguous: associating with {variant.name} moves the poses by "
            f"{variant.apart_m:.2f} m ({variant.apart_sigma:.1f} sigma); disputed measurements: "
            f"{named}{more}"
        )


class AssociationVariants(Of[AssociationCheck]):
    """How the smoother's association compares with others."""

    def __init__(self, checked: AssociationCheck) -> None:
        """checked: all others."""
        super().__init__(checked, entries={"association_check": checked})

    def rows(self) -> Sequence[Row]:
        """Return rows of the table."""
        return self.value.rows()


def check_association(
    landmark_index: LandmarkIndices,
    time_s: Array,
    optimum: tuple[Array, Array, float, int],
    others: Iterable[AlternativeAssociation],
) -> AssociationCheck:
    """Compare an association with others of the same measurements.

    landmark_index: (M,) of measurements at time_s: (M,). optimum: poses (K, 3), their covariances
    (K, 3, 3), chi-square and degrees of freedom with it.
    """
    poses, covariance, chi2, dof = optimum
    scale = max(1.0, chi2 / dof) if dof > 0 else 1.0
    own = _cost(landmark_index, chi2, scale)
    association_variants, disputed = list[AssociationVariant](), list[LandmarkIndices]()
    for other in others:
        sigma, metres = poses_apart(other.poses, poses, covariance)
        sigma = sigma if math.isfinite(other.chi2) else math.inf
        matched = np.full(int(other.landmark_index.max(initial=-1)) + 1, -1, dtype=np.intp)
        first, second = counterparts(landmark_index, other.landmark_index)
        matched[second] = first
        pairs = compare_partitions(landmark_index, other.landmark_index)
        disputed.append(differing_measurements(landmark_index, other.landmark_index, matched))
        association_variants.append(
            AssociationVariant(
                name=other.name,
                agreement=pairs.agreement,
                pairs_both=pairs.pairs_both,
                pairs_association=pairs.pairs_first,
                pairs_variant=pairs.pairs_second,
                apart_sigma=sigma,
                apart_m=metres,
                excess=_cost(other.landmark_index, other.chi2, scale) - own,
                disputed=len(disputed[-1]),
                elsewhere=not sigma < APART,
            )
        )
    several = sum(variant.elsewhere for variant in association_variants) >= SEVERAL
    variants = tuple(
        replace(variant, against=variant.elsewhere and (several or variant.excess <= 0.0))
        for variant in association_variants
    )
    disputes = [
        Dispute(variant.name, max(landmark, -1), len(at), float(at.min()), float(at.max()))
        for variant, rows in zip(variants, disputed, strict=True)
        if variant.against
        for landmark in np.unique(landmark_index[rows]).tolist()
        for at in [time_s[rows][landmark_index[rows] == landmark]]
    ]
    return AssociationCheck(
        verified=not any(variant.against for variant in variants),
        variants=variants,
        disputes=tuple(sorted(disputes, key=lambda d: -d.measurements)),
    )


def _cost(landmark_index: LandmarkIndices, chi2: float, scale: float) -> float:
    """What an association leaves unexplained; scale: by which the noise is larger than stated."""
    unused = float(np.sum(landmark_index < 0))
    landmarks = len(np.unique(landmark_index[landmark_index >= 0]))
    return chi2 / scale + UNUSED_COST * unused + LANDMARK_COST * landmarks


def poses_apart(poses: Array, reference: Array, covariance: Array) -> tuple[float, float]:
    """Root mean square distance of poses (K, 3) in sigma, each counting as one, and in metres.

    covariance: (K, 3, 3) of the reference. The first pose, which the prior holds, does not count.
    """
    if len(poses) < _FEWEST_EPOCHS:
        return 0.0, 0.0
    apart = pose_difference(poses, reference)[1:]
    squared = squared_distance(apart, covariance[1:]) / 3.0
    return float(np.sqrt(squared.mean())), rms(apart[:, :2])
