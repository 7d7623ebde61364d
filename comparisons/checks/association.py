"""Who was seen: a partition of measurements into landmarks against the log's labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from comparisons.checks.check import Check
from comparisons.checks.finding import Absent, Of
from comparisons.figures import More, Named, rows_of
from comparisons.logs.log import Log
from comparisons.words import Row

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known

Ids = NDArray[np.int64]
LandmarkIndices = NDArray[np.intp]

CLUSTER_M = 0.35
"""True landmarks nearer than this to each other are resolved by no sensor of ours."""


@dataclass(frozen=True)
class PartitionScore:
    """Pairs of measurements put together, compared with the pairs that belong together.

    Unused measurements are in no pair put together, but in those that belong together.

    Attributes:
        precision: share of its pairs that belong together.
        recall: share of the pairs that belong together that it has.
    """

    precision: Annotated[More[float], Named("precision", "{:.3f}")]
    recall: Annotated[More[float], Named("recall", "{:.3f}")]


@dataclass(frozen=True)
class AssociationScore:
    """An association made without labels, compared with the labels.

    Clusters are landmarks within CLUSTER_M of each other, merged among the true ones and among the
    estimated ones. A clump taken for one landmark scores in full by clusters, so both are reported.

    Attributes:
        landmarks: over all measurements with a label.
        clusters: the same with near landmarks taken as one; None where the true places are unknown.
        used: landmarks that have measurements.
        labelled: landmarks that have labelled measurements.
    """

    landmarks: PartitionScore
    clusters: PartitionScore | None
    used: Annotated[int | None, Named("landmarks used")] = None
    labelled: Annotated[int | None, Named("landmarks labelled")] = None

    def rows(self, whose: str) -> list[Row]:
        """Return its figures. whose: as `the filter`."""
        group = f"Association by {whose} against the log's labels"
        found, pairs = rows_of(group, self), "pairs of measurements, same"
        found += rows_of(group, self.landmarks, before=f"{pairs} landmark: ")
        if self.clusters is not None:
            found += rows_of(group, self.clusters, before=f"{pairs} cluster of landmarks: ")
        return found


class AssociationFinding(Of[AssociationScore]):
    """An association against the log's labels, which it has not used."""

    def __init__(self, score: AssociationScore, whose: str) -> None:
        """whose: the filter's or the smoother's, in words."""
        super().__init__(score, entries={"association": score})
        self.whose = whose

    def rows(self) -> Sequence[Row]:
        """Return its figures."""
        return self.value.rows(self.whose)


class CheckAssociation(Check):
    """Does the association put together the measurements that the log's labels put together?"""

    name = "association"
    needs = "labels in the log, and an association made without them"
    errs = "not at all: the scores are reported and change no verdict"
    figures = (("association", AssociationScore),)

    def find(self, known: Known) -> AssociationFinding | Absent:
        """Return the score of the filter's association, or of the smoother's without one."""
        if known.prepared.labelled:
            return Absent("the association is by the log's labels")
        if known.given is None and known.run is None:
            index, places, whose = known.landmark_index, known.smoothed.landmark, "the smoother"
        else:
            run, whose = known.ekf, "the filter"
            index, places = run.landmark_index, run.estimate.landmark
        score = score_association(index, places, known.prepared.log)
        return AssociationFinding(score, whose) if score else Absent("the log has no labels")


def score_association(
    landmark_index: NDArray[np.intp], landmark: NDArray[np.float64], log: Log
) -> AssociationScore | None:
    """Score an association made without labels; None when the log has none to score it by.

    landmark_index: (M,) of the measurements, negative for unused. landmark: (L, 2) estimated
    places.
    """
    label = log.measurements.landmark[: len(landmark_index)]
    if not len(label) or (label < 0).any():
        return None
    truth, clusters = log.truth.landmarks, None
    if truth is not None and len(truth.id) > 1 and len(landmark) > 1:
        group = dict(zip(truth.id.tolist(), _clusters(truth.position_m).tolist(), strict=True))
        merged, used = landmark_index.copy(), landmark_index >= 0
        merged[used] = _clusters(landmark)[landmark_index[used]]
        clusters = score_partition(merged, np.array([group.get(i, -1 - i) for i in label.tolist()]))
    counts = len(np.unique(landmark_index[landmark_index >= 0])), len(np.unique(label))
    return AssociationScore(score_partition(landmark_index, label), clusters, *counts)


