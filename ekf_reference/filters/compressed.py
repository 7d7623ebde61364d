"""The compressed filter: local work at local cost (Guivant 2002, sections 4 and 4.1).

While the vehicle stays in a local area only the active states a (the vehicle and the landmarks
around it) are filtered. What they learn about the passive states b is kept in phi, psi and theta
and carried over in one global update on leaving the area, or whenever somebody asks. The result
is that of the full filter, to rounding. The recursions are derived in Guivant and Nebot 2001,
which the paper cites.

The means of passive states need no global update to be read: x_b + P_ba(0) theta costs a product
with a vector. Only covariances outside the area do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_reference.core.ekf import Ekf, StepNoise
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.layout import ABSENT, Layout
from ekf_reference.core.measurements import Association
from ekf_reference.core.state import Correction, KalmanState, LocalMap, MapSnapshot
from ekf_reference.core.trace import Trace
from ekf_reference.models.motion import MotionModel


@dataclass(frozen=True)
class LocalAreas:
    """How the map is cut, and how much of it a global update touches.

    half_m: the vehicle may move this far east, west, north or south of an area's centre before
    the next area is centred on it; that gives the hysteresis. reach_m: landmarks this much
    farther out are active too, or as far as somebody asks who is within reach. least_gain: c1 of
    Guivant 2002, eq. 22; zero for the exact update, 1e-4 is the paper's example.
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


