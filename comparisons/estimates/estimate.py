"""What an estimator says: a trajectory, a map, and how sure it is of both."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """The result of one estimator on one log.

    time_s: (K,). pose: (K, 3), headings unwrapped. pose_covariance: (K, 3, 3), each pose alone.
    landmark_id: (L,). landmark: (L, 2). pose_landmark_id: (Q,) and pose_landmarks: (Q, 3) x, y,
    heading of pose landmarks, such as scan landmarks. joint_covariance: (n, n) of the last
    pose, the landmarks and then these. All covariances are of the additive global error.
    information: `filtered` (pose k knows the log up to k), `smoothed` (every pose has seen the
    future) or `fixed-lag` (pose k has seen the next few). Only the last
    pose and the map of the two may be compared directly.
    """

    time_s: Array
    pose: Array
    pose_covariance: Array
    landmark_id: NDArray[np.int64]
    landmark: Array
    joint_covariance: Array
    information: Literal["filtered", "smoothed", "fixed-lag"]
    provenance: dict[str, str] = field(default_factory=dict)
    pose_landmark_id: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    pose_landmarks: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def __repr__(self) -> str:
        """Return counts in one line."""
        count = len(self.landmark) + len(self.pose_landmarks)
        return f"<Estimate: {len(self.time_s):,} {self.information} poses, {count:,} landmarks>"

    @property
    def joint_mean(self) -> Array:
        """(n,) the last pose and all landmarks, n = 3 + 2 L + 3 Q."""
        return np.concatenate((self.pose[-1], self.landmark.ravel(), self.pose_landmarks.ravel()))

    def pose_landmark_covariances(self) -> Array:
        """(Q, 3, 3) of each pose landmark alone."""
        first = len(self.joint_covariance) - 3 * len(self.pose_landmarks)
        which = np.arange(len(self.pose_landmarks))
        own = self.joint_covariance[first:, first:].reshape(len(which), 3, len(which), 3)
        blocks: Array = own[which, :, which, :]
        return blocks

    def landmark_covariances(self) -> Array:
        """(L, 2, 2) of each landmark alone."""
        points = 3 + 2 * len(self.landmark)
        return landmark_blocks(self.joint_covariance[:points, :points])


def landmark_blocks(joint: Array) -> Array:
    """(L, 2, 2) of each landmark alone, of a covariance (3 + 2 L, 3 + 2 L) behind a pose's."""
    count = (len(joint) - 3) // 2
    which = np.arange(count)
    blocks: Array = joint[3:, 3:].reshape(count, 2, count, 2)[which, :, which, :]
    return blocks
