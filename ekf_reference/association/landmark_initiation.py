"""Candidates: new sightings become landmarks only when reliable and stable.

Guivant 2002, section 2: features enter the map "once they become reliable and stable". A
candidate lives outside the state, as a place in the map; the sighting that completes it
initialises the landmark by Nieto 2005, eq. 2.53, so no sighting is used twice.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ekf_reference.association.nearest_neighbour import CANDIDATE, Association, MappedState
from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.core.measurements import Sightings
from ekf_reference.models.range_bearing import Observation


@dataclass(frozen=True)
class Reliability:
    """When a candidate is believed, and when it is given up.

    sightings: at least so many. age_s: since the first at least so long. spread_m: root mean
    square distance of its sightings from their mean at most so much. join_m: a sighting belongs
    to a candidate within this distance. silence_s: a candidate unseen for longer is dropped.
    """

    sightings: int = 5
    age_s: float = 0.8
    spread_m: float = 0.5
    join_m: float = 1.0
    silence_s: float = 3.0


@dataclass(kw_only=True)
class LandmarkInitiation:
    """Wraps an association rule; its new landmarks have to pass as candidates first.

    promoted, dropped: how many candidates became landmarks, and how many never did.
    """

    rule: Association
    reliability: Reliability = field(default_factory=Reliability)
    promoted: int = 0
    dropped: int = 0
    _sum: Array = field(default_factory=lambda: np.zeros((0, 2)))
    _squares: Array = field(default_factory=lambda: np.zeros(0))
    _count: Array = field(default_factory=lambda: np.zeros(0))
    _first_s: Array = field(default_factory=lambda: np.zeros(0))
    _last_s: Array = field(default_factory=lambda: np.zeros(0))

    def assign(self, state: MappedState, observation: Observation, sightings: Sightings) -> Index:
        """As the rule says, but new landmarks are CANDIDATE until they are reliable."""
        slots = self.rule.assign(state, observation, sightings)
        self._forget(sightings.time_s)
        new = np.flatnonzero(slots >= state.landmark_count)
        if not len(new):
            return slots
        place = observation.invert(state.pose, sightings.z[new]).point
        ready = self._note(place, sightings.time_s)
        slots[new] = CANDIDATE
        slots[new[ready]] = state.landmark_count + np.arange(np.count_nonzero(ready))
        return slots

    def _note(self, place: Array, time_s: float) -> Mask:
        """Add sightings at places (m, 2) to candidates; (m,) whether one is thereby complete."""
        r = self.reliability
        joined = np.full(len(place), -1)
        if len(self._count):
            mean = self._sum / self._count[:, None]
            distance = np.linalg.norm(place[:, None] - mean[None], axis=2)
            nearest = distance.argmin(axis=1)
            near = distance[np.arange(len(place)), nearest] <= r.join_m
            joined[near] = nearest[near]
        fresh = joined < 0
        joined[fresh] = len(self._count) + np.arange(np.count_nonzero(fresh))
        self._grow(place[fresh], time_s)
        np.add.at(self._sum, joined, place)
        np.add.at(self._squares, joined, np.einsum("ij,ij->i", place, place))
        np.add.at(self._count, joined, 1.0)
        self._last_s[joined] = time_s
        mean = self._sum / self._count[:, None]
        variance = self._squares / self._count - np.einsum("ij,ij->i", mean, mean)
        complete = (
            (self._count >= r.sightings)
            & (time_s - self._first_s >= r.age_s)
            & (variance <= r.spread_m**2)
        )
        ready: Mask = complete[joined]
        # Of two sightings of one candidate in a scan, the first makes the landmark.
        first = np.zeros(len(place), dtype=bool)
        first[np.unique(joined, return_index=True)[1]] = True
        self.promoted += int(np.count_nonzero(ready & first))
        self._keep(~np.isin(np.arange(len(complete)), joined[ready]))
        return np.logical_and(ready, first)

    def _forget(self, time_s: float) -> None:
        alive = time_s - self._last_s <= self.reliability.silence_s
        self.dropped += int(np.count_nonzero(~alive))
        if not alive.all():
            self._keep(alive)

    def _grow(self, place: Array, time_s: float) -> None:
        count = len(place)
        self._sum = np.vstack((self._sum, np.zeros((count, 2))))
        self._squares = np.concatenate((self._squares, np.zeros(count)))
        self._count = np.concatenate((self._count, np.zeros(count)))
        self._first_s = np.concatenate((self._first_s, np.full(count, time_s)))
        self._last_s = np.concatenate((self._last_s, np.full(count, time_s)))

    def _keep(self, kept: Mask) -> None:
        self._sum, self._squares = self._sum[kept], self._squares[kept]
        self._count = self._count[kept]
        self._first_s, self._last_s = self._first_s[kept], self._last_s[kept]
