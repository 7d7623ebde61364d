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

from ekf_reference.association.nearest_neighbour import Association
from ekf_reference.core.ekf import Ekf, Stabilisation
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.layout import ABSENT, POINT, POSE, Layout
from ekf_reference.core.local_map import LocalMap, MapSnapshot, by_number
from ekf_reference.core.state import Correction, KalmanState, within
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


class CompressedState:
    """The same face as KalmanState; reading all of mean or covariance makes a global update.

    phi: (a', a), psi: (a, a), theta: (a,) as in section 4; a states at the area's start, a' now.
    """

    def __init__(self, pose: Array, covariance: Array, areas: LocalAreas) -> None:
        """Start with one area around the vehicle."""
        self.areas = areas
        self._reach_m = areas.reach_m
        self.updates: list[GlobalUpdate] = []
        self._whole = KalmanState(pose, covariance)
        self._layout = self._whole.layout  # with the landmarks that are only in the local state
        self._local: KalmanState
        self._slots: dict[int, Index]  # active landmarks of each kind, ascending
        self._place: dict[int, Index]  # of every landmark among those, ABSENT if passive
        self._entry: Index  # of every state entry in the local state, ABSENT if passive
        self._phi: Array
        nothing = np.zeros(0, dtype=np.intp)
        extent = areas.half_m + areas.reach_m
        self._activate({POINT: nothing, POSE: nothing}, pose[:2], extent)

    @property
    def pose(self) -> Array:
        """(3,) x, y, heading; a copy."""
        return self._local.pose

    @property
    def pose_covariance(self) -> Array:
        """(3, 3)."""
        return self._local.pose_covariance

    @property
    def layout(self) -> Layout:
        """Where pose and landmarks lie, active and passive."""
        return self._layout

    @property
    def landmark_count(self) -> int:
        """Number of points that were ever in the state, active and passive."""
        return len(self._layout.point)

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
        """(L, 2) positions of points, passive ones included."""
        return self._places(POINT)

    @property
    def oriented(self) -> Array:
        """(Q, 3) landmarks with a direction, passive ones included."""
        return self._places(POSE)

    def snapshot(self, kinds: tuple[int, ...] = (POINT,)) -> MapSnapshot:
        """The active part as it is, passive landmarks as the last global update left them.

        `landmarks` would bring the passive part up to date, which changes later rounding.
        """
        local, places = self._local.snapshot(kinds), []
        number = np.empty_like(local.slot)
        for k, width in enumerate(kinds):
            active, (whole, part) = self._slots[width], self._both(width)
            place = np.full((len(self._layout.first(width)), POINT), np.nan)
            place[: len(whole)] = whole[:, :POINT]
            place[active] = part[:, :POINT]
            places.append(place)
            of_kind = local.slot % len(kinds) == k
            number[of_kind] = len(kinds) * active[local.slot[of_kind] // len(kinds)] + k
        covariance, order = local.covariance, np.argsort(number)
        if (np.diff(order) < 0).any():
            entries = len(self.pose) + (POINT * order[:, None] + np.arange(POINT)).ravel()
            columns = np.concatenate((np.arange(len(self.pose)), entries))
            covariance = covariance[columns[:, None], columns]
        return MapSnapshot(by_number(places), number[order], covariance)

    def _both(self, width: int) -> tuple[Array, Array]:
        """Landmarks of a kind as of the last global update, and the active ones as they are."""
        if width == POINT:
            return self._whole.landmarks, self._local.landmarks
        return self._whole.oriented, self._local.oriented

    def local_map(self, reach_m: float) -> LocalMap:
        """The landmarks within reach of the vehicle; enters a new area when they lie beyond it."""
        if self._offset() + reach_m > self._extent:
            self._enter(reach_m)
        found = self._local.local_map(reach_m)
        slot = self._slots[POINT][found.slot]
        columns = self._layout.columns(slot)
        return LocalMap(found.pose, slot, found.landmark, found.covariance, columns)

    def within(self, reach_m: float, width: int = POINT) -> Index:
        """Index of a kind at most `reach_m` from the vehicle; exact, and without a global update.

        Areas that begin from now on reach so far, so that those found are active, as a rule.
        """
        self._reach_m = max(self._reach_m, reach_m)
        return within(self._places(width), self._local.mean, reach_m)

    def map_of(self, slot: Index, width: int = POINT) -> LocalMap:
        """Some landmarks of a kind, made active if they are not. Raises ValueError if removed."""
        columns = self._layout.columns(slot, width)
        self._local_entries(columns)  # may replace the local state
        found = self._local.map_of(self._place[width][slot], width)
        return LocalMap(found.pose, slot, found.landmark, found.covariance, columns)

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
        self._psi += seen.T @ seen
        self._theta += seen.T @ done.whitened
        self._phi -= done.gain_root.T @ seen  # (I - W H) phi
        self._fresh = False
        return done

    def augment(
        self, point: Array, jacobian_pose: Array, jacobian_sighting: Array, noise: Array
    ) -> None:
        """Add landmarks inside the area: rows G_x phi_v."""
        count, width = point.shape
        slots, place = self._slots[width], self._place[width]
        entries = self._local.layout.size + np.arange(point.size)
        self._local.augment(point, jacobian_pose, jacobian_sighting, noise)
        self._phi = np.vstack((self._phi, jacobian_pose.reshape(-1, 3) @ self._phi[:3]))
        self._layout = self._layout.appended(count, width)
        self._entry = np.concatenate((self._entry, entries))
        self._place[width] = np.concatenate((place, len(slots) + np.arange(count)))
        self._slots[width] = np.concatenate((slots, len(place) + np.arange(count)))
        self._fresh = False

    def remove(self, slot: Index, width: int = POINT) -> None:
        """Marginalise landmarks of a kind out, after a global update; the area stays.

        Raises ValueError for landmarks that were removed before.
        """
        self._bring_up_to_date()
        self._whole.remove(slot, width)
        self._slots[width] = np.setdiff1d(self._slots[width], slot)
        self._activate(self._slots, self._centre, self._extent)

    def leave(self) -> None:
        """Leave the area now: a global update, and a new area around the vehicle."""
        self._enter(self.areas.reach_m)

    def _local_entries(self, columns: Index) -> Index:
        """Entries in the local state; passive landmarks are made active first."""
        if self._entry[columns].min(initial=0) < 0:
            self._enter(self._extent - self.areas.half_m, columns)
        return self._entry[columns]

    def _places(self, width: int) -> Array:
        """(L, w) of all landmarks of a kind, passive ones as a global update would leave them."""
        active, before = self._slots[width], self._whole.layout
        known = _by_width(self._whole, width)
        place = np.full((len(self._layout.first(width)), width), np.nan)
        place[: len(known)] = known
        place[active] = _by_width(self._local, width)
        passive = np.setdiff1d(before.present(width), active, assume_unique=True)
        if len(passive) and not self._fresh:
            rows = before.columns(passive, width)[before.pose_size :]
            shift = self._whole.covariance[np.ix_(rows, self._columns)] @ self._theta
            place[passive] += shift.reshape(-1, width)
        return place

    def _offset(self) -> float:
        """Distance from the area's centre, east-west or north-south, whichever is more."""
        return float(np.abs(self._local.pose[:2] - self._centre).max())

    def _enter(self, reach_m: float, wanted: Index | None = None) -> None:
        """Leave the area and centre the next one on the vehicle.

        wanted: (c,) state entries whose landmarks become active wherever they are.
        """
        self._bring_up_to_date()
        extent = self.areas.half_m + max(reach_m, self._reach_m)
        centre, active = self._whole.pose[:2], {}
        for width, place in ((POINT, self._whole.landmarks), (POSE, self._whole.oriented)):
            near = np.abs(place[:, :2] - centre).max(axis=1, initial=0.0) <= extent
            if wanted is not None:
                near[self._layout.slots_in(wanted, width)] = True
            active[width] = np.flatnonzero(near)
        self._activate(active, centre, extent)

    def _activate(self, slots: dict[int, Index], centre: Array, extent: float) -> None:
        self._slots, self._centre, self._extent = slots, centre, extent
        self._layout, self._place = self._whole.layout, {}
        for width, active in slots.items():
            self._place[width] = np.full(len(self._layout.first(width)), ABSENT)
            self._place[width][active] = np.arange(len(active))
        self._columns = self._layout.columns(slots[POINT])
        if len(slots[POSE]):
            oriented = self._layout.columns(slots[POSE], POSE)
            self._columns = np.union1d(self._columns, oriented)
        self._local = self._whole.part(self._columns)
        size = len(self._columns)
        self._entry = np.full(self._layout.size, ABSENT)
        self._entry[self._columns] = np.arange(size)
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


def _by_width(state: KalmanState, width: int) -> Array:
    return state.landmarks if width == POINT else state.oriented


class CompressedEkf(Ekf):
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
        """areas: how the map is cut. The rest is as in Ekf."""
        super().__init__(motion, association, prior_pose, prior_covariance, stabilisation, trace)
        self.state = CompressedState(prior_pose, prior_covariance, areas or LocalAreas())
