"""Whether an association made without labels depends on how it was made.

The same measurements, associated backwards in time, with other borders of the pieces and with other
settings, give other partitions and other optima. Two partitions differ where it matters when the
optima are apart by more than the optimum is uncertain. Such a variant speaks against the
association, unless it explains the measurements worse; of several that find it elsewhere, none need
explain them better. The figures are chosen by cross-validation over simulated sensors (see
benchmarks/trust_association.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from comparisons.adapters.smoother_association import Alternative
from comparisons.arrays import Array
from comparisons.checks.association import (
    LandmarkIndices,
    PartitionAgreement,
    compare_partitions,
    counterparts,
    differing_measurements,
)
from ekf_reference.core.geometry import wrap_angle

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
    """One other way to associate.

    partition: the association's first, this one's second. apart_sigma, apart_m: root mean square
    of the poses' distances. excess: how much worse it explains the measurements, as squared misfit
    with costs for landmarks and for measurements left out; negative where it does better. disputed:
    (D,) the measurements that the two do not give to counterparts.
    """

    name: str
    partition: PartitionAgreement
    apart_sigma: float
    apart_m: float
    excess: float
    disputed: LandmarkIndices

    @property
    def elsewhere(self) -> bool:
        """The difference matters."""
        return not self.apart_sigma < APART

    @property
    def better(self) -> bool:
        """It is elsewhere, and explains the measurements no worse."""
        return self.elsewhere and self.excess <= 0.0


@dataclass(frozen=True)
class Dispute:
    """Measurements of one landmark (-1: of none) that a variant gives to others.

    count: of them, within begin_s to end_s.
    """

    variant: str
    landmark: int
    count: int
    begin_s: float
    end_s: float


@dataclass(frozen=True, kw_only=True)
class AssociationCheck:
    """All variants of one association. landmark_index, time_s: (M,) of the measurements."""

    landmark_index: LandmarkIndices
    time_s: Array
    variants: tuple[AssociationVariant, ...]

    @property
    def verified(self) -> bool:
        """No variant that is elsewhere does as well, and few are elsewhere."""
        return not self.against

    @property
    def against(self) -> tuple[AssociationVariant, ...]:
        """The variants that speak against the association."""
        elsewhere = tuple(one for one in self.variants if one.elsewhere)
        if len(elsewhere) >= SEVERAL:
            return elsewhere
        return tuple(one for one in elsewhere if one.better)

    @property
    def disputes(self) -> tuple[Dispute, ...]:
        """The measurements in dispute by landmark, most first, of the variants against."""
        found = []
        for one in self.against:
            landmark_index = self.landmark_index[one.disputed]
            for landmark in np.unique(landmark_index).tolist():
                rows = one.disputed[landmark_index == landmark]
                time_s = self.time_s[rows]
                begin, end = float(time_s.min()), float(time_s.max())
                found.append(Dispute(one.name, max(landmark, -1), len(rows), begin, end))
        return tuple(sorted(found, key=lambda d: -d.count))

    @property
    def remarks(self) -> list[str]:
        """What is in dispute, by each variant against."""
        return [self._remark(one) for one in self.against]

    def _remark(self, one: AssociationVariant) -> str:
        found = [d for d in self.disputes if d.variant == one.name]
        named = "; ".join(
            f"{d.count} of {'no landmark' if d.landmark < 0 else f'landmark {d.landmark}'} "
            f"({d.begin_s:.1f} to {d.end_s:.1f} s)"
            for d in found[:_NAMED]
        )
        more = f"; others of {len(found) - _NAMED} more landmarks" if len(found) > _NAMED else ""
        return (
            f"the association is ambiguous: associating with {one.name} moves the poses by "
            f"{one.apart_m:.2f} m ({one.apart_sigma:.1f} sigma); disputed measurements: "
            f"{named}{more}"
        )


def check_association(
    landmark_index: LandmarkIndices,
    time_s: Array,
    optimum: tuple[Array, Array, float, int],
    others: Iterable[Alternative],
) -> AssociationCheck:
    """Compare an association with others of the same measurements.

    landmark_index: (M,) of measurements at time_s: (M,). optimum: poses (K, 3), their covariances
    (K, 3, 3), chi-square and degrees of freedom with it.
    """
    poses, covariance, chi2, dof = optimum
    scale = max(1.0, chi2 / dof) if dof > 0 else 1.0
    own = _cost(landmark_index, chi2, scale)
    found = []
    for other in others:
        sigma, metres = poses_apart(other.poses, poses, covariance)
        finite = math.isfinite(other.chi2)
        matched = np.full(int(other.landmark_index.max(initial=-1)) + 1, -1, dtype=np.intp)
        first, second = counterparts(landmark_index, other.landmark_index)
        matched[second] = first
        found.append(
            AssociationVariant(
                name=other.name,
                partition=compare_partitions(landmark_index, other.landmark_index),
                apart_sigma=sigma if finite else math.inf,
                apart_m=metres,
                excess=_cost(other.landmark_index, other.chi2, scale) - own,
                disputed=differing_measurements(landmark_index, other.landmark_index, matched),
            )
        )
    return AssociationCheck(landmark_index=landmark_index, time_s=time_s, variants=tuple(found))


def _cost(landmark_index: LandmarkIndices, chi2: float, scale: float) -> float:
    """What an association leaves unexplained; scale: by which the noise is larger than stated."""
    landmarks = len(np.unique(landmark_index[landmark_index >= 0]))
    return (
        chi2 / scale + UNUSED_COST * float(np.sum(landmark_index < 0)) + LANDMARK_COST * landmarks
    )


def poses_apart(poses: Array, reference: Array, covariance: Array) -> tuple[float, float]:
    """Root mean square distance of poses (K, 3) in sigma, each counting as one, and in metres.

    covariance: (K, 3, 3) of the reference. The first pose, which the prior holds, does not count.
    """
    if len(poses) < _FEWEST_EPOCHS:
        return 0.0, 0.0
    d, p = (poses - reference)[1:], covariance[1:]
    d[:, 2] = wrap_angle(d[:, 2])
    squared = np.einsum("ni,ni->n", d, np.linalg.solve(p, d[:, :, None])[:, :, 0]) / 3.0
    return float(np.sqrt(squared.mean())), float(np.sqrt(np.mean(np.sum(d[:, :2] ** 2, axis=1))))
