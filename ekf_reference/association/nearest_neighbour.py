"""Which landmark a sighting belongs to.

An assignment is a slot per sighting, (m,) integers: the landmark's place in the state's map, or
one of the negative codes below. Index from the current landmark count upward name landmarks to
be added, in order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from ekf_reference.association.attributes import (
    NO_ATTRIBUTES,
    AttributeEstimates,
    Attributes,
    same_tail,
)
from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.core.layout import Layout
from ekf_reference.core.local_map import LocalMap
from ekf_reference.core.measurements import Sightings
from ekf_reference.models.range_bearing import Observation

REJECTED = -1
"""Not used: without a label, or a label that the gate contradicts."""
AMBIGUOUS = -2
"""Not used: too far from every landmark to join it, too near to start another, or beaten to it."""
CANDIDATE = -3
"""Not used yet: it may become a landmark (see track_management)."""
DYNAMIC = -4
"""Not used: seen where things move, or of a landmark that stands there (see dynamic_guard)."""

SEARCH_MARGIN_M = 10.0
SEARCH_SIGMAS = 4.0
"""Landmarks are sought this much farther than the longest range of a scan, whichever is more:
metres, or standard deviations of where the vehicle puts the end of that range."""


class MappedState(Protocol):
    """What association asks of a filter's state."""

    @property
    def layout(self) -> Layout:
        """Where pose and landmarks lie."""
        ...

    @property
    def landmark_count(self) -> int:
        """Number of points that were ever in the map: the next one's slot."""
        ...

    @property
    def pose(self) -> Array:
        """(p,) x, y and the direction."""
        ...

    @property
    def pose_covariance(self) -> Array:
        """(p, p)."""
        ...

    def local_map(self, reach_m: float) -> LocalMap:
        """The landmarks within reach."""
        ...

    def map_of(self, slot: Index) -> LocalMap:
        """Some landmarks by slot."""
        ...


class Association(Protocol):
    """Contract of all association rules."""

    def assign(self, state: MappedState, observation: Observation, sightings: Sightings) -> Index:
        """Index (m,) of the sightings of one instant."""
        ...


class Distances(NamedTuple):
    """From m sightings to L landmarks (Nieto 2005, eqs. 2.57, 2.58 and 2.60).

    nis: (m, L) normalised innovation squared. n: (m, L) nis + ln |S|. innovation: (m, L, 2).
    """

    nis: Array
    n: Array
    innovation: Array


def surroundings(state: MappedState, observation: Observation, sightings: Sightings) -> LocalMap:
    """The landmarks that these sightings could be of."""
    longest, variance = (
        float(observation.range_m(sightings.z).max()),
        state.pose_covariance.diagonal(),
    )
    sigma = math.sqrt(variance[:2].sum()) + longest * math.sqrt(variance[2:].sum())
    return state.local_map(longest + max(SEARCH_MARGIN_M, SEARCH_SIGMAS * sigma))


def normalised_distances(
    local: LocalMap, observation: Observation, sightings: Sightings
) -> Distances:
    """Distances of all sightings to all landmarks."""
    predicted = observation.predict(local.pose, local.landmark)
    hv, hl = predicted.jacobian_pose, predicted.jacobian_landmark
    through_pose = hv @ local.vehicle @ hv.transpose(0, 2, 1)
    cross = hv @ local.cross @ hl.transpose(0, 2, 1)
    through_map = hl @ local.own @ hl.transpose(0, 2, 1)
    spread = through_pose + cross + cross.transpose(0, 2, 1) + through_map  # H P H^T, (L, 2, 2)
    s = spread[None] + sightings.noise[:, None]  # (m, L, 2, 2)
    nu = observation.innovation(sightings.z[:, None], predicted.z[None])  # (m, L, 2)
    determinant = s[..., 0, 0] * s[..., 1, 1] - s[..., 0, 1] ** 2
    nis = (
        s[..., 1, 1] * nu[..., 0] ** 2
        - 2.0 * s[..., 0, 1] * nu[..., 0] * nu[..., 1]
        + s[..., 0, 0] * nu[..., 1] ** 2
    ) / determinant
    return Distances(nis, nis + np.log(determinant), nu)


@dataclass
class KnownAssociation:
    """Takes the labels that the log carries; the n-th new label becomes the n-th landmark.

    gate: normalised innovation squared beyond which a label is taken for a misread and its
    sighting rejected (Nieto 2005, section 2.4.1); infinite where labels are certain. first_slot:
    where landmarks by label begin in the map.
    """

    gate: float = float("inf")
    slot_of: dict[int, int] = field(default_factory=dict)
    first_slot: int = 0

    def assign(self, state: MappedState, observation: Observation, sightings: Sightings) -> Index:
        """Look the labels up, giving unseen ones the next slots. Unlabelled are rejected."""
        slots = np.array(
            [
                self.slot_of.setdefault(label, self.first_slot + len(self.slot_of))
                if label >= 0
                else REJECTED
                for label in sightings.identity.tolist()
            ],
            dtype=np.intp,
        )
        return reject_beyond(self.gate, slots, state, observation, sightings)


