"""Who was seen: a partition of sightings into landmarks against the log's labels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage

from comparisons.logs.log import Log

Ids = NDArray[np.int64]

CLUSTER_M = 0.35
"""True landmarks nearer than this to each other are told apart by no sensor of ours."""


@dataclass(frozen=True)
class PartitionScore:
    """By pairs of sightings. precision: share of the pairs put together that belong together.

    recall: share of the pairs that belong together that were put together. Unused sightings are
    in no pair put together, but in those that belong together.
    """

    precision: float
    recall: float


@dataclass(frozen=True)
class AssociationScore:
    """An association made without labels, scored by them.

    landmarks: slots against labels. clusters: the same after merging, among the true landmarks
    and among the estimated ones, those within CLUSTER_M of each other; None where the true places
    are not known.
    """

    landmarks: PartitionScore
    clusters: PartitionScore | None


def score_association(
    slot: NDArray[np.intp], landmark: NDArray[np.float64], log: Log
) -> AssociationScore | None:
    """Score an association made without labels; None when the log has none to score it by.

    slot: (M,) of the sightings, negative for unused. landmark: (L, 2) estimated places.
    """
    label = log.sightings.landmark[: len(slot)]
    if not len(label) or (label < 0).any():
        return None
    truth, clusters = log.truth.landmarks, None
    if truth is not None and len(truth.id) > 1 and len(landmark) > 1:
        group = dict(zip(truth.id.tolist(), _clusters(truth.position_m).tolist(), strict=True))
        merged, used = slot.copy(), slot >= 0
        merged[used] = _clusters(landmark)[slot[used]]
        clusters = score_partition(merged, np.array([group.get(i, -1 - i) for i in label.tolist()]))
    return AssociationScore(score_partition(slot, label), clusters)


def score_partition(slot: NDArray[np.intp], label: Ids) -> PartitionScore:
    """Pairs of sightings (M,): slots (negative for unused) against labels."""
    used = slot >= 0
    _, true = np.unique(label, return_inverse=True)
    together = _pairs(np.bincount(slot[used])) if used.any() else 0
    joint = slot[used].astype(np.int64) * (int(true.max()) + 1) + true[used]
    right = _pairs(np.unique(joint, return_counts=True)[1])
    belong = _pairs(np.bincount(true))
    return PartitionScore(right / together if together else 1.0, right / belong if belong else 1.0)


def _pairs(counts: NDArray[np.intp]) -> int:
    return int(np.sum(counts.astype(np.int64) * (counts - 1) // 2))


def _clusters(place: NDArray[np.float64]) -> NDArray[np.int64]:
    """Cluster of each place (L, 2), by single linkage."""
    groups: NDArray[np.int64] = fcluster(linkage(place, "single"), CLUSTER_M, "distance")
    return groups.astype(np.int64)
