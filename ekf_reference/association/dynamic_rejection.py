"""Nothing that moves is navigated by (Nieto 2005, section 6.5).

Sightings from dynamic regions are discarded, and landmarks under them leave the map that sightings
are matched with. Such a landmark is retired: its place in the state is closed for good. A variable
that is never observed again gains nothing and tells nothing: what the filter says of the rest is
what it would say with the landmark marginalised out. So the compressed filter equals the full one
as before, and a smoother that follows the filter's association has nothing to unlearn.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ekf_reference.association.nearest_neighbour import (
    DYNAMIC,
    Association,
    MappedState,
    surroundings,
)
from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.core.layout import Layout
from ekf_reference.core.local_map import LocalMap
from ekf_reference.core.measurements import Sightings
from ekf_reference.models.range_bearing import Observation


class DynamicGuard(Protocol):
    """Whoever knows where things move."""

    def is_dynamic(self, point: Array) -> Mask:
        """(N,) which points (N, 2) of the world [m] lie in a dynamic region."""
        ...


@dataclass
class DynamicRejection:
    """Wraps an association rule: it sees neither dynamic sightings nor retired landmarks.

    retired: slots that are closed. What was fused before a region was found to be dynamic stays
    fused: the filter cannot unlearn it. Only landmarks within reach of the sightings are asked
    about, so that a compressed filter, whose other landmarks are not up to date, retires the same
    ones at the same time.
    """

    rule: Association
    guard: DynamicGuard
    retired: set[int] = field(default_factory=set)

    def assign(self, state: MappedState, observation: Observation, sightings: Sightings) -> Index:
        """As the rule says, but DYNAMIC for what is seen in a dynamic region or is retired."""
        slots = np.full(len(sightings), DYNAMIC, dtype=np.intp)
        if not len(sightings):
            return slots
        around = surroundings(state, observation, sightings)
        under = around.slot[self.guard.is_dynamic(around.landmark)]
        self.retired.update(under.tolist())
        place = observation.invert(around.pose, sightings.z).point
        still = np.flatnonzero(~self.guard.is_dynamic(place))
        if len(still):
            rest = _WithoutRetired(state, np.array(sorted(self.retired), dtype=np.intp))
            slots[still] = self.rule.assign(rest, observation, sightings.take(still))
            slots[np.isin(slots, rest.closed)] = DYNAMIC
        return slots


@dataclass(frozen=True)
class _WithoutRetired:
    """A state in whose surroundings the retired landmarks (R,) are not to be found."""

    state: MappedState
    closed: Index

    @property
    def landmark_count(self) -> int:
        return self.state.landmark_count

    @property
    def layout(self) -> Layout:
        return self.state.layout

    @property
    def pose(self) -> Array:
        return self.state.pose

    @property
    def pose_covariance(self) -> Array:
        return self.state.pose_covariance

    def local_map(self, reach_m: float) -> LocalMap:
        found = self.state.local_map(reach_m)
        kept = np.flatnonzero(~np.isin(found.slot, self.closed))
        if len(kept) == len(found.slot):
            return found
        p, width = len(found.pose), found.landmark.shape[1]
        own = p + width * kept[:, None] + np.arange(width)
        rows = np.concatenate((np.arange(p), own.ravel()))
        return LocalMap(
            found.pose,
            found.slot[kept],
            found.landmark[kept],
            found.covariance[rows[:, None], rows],
            found.columns[rows],
        )

    def map_of(self, slot: Index) -> LocalMap:
        return self.state.map_of(slot)
