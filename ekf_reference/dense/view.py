"""What dense mapping reads of a filter. Nothing here, or behind it, writes to the filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.layout import POINT


@dataclass(frozen=True)
class FilterView:
    """A filter at one instant (Nieto 2005, section 3.7: information flows one way).

    pose: (3,) x, y, heading. landmark: (L, 2) [m] all of the map; one that has left the map, or
    is not there yet, is NaN, since places in the map are for good. slot: (m,) landmarks whose
    covariance is current, ascending; of a compressed filter the active ones. covariance:
    (3 + 2 m, 3 + 2 m) of the pose and these. The arrays are the filter's own, read-only, and hold
    until it moves on.

    Of landmarks with a direction these are the places: x and y of the state, with what of its
    covariance belongs to them (Nieto 2005, section 6.2). With several kinds a place in the map is
    a number as of Layout.numbered.
    """

    pose: Array
    landmark: Array
    slot: Index
    covariance: Array

    @classmethod
    def of(cls, ekf: Ekf, kinds: tuple[int, ...] = (POINT,)) -> FilterView:
        """The filter as it is now, whatever it keeps its pose as. kinds: of landmarks, by width."""
        reading, seen = ekf.read_pose(), ekf.state.snapshot(kinds)
        covariance = seen.covariance
        p = len(reading.own)
        if p != 3:
            turn = np.eye(3 + 2 * len(seen.slot), len(covariance), k=p - 3)
            turn[:3, :] = 0.0
            turn[:3, :p] = reading.jacobian
            covariance = turn @ covariance @ turn.T
        return cls(reading.pose, seen.landmark, seen.slot, covariance)

    def near(self, reach_m: float) -> Index:
        """(k,) landmarks with a current covariance, at most so far east-west and north-south."""
        apart = np.abs(self.landmark[self.slot] - self.pose[:2])
        close = np.flatnonzero(apart.max(axis=1, initial=0.0) <= reach_m)
        return self.slot[close]

    def joint(self, slot: Index) -> Array:
        """(3 + 2 k, 3 + 2 k) covariance of the pose and some landmarks (k,) among `slot`."""
        place = 3 + 2 * np.searchsorted(self.slot, slot)
        columns = np.concatenate((np.arange(3), (place[:, None] + np.arange(2)).ravel()))
        part: Array = self.covariance[columns[:, None], columns]
        return part
