"""The compressed filter: local work at local cost (Guivant 2002, sections 4 and 4.1).

While the vehicle stays in a local area only the active states a (the vehicle and the landmarks
around it) are filtered. What they learn about the passive states b is kept in phi, psi and theta
and carried over in one global update on leaving the area, or whenever somebody asks. The result
is that of the full filter, to rounding. The recursions are derived in Guivant and Nebot 2001,
which the paper cites.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_reference.association import Association
from ekf_reference.full_ekf import FullEkf, Stabilisation
from ekf_reference.kalman import (
    Array,
    Correction,
    Glance,
    Index,
    KalmanState,
    LocalMap,
    state_columns,
)
from ekf_reference.motion import MotionModel
from ekf_reference.trace import Trace


@dataclass(frozen=True)
class LocalAreas:
    """How the map is cut, and how much of it a global update touches.

    half_m: the vehicle may move this far east, west, north or south of an area's centre before
    the next area is centred on it; that gives the hysteresis. reach_m: landmarks this much
    farther out are active too. least_gain: c1 of Guivant 2002, eq. 22; zero for the exact
    update, 1e-4 is the paper's example.
    """

    half_m: float = 25.0
    reach_m: float = 40.0
    least_gain: float = 0.0


@dataclass(frozen=True)
class GlobalUpdate:
    """What one global update did. passive: states outside the area; spared: those of set I."""

    passive: int
    active: int
    spared: int

    @property
    def saved(self) -> float:
        """Share of the passive covariance block that was left alone."""
        return (self.spared / self.passive) ** 2 if self.passive else 0.0


class CompressedState:
    """The same face as KalmanState; reading mean or covariance brings the passive part up to date.

    phi: (a', a), psi: (a, a), theta: (a,) as in section 4; a states at the area's start, a' now.
    """

    def __init__(self, pose: Array, covariance: Array, areas: LocalAreas) -> None:
        """Start with one area around the vehicle."""
        self.areas = areas
        self.updates: list[GlobalUpdate] = []
        self._whole = KalmanState(pose, covariance)
        self._local: KalmanState
        self._slots: Index  # active landmarks, ascending
        self._place: Index  # of every landmark among the active ones, -1 if passive
        self._phi: Array
        self._activate(np.zeros(0, dtype=np.intp), pose[:2], areas.half_m + areas.reach_m)

    @property
    def pose(self) -> Array:
        """(3,) x, y, heading; a copy."""
        return self._local.pose

    @property
    def pose_covariance(self) -> Array:
        """(3, 3)."""
        return self._local.pose_covariance

    @property
    def landmark_count(self) -> int:
        """Number of landmarks, active and passive."""
        return self._whole.landmark_count + self._local.landmark_count - self._started

    @property
    def mean(self) -> Array:
        """(n,) state, passive part included."""
        self._bring_up_to_date()
        return self._whole.mean

    @property
    def covariance(self) -> Array:
        """(n, n) covariance, passive part included."""
        self._bring_up_to_date()
        return self._whole.covariance

    @property
    def landmarks(self) -> Array:
        """(L, 2) positions, passive ones included."""
        self._bring_up_to_date()
        return self._whole.landmarks

    def glance(self) -> Glance:
        """The active part as it is, passive landmarks as the last global update left them.

        `landmarks` would bring the passive part up to date, which changes later rounding.
        """
        landmark = np.concatenate((self._whole.landmarks, self._local.landmarks[self._started :]))
        landmark[self._slots] = self._local.landmarks
        return Glance(landmark, self._slots, self._local.covariance)

    def local_map(self, reach_m: float) -> LocalMap:
        """The landmarks within reach of the vehicle; enters a new area when they lie beyond it."""
        if self._offset() + reach_m > self._extent:
            self._enter(reach_m)
        found = self._local.local_map(reach_m)
        return LocalMap(found.pose, self._slots[found.slot], found.landmark, found.covariance)

    def map_of(self, slot: Index) -> LocalMap:
        """Some landmarks, made active if they are not."""
        place = self._local_slots(slot)  # may replace the local state
        found = self._local.map_of(place)
        return LocalMap(found.pose, slot, found.landmark, found.covariance)

    def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        """Move the vehicle: phi <- F phi. Beyond the area's edge the next area begins."""
        self._local.predict(pose, jacobian_pose, noise)
        self._phi[:3] = jacobian_pose @ self._phi[:3]
        self._fresh = False
        if self._offset() > self.areas.half_m:
            self._enter(self.areas.reach_m)

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Fuse in the active states; psi, theta and phi take note, in this order."""
        local = columns.copy()
        slots = self._local_slots((columns[3::2] - 3) // 2)
        local[3::2], local[4::2] = 3 + 2 * slots, 4 + 2 * slots
        done = self._local.update(local, jacobian, innovation, noise)
        seen = done.inverse_root @ (jacobian @ self._phi[local])  # L^-1 H phi
        self._psi += seen.T @ seen
        self._theta += seen.T @ done.whitened
        self._phi -= done.gain_root.T @ seen  # (I - W H) phi
        self._fresh = False
        return done

    def augment(
        self, point: Array, jacobian_pose: Array, jacobian_sighting: Array, noise: Array
    ) -> None:
        """Add landmarks inside the area: rows G_x phi_v."""
        first = self.landmark_count
        self._local.augment(point, jacobian_pose, jacobian_sighting, noise)
        self._phi = np.vstack((self._phi, jacobian_pose.reshape(-1, 3) @ self._phi[:3]))
        added = first + np.arange(len(point))
        self._place = np.concatenate((self._place, len(self._slots) + np.arange(len(point))))
        self._slots = np.concatenate((self._slots, added))
        self._fresh = False

    def leave(self) -> None:
        """Leave the area now: a global update, and a new area around the vehicle."""
        self._enter(self.areas.reach_m)

    def _local_slots(self, slot: Index) -> Index:
        """Places in the local map; passive landmarks are made active first."""
        if self._place[slot].min(initial=0) < 0:
            self._enter(self._extent - self.areas.half_m, slot)
        return self._place[slot]

    def _offset(self) -> float:
        """Distance from the area's centre, east-west or north-south, whichever is more."""
        return float(np.abs(self._local.pose[:2] - self._centre).max())

    def _enter(self, reach_m: float, wanted: Index | None = None) -> None:
        """Leave the area and centre the next one on the vehicle; `wanted` become active, too."""
        self._bring_up_to_date()
        extent = self.areas.half_m + max(reach_m, self.areas.reach_m)
        centre = self._whole.pose[:2]
        near = np.abs(self._whole.landmarks - centre).max(axis=1, initial=0.0) <= extent
        if wanted is not None:
            near[wanted] = True
        self._activate(np.flatnonzero(near), centre, extent)

    def _activate(self, slots: Index, centre: Array, extent: float) -> None:
        self._slots, self._centre, self._extent = slots, centre, extent
        self._started = len(slots)
        self._place = np.full(self._whole.landmark_count, -1)
        self._place[slots] = np.arange(len(slots))
        self._columns = state_columns(slots)
        self._local = self._whole.part(self._columns)
        size = len(self._columns)
        self._phi, self._psi, self._theta = np.eye(size), np.zeros((size, size)), np.zeros(size)
        self._fresh = True

    def _bring_up_to_date(self) -> None:
        """The global update: P_ab = phi P_ab(0), P_bb -= P_ba(0) psi P_ab(0), x_b += P_ba(0) theta.

        Guivant 2002, eqs. 18 to 23 when least_gain is above zero: passive states that gain less
        keep their covariance with each other, which leaves P* - P positive semidefinite.
        """
        if self._fresh:
            return
        whole = self._whole
        values, vectors = np.linalg.eigh(self._psi)
        before = whole.covariance[:, self._columns]  # P_ba(0), and P_aa(0) which is overwritten
        root = before @ (vectors * np.sqrt(np.maximum(values, 0.0)))
        spared = np.zeros(0, dtype=np.intp)
        if self.areas.least_gain > 0.0:
            gain = np.einsum("ij,ij->i", root, root)  # diagonal of Delta P
            little = gain < self.areas.least_gain * whole.covariance.diagonal()
            little[self._columns] = False
            spared = np.flatnonzero(little)
        active = len(self._columns)
        passive = len(before) - active
        whole.merge(self._columns, self._local, self._phi, root, before @ self._theta, spared)
        self.updates.append(GlobalUpdate(passive, active, len(spared)))
        self._activate(self._slots, self._centre, self._extent)


class CompressedEkf(FullEkf):
    """The full filter's steps on a compressed state."""

    def __init__(
        self,
        motion: MotionModel,
        association: Association,
        prior_pose: Array,
        prior_covariance: Array,
        stabilisation: Stabilisation | None = None,
        trace: Trace | None = None,
        areas: LocalAreas | None = None,
    ) -> None:
        """areas: how the map is cut. The rest is as in FullEkf."""
        super().__init__(motion, association, prior_pose, prior_covariance, stabilisation, trace)
        self.state = CompressedState(prior_pose, prior_covariance, areas or LocalAreas())