@dataclass(frozen=True)
class SurveyedLandmarks:
    """Sightings of landmarks that were in the map beforehand go by label, others by a rule.

    slot_of: place in the map of each surveyed landmark's label. gate: as in KnownAssociation; a
    wrong sighting of a landmark that is known for certain does the most harm.
    """

    rule: Association
    slot_of: dict[int, int]
    gate: float = 30.0

    def assign(self, state: MappedState, observation: Observation, sightings: Sightings) -> Index:
        """Surveyed landmarks first, then the rule for the rest."""
        labels = sightings.identity.tolist()
        slots = np.array([self.slot_of.get(label, REJECTED) for label in labels], dtype=np.intp)
        others = np.flatnonzero(slots < 0)
        slots = reject_beyond(self.gate, slots, state, observation, sightings)
        if len(others):
            slots[others] = self.rule.assign(state, observation, sightings.take(others))
        return slots


def reject_beyond(
    gate: float, slots: Index, state: MappedState, observation: Observation, sightings: Sightings
) -> Index:
    """The slots, REJECTED where a landmark was removed or its nis exceeds the gate."""
    mapped = np.flatnonzero((slots >= 0) & (slots < state.landmark_count))
    gone = state.layout.point[slots[mapped]] < 0
    if gone.any():
        slots = slots.copy()
        slots[mapped[gone]], mapped = REJECTED, mapped[~gone]
    if np.isfinite(gate) and len(mapped):
        local = state.map_of(slots[mapped])
        nis = normalised_distances(local, observation, sightings.take(mapped)).nis
        slots = slots.copy()
        slots[mapped[nis.diagonal() > gate]] = REJECTED
    return slots


@dataclass(frozen=True)
class NearestNeighbour:
    """Gated nearest neighbour, each landmark taken at most once in a scan.

    A sighting may join a landmark when its normalised innovation squared (Nieto 2005, eq. 2.58)
    is within `gate`; among those the least N (eq. 2.60) wins, over the whole scan in order of N.
    A sighting whose nis exceeds `new_gate` for every landmark starts a new one; between the two
    gates, or beaten to its landmark, it is ambiguous.

    gate, new_gate: bounds of the chi-square variable with 2 degrees of freedom; with attributes,
    which enter both nis and N, those of the same probability with as many more.
    """

    gate: float = 13.82  # 99.9 %
    new_gate: float = 25.0
    attributes: Attributes = NO_ATTRIBUTES

    def assign(self, state: MappedState, observation: Observation, sightings: Sightings) -> Index:
        """Assign by position and attributes; labels are not used."""
        local = surroundings(state, observation, sightings)
        distances = normalised_distances(local, observation, sightings)
        added = self.attributes.distances(local.slot, sightings)
        nis, dof = distances.nis + added.nis, 2 + added.dof
        column = match_in_order(distances.n + added.n, nis <= same_tail(self.gate, dof))
        unseen = np.logical_and.reduce(nis > same_tail(self.new_gate, dof), axis=1)
        return slots_of(column, unseen, local.slot, state.landmark_count)


@dataclass(frozen=True)
class RememberedAttributes:
    """Wraps all other rules: what a sighting tells goes to the landmark that it was given to.

    memory: the one that the rule within asks.
    """

    rule: Association
    memory: AttributeEstimates

    def assign(self, state: MappedState, observation: Observation, sightings: Sightings) -> Index:
        """As the rule says."""
        slots = self.rule.assign(state, observation, sightings)
        self.memory.note(slots, sightings)
        return slots


@dataclass(frozen=True)
class EuclideanNeighbour:
    """Nearest landmark within d_min of the sighting's place in the map (Misono 2007, eq. 17).

    Eq. 16 is printed with a sign lost; the inverse of the observation model takes its place.
    A sighting with no landmark within d_min starts a new one; beaten to it, it is ambiguous.
    """

    d_min_m: float = 1.0

    def assign(self, state: MappedState, observation: Observation, sightings: Sightings) -> Index:
        """Assign by distance in metres."""
        local = surroundings(state, observation, sightings)
        place = observation.invert(local.pose, sightings.z).point
        distance = np.linalg.norm(place[:, None] - local.landmark[None], axis=2)
        column = match_in_order(distance, distance < self.d_min_m)
        unseen = distance.min(axis=1, initial=np.inf) >= self.d_min_m
        return slots_of(column, unseen, local.slot, state.landmark_count)


def match_in_order(cost: Array, allowed: Mask) -> Index:
    """Column of each row (m,), -1 for none: the cheapest allowed pairs first, none used twice."""
    column = np.full(len(cost), -1, dtype=np.intp)
    rows, columns = np.nonzero(allowed)
    taken: set[int] = set()
    for k in np.argsort(cost[rows, columns], kind="stable").tolist():
        i, j = int(rows[k]), int(columns[k])
        if column[i] < 0 and j not in taken:
            column[i] = j
            taken.add(j)
    return column


def slots_of(column: Index, unseen: Mask, local_slot: Index, count: int) -> Index:
    """Index from columns of a local map; unseen sightings get new slots, the rest is ambiguous."""
    slots = np.full(len(column), AMBIGUOUS, dtype=np.intp)
    matched = column >= 0
    slots[matched] = local_slot[column[matched]]
    slots[unseen] = count + np.arange(np.count_nonzero(unseen))
    return slots
