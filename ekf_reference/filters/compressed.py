"""The compressed filter: local work at local cost (Guivant 2002, sections 4 and 4.1).

While the vehicle stays in a local area only the active states a (the vehicle and the landmarks
around it) are filtered. What they learn about the passive states b is kept in phi, psi and theta
(derived in Guivant and Nebot 2001) and carried over in one global update. psi is kept as a square
root: where all landmarks share an uncertainty that is large beside their distances', psi P_ab(0)
cancels, and psi itself would cost half the digits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ekf_reference.core import machine
from ekf_reference.core.ekf import Ekf, StepNoise
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT, LandmarkKind, NewLandmarks
from ekf_reference.core.layout import ABSENT, Layout
from ekf_reference.core.measurements import Association
from ekf_reference.core.state import Correction, KalmanState, LocalMap, MapSnapshot
from ekf_reference.core.trace import Trace
from ekf_reference.models.motion import MotionModel


@dataclass(frozen=True)
class LocalAreas:
    """How the map is cut, and how much of it a global update touches.

    half_m: the vehicle may move this far east, west, north or south of an area's centre before
    the next area is centred on it. reach_m: the active area extends this far beyond that, or as
    far as the longest range that `within` was asked for. least_gain: c1 of Guivant 2002, eq. 22;
    zero for the exact update, 1e-4 is the paper's example. most_share: an area with a larger share
    of all states has them all, which leaves nothing to keep for a global update.
    """

    half_m: float = 25.0
    reach_m: float = 40.0
    least_gain: float = 0.0
    most_share: float = 1.0


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


@dataclass
class LocalWork:
    """What local areas have saved: of all updates, those that left some states passive.

    updates: measurement updates. compressed: those with passive states. active_share: the share of
    all states that was active, summed over the updates.
    """

    updates: int = 0
    compressed: int = 0
    active_share: float = 0.0

    def add(self, active: int, passive: int) -> None:
        """Count an update.

        Args:
            active: States in the local area.
            passive: All others.
        """
        self.updates += 1
        self.compressed += passive > 0
        self.active_share += active / (active + passive)


class CompressedState(KalmanState):
    """Updates passive states late: on leaving the area, on removal, or to read mean or covariance.

    What KalmanState keeps is all of it as of the last global update. phi: (a', a), theta: (a,) as
    in section 4; a states at the area's start, a' now. learnt: rows (m, a + 1) L^-1 (H phi, nu) of
    the updates, S = L L^T: psi is the sum of their squares. theta repeats what their last column
    says, for places that are asked between global updates. Where no state is passive, as in a small
    map, none of the three is kept.
    """

    def __init__(self, pose: Array, covariance: Array, areas: LocalAreas) -> None:
        """Start with one area around the vehicle.

        Args:
            pose: (3,) x, y [m], heading [rad], unwrapped.
            covariance: (3, 3), symmetric positive definite.
            areas: How the map is cut.
        """
        super().__init__(pose, covariance)
        self.areas = areas
        self.updates: list[GlobalUpdate] = []
        self.work = LocalWork()
        self._reach_m = areas.reach_m
        self._activate(np.arange(len(pose)), _place(pose), areas.half_m + areas.reach_m)

    def _activate(self, columns: Index, centre: tuple[float, float], extent: float) -> None:
        """Begin an area with some active states, their entries (a,) ascending, the pose's first."""
        self._columns, self._centre, self._extent = columns, centre, extent
        self._local = self.part(columns)  # the marginal of the active states
        self._present: Layout = self._layout  # of all, also of landmarks new in `_local`
        self._entry: Index = np.full(self._layout.size, ABSENT)  # of each state entry in `_local`
        self._entry[columns] = np.arange(len(columns))
        self._passive = self._layout.size - len(columns)
        self._phi: Array = np.eye(len(columns))
        self._theta = np.zeros(len(columns))
        self._learnt: list[Array] = []
        self._learnt_rows = 0
        self._fresh = True

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

    def places(self, kind: LandmarkKind) -> Array:
        """Return all landmarks (L, w), passive ones at x_b(0) + P_ba(0) theta: no global update."""
        place, active = self.snapshot(kind)
        passive = np.setdiff1d(self._layout.present(kind), active, assume_unique=True)
        if len(passive) and not self._fresh:
            rows = self._layout.columns(passive, kind)[self._layout.pose_size :]
            shift = super().covariance[np.ix_(rows, self._columns)] @ self._theta
            place[passive] += shift.reshape(-1, kind.width)
        return place

    def snapshot(self, kind: LandmarkKind = POINT) -> MapSnapshot:
        """Return all landmarks of a kind, passive ones as the last global update left them."""
        known, active = super().places(kind), self._local.layout.present(kind)
        place = np.full((len(self._present.first[kind]), kind.width), np.nan)
        place[: len(known)] = known
        place[active] = self._local.places(kind)[active]
        return MapSnapshot(place, active)

    def covariance_of(self, columns: Index) -> Array:
        """Return the covariance (c, c) of some entries, all active, a copy."""
        return self._local.covariance_of(self._entry[columns])

    def local_map(self, reach_m: float) -> LocalMap:
        """Return the points within reach of the vehicle; enter a new area when they lie beyond."""
        if self._offset() + reach_m > self._extent:
            self.leave(reach_m)
        return self.map_of(self._local._near(reach_m, POINT))

    def map_of(self, landmark_index: Index, kind: LandmarkKind = POINT) -> LocalMap:
        """Return some landmarks of a kind, made active if they are not."""
        columns = self._present.columns(landmark_index, kind)
        self._local_entries(columns)  # may replace the local state
        return replace(self._local.map_of(landmark_index, kind), columns=columns)

    def within(self, reach_m: float, kind: LandmarkKind = POINT) -> Index:
        """Return the landmark indices at most `reach_m` away; later areas reach at least so far."""
        self._reach_m = max(self._reach_m, reach_m)
        return super().within(reach_m, kind)

    def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        """Move the vehicle: phi <- F phi. Beyond the area's edge the next area begins."""
        self._local.predict(pose, jacobian_pose, noise)
        if self._passive:
            self._phi[:3] = jacobian_pose @ self._phi[:3]
        self._fresh = False
        if self._offset() > self.areas.half_m:
            self.leave()

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Fuse in the active states, then add to psi and theta with the old phi, then move phi."""
        local = self._local_entries(columns)
        done = self._local.update(local, jacobian, innovation, noise)
        self.work.add(self._local.layout.size, self._passive)
        self._fresh = False
        if not self._passive:
            return done
        seen = done.inverse_root @ (jacobian @ self._phi[local])  # L^-1 H phi
        self._learn(np.column_stack((seen, done.whitened)))  # psi + phi^T H^T S^-1 H phi
        self._theta += seen.T @ done.whitened  # theta + phi^T H^T S^-1 nu
        self._phi -= done.gain_root.T @ seen  # (I - W H) phi
        return done

    def augment(self, new: NewLandmarks, noise: Array, kind: LandmarkKind = POINT) -> None:
        """Add landmarks inside the area: rows G_x phi_v."""
        entries = self._local.layout.size + np.arange(new.landmark.size)
        self._local.augment(new, noise, kind)
        if self._passive:
            through = new.jacobian_pose.reshape(-1, 3) @ self._phi[:3]
            self._phi = np.vstack((self._phi, through))
        self._present = self._present.appended(len(new.landmark), kind)
        self._entry = np.concatenate((self._entry, entries))
        self._fresh = False

    def remove(self, landmark_index: Index, kind: LandmarkKind = POINT) -> None:
        """Marginalise landmarks of a kind out, after a global update; the area stays."""
        self._global_update()
        gone = np.unique(self._layout.columns(landmark_index, kind)[self._layout.pose_size :])
        active = np.setdiff1d(self._columns, gone)
        super().remove(landmark_index, kind)
        self._activate(active - np.searchsorted(gone, active), self._centre, self._extent)

    def leave(self, reach_m: float = 0.0, *wanted: Index) -> None:
        """Make a global update, and enter a new area around the vehicle.

        Args:
            reach_m: How far the new area has to extend beyond where the vehicle may go in it [m].
            wanted: (c,) state entries of landmarks that must be active, wherever they lie.

        Source: Guivant 2002, eqs. 17 to 23.
        """
        self._global_update()
        extent = self.areas.half_m + max(reach_m, self._reach_m)
        columns = np.unique(np.concatenate((self.columns_near(extent), *wanted)))
        if len(columns) > self.areas.most_share * self._layout.size:
            columns = np.arange(self._layout.size)
        self._activate(columns, _place(self._mean), extent)

    def _local_entries(self, columns: Index) -> Index:
        """Entries in the local state; passive landmarks are made active first."""
        if self._entry[columns].min(initial=0) < 0:
            self.leave(self._extent - self.areas.half_m, columns)
        return self._entry[columns]

    def _offset(self) -> float:
        """Distance from the area's centre, east-west or north-south, whichever is more."""
        (x, y), (east, north) = _place(self._local.pose), self._centre
        return max(abs(x - east), abs(y - north))

    def _learn(self, rows: Array) -> None:
        """Add rows (m, a + 1) to psi; many are folded into as few as say the same."""
        self._learnt.append(rows)
        self._learnt_rows += len(rows)
        if self._learnt_rows > machine.FOLDED * rows.shape[1]:
            self._learnt = [self._psi_root()]
            self._learnt_rows = len(self._learnt[0])

    def _psi_root(self) -> Array:
        """Return R (k, a) with psi = R^T R, and d (k,) with theta = R^T d as the last column.

        k is at most the number of active states that an update has touched.
        """
        rows = np.concatenate((np.zeros((0, len(self._columns) + 1)), *self._learnt))
        touched = np.flatnonzero(rows[:, :-1].any(axis=0))
        small = np.linalg.qr(rows[:, [*touched, -1]], mode="r")[: len(touched)]
        root = np.zeros((len(small), rows.shape[1]))
        root[:, [*touched, -1]] = small
        return root

    def _global_update(self) -> None:
        """Set P_ab = phi P_ab(0), P_bb -= P_ba(0) psi P_ab(0), x_b += P_ba(0) theta.

        Guivant 2002, eqs. 17 to 23. From 19 on when least_gain is above zero: passive states that
        gain less keep their covariance with each other, and P* - P is positive semidefinite.
        """
        if self._fresh:
            return
        learnt = self._psi_root()
        whole = super().covariance
        before = whole[:, self._columns]  # P_ba(0), and P_aa(0) which is overwritten
        root = before @ learnt[:, :-1].T  # Delta P = root root^T, 18
        gain = np.einsum("ij,ij->i", root, root)  # diagonal of Delta P
        little = gain < self.areas.least_gain * whole.diagonal()  # 22
        little[self._columns] = False
        spared = np.flatnonzero(little)
        size, active = self._layout.size, len(self._columns)
        if machine.STRIP_COST * ((size - active) ** 2 - len(spared) ** 2) > size**2:
            spared = spared[:0]  # sparing so few costs more than the exact update
        self.updates.append(GlobalUpdate(size - active, active, len(spared)))
        self.merge(self._columns, self._local, self._phi, root, root @ learnt[:, -1], spared)
        columns = np.concatenate((self._columns, np.arange(size, self._layout.size)))
        self._activate(columns, self._centre, self._extent)


def _place(pose: Array) -> tuple[float, float]:
    """East and north of a pose or a state that begins with it."""
    return float(pose[0]), float(pose[1])


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
        """Start at a prior, with one area around the vehicle.

        Args:
            motion: The vehicle model.
            association: Which rule finds the landmark of a measurement.
            prior_pose: (3,) x, y [m], heading [rad], unwrapped.
            prior_covariance: (3, 3), positive definite, of the additive global error.
            stabilisation: Noise that every step adds; none by default.
            trace: Receives every linearisation; by default nothing is recorded.
            areas: How the map is cut; with `least_gain` above zero the filter is conservative, else
                exact.

        Source: Guivant 2002, sections 4 and 4.1.
        """
        super().__init__(motion, association, prior_pose, prior_covariance, stabilisation, trace)
        self.state = CompressedState(prior_pose, prior_covariance, areas or LocalAreas())
