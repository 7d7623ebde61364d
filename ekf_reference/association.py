"""Which landmark a sighting belongs to.

An assignment is a slot per sighting, (m,) integers: the landmark's place in the state's map, or
REJECTED. Slots from the current landmark count upward name landmarks to be added, in order.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ekf_reference.kalman import KalmanState
from ekf_reference.observation import RangeBearing

Array = NDArray[np.float64]
Slots = NDArray[np.intp]

REJECTED = -1


class Association(Protocol):
    """Contract of all association rules."""

    def assign(
        self,
        state: KalmanState,
        observation: RangeBearing,
        z: Array,
        noise: Array,
        identity: NDArray[np.int64],
    ) -> Slots:
        """Slots (m,) of sightings z (m, 2) with covariances noise (m, 2, 2).

        identity: (m,) labels from the log, negative where the sensor gave none.
        """
        ...


@dataclass
class KnownAssociation:
    """Takes the labels that the log carries; the n-th new label becomes the n-th landmark.

    gate: normalised innovation squared beyond which a label is taken for a misread and its
    sighting rejected (Nieto 2005, section 2.4.1); infinite where labels are certain.
    """

    gate: float = float("inf")
    slot_of: dict[int, int] = field(default_factory=dict)

    def assign(
        self,
        state: KalmanState,
        observation: RangeBearing,
        z: Array,
        noise: Array,
        identity: NDArray[np.int64],
    ) -> Slots:
        """Look the labels up, giving unseen ones the next slots. Unlabelled are rejected."""
        slots = np.array(
            [
                self.slot_of.setdefault(label, len(self.slot_of)) if label >= 0 else REJECTED
                for label in identity.tolist()
            ],
            dtype=np.intp,
        )
        if np.isfinite(self.gate) and state.landmark_count:
            nis, _ = normalised_distances(state, observation, z, noise)
            known = np.flatnonzero((slots != REJECTED) & (slots < state.landmark_count))
            slots[known[nis[known, slots[known]] > self.gate]] = REJECTED
        return slots


@dataclass(frozen=True)
class NearestNeighbour:
    """Gated nearest neighbour, each landmark taken at most once in a scan.

    A sighting may join a landmark when its normalised innovation squared (Nieto 2005, eq. 2.58)
    is within `gate`; among those the least N = nis + ln |S| (eq. 2.60) wins, over the whole scan
    in order of N. A sighting whose nis exceeds `new_gate` for every landmark starts a new one;
    between the two gates, or beaten to its landmark, it is ambiguous and rejected.

    gate, new_gate: bounds of the chi-square variable with 2 degrees of freedom.
    """

    gate: float = 13.82  # 99.9 %
    new_gate: float = 25.0

    def assign(
        self,
        state: KalmanState,
        observation: RangeBearing,
        z: Array,
        noise: Array,
        identity: NDArray[np.int64],
    ) -> Slots:
        """Assign by position alone; `identity` is not used."""
        count = state.landmark_count
        slots = np.full(len(z), REJECTED, dtype=np.intp)
        if count:
            nis, distance = normalised_distances(state, observation, z, noise)
            unseen = nis.min(axis=1) > self.new_gate
            self._match(nis, distance, slots)
        else:
            unseen = np.ones(len(z), dtype=bool)
        slots[unseen] = count + np.arange(np.count_nonzero(unseen))
        return slots

    def _match(self, nis: Array, distance: Array, slots: Slots) -> None:
        rows, columns = np.nonzero(nis <= self.gate)
        taken: set[int] = set()
        for k in np.argsort(distance[rows, columns], kind="stable"):
            row, column = int(rows[k]), int(columns[k])
            if slots[row] == REJECTED and column not in taken:
                slots[row] = column
                taken.add(column)


def normalised_distances(
    state: KalmanState, observation: RangeBearing, z: Array, noise: Array
) -> tuple[Array, Array]:
    """Normalised innovation squared and N, both (m, L), of every sighting and landmark.

    Nieto 2005, eqs. 2.57, 2.58 and 2.60.
    """
    predicted = observation.predict(state.pose, state.landmarks)
    hv, hl = predicted.jacobian_pose, predicted.jacobian_landmark
    blocks = _covariance_blocks(state)
    through_pose = hv @ blocks.vehicle @ hv.transpose(0, 2, 1)
    cross = hv @ blocks.cross @ hl.transpose(0, 2, 1)
    through_map = hl @ blocks.own @ hl.transpose(0, 2, 1)
    spread = through_pose + cross + cross.transpose(0, 2, 1) + through_map  # H P H^T, (L, 2, 2)
    s = spread[None] + noise[:, None]  # (m, L, 2, 2)
    nu = observation.innovation(z[:, None], predicted.z[None])  # (m, L, 2)
    determinant = s[..., 0, 0] * s[..., 1, 1] - s[..., 0, 1] ** 2
    nis = (
        s[..., 1, 1] * nu[..., 0] ** 2
        - 2.0 * s[..., 0, 1] * nu[..., 0] * nu[..., 1]
        + s[..., 0, 0] * nu[..., 1] ** 2
    ) / determinant
    return nis, nis + np.log(determinant)


@dataclass(frozen=True)
class _Blocks:
    vehicle: Array  # (3, 3)
    cross: Array  # (L, 3, 2)
    own: Array  # (L, 2, 2)


def _covariance_blocks(state: KalmanState) -> _Blocks:
    p, count = state.covariance, state.landmark_count
    cross = p[:3, 3:].reshape(3, count, 2).transpose(1, 0, 2)
    diagonal = np.arange(count)
    own = p[3:, 3:].reshape(count, 2, count, 2)[diagonal, :, diagonal, :]
    return _Blocks(p[:3, :3], cross, own)
