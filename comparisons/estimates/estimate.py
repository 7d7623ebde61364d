"""What an estimator says: a trajectory, a map, and how sure it is of both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.shown import Shown, render
from ekf_reference.core.landmark_types import POINT, POSE
from ekf_reference.core.layout import Layout

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True)
class Estimate(Shown):
    """Hold what one estimator found on one log: a trajectory, a map, and how certain it is of both.

    All covariances are of the additive global error (x, y, heading). Only the last pose and the map
    of a filtered and a smoothed estimate may be compared directly.

    Attributes:
        time_s: (K,) of the poses.
        pose: (K, 3) x, y [m], heading [rad], unwrapped.
        pose_covariance: (K, 3, 3) of each pose alone.
        landmark_id: (L,) of point landmarks.
        landmark: (L, 2) x, y [m].
        joint_covariance: (n, n) of the last pose, the point landmarks and then the pose landmarks;
            n = 3 + 2 L + 3 Q.
        information: `filtered` (pose k knows the log up to k), `smoothed` (every pose knows the
            whole log) or `fixed-lag` (pose k knows a little of what follows).
        provenance: Free text by key.
        pose_landmark_id: (Q,) of pose landmarks, such as scan landmarks.
        pose_landmarks: (Q, 3) x, y [m], heading [rad].
        labels: Names of point landmarks by id, where they have any but the id.
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
    labels: Mapping[int, str] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """(L,) of point landmarks: their labels, else their ids."""
        return [self.labels.get(i, str(i)) for i in self.landmark_id.tolist()]

    def __repr__(self) -> str:
        """Return counts in one line."""
        count = len(self.landmark) + len(self.pose_landmarks)
        return f"<Estimate: {len(self.time_s):,} {self.information} poses, {count:,} landmarks>"

    def to_pandas(self, table: Literal["poses", "landmarks"] = "poses") -> DataFrame:
        """Return a table as a pandas data frame.

        Args:
            table: `poses`: time_s, x_m, y_m, heading_rad (unwrapped) and their standard deviations;
                `landmarks`: id, x_m, y_m, their standard deviations and covariance, and heading_rad
                for landmarks that have one. All in the log's frame.

        Returns:
            One row for each pose or landmark.

        Raises:
            InputError: pandas is not installed, or there is no such table.
        """
        return render("frame", self, table)

    @property
    def joint_mean(self) -> Array:
        """(n,) the last pose and all landmarks, n = 3 + 2 L + 3 Q."""
        return np.concatenate((self.pose[-1], self.landmark.ravel(), self.pose_landmarks.ravel()))

    @property
    def layout(self) -> Layout:
        """Where the last pose and all landmarks lie in `joint_mean` and `joint_covariance`."""
        return Layout.packed(3, len(self.landmark), len(self.pose_landmarks))

    def pose_landmark_covariances(self) -> Array:
        """Return the covariance of each pose landmark alone.

        Returns:
            (Q, 3, 3) of x, y, heading [m, m, rad], additive global error.
        """
        return self.layout.blocks(self.joint_covariance, POSE)

    def landmark_covariances(self) -> Array:
        """Return the covariance of each point landmark alone.

        Returns:
            (L, 2, 2) [m^2], additive global error; the diagonal blocks of `joint_covariance`, none
            where that is of the pose alone.
        """
        points = 3 + POINT.width * len(self.landmark)
        return landmark_blocks(self.joint_covariance[:points, :points])


def landmark_blocks(joint: Array) -> Array:
    """(L, 2, 2) of each landmark alone, of a covariance (3 + 2 L, 3 + 2 L) behind a pose's."""
    return Layout.packed(3, (len(joint) - 3) // POINT.width).blocks(joint)
