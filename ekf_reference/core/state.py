"""The joint Gaussian of vehicle and map. The only module that writes mean and covariance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.layout import POINT, POSE, Layout
from ekf_reference.core.local_map import LocalMap, MapSnapshot, by_number


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


class KalmanState:
    """Mean and covariance of the pose (p entries), then of the landmarks as they came.

    The pose is x, y, heading, or x, y, cosine, sine. Landmarks are points (x, y) or have a
    direction (x, y, heading); `layout` says what lies where. The arrays handed out are read-only;
    views change with the next write. Headings are unwrapped, the covariance is of the additive
    global error.
    """

    def __init__(self, pose: Array, covariance: Array) -> None:
        """pose: (p,). covariance: (p, p), symmetric positive definite."""
        self._layout = Layout.of_pose(len(pose))
        self._mean = np.array(pose, dtype=float)
        self._covariance = np.array(covariance, dtype=float)

    @property
    def _pose_size(self) -> int:
        return self._layout.pose_size

    @property
    def _size(self) -> int:
        return self._layout.size

    @property
    def layout(self) -> Layout:
        """Where pose and landmarks lie."""
        return self._layout

    @property
    def mean(self) -> Array:
        """(n,) state."""
        return _read_only(self._mean[: self._size])

    @property
    def covariance(self) -> Array:
        """(n, n) covariance."""
        return _read_only(self._covariance[: self._size, : self._size])

    @property
    def pose(self) -> Array:
        """(p,) x, y and the direction; a copy."""
        return self._mean[: self._pose_size].copy()

    @property
    def pose_covariance(self) -> Array:
        """(p, p); a copy."""
        return self._covariance[: self._pose_size, : self._pose_size].copy()

    @property
    def landmarks(self) -> Array:
        """(L, 2) positions of all points; NaN where one was removed."""
        if self._layout.plain:
            return self.mean[self._pose_size :].reshape(-1, 2)
        return self._places(POINT)

    @property
    def landmark_count(self) -> int:
        """Number of points that were ever in the state: the next one's slot."""
        return len(self._layout.point)

    @property
    def oriented(self) -> Array:
        """(Q, 3) x, y, heading of the landmarks with a direction; NaN where one was removed."""
        return self._places(POSE)

    def snapshot(self, kinds: tuple[int, ...] = (POINT,)) -> MapSnapshot:
        """Pose and places of all landmarks of some kinds, without moving anything."""
        if self._layout.plain and kinds == (POINT,):
            return MapSnapshot(self.landmarks, np.arange(self.landmark_count), self.covariance)
        number, first = self._layout.numbered(kinds)
        entries = (first[:, None] + np.arange(POINT)).ravel()
        columns = np.concatenate((np.arange(self._pose_size), entries))
        place = by_number([self._places(width) for width in kinds])
        return MapSnapshot(place, number, self._covariance[columns[:, None], columns])

    def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        """Move the vehicle; the map stays (Nieto 2005, eqs. 2.32 and 2.36).

        pose: (p,) f(x, u). jacobian_pose: (p, p). noise: (p, p), all of the step's noise.
        """
        v, n, p = self._pose_size, self._size, self._covariance
        self._mean[:v] = pose
        vehicle = jacobian_pose @ p[:v, :v] @ jacobian_pose.T + noise
        p[:v, :v] = 0.5 * (vehicle + vehicle.T)
        cross = jacobian_pose @ p[:v, v:n]
        p[:v, v:n] = cross
        p[v:n, :v] = cross.T

    def local_map(self, reach_m: float) -> LocalMap:
        """The landmarks at most `reach_m` east, west, north or south of the vehicle."""
        near = np.abs(self.landmarks - self._mean[:2]).max(axis=1, initial=0.0) <= reach_m
        return self.map_of(np.flatnonzero(near))

    def within(self, reach_m: float, width: int = POINT) -> Index:
        """Index (m,) of the landmarks of a kind that are at most `reach_m` from the vehicle."""
        return within(self._places(width), self._mean, reach_m)

    def map_of(self, slot: Index, width: int = POINT) -> LocalMap:
        """Some landmarks (m,) of a kind, by their slots. Raises ValueError for removed ones."""
        columns = self._layout.columns(slot, width)
        covariance = self._covariance[columns[:, None], columns]
        landmark = self._mean[columns[self._pose_size :]].reshape(-1, width)
        return LocalMap(self.pose, slot, landmark, covariance, columns)

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Fuse one stacked observation (Nieto 2005, eqs. 2.39 and 2.45 to 2.47).

        Errata: 2.39 is printed S = H P H + R and 2.47 W = P H S^-1; the transposes belong there.

        columns: (c,) state entries the observation depends on. jacobian: (m, c) with respect to
        them. innovation: (m,), wrapped. noise: (m, m).

        With S = L L^T the term W S W^T is U^T U, U = L^-1 H P: symmetric as computed.
        Raises FilterDivergedError when S is not positive definite, or anything is not finite.
        """
        n = self._size
        p = self._covariance[:n, :n]
        gain_left = p[:, columns] @ jacobian.T  # P H^T, (n, m)
        innovation_covariance = jacobian @ gain_left[columns] + noise
        if not (np.isfinite(innovation_covariance).all() and np.isfinite(innovation).all()):
            raise FilterDivergedError("the innovation or its covariance is not finite")
        try:
            root = np.linalg.cholesky(innovation_covariance)
        except np.linalg.LinAlgError as error:
            raise FilterDivergedError(
                "the innovation covariance is not positive definite"
            ) from error
        inverse_root = np.linalg.inv(root)
        u = inverse_root @ gain_left.T
        whitened = inverse_root @ innovation
        self._mean[:n] += u.T @ whitened
        p -= u.T @ u
        return Correction(inverse_root, u, whitened, innovation_covariance)

    def augment(
        self, point: Array, jacobian_pose: Array, jacobian_sighting: Array, noise: Array
    ) -> None:
        """Append m landmarks, correlated through the vehicle (Nieto 2005, eqs. 2.51 to 2.53).

        point: (m, w), 2 entries for points and 3 for landmarks with a direction. jacobian_pose:
        (m, w, p). jacobian_sighting: (m, w, w). noise: (m, w, w), the sightings' covariances.
        """
        count, width = point.shape
        v, n, added = self._pose_size, self._size, width * count
        self._reserve(n + added)
        p = self._covariance
        stacked = jacobian_pose.reshape(added, v)
        cross = stacked @ p[:v, :n]
        p[n : n + added, :n] = cross
        p[:n, n : n + added] = cross.T
        spread = jacobian_sighting @ noise @ jacobian_sighting.transpose(0, 2, 1)
        own = cross[:, :v] @ stacked.T + block_diagonal(spread)
        p[n : n + added, n : n + added] = 0.5 * (own + own.T)
        self._mean[n : n + added] = point.ravel()
        self._layout = self._layout.appended(count, width)

    def remove(self, slot: Index, width: int = POINT) -> None:
        """Marginalise landmarks (m,) of a kind out; their slots stay empty.

        Raises ValueError for landmarks that were removed before.
        """
        gone = self._layout.columns(slot, width)[self._pose_size :]
        kept = np.setdiff1d(np.arange(self._size), gone)
        size = len(kept)
        self._mean[:size] = self._mean[kept]
        self._covariance[:size, :size] = self._covariance[kept[:, None], kept]
        self._layout = self._layout.without(slot, width)

    def part(self, columns: Index) -> KalmanState:
        """The marginal of some state entries (c,), the pose's first; slots count anew."""
        chosen = KalmanState(self.pose, self.pose_covariance)
        chosen._reserve(len(columns))
        chosen._layout = self._layout.part(columns)
        chosen._mean[: len(columns)] = self._mean[columns]
        chosen._covariance[: len(columns), : len(columns)] = self._covariance[
            columns[:, None], columns
        ]
        return chosen

    def merge(
        self,
        columns: Index,
        local: KalmanState,
        transition: Array,
        root: Array,
        shift: Array,
        spared: Index,
    ) -> None:
        """Take over what a local filter learnt (the global update of the compressed filter).

        columns: (a,) entries that the local state started from. local: its state now, further
        landmarks behind the first a. transition: (a', a) phi. root: (n, k) with
        Delta P = root root^T, shift: (n,) correction of the mean, for entries outside. spared:
        entries whose covariance with each other stays as it is (Guivant 2002, eqs. 22 and 23).
        """
        n, a = self._size, len(columns)
        total = n + local._size - a
        self._reserve(total)
        mean, p = self._mean, self._covariance
        cross = transition @ p[columns, :n]  # P_ab = phi P_ab(0), all columns
        changed = np.setdiff1d(np.arange(n), spared)
        if 2 * len(changed) < n:
            p[changed, :n] -= root[changed] @ root.T
            p[spared[:, None], changed] = p[changed[:, None], spared].T
        else:  # contiguous and therefore faster where most entries change
            kept = p[spared[:, None], spared]
            p[:n, :n] -= root @ root.T
            p[spared[:, None], spared] = kept
        mean[:n] += shift
        everywhere = np.concatenate((columns, np.arange(n, total)))
        p[everywhere, :n] = cross
        p[:n, everywhere] = cross.T
        p[everywhere[:, None], everywhere] = local.covariance
        mean[everywhere] = local.mean
        self._layout = self._layout.continued(local.layout, a)

    def _places(self, width: int) -> Array:
        """(L, w) of all landmarks of a kind, a copy."""
        first = self._layout.first(width)
        place: Array = self._mean[first[:, None] + np.arange(width)]
        place[first < 0] = np.nan
        return place

    def _reserve(self, size: int) -> None:
        """Grow the buffers geometrically, so that adding landmarks stays cheap."""
        if size <= len(self._mean):
            return
        capacity = max(size, 2 * len(self._mean), 64)
        mean, covariance = np.zeros(capacity), np.zeros((capacity, capacity))
        n = self._size
        mean[:n] = self._mean[:n]
        covariance[:n, :n] = self._covariance[:n, :n]
        self._mean, self._covariance = mean, covariance


