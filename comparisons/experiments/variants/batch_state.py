"""The joint Gaussians of many runs at once: the only module that writes their means, covariances.

State order: x, y, heading (unwrapped), then landmarks. All runs have the same landmarks, in the
same order, since they see the same things at the same time. Covariances are of the additive
global error here; InvariantState keeps those of another.
"""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.experiments.variants.batch_models import rotated, turned
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.core.landmark_types import POINT, LandmarkKind
from ekf_reference.core.layout import Layout


def measured(matrix: Array, lever: Array | None, landmark_index: Index, x: Array) -> Array:
    """H X (B, 2 m, c) for X (B, n, c), with H = M [-I, -J lever, I] of each landmark.

    matrix: (B, m, 2, 2) M. lever: (B, m, 2), or None where the heading has no part.
    """
    runs, _, columns = x.shape
    landmark = x[:, 3:].reshape(runs, -1, 2, columns)[:, landmark_index]
    seen = landmark - x[:, None, :2]
    if lever is not None:
        seen -= turned(lever)[..., None] * x[:, None, None, 2]
    product: Array = (matrix @ seen).reshape(runs, -1, columns)
    return product


class BatchState:
    """Means (B, n) and covariances (B, n, n)."""

    def __init__(self, pose: Array, covariance: Array, runs: int, capacity: int) -> None:
        """Start: pose (3,), covariance (3, 3), the same for all runs. capacity: most landmarks."""
        size = Layout.packed(3, capacity).size
        self._mean = np.zeros((runs, size))
        self._covariance = np.zeros((runs, size, size))
        self._mean[:, :3], self._covariance[:, :3, :3] = pose, covariance
        self._size = 3
        self.lost = np.zeros(runs, dtype=bool)
        """(B,) runs whose innovation covariance stopped being positive definite."""

    @property
    def mean(self) -> Array:
        """(B, n), a view."""
        return self._mean[:, : self._size]

    @property
    def covariance(self) -> Array:
        """(B, n, n), a view."""
        return self._covariance[:, : self._size, : self._size]

    @property
    def pose(self) -> Array:
        """(B, 3), a view."""
        return self._mean[:, :3]

    @property
    def landmarks(self) -> Array:
        """(B, L, 2), a view."""
        return self.mean[:, 3:].reshape(len(self._mean), -1, 2)

    def places(self, kind: LandmarkKind) -> Array:
        """(B, L, 2) of points, a view; there are no others."""
        return self.landmarks if kind == POINT else np.zeros((len(self._mean), 0, kind.width))

    def predict(self, pose: Array, travel: Array, noise: Array) -> None:
        """Move the robots; Phi = [[I, J travel], [0, 1]].

        pose: (B, 3) where to. travel: (B, 2). noise: (B, 3, 3).
        """
        p = self.covariance
        p[:, :2] += turned(travel)[:, :, None] * p[:, None, 2]
        p[:, :, :2] += turned(travel)[:, None, :] * p[:, :, 2, None]
        p[:, :3, :3] += noise
        self._mean[:, :3] = pose

    def update(
        self,
        landmark_index: Index,
        matrix: Array,
        lever: Array | None,
        innovation: Array,
        noise: Array,
    ) -> None:
        """Fuse the measurements of one instant; H as of `measured`.

        innovation: (B, m, 2). noise: (m, 2) variances. With S = L L^T the term W S W^T is U^T U,
        U = L^-1 H P, as in ekf_reference.core.state.
        """
        p = self.covariance
        hp = measured(matrix, lever, landmark_index, p)
        s = measured(matrix, lever, landmark_index, hp.transpose(0, 2, 1))
        rows = np.arange(s.shape[1])
        s[:, rows, rows] += noise.ravel()
        inverse_root = np.linalg.inv(self._root(s))
        u = inverse_root @ hp
        whitened = inverse_root @ innovation.reshape(len(p), -1, 1)
        self._move((u.transpose(0, 2, 1) @ whitened)[..., 0])
        p -= u.transpose(0, 2, 1) @ u

    def augment(self, point: Array, lever: Array, spread: Array) -> None:
        """Append landmarks (B, k, 2), whose errors are [I, J lever] of the pose's plus noise.

        lever: (B, k, 2). spread: (B, k, 2, 2) covariance of that noise.
        """
        n, k = self._size, point.shape[1]
        full, end = self._covariance, n + 2 * k
        own = full[:, None, :2, :n] + turned(lever)[..., None] * full[:, None, None, 2, :n]
        cross = own.reshape(len(full), 2 * k, n)
        full[:, n:end, :n] = cross
        full[:, :n, n:end] = cross.transpose(0, 2, 1)
        block = cross[:, :, None, :2] + cross[:, :, None, 2:3] * turned(lever)[:, None]
        full[:, n:end, n:end] = block.reshape(len(full), 2 * k, 2 * k)
        for i in range(k):
            at = slice(n + 2 * i, n + 2 * i + 2)
            full[:, at, at] += spread[:, i]
        self._mean[:, n:end] = point.reshape(len(full), -1)
        self._size = end

    def pose_error(self, truth: Array) -> tuple[Array, Array]:
        """Errors (B, 3) from a true pose (3,) and their covariances (B, 3, 3), the filter's own."""
        error = truth - self.pose
        error[:, 2] = wrap_angle(error[:, 2])
        return error, self.pose_covariance()

    def pose_covariance(self) -> Array:
        """(B, 3, 3) of the additive error."""
        return self._covariance[:, :3, :3].copy()

    def landmark_covariance(self) -> Array:
        """(B, L, 2, 2) of the additive error, each landmark's own."""
        diagonal = np.arange((self._size - 3) // 2)
        p = self.covariance[:, 3:, 3:]
        blocks = p.reshape(len(p), len(diagonal), 2, len(diagonal), 2)
        own: Array = blocks[:, diagonal, :, diagonal].transpose(1, 0, 2, 3)
        return own

    def _move(self, correction: Array) -> None:
        """Add a correction (B, n) to the means."""
        self._mean[:, : self._size] += correction

    def _root(self, s: Array) -> Array:
        """Lower triangular roots of (B, m, m); runs that have none are lost, with a unit root."""
        try:
            return np.asarray(np.linalg.cholesky(s), dtype=float)
        except np.linalg.LinAlgError:
            for run, matrix in enumerate(s):
                try:
                    np.linalg.cholesky(matrix)
                except np.linalg.LinAlgError:
                    self.lost[run] = True
                    s[run] = np.eye(len(matrix))
            return np.asarray(np.linalg.cholesky(s), dtype=float)


class BatchInvariantState(BatchState):
    """Covariances of the right-invariant error xi of SE(2) with landmarks (Barrau 2015).

    position = R(a) estimate + V(a) xi_p and likewise every landmark, with a = xi_heading; to first
    order the additive error is xi_p + J estimate a.
    """

    def predict_invariant(self, pose: Array, gamma: Array, control_noise: Array) -> None:
        """Move; Phi is the identity. gamma: (B, n, 2) of xi by the control, (2,) variances."""
        p = self.covariance
        p += (gamma * control_noise) @ gamma.transpose(0, 2, 1)
        self._mean[:, :3] = pose

    def pose_error(self, truth: Array) -> tuple[Array, Array]:
        """Errors (B, 3) as xi, the logarithm on SE(2), and their covariances."""
        a = wrap_angle(truth[2] - self.pose[:, 2])
        moved = truth[:2] - rotated(a, self.pose[:, :2])
        error = np.column_stack((_left_jacobian(a, moved, inverse=True), a))
        return error, self._covariance[:, :3, :3].copy()

    def pose_covariance(self) -> Array:
        """(B, 3, 3) of the additive error, to first order."""
        turn = np.broadcast_to(np.eye(3), (len(self._mean), 3, 3)).copy()
        turn[:, :2, 2] = turned(self.pose[:, :2])
        covariance: Array = turn @ self._covariance[:, :3, :3] @ turn.transpose(0, 2, 1)
        return covariance

    def landmark_covariance(self) -> Array:
        """(B, L, 2, 2) of the additive error, to first order."""
        arm = turned(self.landmarks)
        with_heading = self.covariance[:, 3:, 2].reshape(arm.shape)
        mixed = with_heading[..., :, None] * arm[..., None, :]
        across = self._covariance[:, 2, 2, None, None, None] * arm[..., None] * arm[..., None, :]
        return super().landmark_covariance() + mixed + mixed.transpose(0, 1, 3, 2) + across

    def _move(self, correction: Array) -> None:
        """exp(xi) applied to the whole state."""
        a = correction[:, 2]
        self._mean[:, 2] += a
        points = np.concatenate((self.pose[:, None, :2], self.landmarks), axis=1)
        xi = np.concatenate((correction[:, :2], correction[:, 3:]), axis=1).reshape(points.shape)
        moved = rotated(a[:, None], points) + _left_jacobian(a[:, None], xi)
        self._mean[:, :2] = moved[:, 0]
        self._mean[:, 3 : self._size] = moved[:, 1:].reshape(len(a), -1)


def _left_jacobian(angle: Array, vector: Array, *, inverse: bool = False) -> Array:
    """V(a) v, or its inverse, V = [[sin a, cos a - 1], [1 - cos a, sin a]] / a."""
    half = 0.5 * angle
    shrink = np.sinc(half / np.pi)  # V is a turn by a/2 with this factor
    if inverse:
        return rotated(-half, vector) / shrink[..., None]
    return rotated(half, vector) * shrink[..., None]
