"""Candidates: new features become landmarks only when reliable and stable.

Guivant 2002, section 2: features enter the map "once they become reliable and stable". A
candidate lives outside the state, as a place in the map; the measurement that completes it
initialises the landmark by Nieto 2005, eq. 2.53, so no measurement is used twice.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.measurements import CANDIDATE, Association, Measurements
from ekf_reference.core.state import KalmanState


@dataclass(frozen=True)
class Reliability:
    """When a candidate becomes a landmark, and when it is given up.

    measurements: at least so many. age_s: since the first at least so long. spread_m: root mean
    square distance of its measurements from their mean at most so much. join_m: a measurement
    belongs to a candidate within this distance. silence_s: one unseen for longer is dropped.
    """

    measurements: int = 5
    age_s: float = 0.8
    spread_m: float = 0.5
    join_m: float = 1.0
    silence_s: float = 3.0


@dataclass
class _Candidate:
    """Sums over the places (2,) of a candidate's measurements, and their times."""

    first_s: float
    last_s: float
    total: Array = field(default_factory=lambda: np.zeros(2))
    squares: float = 0.0
    count: int = 0

    def add(self, place: Array, time_s: float) -> None:
        self.total = self.total + place
        self.squares += float(np.einsum("i,i->", place, place))
        self.count += 1
        self.last_s = time_s

    @property
    def mean(self) -> Array:
        return self.total / self.count

    def complete(self, rule: Reliability) -> bool:
        spread = self.squares / self.count - float(np.einsum("i,i->", self.mean, self.mean))
        return (
            self.count >= rule.measurements
            and self.last_s - self.first_s >= rule.age_s
            and spread <= rule.spread_m**2
        )


@dataclass(kw_only=True)
class LandmarkInitiation:
    """Wraps an association rule; its new landmarks have to pass as candidates first.

    promoted, dropped: how many candidates became landmarks, and how many never did.
    """

    rule: Association
    reliability: Reliability = field(default_factory=Reliability)
    promoted: int = 0
    dropped: int = 0
    _candidates: list[_Candidate] = field(default_factory=list)

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Assign by the rule, but new landmarks are CANDIDATE until they are reliable."""
        slots = self.rule.assign(state, model, seen)
        self._forget(seen.time_s)
        new = np.flatnonzero(slots >= state.landmark_count)
        if not len(new):
            return slots
        place = model.invert(state.pose, seen.z[new]).landmark
        slots[new] = CANDIDATE
        ready = new[self._complete(place, seen.time_s)]
        slots[ready] = state.landmark_count + np.arange(len(ready))
        return slots

    def _complete(self, place: Array, time_s: float) -> list[int]:
        """Add places (m, 2); return the first of each candidate that is thereby complete."""
        joined = [self._nearest(point) for point in place]
        for k, candidate in enumerate(joined):
            if candidate is None:
                joined[k] = candidate = _Candidate(time_s, time_s)
                self._candidates.append(candidate)
            candidate.add(place[k], time_s)
        done: dict[int, int] = {}
        for k, candidate in enumerate(joined):
            if candidate is not None and candidate.complete(self.reliability):
                done.setdefault(id(candidate), k)
        self._candidates = [one for one in self._candidates if id(one) not in done]
        self.promoted += len(done)
        return list(done.values())

    def _nearest(self, point: Array) -> _Candidate | None:
        """The candidate within reach of a place (2,) that is nearest to it."""
        if not self._candidates:
            return None
        away = np.linalg.norm(point - [one.mean for one in self._candidates], axis=1)
        return self._candidates[away.argmin()] if away.min() <= self.reliability.join_m else None

    def _forget(self, time_s: float) -> None:
        silence_s = self.reliability.silence_s
        alive = [one for one in self._candidates if time_s - one.last_s <= silence_s]
        self.dropped += len(self._candidates) - len(alive)
        self._candidates = alive
