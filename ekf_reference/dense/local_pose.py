"""The vehicle in the frame of two landmarks (Nieto 2005, eqs. 3.27 and 3.28).

The thesis writes the local pose in affine coordinates. Here they are metres along and across the
axis from L1 to L2, heading as in 3.28. Then a point's place in the frame is the local pose composed
with the measurement (3.29), and the third landmark does not matter.
"""

from typing import NamedTuple, Self

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT
from ekf_reference.dense.triangles import turned
from ekf_reference.dense.view import FilterView


class Frames(NamedTuple):
    """Frames of axes from L1 to L2.

    origin: (..., 2) [m], L1. turn: (..., 2, 2), its columns the frame's axes in the world.
    """

    origin: Array
    turn: Array

    @classmethod
    def of(cls, first: Array, second: Array) -> Self:
        """Of landmarks (..., 2) and (..., 2) [m]."""
        ahead = second - first
        ahead = ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)
        return cls(first, np.stack((ahead, turned(ahead)), axis=-1))

    def to_local(self, point: Array) -> Array:
        """Points (..., 2) [m] of the world in their frames."""
        local: Array = np.einsum("...ji,...j->...i", self.turn, point - self.origin)
        return local

    def to_world(self, local: Array) -> Array:
        """Points (..., 2) [m] of their frames in the world."""
        point: Array = self.origin + np.einsum("...ij,...j->...i", self.turn, local)
        return point


def local_pose(pose: Array, first: Array, second: Array) -> Array:
    """x, y [m] and heading [rad] of a pose (3,) along the axes from L1 to L2; (..., 3).

    first, second: (..., 2) [m]. The heading is not wrapped. Source: Nieto 2005, eqs. 3.27, 3.28;
    erratum: tan^-1 of the quotient loses the axis' quadrant, atan2 holds.
    """
    place = Frames.of(first, second).to_local(pose[:2])
    ahead = second - first
    heading = pose[2] - np.arctan2(ahead[..., 1], ahead[..., 0])
    return np.concatenate((place, heading[..., None]), axis=-1)


def local_pose_jacobian(pose: Array, first: Array, second: Array) -> Array:
    """Its derivative (..., 3, 7) by x, y, heading, L1x, L1y, L2x, L2y."""
    frame, ahead = Frames.of(first, second), second - first
    place = frame.to_local(pose[:2])
    by_second = turned(ahead) / np.square(ahead).sum(axis=-1, keepdims=True)  # of the axis' angle
    jacobian = np.zeros((*place.shape[:-1], 3, 7))
    jacobian[..., :2, :2] = np.swapaxes(frame.turn, -1, -2)
    jacobian[..., 2, 2] = 1.0
    jacobian[..., :2, 5:] = -turned(place)[..., None] * by_second[..., None, :]
    jacobian[..., 2, 5:] = -by_second
    jacobian[..., 3:5] = -jacobian[..., 5:]
    jacobian[..., :2, 3:5] -= jacobian[..., :2, :2]
    return jacobian


def read_local_poses(view: FilterView, axis: Index) -> tuple[Array, Array]:
    """Mean (G, 3) and covariance (G, 3, 3) of the vehicle in the frames of axes (G, 2).

    axis: places in the map of L1 and L2, which must be among the view's `landmark_index`.
    """
    first, second = view.landmark[axis[:, 0]], view.landmark[axis[:, 1]]
    place = view.layout.first[POINT][np.searchsorted(view.landmark_index, axis)]
    columns = np.empty((len(axis), 7), dtype=np.intp)
    columns[:, :3] = np.arange(3)
    columns[:, 3::2], columns[:, 4::2] = place, place + 1
    joint = view.covariance[columns[:, :, None], columns[:, None, :]]
    j = local_pose_jacobian(view.pose, first, second)
    covariance: Array = j @ joint @ np.swapaxes(j, 1, 2)
    return local_pose(view.pose, first, second), 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
