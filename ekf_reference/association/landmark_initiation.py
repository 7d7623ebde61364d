"""Candidates: new features become landmarks only when reliable and stable.

Guivant 2002, section 2: features enter the map "once they become reliable and stable". A candidate
lives outside the state; the measurement that completes it initialises the landmark (Nieto 2005,
eq. 2.53), so no measurement is used twice.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.measurements import CANDIDATE, Association, Measurements
from ekf_reference.core.state import KalmanState


@dataclass(frozen=True)
class Reliability:
    """When a candidate becomes a landmark, and when it is given up.

    measurements: the least number. age_s: the least time since the first. spread_m: the greatest
    root mean square distance of its measurements from their mean. join_m: a measurement belongs to
    a candidate within this distance. silence_s: one unseen for longer is dropped.
    """

    measurements: int = 5
    age_s: float = 0.8
    spread_m: float = 0.5
    join_m: float = 1.0
    silence_s: float = 3.0


@dataclass(eq=False)
class _Candidate:
    """Sums over the places (2,) of a candidate's measurements, and their times."""

    first_s: float
    last_s: float = 0.0
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

    rule: one that goes by the state alone. KnownAssociation is none: it keeps landmark indices of
    its own.
    promoted, dropped: how many candidates became landmarks, and how many never did.
    """

    rule: Association
    reliability: Reliability = Reliability()
    promoted: int = 0
    dropped: int = 0
    _candidates: list[_Candidate] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Raise TypeError for KnownAssociation."""
        if isinstance(self.rule, KnownAssociation):
            raise TypeError("labels give landmark indices away before a landmark is confirmed")

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Assign by the rule, but new landmarks are CANDIDATE until they are reliable."""
        landmark_indices = self.rule.assign(state, model, seen)
        silence_s, before = self.reliability.silence_s, len(self._candidates)
        self._candidates = [c for c in self._candidates if seen.time_s - c.last_s <= silence_s]
        self.dropped += before - len(self._candidates)
        new = np.flatnonzero(landmark_indices >= state.landmark_count)
        place = model.invert(state.pose, seen.z[new]).landmark
        joined = [self._nearest(point) or _Candidate(seen.time_s) for point in place]
        self._candidates += [one for one in joined if not one.count]
        for candidate, point in zip(joined, place, strict=True):
            candidate.add(point, seen.time_s)
        done: dict[_Candidate, int] = {}  # first measurement of each that is complete
        for k, candidate in zip(new.tolist(), joined, strict=True):
            if candidate.complete(self.reliability):
                done.setdefault(candidate, k)
        self._candidates = [one for one in self._candidates if one not in done]
        self.promoted += len(done)
        landmark_indices[new] = CANDIDATE
        landmark_indices[list(done.values())] = state.landmark_count + np.arange(len(done))
        return landmark_indices

    def _nearest(self, point: Array) -> _Candidate | None:
        """The candidate within reach of a place (2,) that is nearest to it."""
        if not self._candidates:
            return None
        away = np.linalg.norm(point - [one.mean for one in self._candidates], axis=1)
        return self._candidates[away.argmin()] if away.min() <= self.reliability.join_m else None
