"""The Gaussian of the last pose and the map, carried through one piece of a log.

A smoother gives it at the end of a piece; through the next it is moved by the odometry and narrowed
by what has been recognised, only to judge what is seen. The smoother then starts it anew.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from graphslam.arrays import Array, Index, wrap_angle
from graphslam.layout import Layout


class ExpectedMeasurements(NamedTuple):
    """Measurements expected of n landmarks. z: (n, 2). jacobian: (n, 2, 5) by pose and landmark."""

    z: Array
    jacobian: Array


class RunningEstimate:
    """Mean and covariance of pose (3) and landmarks (2 each), additive global error."""

    def __init__(self, mean: Array, covariance: Array) -> None:
        """mean: (3 + 2 L,). covariance: of it."""
        self.mean, self.covariance = mean.copy(), covariance.copy()

    @property
    def pose(self) -> Array:
        """(3,)."""
        return self.mean[:3]

    @property
    def landmarks(self) -> Array:
        """(L, 2)."""
        return self.mean[3:].reshape(-1, 2)

    def move(self, increment: Array, covariance: Array) -> None:
        """By an increment (3,) with covariance (3, 3) of the right perturbation."""
        x, y, heading = self.pose
        cos, sin = np.cos(heading), np.sin(heading)
        east = cos * increment[0] - sin * increment[1]
        north = sin * increment[0] + cos * increment[1]
        f = np.array([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 1.0]])
        self.mean[:3] = x + east, y + north, heading + increment[2]
        cos, sin = np.cos(self.mean[2]), np.sin(self.mean[2])
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        p = self.covariance
        own = f @ p[:3, :3] @ f.T + turn @ covariance @ turn.T
        p[:3, 3:] = f @ p[:3, 3:]
        p[3:, :3] = p[:3, 3:].T
        p[:3, :3] = own

    def reach_m(self, longest_m: float) -> float:
        """How far a landmark may be that is seen at a range, with a pose four sigma off."""
        p = self.covariance.diagonal()
        return longest_m + 5.0 + 4.0 * (math.sqrt(p[0] + p[1]) + longest_m * math.sqrt(p[2]))

    def near(self, reach_m: float) -> Index:
        """Landmarks within reach of the vehicle."""
        distance = np.linalg.norm(self.landmarks - self.pose[:2], axis=1)
        return np.flatnonzero(distance <= reach_m)

    def expect(self, landmark_indices: Index) -> ExpectedMeasurements:
        """What landmarks (n,) would look like from here."""
        offset = self.landmarks[landmark_indices] - self.pose[:2]
        r = np.hypot(offset[:, 0], offset[:, 1])
        z = np.column_stack((r, np.arctan2(offset[:, 1], offset[:, 0]) - self.pose[2]))
        along, across = offset / r[:, None], offset[:, ::-1] * (-1.0, 1.0) / r[:, None] ** 2
        jacobian = np.zeros((len(r), 2, 5))
        jacobian[:, 0, 3:], jacobian[:, 1, 3:] = along, across
        jacobian[:, :, :2] = -jacobian[:, :, 3:]
        jacobian[:, 1, 2] = -1.0
        return ExpectedMeasurements(z, jacobian)

    def spread(self, landmark_indices: Index, jacobian: Array) -> Array:
        """(2 n, 2 n) covariance of the expected measurements of landmarks (n,), noise left out."""
        columns = _columns(landmark_indices)
        flat = _stacked(landmark_indices, landmark_indices, jacobian)
        return flat @ self.covariance[np.ix_(columns, columns)] @ flat.T

    def learn(self, landmark_indices: Index, z: Array, variance: Array) -> None:
        """Narrow by measurements (m, 2) with variances (m, 2) of landmarks (m,)."""
        expected = self.expect(landmark_indices)
        different = np.unique(landmark_indices)
        columns = _columns(different)
        flat = _stacked(different, landmark_indices, expected.jacobian)
        nu = wrapped(z - expected.z).ravel()
        left = self.covariance[:, columns] @ flat.T
        gain = np.linalg.solve(flat @ left[columns] + np.diag(variance.ravel()), left.T).T
        self.mean += gain @ nu
        self.covariance -= gain @ left.T


def _columns(landmark_indices: Index) -> Index:
    """Entries (3 + 2 n,) of the pose and of landmarks (n,) in mean and covariance."""
    first = Layout(1, int(landmark_indices.max(initial=-1)) + 1).point[landmark_indices]
    return np.concatenate(([0, 1, 2], (first[:, None] + (0, 1)).ravel()))


def _stacked(different: Index, landmark_indices: Index, jacobian: Array) -> Array:
    """(2 m, 3 + 2 n) Jacobian of measurements of landmarks (m,) by pose and landmarks (n,).

    different: the latter, ascending. jacobian: (m, 2, 5).
    """
    count, layout = len(landmark_indices), Layout(1, len(different))
    which, place = np.arange(count), layout.point[np.searchsorted(different, landmark_indices)]
    result = np.zeros((count, 2, layout.size))
    result[:, :, :3] = jacobian[:, :, :3]
    result[which, :, place], result[which, :, place + 1] = jacobian[:, :, 3], jacobian[:, :, 4]
    return result.reshape(2 * count, -1)


def wrapped(difference: Array) -> Array:
    """Range and bearing differences (..., 2), the bearing in (-pi, pi]."""
    result = difference.copy()
    result[..., 1] = wrap_angle(result[..., 1])
    return result
