"""Joint compatibility branch and bound (Nieto 2005, section 2.4.1, "batch data association").

Sightings of one scan share the error of the pose, so a set of pairings that are each likely can
be unlikely together. The largest set that passes one joint gate wins, the one with the least
joint distance among equals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from ekf_reference.association import (
    MappedState,
    Slots,
    match_in_order,
    normalised_distances,
    slots_of,
    surroundings,
)
from ekf_reference.kalman import block_diagonal, stack, state_columns
from ekf_reference.local_map import LocalMap
from ekf_reference.observation import Observation
from ekf_reference.sightings import Sightings

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class JointCompatibility:
    """Each pairing within `gate`, all together within the joint gate of the same probability.

    probability: of the chi-square gates. new_gate: as in NearestNeighbour. most_nodes: branches
    visited at the most in one scan; beyond that the best set so far is taken. Of a scan with more
    than `most_sightings` to match, the nearest neighbour decides.
    """

    probability: float = 0.999
    new_gate: float = 25.0
    most_nodes: int = 4000
    most_sightings: int = 100

    def assign(self, state: MappedState, observation: Observation, sightings: Sightings) -> Slots:
        """Assign by position, all sightings of the scan together."""
        local = surroundings(state, observation, sightings)
        distances = normalised_distances(local, observation, sightings)
        compatible = distances.nis <= self._gate(1)
        sighting, landmark = np.nonzero(compatible)
        column = np.full(len(sightings), -1, dtype=np.intp)
        if len(np.unique(sighting)) > self.most_sightings:
            column = match_in_order(distances.n, compatible)
        elif len(sighting):
            nu = distances.innovation[sighting, landmark]
            spread = pair_covariance(local, observation, sightings, sighting, landmark)
            order = np.lexsort((distances.n[sighting, landmark], sighting))
            search = _Search(
                sighting[order],
                landmark[order],
                nu[order],
                _reorder(spread, order),
                np.array([self._gate(k) for k in range(len(sightings) + 1)]),
                self.most_nodes,
            )
            for pair in search.best():
                column[search.sighting[pair]] = search.landmark[pair]
        unseen = distances.nis.min(axis=1, initial=np.inf) > self.new_gate
        return slots_of(column, unseen, local.slot, state.landmark_count)

    def _gate(self, pairs: int) -> float:
        """Bound of the chi-square variable with 2 * pairs degrees of freedom."""
        return 2.0 * float(gammaincinv(max(pairs, 1), self.probability))


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


class _Search:
    """Depth first over the sightings; every node extends one Cholesky factor by two rows."""

    def __init__(
        self,
        sighting: Index,
        landmark: Index,
        nu: Array,
        spread: Array,
        gates: Array,
        most_nodes: int,
    ) -> None:
        self.sighting, self.landmark = sighting, landmark
        self._nu, self._spread, self._gates = nu, spread, gates
        rows = np.unique(sighting)
        self._pairs = [np.flatnonzero(sighting == row).tolist() for row in rows]
        self._left = most_nodes
        self._best: list[int] = []
        self._best_distance = np.inf

    def best(self) -> list[int]:
        """The pairs of the best set."""
        size = 2 * len(self._pairs)
        self._descend(0, [], 0.0, np.zeros((size, size)), np.zeros(size))
        return self._best

    def _descend(
        self, level: int, chosen: list[int], distance: float, root: Array, whitened: Array
    ) -> None:
        """The distance grows with every pair; the gate of the whole set is tested at its end.

        root: lower Cholesky factor of the chosen pairs' covariance.
        """
        possible = len(chosen) + len(self._pairs) - level
        if possible < len(self._best) or (
            possible == len(self._best) and distance >= self._best_distance
        ):
            return
        if level == len(self._pairs):
            if distance <= self._gates[len(chosen)]:
                self._best, self._best_distance = list(chosen), distance
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
            total = distance + float(tail @ tail)
            if total > self._gates[possible]:  # the widest gate that this branch may still meet
                continue
            root[k : k + 2, :k], root[k : k + 2, k : k + 2] = below, corner
            whitened[k : k + 2] = tail
            self._descend(level + 1, [*chosen, pair], total, root, whitened)
        self._descend(level + 1, chosen, distance, root, whitened)