def within(place: Array, centre: Array, reach_m: float) -> Index:
    """Rows (m,) of places (L, w) at most `reach_m` from where a state (n,) begins; none is NaN."""
    away = np.hypot(place[:, 0] - centre[0], place[:, 1] - centre[1])
    return np.flatnonzero(away <= reach_m)


def state_columns(slot: Index, pose_size: int = 3) -> Index:
    """Entries (p + 2 m,) of the pose and some points (m,) of a map that is nothing but points.

    A LocalMap is; of a whole state its layout knows.
    """
    columns = np.empty(pose_size + 2 * len(slot), dtype=np.intp)
    columns[:pose_size] = np.arange(pose_size)
    columns[pose_size::2] = pose_size + 2 * slot
    columns[pose_size + 1 :: 2] = pose_size + 1 + 2 * slot
    return columns


def stack(jacobian_pose: Array, jacobian_landmark: Array) -> Array:
    """One Jacobian (w m, p + w m) for m sightings, in the order of Layout.columns.

    jacobian_pose: (m, w, p). jacobian_landmark: (m, w, w).

    Two sightings of one landmark get two sets of columns with the same state entries, which
    sums their effect on S and on the gain as it should.
    """
    m, width, p = jacobian_pose.shape
    jacobian = np.zeros((m, width, p + width * m))
    jacobian[:, :, :p] = jacobian_pose
    which = np.arange(m)
    for i in range(width):
        jacobian[which, :, p + i + width * which] = jacobian_landmark[:, :, i]
    return jacobian.reshape(width * m, -1)


def unstack(jacobian: Array, width: int = POINT) -> tuple[Array, Array]:
    """The blocks (m, w, p) and (m, w, w) that `stack` put together."""
    m = len(jacobian) // width
    p = jacobian.shape[1] - width * m
    blocks, which = jacobian.reshape(m, width, -1), np.arange(m)[:, None]
    by_landmark: Array = blocks[which, :, p + width * which + np.arange(width)].transpose(0, 2, 1)
    return blocks[:, :, :p], by_landmark


def diagonal_blocks(matrix: Array, width: int = POINT) -> Array:
    """The blocks (m, w, w) on the diagonal of a (w m, w m) matrix."""
    m = len(matrix) // width
    which = np.arange(m)
    blocks: Array = matrix.reshape(m, width, m, width)[which, :, which]
    return blocks


def block_diagonal(blocks: Array) -> Array:
    """(m, w, w) blocks to a (w m, w m) matrix."""
    m, width, _ = blocks.shape
    full = np.zeros((m, width, m, width))
    which = np.arange(m)
    full[which, :, which, :] = blocks
    return full.reshape(width * m, width * m)


def _read_only(array: Array) -> Array:
    view = array.view()
    view.flags.writeable = False
    return view
