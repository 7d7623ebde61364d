"""The joint Gaussian of vehicle and map. The only module that writes mean and covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class FilterDivergedError(ArithmeticError):
    """The covariance lost positive definiteness or a number stopped being finite."""


class KalmanState:
    """Mean and covariance of the pose (x, y, heading), then of the landmarks (x, y each).

    The arrays handed out are read-only views; they change with the next write. The heading is
    unwrapped, the covariance is of the additive global error.
    """

    def __init__(self, pose: Array, covariance: Array) -> None:
        """pose: (3,). covariance: (3, 3), symmetric positive definite."""
        self._size = 3
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
        """(3,) x, y, heading; a copy."""
        return self._mean[:3].copy()

    @property
    def landmarks(self) -> Array:
        """(L, 2) positions."""
        return self.mean[3:].reshape(-1, 2)

    @property
    def landmark_count(self) -> int:
        """Number of landmarks in the state."""
        return (self._size - 3) // 2

    def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        """Move the vehicle; the map stays (Nieto 2005, eqs. 2.32 and 2.36).

        pose: (3,) f(x, u). jacobian_pose: (3, 3). noise: (3, 3), all of the step's noise.
        """
        n, p = self._size, self._covariance
        self._mean[:3] = pose
        vehicle = jacobian_pose @ p[:3, :3] @ jacobian_pose.T + noise
        p[:3, :3] = 0.5 * (vehicle + vehicle.T)
        cross = jacobian_pose @ p[:3, 3:n]
        p[:3, 3:n] = cross
        p[3:n, :3] = cross.T

    def update(self, columns: Index, jacobian: Array, innovation: Array, noise: Array) -> None:
        """Fuse one stacked observation (Nieto 2005, eqs. 2.39, 2.45 to 2.47 as corrected).

        columns: (c,) state entries the observation depends on. jacobian: (m, c) with respect to
        them. innovation: (m,), wrapped. noise: (m, m).

        With S = L L^T the term W S W^T is U^T U, U = L^-1 H P: symmetric as computed.
        Raises FilterDivergedError when S is not positive definite.
        """
        n = self._size
        p = self._covariance[:n, :n]
        gain_left = p[:, columns] @ jacobian.T  # P H^T, (n, m)
        innovation_covariance = jacobian @ gain_left[columns] + noise
        try:
            root = np.linalg.cholesky(innovation_covariance)
        except np.linalg.LinAlgError as error:
            raise FilterDivergedError(
                "the innovation covariance is not positive definite"
            ) from error
        inverse_root = np.linalg.inv(root)
        u = inverse_root @ gain_left.T
        self._mean[:n] += u.T @ (inverse_root @ innovation)
        p -= u.T @ u

    def augment(
        self, point: Array, jacobian_pose: Array, jacobian_sighting: Array, noise: Array
    ) -> None:
        """Append m landmarks, correlated through the vehicle (Nieto 2005, eqs. 2.51 to 2.53).

        point: (m, 2). jacobian_pose: (m, 2, 3). jacobian_sighting: (m, 2, 2). noise: (m, 2, 2),
        the sightings' covariances.
        """
        n, added = self._size, 2 * len(point)
        self._reserve(n + added)
        p = self._covariance
        stacked = jacobian_pose.reshape(added, 3)
        cross = stacked @ p[:3, :n]
        p[n : n + added, :n] = cross
        p[:n, n : n + added] = cross.T
        own = cross[:, :3] @ stacked.T
        spread = jacobian_sighting @ noise @ jacobian_sighting.transpose(0, 2, 1)
        for i in range(len(point)):
            own[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += spread[i]
        p[n : n + added, n : n + added] = 0.5 * (own + own.T)
        self._mean[n : n + added] = point.ravel()
        self._size = n + added

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


def _read_only(array: Array) -> Array:
    view = array.view()
    view.flags.writeable = False
    return view
