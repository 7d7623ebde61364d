"""Joint compatibility branch and bound (Nieto 2005, section 2.4.1, "batch data association").

Measurements of one scan share the error of the pose, so a set of pairings that are each likely can
be unlikely together. The largest set that passes one joint gate wins, the one with the least
joint nis, attributes included, among equals.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from scipy.special import gammaincinv

from ekf_reference.association.attributes import NO_ATTRIBUTES, Attributes, same_tail
from ekf_reference.association.distances import (
    indices_of,
    landmarks_around,
    match_in_order,
    normalised_distances,
)
from ekf_reference.core.blocks import block_diagonal, stack
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.measurements import Measurements
from ekf_reference.core.state import KalmanState, LocalMap


@dataclass(frozen=True, kw_only=True)
class JointCompatibility:
    """Each pairing within the chi-square gate of `probability`, all together within the joint one.

    new_gate: as in NearestNeighbour. most_nodes: branches visited at the most in one scan; beyond
    that the best set so far is taken, and counted ("cut off"). Of a scan with more than
    `most_matched` to match, the nearest neighbour decides. attributes: enter every gate with their
    degrees of freedom, and the joint distance by how much less likely they make a pairing than the
    likeliest of its measurement.
    """

    probability: float = 0.999
    new_gate: float = 25.0
    most_nodes: int = 4000
    most_matched: int = 100
    attributes: Attributes = NO_ATTRIBUTES
    counts: Counter[str] = field(default_factory=Counter, compare=False)

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Assign by position and attributes, all measurements of the scan together."""
        local = landmarks_around(state, model, seen)
        distances = normalised_distances(local, model, seen)
        added = self.attributes.distances(local.landmark_index, seen)
        nis, n, dof = distances.nis + added.nis, distances.n + added.n, 2 + added.dof
        upward = np.arange(int(dof.max(initial=2)) * len(dof) + 1)
        gates = 2.0 * gammaincinv(0.5 * np.maximum(upward, 2), self.probability)
        compatible = nis <= gates[dof]
        row, landmark = np.nonzero(compatible)
        column = np.full(len(seen), -1, dtype=np.intp)
        if len(np.unique(row)) > self.most_matched:
            column = match_in_order(n, compatible)
        elif len(row):
            order = np.lexsort((n[row, landmark], row))
            row, landmark = pairs = row[order], landmark[order]
            least = np.where(compatible, added.n, np.inf).min(axis=1, keepdims=True)
            search = _Search(
                row=row,
                landmark=landmark.tolist(),
                innovation=distances.innovation[pairs],
                spread=pair_covariance(local, model, seen, row, landmark),
                nis=added.nis[pairs].tolist(),
                cost=(added.n - least)[pairs].tolist(),
                dof=dof[pairs].tolist(),
                gates=gates,
                left=self.most_nodes,
            )
            chosen = search.best()
            self.counts["cut off"] += search.cut_off
            column[row[chosen]] = landmark[chosen]
        far = nis > same_tail(self.new_gate, dof)
        return indices_of(column, far, local.landmark_index, state.landmark_count)


def pair_covariance(
    local: LocalMap, model: MeasurementModel, seen: Measurements, row: Index, landmark: Index
) -> Array:
    """Return the joint covariance of the innovations of pairs, correlations included.

    Args:
        local: Landmarks with their joint covariance.
        model: How they are measured.
        seen: Measurements of one instant.
        row: (p,) measurement of each pair.
        landmark: (p,) row of each pair's landmark in `local`; may repeat.

    Returns:
        (2 p, 2 p).
    """
    chosen, where = np.unique(landmark, return_inverse=True)
    part = local.take(chosen)
    predicted = model.predict(part.pose, part.landmark)
    h = stack(predicted.jacobian_pose, predicted.jacobian_landmark).reshape(len(chosen), 2, -1)
    stacked = h[where].reshape(2 * len(landmark), -1)
    return stacked @ part.covariance @ stacked.T + block_diagonal(seen.noise[row])


@dataclass(kw_only=True)
class _Search:
    """Depth first over the measurements; every node extends one Cholesky factor by two rows.

    Of p pairs, by row. innovation: (p, 2). spread: (2 p, 2 p). nis, cost: of the attributes, the
    latter -2 ln of their density, none below 0. dof: position and attributes. gates: of the joint
    nis by its dof. left: nodes that may still be visited; cut_off: more were asked for.
    """

    row: Index
    landmark: list[int]
    innovation: Array
    spread: Array
    nis: list[float]
    cost: list[float]
    dof: list[int]
    gates: Array
    left: int
    cut_off: bool = False
    _best: list[int] = field(default_factory=list)
    _best_cost: float = np.inf

    def best(self) -> list[int]:
        """Return the pairs of the best set."""
        self._of_row = [np.flatnonzero(self.row == row).tolist() for row in np.unique(self.row)]
        most = [max(self.dof[pair] for pair in own) for own in self._of_row]
        self._dof_left = [sum(most[level:]) for level in range(len(most) + 1)]
        self._whitened = np.zeros(2 * len(most))
        self._root = np.diag(self._whitened)  # lower Cholesky factor of the chosen pairs' spread
        self._descend(0, [], 0.0, 0.0, 0)
        return self._best

    def _descend(self, level: int, chosen: list[int], nis: float, cost: float, dof: int) -> None:
        """Nis and cost grow with every pair; the gate of the whole set is tested at its end."""
        possible = len(chosen) + len(self._of_row) - level
        if (possible, -cost) <= (len(self._best), -self._best_cost):
            return
        if level == len(self._of_row):
            if nis <= self.gates[dof]:
                self._best, self._best_cost = chosen, cost
            return
        widest = self.gates[dof + self._dof_left[level]]  # that this branch may still meet
        taken = {self.landmark[pair] for pair in chosen}
        for pair in self._of_row[level]:
            wanted = self.landmark[pair] not in taken
            self.cut_off |= wanted and self.left == 0
            if wanted and self.left > 0:
                self.left -= 1
                own, more = self._extend(chosen, pair), dof + self.dof[pair]
                total, costs = nis + own + self.nis[pair], cost + own + self.cost[pair]
                if total <= widest:
                    self._descend(level + 1, [*chosen, pair], total, costs, more)
        self._descend(level + 1, chosen, nis, cost, dof)

    def _extend(self, chosen: list[int], pair: int) -> float:
        """Add a pair to the factor; return its nis given the others, NaN for a copy of one."""
        k, own = 2 * len(chosen), slice(2 * pair, 2 * pair + 2)
        entries = (2 * np.array(chosen, dtype=np.intp)[:, None] + (0, 1)).ravel()
        below = np.linalg.solve(self._root[:k, :k], self.spread[entries, own]).T
        try:
            corner = np.linalg.cholesky(self.spread[own, own] - below @ below.T)
        except np.linalg.LinAlgError:
            return np.nan
        tail = np.linalg.solve(corner, self.innovation[pair] - below @ self._whitened[:k])
        self._root[k : k + 2, :k], self._root[k : k + 2, k : k + 2] = below, corner
        self._whitened[k : k + 2] = tail
        return float(tail @ tail)
