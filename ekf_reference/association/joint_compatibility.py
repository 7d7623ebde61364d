"""Joint compatibility branch and bound (Nieto 2005, section 2.4.1, "batch data association").

Measurements of one scan share the error of the pose, so a set of pairings that are each likely can
be unlikely together. The largest set that passes one joint gate wins, the one with the least
joint distance among equals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv

from ekf_reference.association.attributes import NO_ATTRIBUTES, Attributes, same_tail
from ekf_reference.association.distances import (
    landmarks_around,
    match_in_order,
    normalised_distances,
    slots_of,
)
from ekf_reference.core.blocks import block_diagonal, stack
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.measurements import Measurements
from ekf_reference.core.state import KalmanState, LocalMap


@dataclass(frozen=True)
class JointCompatibility:
    """Each pairing within `gate`, all together within the joint gate of the same probability.

    probability: of the chi-square gates. new_gate: as in NearestNeighbour. most_nodes: branches
    visited at the most in one scan; beyond that the best set so far is taken. Of a scan with more
    than `most_matched` to match, the nearest neighbour decides. attributes: enter every gate with
    their degrees of freedom, and the joint distance by how much less likely they make a pairing
    than the likeliest of the same measurement.
    """

    probability: float = 0.999
    new_gate: float = 25.0
    most_nodes: int = 4000
    most_matched: int = 100
    attributes: Attributes = NO_ATTRIBUTES

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Assign by position and attributes, all measurements of the scan together."""
        local = landmarks_around(state, model, seen)
        distances = normalised_distances(local, model, seen)
        added = self.attributes.distances(local.slot, seen)
        nis, n, dof = distances.nis + added.nis, distances.n + added.n, 2 + added.dof
        gates = self._gates(int(dof.max(initial=2)) * len(dof))
        compatible = nis <= gates[dof]
        row, landmark = np.nonzero(compatible)
        column = np.full(len(seen), -1, dtype=np.intp)
        if len(np.unique(row)) > self.most_matched:
            column = match_in_order(n, compatible)
        elif len(row):
            order = np.lexsort((n[row, landmark], row))
            row, landmark = row[order], landmark[order]
            least = np.where(compatible, added.n, np.inf).min(axis=1, keepdims=True, initial=np.inf)
            pairs = _Pairs(
                row,
                landmark,
                distances.innovation[row, landmark],
                pair_covariance(local, model, seen, row, landmark),
                added.nis[row, landmark],
                (added.n - least)[row, landmark],
                dof[row, landmark],
            )
            chosen = _Search(pairs, gates, self.most_nodes).best()
            column[row[chosen]] = landmark[chosen]
        new = np.logical_and.reduce(nis > same_tail(self.new_gate, dof), axis=1)
        return slots_of(column, new, local.slot, state.landmark_count)

    def _gates(self, most: int) -> Array:
        """Bounds of chi-square variables with 0 to `most` degrees of freedom, 2 at the least."""
        dof = np.maximum(np.arange(most + 1), 2)
        bounds: Array = 2.0 * gammaincinv(0.5 * dof, self.probability)
        return bounds


def pair_covariance(
    local: LocalMap, model: MeasurementModel, seen: Measurements, row: Index, landmark: Index
) -> Array:
    """Return the covariance (2 p, 2 p) of the innovations of p pairs, correlations included."""
    chosen, where = np.unique(landmark, return_inverse=True)
    part = local.take(chosen)
    predicted = model.predict(part.pose, part.landmark)
    h = stack(predicted.jacobian_pose, predicted.jacobian_landmark).reshape(len(chosen), 2, -1)
    stacked = h[where].reshape(2 * len(landmark), -1)
    spread = stacked @ part.covariance @ stacked.T
    return spread + block_diagonal(seen.noise[row])


class _Pairs(NamedTuple):
    """Pairings (p,) of measurements, by row, with landmarks of the local map.

    innovation: (p, 2). spread: (2 p, 2 p). Of the attributes, nis: (p,) and cost: (p,) -2 ln of
    their density, none below 0. dof: (p,) position and attributes.
    """

    row: Index
    landmark: Index
    innovation: Array
    spread: Array
    nis: Array
    cost: Array
    dof: Index


class _Sum(NamedTuple):
    """Of the chosen pairs: joint nis, -2 ln of the density up to a constant, degrees of freedom."""

    nis: float
    cost: float
    dof: int


class _Search:
    """Depth first over the measurements; every node extends one Cholesky factor by two rows."""

    def __init__(self, pairs: _Pairs, gates: Array, most_nodes: int) -> None:
        self._pairs, self._gates, self._left = pairs, gates, most_nodes
        self._of_row = [np.flatnonzero(pairs.row == row).tolist() for row in np.unique(pairs.row)]
        most = [int(pairs.dof[own].max()) for own in self._of_row]
        self._dof_left = [sum(most[level:]) for level in range(len(most) + 1)]
        self._best: list[int] = []
        self._best_cost = np.inf

    def best(self) -> list[int]:
        """Return the pairs of the best set."""
        size = 2 * len(self._of_row)
        self._descend(0, [], _Sum(0.0, 0.0, 0), np.zeros((size, size)), np.zeros(size))
        return self._best

    def _descend(
        self, level: int, chosen: list[int], so_far: _Sum, root: Array, whitened: Array
    ) -> None:
        """Distance and cost grow with every pair; the gate of the whole set is tested at its end.

        root: lower Cholesky factor of the chosen pairs' covariance.
        """
        possible = len(chosen) + len(self._of_row) - level
        if possible < len(self._best) or (
            possible == len(self._best) and so_far.cost >= self._best_cost
        ):
            return
        if level == len(self._of_row):
            if so_far.nis <= self._gates[so_far.dof]:
                self._best, self._best_cost = list(chosen), so_far.cost
            return
        widest = self._gates[so_far.dof + self._dof_left[level]]  # that this branch may still meet
        taken = {int(self._pairs.landmark[pair]) for pair in chosen}
        for pair in self._of_row[level]:
            if self._left <= 0:
                break
            if int(self._pairs.landmark[pair]) in taken:
                continue
            self._left -= 1
            total = self._extend(chosen, pair, so_far, root, whitened)
            if total is not None and total.nis <= widest:
                self._descend(level + 1, [*chosen, pair], total, root, whitened)
        self._descend(level + 1, chosen, so_far, root, whitened)

    def _extend(
        self, chosen: list[int], pair: int, so_far: _Sum, root: Array, whitened: Array
    ) -> _Sum | None:
        """Add a pair to the factor; None for a copy of one that is there: nothing new to test."""
        p, k, own = self._pairs, 2 * len(chosen), slice(2 * pair, 2 * pair + 2)
        entries = (2 * np.array(chosen, dtype=np.intp)[:, None] + (0, 1)).ravel()
        below = np.linalg.solve(root[:k, :k], p.spread[entries, own]).T if k else np.zeros((2, 0))
        try:
            corner = np.linalg.cholesky(p.spread[own, own] - below @ below.T)
        except np.linalg.LinAlgError:
            return None
        tail = np.linalg.solve(corner, p.innovation[pair] - below @ whitened[:k])
        root[k : k + 2, :k], root[k : k + 2, k : k + 2] = below, corner
        whitened[k : k + 2] = tail
        nis = float(tail @ tail)
        return _Sum(
            so_far.nis + nis + float(p.nis[pair]),
            so_far.cost + nis + float(p.cost[pair]),
            so_far.dof + int(p.dof[pair]),
        )