def score_partition(landmark_index: NDArray[np.intp], label: Ids) -> PartitionScore:
    """Pairs of measurements (M,): landmark indices (negative for unused) against labels."""
    used = landmark_index >= 0
    _, true = np.unique(label, return_inverse=True)
    together = _pairs(np.bincount(landmark_index[used])) if used.any() else 0
    joint = landmark_index[used].astype(np.int64) * (int(true.max()) + 1) + true[used]
    right = _pairs(np.unique(joint, return_counts=True)[1])
    belong = _pairs(np.bincount(true))
    return PartitionScore(right / together if together else 1.0, right / belong if belong else 1.0)


def _pairs(counts: NDArray[np.intp]) -> int:
    return int(np.sum(counts.astype(np.int64) * (counts - 1) // 2))


def _clusters(place: NDArray[np.float64]) -> NDArray[np.int64]:
    """Cluster of each place (L, 2), by single linkage."""
    from scipy.cluster.hierarchy import fcluster, linkage  # takes long to load

    groups: NDArray[np.int64] = fcluster(linkage(place, "single"), CLUSTER_M, "distance")
    return groups.astype(np.int64)


@dataclass(frozen=True, kw_only=True)
class PartitionAgreement:
    """Two associations of the same measurements, neither being the truth.

    pairs_both: pairs of measurements that both put together; pairs_first, pairs_second: that only
    one does. splits: landmarks of the first whose measurements the second gives to several, merges:
    the reverse; a share below SHARE does not count. only_first, only_second: measurements that only
    one uses.
    """

    pairs_both: int
    pairs_first: int
    pairs_second: int
    splits: int
    merges: int
    only_first: int
    only_second: int

    @property
    def agreement(self) -> float:
        """Share of the pairs put together by either that both put together."""
        every = self.pairs_both + self.pairs_first + self.pairs_second
        return self.pairs_both / every if every else 1.0


SHARE = 0.1
"""Of a landmark's measurements; fewer do not make a split or a merge."""


def compare_partitions(first: NDArray[np.intp], second: NDArray[np.intp]) -> PartitionAgreement:
    """Landmark indices (M,) of the same measurements by two associations, negative for unused."""
    table = _shared(first, second)
    together = _pairs(table.ravel())
    own = [_pairs(np.bincount(one[one >= 0])) for one in (first, second)]
    return PartitionAgreement(
        pairs_both=together,
        pairs_first=own[0] - together,
        pairs_second=own[1] - together,
        splits=_divided(table),
        merges=_divided(table.T),
        only_first=int(np.count_nonzero((first >= 0) & (second < 0))),
        only_second=int(np.count_nonzero((first < 0) & (second >= 0))),
    )


def counterparts(
    first: NDArray[np.intp], second: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Landmarks of two associations that share most of each other's measurements, one to one."""
    table = _shared(first, second)
    if not table.size:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    best = table.argmax(axis=1)
    rows = np.arange(len(table))
    mutual = (table[rows, best] > 0) & (table.argmax(axis=0)[best] == rows)
    return rows[mutual], best[mutual]


def _shared(first: LandmarkIndices, second: LandmarkIndices) -> Ids:
    """How many measurements each landmark of one association shares with each of another."""
    both = (first >= 0) & (second >= 0)
    table = np.zeros((first.max(initial=-1) + 1, second.max(initial=-1) + 1), dtype=np.int64)
    np.add.at(table, (first[both], second[both]), 1)
    return table


def _divided(table: Ids) -> int:
    """Rows whose counts fall on several columns."""
    total = table.sum(axis=1, keepdims=True)
    return int(np.count_nonzero((table > SHARE * np.maximum(total, 1)).sum(axis=1) > 1))


def differing_measurements(
    first: LandmarkIndices, second: LandmarkIndices, matched: LandmarkIndices
) -> LandmarkIndices:
    """Which of the measurements (M,) two associations give to landmarks that are no counterparts.

    matched: (L,) the first's counterpart of each of the second's landmarks, -1 for none. A
    measurement that neither uses does not differ.
    """
    used = second >= 0
    meant = np.full(len(second), -1, dtype=np.intp)
    meant[used] = matched[second[used]]
    same = (first >= 0) & used & (first == meant)
    return np.flatnonzero(~same & ((first >= 0) | used))
