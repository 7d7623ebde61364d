"""S': the smoother with its own association beside S, which has the filter's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.checks.accuracy import Accuracy
from comparisons.checks.agreement import BlockAgreement, Gaussian, block_agreement
from comparisons.checks.association import (
    AssociationScore,
    PartitionAgreement,
    compare_partitions,
    counterparts,
)
from comparisons.checks.misfit import squared_misfit
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Sightings
from graphslam.optimum import Proof

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class OwnAssociationCheck:
    """The association gap, S - S'.

    partition: the filter's association first, the smoother's own second. pose: S against S' in the
    last pose. landmark_rms_m: between landmarks that share most of their sightings, None without
    any. slot: (M,) the smoother's own landmarks of the sightings, negative for unused. matched:
    (L,) the filter's counterpart of each of its landmarks, -1 for none. differing: the sightings
    that the two do not give to counterparts. cost: (D, 2) squared misfit of each of these, in units
    of its noise, at S with the filter's landmark and at S' with its own, NaN where it is unused.
    estimate, proof, accuracy, score: of S'.
    """

    slot: Index
    matched: Index
    differing: Index
    cost: Array
    partition: PartitionAgreement
    pose: BlockAgreement
    landmark_rms_m: float | None
    estimate: Estimate
    proof: Proof
    accuracy: Accuracy | None
    score: AssociationScore | None


def check_own_association(
    seen: Sightings,
    epoch: Index,
    filters: Index,
    own: Index,
    smoothed: Estimate,
    estimate: Estimate,
    proof: Proof,
    accuracy: Accuracy | None,
    score: AssociationScore | None,
) -> OwnAssociationCheck:
    """Compare. seen, epoch: the sightings, of which the first M are told, and their epochs.

    filters, own: (M,) slots. smoothed: S. estimate, proof, accuracy, score: of S'.
    """
    first, second = counterparts(filters, own)
    apart = smoothed.landmark[first] - estimate.landmark[second]
    poses = [Gaussian(e.pose[-1], e.joint_covariance[:3, :3]) for e in (smoothed, estimate)]
    matched = np.full(len(estimate.landmark), -1, dtype=np.intp)
    matched[second] = first
    differing = differing_sightings(filters, own, matched)
    cost = np.full((len(differing), 2), np.nan)
    for column, (slot, e) in enumerate(((filters, smoothed), (own, estimate))):
        used = np.flatnonzero(slot[differing] >= 0)
        rows = differing[used]
        cost[used, column] = squared_misfit(seen, rows, e.pose[epoch[rows]], e.landmark[slot[rows]])
    return OwnAssociationCheck(
        own,
        matched,
        differing,
        cost,
        compare_partitions(filters, own),
        block_agreement(*poses),
        float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))) if len(apart) else None,
        estimate,
        proof,
        accuracy,
        score,
    )


def differing_sightings(filters: Index, own: Index, matched: Index) -> Index:
    """Which of the sightings (M,) go to landmarks that are not counterparts.

    matched: (L,) the filter's counterpart of each of the own landmarks, -1 for none. A sighting
    that neither uses does not differ.
    """
    used = own >= 0
    meant = np.full(len(own), -1, dtype=np.intp)
    meant[used] = matched[own[used]]
    same = (filters >= 0) & used & (filters == meant)
    return np.flatnonzero(~same & ((filters >= 0) | used))
