"""The joint Gaussian of vehicle and map. The only module that writes mean and covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class LocalMap:
    """The landmarks that may be seen from here, as association needs them.

    pose: (p,). slot: (L,) places in the map. landmark: (L, 2). covariance: (p + 2 L, p + 2 L) of
    the pose and these landmarks.
    """

    pose: Array
    slot: Index
    landmark: Array
    covariance: Array

    @property
    def columns(self) -> Index:
        """(p + 2 L,) state entries of the pose and these landmarks."""
        return state_columns(self.slot, len(self.pose))

    @property
    def vehicle(self) -> Array:
        """(p, p) P_vv."""
        p = len(self.pose)
        return self.covariance[:p, :p]

    @property
    def cross(self) -> Array:
        """(L, p, 2) P_vl of each landmark."""
        p = len(self.pose)
        return self.covariance[:p, p:].reshape(p, len(self.slot), 2).transpose(1, 0, 2)

    @property
    def own(self) -> Array:
        """(L, 2, 2) P_ll of each landmark."""
        p = len(self.pose)
        diagonal, above = self.covariance.diagonal(), self.covariance.diagonal(1)
        own = np.empty((len(self.slot), 2, 2))
        own[:, 0, 0] = diagonal[p::2]
        own[:, 1, 1] = diagonal[p + 1 :: 2]
        own[:, 0, 1] = own[:, 1, 0] = above[p::2]
        return own


class Glance(NamedTuple):
    """A state as it lies, read without moving anything: what dense maps are placed by.

    landmark: (L, 2) all of them. slot: (m,) those whose covariance is current. covariance:
    (p + 2 m, p + 2 m) of the pose and these. Read-only; it changes with the next write.
    """

    landmark: Array
    slot: Index
    covariance: Array


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
    """Mean and covariance of the pose (p entries), then of the landmarks (x, y each).

    The pose is x, y, heading, or x, y, cosine, sine. The arrays handed out are read-only views;
    they change with the next write. The heading is unwrapped, the covariance is of the additive
    global error.
    """

    def __init__(self, pose: Array, covariance: Array) -> None:
        """pose: (p,). covariance: (p, p), symmetric positive definite."""
        self._pose_size = self._size = len(pose)
        self._mean = np.array(pose, dtype=float)
        self._covariance = np.array(covariance, dtype=float)

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
        """(L, 2) positions."""
        return self.mean[self._pose_size :].reshape(-1, 2)

    @property
    def landmark_count(self) -> int:
        """Number of landmarks in the state."""
        return (self._size - self._pose_size) // 2

    def glance(self) -> Glance:
        """All there is, without moving anything."""
        return Glance(self.landmarks, np.arange(self.landmark_count), self.covariance)

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

    def map_of(self, slot: Index) -> LocalMap:
        """Some landmarks (m,), by their places in the map."""
        columns = state_columns(slot, self._pose_size)
        covariance = self._covariance[columns[:, None], columns]
        return LocalMap(self.pose, slot, self.landmarks[slot], covariance)

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

        point: (m, 2). jacobian_pose: (m, 2, p). jacobian_sighting: (m, 2, 2). noise: (m, 2, 2),
        the sightings' covariances.
        """
        v, n, added = self._pose_size, self._size, 2 * len(point)
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
        self._size = n + added

    def part(self, columns: Index) -> KalmanState:
        """The marginal of some state entries (c,), the pose's first."""
        chosen = KalmanState(self.pose, self.pose_covariance)
        chosen._reserve(len(columns))
        chosen._size = len(columns)
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
        self._size = total

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


def state_columns(slot: Index, pose_size: int = 3) -> Index:
    """State entries (p + 2 m,) of the pose and some landmarks (m,)."""
    columns = np.empty(pose_size + 2 * len(slot), dtype=np.intp)
    columns[:pose_size] = np.arange(pose_size)
    columns[pose_size::2] = pose_size + 2 * slot
    columns[pose_size + 1 :: 2] = pose_size + 1 + 2 * slot
    return columns


def stack(jacobian_pose: Array, jacobian_landmark: Array) -> Array:
    """One Jacobian (2 m, p + 2 m) for m sightings, in the order of state_columns.

    jacobian_pose: (m, 2, p). jacobian_landmark: (m, 2, 2).

    Two sightings of one landmark get two pairs of columns with the same state entries, which
    sums their effect on S and on the gain as it should.
    """
    m, _, p = jacobian_pose.shape
    jacobian = np.zeros((m, 2, p + 2 * m))
    jacobian[:, :, :p] = jacobian_pose
    which = np.arange(m)
    jacobian[which, :, p + 2 * which] = jacobian_landmark[:, :, 0]
    jacobian[which, :, p + 1 + 2 * which] = jacobian_landmark[:, :, 1]
    return jacobian.reshape(2 * m, -1)


def unstack(jacobian: Array) -> tuple[Array, Array]:
    """The blocks (m, 2, p) and (m, 2, 2) that `stack` put together."""
    m = len(jacobian) // 2
    p = jacobian.shape[1] - 2 * m
    blocks, which = jacobian.reshape(m, 2, -1), np.arange(m)[:, None]
    by_landmark: Array = blocks[which, :, p + 2 * which + (0, 1)].transpose(0, 2, 1)
    return blocks[:, :, :p], by_landmark


def diagonal_blocks(matrix: Array) -> Array:
    """The blocks (m, 2, 2) on the diagonal of a (2 m, 2 m) matrix."""
    m = len(matrix) // 2
    which = np.arange(m)
    blocks: Array = matrix.reshape(m, 2, m, 2)[which, :, which]
    return blocks


def block_diagonal(blocks: Array) -> Array:
    """(m, 2, 2) blocks to a (2 m, 2 m) matrix."""
    m = len(blocks)
    full = np.zeros((m, 2, m, 2))
    which = np.arange(m)
    full[which, :, which, :] = blocks
    return full.reshape(2 * m, 2 * m)


def _read_only(array: Array) -> Array:
    view = array.view()
    view.flags.writeable = False
    return view
