"""What dense mapping reads of a filter. Nothing here, or behind it, writes to the filter."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT, LandmarkKind
from ekf_reference.core.layout import Layout


@dataclass(frozen=True)
class FilterView:
    """A filter at one instant (Nieto 2005, section 3.7: information flows one way).

    pose: (3,) x, y, heading. landmark: (L, 2) [m] all of the map; one that has left the map, or
    is not there yet, is NaN, since places in the map are for good. landmark_index: (m,) landmarks
    whose covariance is current, ascending; of a compressed filter the active ones. covariance:
    (3 + 2 m, 3 + 2 m) of the pose and these. All are copies.

    Of pose landmarks these are the places: x and y of the state, with what of its
    covariance belongs to them (Nieto 2005, section 6.2). With several kinds a place in the map is
    a number as of `numbered`.
    """

    pose: Array
    landmark: Array
    landmark_index: Index
    covariance: Array

    @classmethod
    def of(cls, ekf: Ekf, kinds: tuple[LandmarkKind, ...] = (POINT,)) -> Self:
        """The filter as it is now, whatever it keeps its pose as. kinds: of landmarks."""
        reading = ekf.read_pose()
        seen = [ekf.state.snapshot(kind) for kind in kinds]
        number, first = numbered(ekf.state.layout, kinds, [each.landmark_index for each in seen])
        p = len(reading.own)
        entry = np.concatenate((np.arange(p), (first[:, None] + np.arange(2)).ravel()))
        covariance = ekf.state.covariance_of(entry)
        if p != 3:
            turn = np.eye(len(covariance) + 3 - p, len(covariance), k=p - 3)
            turn[:3, :] = 0.0
            turn[:3, :p] = reading.jacobian
            covariance = turn @ covariance @ turn.T
        return cls(reading.pose, by_number([each.place for each in seen]), number, covariance)

    @property
    def layout(self) -> Layout:
        """Where the pose and the places of `landmark_index` lie in `covariance`."""
        return Layout.packed(3, len(self.landmark_index))

    def near(self, reach_m: float) -> Index:
        """(k,) landmarks with a current covariance, at most so far east-west and north-south."""
        apart = np.abs(self.landmark[self.landmark_index] - self.pose[:2])
        close = np.flatnonzero(apart.max(axis=1, initial=0.0) <= reach_m)
        return self.landmark_index[close]

    def joint(self, landmark_index: Index) -> Array:
        """(3 + 2 k, 3 + 2 k) covariance of the pose and landmarks (k,) among `landmark_index`."""
        columns = self.layout.columns(np.searchsorted(self.landmark_index, landmark_index))
        return self.covariance[columns[:, None], columns]


def numbered(
    layout: Layout, kinds: Sequence[LandmarkKind], landmark_indices: Sequence[Index]
) -> tuple[Index, Index]:
    """Return numbers (m,), ascending, and first state entries (m,) of landmarks of some kinds.

    landmark_indices: of each kind. Landmark `landmark_index` of the k-th of n kinds has the number
    n landmark index + k, for
    good: with one kind numbers are landmark indices.
    """
    number = np.concatenate(
        [len(kinds) * landmark_index + k for k, landmark_index in enumerate(landmark_indices)]
    )
    each = zip(kinds, landmark_indices, strict=True)
    first = np.concatenate([layout.first[kind][landmark_index] for kind, landmark_index in each])
    order = np.argsort(number)
    return number[order], first[order]


def by_number(kinds: Sequence[Array]) -> Array:
    """Return places (L, 2) by number (see `numbered`) of landmarks (L_k, 2 or 3) of each kind.

    NaN where no landmark has the number.
    """
    count = max((len(kinds) * len(each) for each in kinds), default=0)
    place = np.full((count, 2), np.nan)
    for k, each in enumerate(kinds):
        place[k :: len(kinds)][: len(each)] = each[:, :2]
    return place