class CompressedState(KalmanState):
    """A state whose passive part lags behind until somebody reads all of mean or covariance.

    What KalmanState keeps is all of it as of the last global update. phi: (a', a), psi: (a, a),
    theta: (a,) as in section 4; a states at the area's start, a' now.
    """

    def __init__(self, pose: Array, covariance: Array, areas: LocalAreas) -> None:
        """Start with one area around the vehicle."""
        super().__init__(pose, covariance)
        self.areas = areas
        self.updates: list[GlobalUpdate] = []
        self._reach_m = areas.reach_m
        self._present: Layout  # of all, also of landmarks that only the local state has so far
        self._local: KalmanState  # the marginal of the active states
        self._columns: Index  # (a,) state entries that the local state started from
        self._entry: Index  # of every state entry in the local state, ABSENT if passive
        self._phi: Array
        self._activate(np.arange(len(pose)), pose[:2], areas.half_m + areas.reach_m)

    @property
    def layout(self) -> Layout:
        """Where pose and landmarks lie, active and passive."""
        return self._present

    @property
    def pose(self) -> Array:
        """(3,) x, y, heading; a copy."""
        return self._local.pose

    @property
    def pose_covariance(self) -> Array:
        """(3, 3); a copy."""
        return self._local.pose_covariance

    @property
    def mean(self) -> Array:
        """(n,) state, after a global update."""
        self._global_update()
        return super().mean

    @property
    def covariance(self) -> Array:
        """(n, n) covariance, after a global update."""
        self._global_update()
        return super().covariance

    def places(self, width: int) -> Array:
        """Return all landmarks (L, w) of a kind, passive ones as a global update would have them.

        Guivant 2002, section 4: x_b = x_b(0) + P_ba(0) theta.
        """
        place, active = self.snapshot(width)
        before = self._layout
        passive = np.setdiff1d(before.present(width), active, assume_unique=True)
        if len(passive) and not self._fresh:
            rows = before.columns(passive, width)[before.pose_size :]
            shift = super().covariance[np.ix_(rows, self._columns)] @ self._theta
            place[passive] += shift.reshape(-1, width)
        return place

    def snapshot(self, width: int = POINT) -> MapSnapshot:
        """Return all landmarks of a kind, passive ones as the last global update left them.

        `landmarks` would bring the passive part up to date, which changes later rounding.
        """
        known, active = super().places(width), self._local.layout.present(width)
        place = np.full((len(self._present.first[width]), width), np.nan)
        place[: len(known)] = known
        place[active] = self._local.places(width)[active]
        return MapSnapshot(place, active)

    def covariance_of(self, columns: Index) -> Array:
        """Return the covariance (c, c) of some active states, a copy."""
        return self._local.covariance_of(self._entry[columns])

    def local_map(self, reach_m: float) -> LocalMap:
        """Return the points within reach of the vehicle; enter a new area when they lie beyond."""
        if self._offset() + reach_m > self._extent:
            self._enter(reach_m)
        return self._as_whole(self._local.local_map(reach_m))

    def map_of(self, slot: Index, width: int = POINT) -> LocalMap:
        """Return some landmarks of a kind, made active if they are not."""
        self._local_entries(self._present.columns(slot, width))  # may replace the local state
        return self._as_whole(self._local.map_of(slot, width), width)

    def within(self, reach_m: float, width: int = POINT) -> Index:
        """Return the slots of a kind at most `reach_m` away; exact, and without a global update.

        Areas that begin from now on reach so far, so that those found are active, as a rule.
        """
        self._reach_m = max(self._reach_m, reach_m)
        return super().within(reach_m, width)

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
        local = self._local_entries(columns)
        done = self._local.update(local, jacobian, innovation, noise)
        seen = done.inverse_root @ (jacobian @ self._phi[local])  # L^-1 H phi
        self._psi += seen.T @ seen  # psi + phi^T H^T S^-1 H phi
        self._theta += seen.T @ done.whitened  # theta + phi^T H^T S^-1 nu
        self._phi -= done.gain_root.T @ seen  # (I - W H) phi
        self._fresh = False
        return done

    def augment(
        self, landmark: Array, jacobian_pose: Array, jacobian_z: Array, noise: Array
    ) -> None:
        """Add landmarks inside the area: rows G_x phi_v."""
        entries = self._local.layout.size + np.arange(landmark.size)
        self._local.augment(landmark, jacobian_pose, jacobian_z, noise)
        self._phi = np.vstack((self._phi, jacobian_pose.reshape(-1, 3) @ self._phi[:3]))
        self._present = self._present.appended(*landmark.shape)
        self._entry = np.concatenate((self._entry, entries))
        self._fresh = False

    def remove(self, slot: Index, width: int = POINT) -> None:
        """Marginalise landmarks of a kind out, after a global update; the area stays.

        Raises ValueError for landmarks that were removed before.
        """
        self._global_update()
        gone = self._layout.columns(slot, width)[self._layout.pose_size :]
        kept = np.setdiff1d(np.arange(self._layout.size), gone)
        super().remove(slot, width)
        active = np.searchsorted(kept, np.setdiff1d(self._columns, gone))
        self._activate(active, self._centre, self._extent)

    def leave(self) -> None:
        """Leave the area now: a global update, and a new area around the vehicle."""
        self._enter(self.areas.reach_m)

    def _as_whole(self, found: LocalMap, width: int = POINT) -> LocalMap:
        """The same with the entries of the whole state."""
        columns = self._present.columns(found.slot, width)
        return LocalMap(found.pose, found.slot, found.landmark, found.covariance, columns)

    def _local_entries(self, columns: Index) -> Index:
        """Entries in the local state; passive landmarks are made active first."""
        if self._entry[columns].min(initial=0) < 0:
            self._enter(self._extent - self.areas.half_m, columns)
        return self._entry[columns]

    def _offset(self) -> float:
        """Distance from the area's centre, east-west or north-south, whichever is more."""
        return float(np.abs(self._local.pose[:2] - self._centre).max())

    def _enter(self, reach_m: float, wanted: Index | None = None) -> None:
        """Leave the area and centre the next one on the vehicle.

        wanted: (c,) state entries that become active wherever their landmarks are.
        """
        self._global_update()
        extent = self.areas.half_m + max(reach_m, self._reach_m)
        columns = self.columns_near(extent)
        if wanted is not None:
            columns = np.union1d(columns, wanted)
        self._activate(columns, self._mean[:2].copy(), extent)

    def _activate(self, columns: Index, centre: Array, extent: float) -> None:
        """Begin an area with some active states, their entries (a,) ascending, the pose's first."""
        self._columns, self._centre, self._extent = columns, centre, extent
        self._present, self._local = self._layout, self.part(columns)
        size = len(columns)
        self._entry = np.full(self._layout.size, ABSENT)
        self._entry[columns] = np.arange(size)
        self._phi, self._psi, self._theta = np.eye(size), np.zeros((size, size)), np.zeros(size)
        self._fresh = True

    def _global_update(self) -> None:
        """Set P_ab = phi P_ab(0), P_bb -= P_ba(0) psi P_ab(0), x_b += P_ba(0) theta.

        Guivant 2002, eqs. 17 and 18, and 19 to 23 when least_gain is above zero: passive states
        that gain less keep their covariance with each other, which leaves P* - P positive
        semidefinite.
        """
        if self._fresh:
            return
        values, vectors = np.linalg.eigh(self._psi)
        whole = super().covariance
        before = whole[:, self._columns]  # P_ba(0), and P_aa(0) which is overwritten
        root = before @ (vectors * np.sqrt(np.maximum(values, 0.0)))  # Delta P = root root^T, 18
        spared = np.zeros(0, dtype=np.intp)
        if self.areas.least_gain > 0.0:
            gain = np.einsum("ij,ij->i", root, root)  # diagonal of Delta P
            little = gain < self.areas.least_gain * whole.diagonal()  # 22
            little[self._columns] = False
            spared = np.flatnonzero(little)
        active, size = len(self._columns), self._layout.size
        shift = before @ self._theta
        self.merge(self._columns, self._local, self._phi, root, shift, spared)
        self.updates.append(GlobalUpdate(size - active, active, len(spared)))
        added = np.arange(size, self._layout.size)
        self._activate(np.concatenate((self._columns, added)), self._centre, self._extent)


class CompressedEkf(Ekf):
    """The full filter's steps on a compressed state."""

    state: CompressedState

    def __init__(
        self,
        motion: MotionModel,
        association: Association,
        prior_pose: Array,
        prior_covariance: Array,
        stabilisation: StepNoise | None = None,
        trace: Trace | None = None,
        areas: LocalAreas | None = None,
    ) -> None:
        """areas: how the map is cut. The rest is as in Ekf."""
        super().__init__(motion, association, prior_pose, prior_covariance, stabilisation, trace)
        self.state = CompressedState(prior_pose, prior_covariance, areas or LocalAreas())
