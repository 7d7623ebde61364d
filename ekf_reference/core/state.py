"""The joint Gaussian of vehicle and map. The only module that writes mean and covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ekf_reference.core import machine
from ekf_reference.core.blocks import block_diagonal
from ekf_reference.core.chart import ADDITIVE, Chart
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import KINDS, POINT, LandmarkKind, NewLandmarks
from ekf_reference.core.layout import Layout


class Correction(NamedTuple):
    """What an update did, with S = L L^T.

    inverse_root: (m, m) L^-1. gain_root: (m, n) U = L^-1 H P, so that W = U^T L^-1. whitened:
    (m,) L^-1 innovation. spread: (m, m) S.
    """

    inverse_root: Array
    gain_root: Array
    whitened: Array
    spread: Array


class FilterDivergedError(ArithmeticError):
    """The covariance lost positive definiteness or a number stopped being finite."""


@dataclass(frozen=True, kw_only=True)
class LocalMap:
    """The pose and some landmarks of one kind, such as those that may be seen from here.

    pose: (p,). landmark_index: (L,). landmark: (L, w). covariance: (p + w L, p + w L) of all.
    columns: (p + w L,) their state entries.
    """

    pose: Array
    kind: LandmarkKind
    landmark_index: Index
    landmark: Array
    covariance: Array
    columns: Index

    @property
    def vehicle(self) -> Array:
        """(p, p) P_vv."""
        return self.covariance[: len(self.pose), : len(self.pose)]

    @property
    def cross(self) -> Array:
        """(L, p, w) P_vl of each landmark."""
        p = len(self.pose)
        return self.covariance[:p, p:].reshape(p, *self.landmark.shape).transpose(1, 0, 2)

    @property
    def own(self) -> Array:
        """(L, w, w) P_ll of each landmark, of the upper triangle: symmetric to the bit."""
        entry = len(self.pose) + np.arange(self.landmark.size).reshape(self.landmark.shape)
        i, j = entry[:, :, None], entry[:, None]
        return self.covariance[np.minimum(i, j), np.maximum(i, j)]

    def take(self, rows: Index) -> LocalMap:
        """Return the pose and some of the landmarks.

        Args:
            rows: (k,) of the landmarks here, which are no landmark indices.

        Returns:
            The smaller map with its own joint covariance.
        """
        layout = Layout.of_pose(len(self.pose)).appended(len(self.landmark), self.kind)
        entry = layout.columns(rows, self.kind)
        return replace(
            self,
            landmark_index=self.landmark_index[rows],
            landmark=self.landmark[rows],
            covariance=self.covariance[entry[:, None], entry],
            columns=self.columns[entry],
        )


class MapSnapshot(NamedTuple):
    """Landmarks (L, w) of a kind, NaN where removed; ascending indices (m,) of current ones."""

    place: Array
    landmark_index: Index


class KalmanState:
    """Mean and covariance of the pose (p entries), then of the landmarks as they came.

    The pose is x, y, heading, or x, y, cosine, sine. Headings are unwrapped, the covariance is of
    the additive global error (Nieto 2005, eqs. 2.2 and 2.25 to 2.31). Arrays handed out are copies,
    or read-only views that change with the next write.
    """

    def __init__(self, pose: Array, covariance: Array, chart: Chart = ADDITIVE) -> None:
        """Start with a pose alone.

        Args:
            pose: (p,), heading unwrapped; copied.
            covariance: (p, p), symmetric positive definite; copied.
            chart: Of the pose.
        """
        self._chart = chart
        self._layout = Layout.of_pose(len(pose))
        self._mean = np.array(pose, dtype=float)
        self._covariance = np.array(covariance, dtype=float)

    @property
    def layout(self) -> Layout:
        """Where pose and landmarks lie."""
        return self._layout

    @property
    def mean(self) -> Array:
        """(n,) state."""
        return _read_only(self._mean[: self._layout.size])

    @property
    def covariance(self) -> Array:
        """(n, n) covariance."""
        return _read_only(self._covariance[: self._layout.size, : self._layout.size])

    @property
    def pose(self) -> Array:
        """(p,) x, y and the direction; a copy (Nieto 2005, eqs. 2.26, 5.4 and 6.2)."""
        return self._mean[: self._layout.pose_size].copy()

    @property
    def pose_covariance(self) -> Array:
        """(p, p); a copy."""
        return self._covariance[: self._layout.pose_size, : self._layout.pose_size].copy()

    @property
    def landmarks(self) -> Array:
        """(L, 2) all points; NaN where one was removed (Nieto 2005, eqs. 2.27 and 6.3)."""
        return self.places(POINT)

    @property
    def landmark_count(self) -> int:
        """Number of points that were ever in the state: the next one's landmark index."""
        return len(self.layout.first[POINT])

    def places(self, kind: LandmarkKind) -> Array:
        """Return all landmarks of a kind.

        Args:
            kind: Of the landmarks.

        Returns:
            (L, w) by landmark index, a copy; NaN where one was removed.

        Source: Nieto 2005, eqs. 5.5 and 6.4.
        """
        first = self._layout.first[kind]
        place: Array = self._mean[first[:, None] + np.arange(kind.width)]
        place[first < 0] = np.nan
        return place

    def local_map(self, reach_m: float) -> LocalMap:
        """Return the points near the vehicle.

        Args:
            reach_m: Half the side of a square around the vehicle, its sides east-west and north-
                south [m].

        Returns:
            Pose and points with their joint covariance.
        """
        return self.map_of(self._near(reach_m, POINT))

    def columns_near(self, reach_m: float) -> Index:
        """Return the state entries of the pose and of all landmarks near the vehicle.

        Args:
            reach_m: As in `local_map`.

        Returns:
            (c,) entries, ascending.
        """
        p = self._layout.pose_size
        near = [self._layout.columns(self._near(reach_m, k), k)[p:] for k in KINDS]
        return np.sort(np.concatenate((np.arange(p), *near)))

    def within(self, reach_m: float, kind: LandmarkKind = POINT) -> Index:
        """Return the landmarks of a kind within a circle around the vehicle.

        Args:
            reach_m: Its radius [m].
            kind: Of the landmarks.

        Returns:
            (m,) landmark indices, ascending.
        """
        offset = self.places(kind)[:, :2] - self.pose[:2]
        return np.flatnonzero(np.hypot(*offset.T) <= reach_m)

    def _near(self, reach_m: float, kind: LandmarkKind) -> Index:
        offset = self.places(kind)[:, :2] - self.pose[:2]
        return np.flatnonzero(np.abs(offset).max(axis=1) <= reach_m)

    def map_of(self, landmark_index: Index, kind: LandmarkKind = POINT) -> LocalMap:
        """Return the pose and some landmarks with their joint covariance.

        Args:
            landmark_index: (m,) landmark indices.
            kind: Of the landmarks.

        Returns:
            Copies, in the order asked for.

        Raises:
            ValueError: A landmark was removed.
        """
        columns = self._layout.columns(landmark_index, kind)
        landmark = self._mean[columns[self._layout.pose_size :]].reshape(-1, kind.width)
        return LocalMap(
            pose=self.pose,
            kind=kind,
            landmark_index=landmark_index,
            landmark=landmark,
            covariance=self.covariance_of(columns),
            columns=columns,
        )

    def snapshot(self, kind: LandmarkKind = POINT) -> MapSnapshot:
        """Return all landmarks of a kind, and which of them are current.

        Args:
            kind: Of the landmarks.

        Returns:
            Places, and the indices of current ones: here all that are in the state.
        """
        return MapSnapshot(self.places(kind), self._layout.present(kind))

    def covariance_of(self, columns: Index) -> Array:
        """Return the covariance of some entries.

        Args:
            columns: (c,) state entries.

        Returns:
            (c, c), a copy.
        """
        return self._covariance[columns[:, None], columns]

    def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        """Move the vehicle; the map stays, so the Jacobian of the whole is diag(F, I).

        Args:
            pose: (p,) f(x, u), heading unwrapped.
            jacobian_pose: (p, p), F = df/dx at the departed pose, of the additive global error.
            noise: (p, p), all of the step's.

        Source: Guivant 2002, eqs. 5 to 7; Misono 2007, eqs. 1, 6 and 11; Nieto 2005, eqs. 2.14 and
        2.32 to 2.36.
        """
        self._mean[: len(pose)] = pose
        self._carry(jacobian_pose, noise)

    def _carry(self, jacobian_pose: Array, noise: Array | float) -> None:
        """Carry the covariance over to where the pose is now."""
        v, n, p = self._layout.pose_size, self._layout.size, self._covariance
        vehicle = jacobian_pose @ p[:v, :v] @ jacobian_pose.T + noise
        p[:v, :v] = 0.5 * (vehicle + vehicle.T)
        if n > v:
            cross = jacobian_pose @ p[:v, v:n]
            p[:v, v:n], p[v:n, :v] = cross, cross.T

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Fuse one stacked measurement.

        With S = L L^T the term W S W^T is U^T U, U = L^-1 H P: symmetric as computed.

        Args:
            columns: (c,) state entries that the measurement depends on; may repeat.
            jacobian: (m, c), H by these entries.
            innovation: (m,), angles wrapped.
            noise: (m, m), R.

        Returns:
            The factors of S and the whitened innovation, for the trace and the compressed filter.

        Raises:
            FilterDivergedError: S is not positive definite, or S or the innovation is not finite;
                the state is as before.

        Source: Guivant 2002, eq. 8; Misono 2007, eqs. 13 to 15; Nieto 2005, eqs. 2.39, 2.45 to 2.47
        and, for entries that are not measured, 3.11.
        Errata: 2.39 is printed S = H P H + R and 2.47 W = P H S^-1; the transposes belong there.
        """
        v, n = self._layout.pose_size, self._layout.size
        p = self._covariance[:n, :n]
        gain_left = p[:, columns] @ jacobian.T  # P H^T, (n, m)
        innovation_covariance = jacobian @ gain_left[columns] + noise  # S, 2.39
        if not (np.isfinite(innovation_covariance).all() and np.isfinite(innovation).all()):
            raise FilterDivergedError("the innovation or its covariance is not finite")
        try:
            inverse_root = np.linalg.inv(np.linalg.cholesky(innovation_covariance))
        except np.linalg.LinAlgError as e:
            raise FilterDivergedError("the innovation covariance is not positive definite") from e
        u, whitened = inverse_root @ gain_left.T, inverse_root @ innovation
        pose, step = self.pose, u.T @ whitened
        self._mean[:n] += step  # 2.45
        p -= u.T @ u  # 2.46
        if (reset := self._chart.reset(pose, step[:v])) is not None:
            self._mean[:v] = self._chart.plus(pose, step[:v])
            self._carry(reset, 0.0)
        return Correction(inverse_root, u, whitened, innovation_covariance)

    def augment(self, new: NewLandmarks, noise: Array, kind: LandmarkKind = POINT) -> None:
        """Append m landmarks of a kind, correlated with everything through the vehicle.

        Args:
            new: They, with G_x by the pose and G_z by the measurement.
            noise: (m, w, w), R.
            kind: Of the landmarks.

        Source: Nieto 2005, eqs. 2.48 to 2.53.
        """
        v, n = self._layout.pose_size, self._layout.size
        last = slice(n, n + new.landmark.size)
        self._reserve(last.stop)
        p, stacked = self._covariance, new.jacobian_pose.reshape(-1, v)
        cross = stacked @ p[:v, :n]
        p[last, :n], p[:n, last] = cross, cross.T
        own_noise = new.jacobian_z @ noise @ new.jacobian_z.transpose(0, 2, 1)
        own = cross[:, :v] @ stacked.T + block_diagonal(own_noise)
        p[last, last] = 0.5 * (own + own.T)
        self._mean[last] = new.landmark.ravel()
        self._layout = self._layout.appended(len(new.landmark), kind)

    def remove(self, landmark_index: Index, kind: LandmarkKind = POINT) -> None:
        """Marginalise landmarks out; their indices are not given again.

        Args:
            landmark_index: (m,) landmark indices.
            kind: Of the landmarks.

        Raises:
            ValueError: A landmark was removed already.
        """
        gone = self._layout.columns(landmark_index, kind)[self._layout.pose_size :]
        kept = np.setdiff1d(np.arange(self._layout.size), gone)
        self._layout, n = self._layout.part(kept), len(kept)
        self._mean[:n] = self._mean[kept]
        self._covariance[:n, :n] = self._covariance[kept[:, None], kept]

    def part(self, columns: Index) -> KalmanState:
        """Return the marginal of some state entries.

        Args:
            columns: (c,) entries, the pose's first; whole landmarks.

        Returns:
            A state of its own; landmark indices are the same.
        """
        covariance = self._covariance[columns[:, None], columns]
        chosen = KalmanState(self._mean[columns], covariance, self._chart)
        chosen._layout = self._layout.part(columns)
        return chosen

    def merge(
        self, start: Index, local: KalmanState, phi: Array, root: Array, shift: Array, spared: Index
    ) -> None:
        """Take over what a local filter learnt: the global update of the compressed filter.

        Args:
            start: (a,) entries that the local state started from.
            local: Its state now, new landmarks behind the first a entries.
            phi: (a', a), which carries the correlations: P_ab = phi P_ab(0).
            root: (n, k) with Delta P = root root^T, for entries outside.
            shift: (n,) of the mean, for entries outside.
            spared: (s,) entries whose covariance with each other stays as it is.

        Source: Guivant 2002, eqs. 17, 20, 21 and 23.
        """
        n, a = self._layout.size, len(start)
        total = n + local._layout.size - a
        self._reserve(total)
        mean, p = self._mean, self._covariance
        everywhere = np.concatenate((start, np.arange(n, total)))
        if n > a:
            cross = phi @ p[start, :n]  # P_ab = phi P_ab(0), all columns
            if len(spared) or n > machine.WHOLE:
                changed = np.setdiff1d(np.arange(n), np.concatenate((start, spared)))
                subtract(p, root, changed, spared)
            else:
                p[:n, :n] -= root @ root.T
            mean[:n] += shift
            p[everywhere, :n], p[:n, everywhere] = cross, cross.T
        p[everywhere[:, None], everywhere] = local.covariance
        mean[everywhere] = local.mean
        self._layout = self._layout.continued(local.layout, a)

    def _reserve(self, size: int) -> None:
        """Grow the buffers geometrically, so that adding landmarks stays cheap."""
        used = len(self._mean)
        if size > used:
            room = max(size, 2 * used, 64)
            mean, covariance = np.zeros(room), np.zeros((room, room))  # memory once it is written
            mean[:used], covariance[:used, :used] = self._mean, self._covariance
            self._mean, self._covariance = mean, covariance


def correlation_coefficients(covariance: Array) -> Array:
    """Return the absolute correlation coefficients |P_ij| / sqrt(P_ii P_jj).

    Args:
        covariance: (n, n), with positive diagonal.

    Returns:
        (n, n), 1 on the diagonal. The sign is lost, as in the source.

    Source: Nieto 2005, eq. 2.62.
    """
    sigma = np.sqrt(np.diag(covariance))
    coefficients: Array = np.abs(covariance) / np.outer(sigma, sigma)
    return coefficients


def subtract(p: Array, root: Array, changed: Index, spared: Index) -> None:
    """Subtract root root^T from a covariance in place, but for the spared block.

    In strips of changed rows, rightward from the first's own entry, and to its left where spared:
    each pair is computed once, and a strip stays in the cache.

    Args:
        p: (>= n, >= n), changed.
        root: (n, k).
        changed: (c,) entries whose rows and columns change, ascending.
        spared: (s,) entries whose covariance with each other stays, ascending.

    Source: Guivant 2002, eqs. 20, 21 and 23.
    """
    n, across = len(root), root[spared]
    for first in range(0, len(changed), machine.STRIP):
        rows = changed[first : first + machine.STRIP]
        i, own = rows[0], root[rows]
        p[rows, i:n] -= own @ root[i:].T
        p[i:n, rows] = p[rows, i:n].T
        before = spared[: np.searchsorted(spared, i)]
        left = p[rows[:, None], before] - own @ across[: len(before)].T
        p[rows[:, None], before], p[before[:, None], rows] = left, left.T


def _read_only(array: Array) -> Array:
    view = array.view()
    view.flags.writeable = False
    return view
