"""Joint compatibility branch and bound (Nieto 2005, section 2.4.1, "batch data association").

Sightings of one scan share the error of the pose, so a set of pairings that are each likely can
be unlikely together. The largest set that passes one joint gate wins, the one with the least
joint distance among equals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv

from ekf_reference.association.attributes import NO_ATTRIBUTES, Attributes, same_tail
from ekf_reference.association.nearest_neighbour import (
    MappedState,
    match_in_order,
    normalised_distances,
    slots_of,
    surroundings,
)
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.local_map import LocalMap
from ekf_reference.core.measurements import Sightings
from ekf_reference.core.state import block_diagonal, stack, state_columns
from ekf_reference.models.range_bearing import Observation


@dataclass(frozen=True)
class JointCompatibility:
    """Each pairing within `gate`, all together within the joint gate of the same probability.

    probability: of the chi-square gates. new_gate: as in NearestNeighbour. most_nodes: branches
    visited at the most in one scan; beyond that the best set so far is taken. Of a scan with more
    than `most_sightings` to match, the nearest neighbour decides. attributes: enter every gate with
    their degrees of freedom, and the joint distance by how much less likely they make a pairing
    than the likeliest of the same sighting.
    """

    probability: float = 0.999
    new_gate: float = 25.0
    most_nodes: int = 4000
    most_sightings: int = 100
    attributes: Attributes = NO_ATTRIBUTES

    def assign(self, state: MappedState, observation: Observation, sightings: Sightings) -> Index:
        """Assign by position and attributes, all sightings of the scan together."""
        local = surroundings(state, observation, sightings)
        distances = normalised_distances(local, observation, sightings)
        added = self.attributes.distances(local.slot, sightings)
        nis, n, dof = distances.nis + added.nis, distances.n + added.n, 2 + added.dof
        gates = self._gates(int(dof.max(initial=2)) * len(dof))
        compatible = nis <= gates[dof]
        sighting, landmark = np.nonzero(compatible)
        column = np.full(len(sightings), -1, dtype=np.intp)
        if len(np.unique(sighting)) > self.most_sightings:
            column = match_in_order(n, compatible)
        elif len(sighting):
            nu = distances.innovation[sighting, landmark]
            spread = pair_covariance(local, observation, sightings, sighting, landmark)
            order = np.lexsort((n[sighting, landmark], sighting))
            least = np.where(compatible, added.n, np.inf).min(axis=1, keepdims=True, initial=np.inf)
            row, which = sighting[order], landmark[order]
            beside = _Beside(added.nis[row, which], (added.n - least)[row, which], dof[row, which])
            search = _Search(
                row,
                which,
                nu[order],
                _reorder(spread, order),
                beside,
                gates,
                self.most_nodes,
            )
            for pair in search.best():
                column[search.sighting[pair]] = search.landmark[pair]
        unseen = np.logical_and.reduce(nis > same_tail(self.new_gate, dof), axis=1)
        return slots_of(column, unseen, local.slot, state.landmark_count)

    def _gates(self, most: int) -> Array:
        """Bounds of chi-square variables with 0 to `most` degrees of freedom, 2 at the least."""
        dof = np.maximum(np.arange(most + 1), 2)
        bounds: Array = 2.0 * gammaincinv(0.5 * dof, self.probability)
        return bounds


def pair_covariance(
    local: LocalMap,
    observation: Observation,
    sightings: Sightings,
    sighting: Index,
    landmark: Index,
) -> Array:
    """Covariance (2 p, 2 p) of the innovations of p pairs, all correlations included."""
    chosen, where = np.unique(landmark, return_inverse=True)
    predicted = observation.predict(local.pose, local.landmark[chosen])
    columns = state_columns(chosen, len(local.pose))
    h = stack(predicted.jacobian_pose, predicted.jacobian_landmark).reshape(len(chosen), 2, -1)
    stacked = h[where].reshape(2 * len(landmark), -1)
    spread = stacked @ local.covariance[columns[:, None], columns] @ stacked.T
    return spread + block_diagonal(sightings.noise[sighting])


def _reorder(spread: Array, order: Index) -> Array:
    entries = (2 * order[:, None] + (0, 1)).ravel()
    reordered: Array = spread[entries[:, None], entries]
    return reordered


class _Beside(NamedTuple):
    """What the attributes say of p pairs, apart from each other.

    nis: (p,). cost: (p,) -2 ln of their density, none below 0. dof: (p,) the position's included.
    """

    nis: Array
    cost: Array
    dof: Index


class _Sum(NamedTuple):
    """Of the chosen pairs: joint nis, -2 ln of the density up to a constant, degrees of freedom."""

    nis: float
    cost: float
    dof: int

    def plus(self, nis: float, beside: _Beside, pair: int) -> _Sum:
        """One more pair, whose position adds to the joint nis."""
        return _Sum(
            self.nis + nis + float(beside.nis[pair]),
            self.cost + nis + float(beside.cost[pair]),
            self.dof + int(beside.dof[pair]),
        )


class _Search:
    """Depth first over the sightings; every node extends one Cholesky factor by two rows."""

    def __init__(
        self,
        sighting: Index,
        landmark: Index,
        nu: Array,
        spread: Array,
        beside: _Beside,
        gates: Array,
        most_nodes: int,
    ) -> None:
        self.sighting, self.landmark = sighting, landmark
        self._nu, self._spread, self._beside, self._gates = nu, spread, beside, gates
        rows = np.unique(sighting)
        self._pairs = [np.flatnonzero(sighting == row).tolist() for row in rows]
        most = [int(beside.dof[pairs].max()) for pairs in self._pairs]
        self._dof_left = [sum(most[level:]) for level in range(len(most) + 1)]
        self._left = most_nodes
        self._best: list[int] = []
        self._best_cost = np.inf

    def best(self) -> list[int]:
        """The pairs of the best set."""
        size = 2 * len(self._pairs)
        self._descend(0, [], _Sum(0.0, 0.0, 0), np.zeros((size, size)), np.zeros(size))
        return self._best

    def _descend(
        self, level: int, chosen: list[int], so_far: _Sum, root: Array, whitened: Array
    ) -> None:
        """Distance and cost grow with every pair; the gate of the whole set is tested at its end.

        root: lower Cholesky factor of the chosen pairs' covariance.
        """
        possible = len(chosen) + len(self._pairs) - level
        if possible < len(self._best) or (
            possible == len(self._best) and so_far.cost >= self._best_cost
        ):
            return
        if level == len(self._pairs):
            if so_far.nis <= self._gates[so_far.dof]:
                self._best, self._best_cost = list(chosen), so_far.cost
            return
        k = 2 * len(chosen)
        taken = {int(self.landmark[pair]) for pair in chosen}
        entries = (2 * np.array(chosen, dtype=np.intp)[:, None] + (0, 1)).ravel()
        for pair in self._pairs[level]:
            if self._left <= 0:
                break
            if int(self.landmark[pair]) in taken:
                continue
            self._left -= 1
            own = slice(2 * pair, 2 * pair + 2)
            below = (
                np.linalg.solve(root[:k, :k], self._spread[entries, own]).T
                if k
                else np.zeros((2, 0))
            )
            rest = self._spread[own, own] - below @ below.T
            try:
                corner = np.linalg.cholesky(rest)
            except np.linalg.LinAlgError:
                continue  # two copies of one pairing: nothing new to test
            tail = np.linalg.solve(corner, self._nu[pair] - below @ whitened[:k])
            total = so_far.plus(float(tail @ tail), self._beside, pair)
            widest = so_far.dof + self._dof_left[level]
            if total.nis > self._gates[widest]:  # the widest that this branch may still meet
                continue
            root[k : k + 2, :k], root[k : k + 2, k : k + 2] = below, corner
            whitened[k : k + 2] = tail
            self._descend(level + 1, [*chosen, pair], total, root, whitened)
        self._descend(level + 1, chosen, so_far, root, whitened)
