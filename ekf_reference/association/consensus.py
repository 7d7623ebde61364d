"""Joint association that abstains where likely hypotheses disagree, for clumps of landmarks.

After a blind turn a measurement may fit several landmarks, and a wrong choice is fused for good.
Here all hypotheses of a scan are weighed against each other (Nieto 2005, section 2.4.1; the joint
form of eqs. 2.58 and 2.60), and only that is used which all likely ones agree on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ekf_reference.association.distances import landmarks_around, normalised_distances
from ekf_reference.association.joint_compatibility import pair_covariance
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.measurements import AMBIGUOUS, Measurements
from ekf_reference.core.state import KalmanState, LocalMap

_NEW = -1


@dataclass(frozen=True)
class ConsensusAssociation:
    """Measurements are AMBIGUOUS unless the likely hypotheses agree on them.

    resolution_m: diameter of a disc; what is seen in it is of one landmark. odds: a hypothesis
    counts until the best is so many times likelier. new_density: new landmarks expected in the
    view, per m and rad. gate: of the nis of a single pairing. most_hypotheses: followed at a time.
    """

    resolution_m: float = 0.75
    odds: float = 30.0
    new_density: float = 1e-3
    gate: float = 25.0
    most_hypotheses: int = 200

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Assign the measurements on which all likely hypotheses agree."""
        point = model.invert(state.pose, seen.z).landmark
        group = _groups(point, self.resolution_m)
        # Of a group the mean place, with the noise of one, since what puts one wrong puts the next,
        # too, and that of a place in a disc, whose variance is its diameter^2 / 16.
        share = np.equal.outer(np.arange(group.max() + 1), group).astype(float)
        share /= share.sum(axis=1, keepdims=True)
        predicted = model.predict(state.pose, share @ point)
        h = predicted.jacobian_landmark
        noise = np.einsum("gm,mij->gij", share, seen.noise)
        noise += self.resolution_m**2 / 16.0 * h @ h.transpose(0, 2, 1)
        merged = Measurements(predicted.z, noise, np.full(len(share), -1), closed=seen.closed)
        local = landmarks_around(state, model, merged)
        landmark_indices = np.full(len(seen), AMBIGUOUS, dtype=np.intp)
        added = state.landmark_count
        for place, choices in enumerate(zip(*self._likely(local, model, merged), strict=True)):
            landmark, *others = set(choices)
            if not others:
                landmark_indices[group == place] = (
                    added if landmark == _NEW else local.landmark_index[landmark]
                )
                added += landmark == _NEW
        return landmark_indices

    def _likely(
        self, local: LocalMap, model: MeasurementModel, merged: Measurements
    ) -> list[tuple[int, ...]]:
        """Hypotheses within the odds of the best: per place a landmark, none twice, or _NEW.

        One costs -2 ln of its density up to a constant: joint nis + ln |S| of its pairs, and
        -2 ln (2 pi density) for each new landmark.
        """
        nis = normalised_distances(local, model, merged)
        place, landmark = np.nonzero(nis.nis <= self.gate)
        if not len(place):
            return [(_NEW,) * len(merged)]
        nu = nis.innovation[place, landmark].ravel()
        spread = pair_covariance(local, model, merged, place, landmark)
        cost_of_new = -2.0 * math.log(2.0 * math.pi * self.new_density)
        beam: list[tuple[float, tuple[int, ...], list[int]]] = [(0.0, (), [])]
        for k in range(len(merged)):
            grown = [(cost + cost_of_new, (*c, _NEW), pairs) for cost, c, pairs in beam]
            options = [(p, int(landmark[p])) for p in np.flatnonzero(place == k).tolist()]
            for _, choice, pairs in beam:
                for chosen, one in [([*pairs, p], j) for p, j in options if j not in choice]:
                    entries = (2 * np.array(chosen)[:, None] + (0, 1)).ravel()
                    s, innovation = spread[entries[:, None], entries], nu[entries]
                    joint = innovation @ np.linalg.solve(s, innovation) + np.linalg.slogdet(s)[1]
                    cost = cost_of_new * choice.count(_NEW) + float(joint)
                    grown.append((cost, (*choice, one), chosen))
            beam = sorted(grown)[: self.most_hypotheses]
        return [c for cost, c, _ in beam if cost <= beam[0][0] + 2.0 * math.log(self.odds)]


def _groups(point: Array, within_m: float) -> Index:
    """Group (m,) of each point (m, 2): that with the nearest first point within reach, or new."""
    group, first = np.empty(len(point), dtype=np.intp), point[:0]
    for k, p in enumerate(point):
        distance = np.linalg.norm(first - p, axis=1)
        near = distance.min(initial=np.inf) <= within_m
        group[k] = distance.argmin() if near else len(first)
        first = first if near else np.vstack((first, p))
    return group
