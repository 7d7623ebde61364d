"""A right estimate of a log at the times of another that is compared with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index
from comparisons.shown import Brief
from ekf_reference.core.layout import Layout


@dataclass(frozen=True, kw_only=True, repr=False)
class Reference(Brief):
    """Another estimate of the log, at the external estimate's own times.

    name: as in "equal to NAME". time_s: (K,). known: (K,) whether it speaks of the pose at that
    time. pose: (K, 3). pose_covariance: (K, 3, 3). landmark_id: (L,). landmark: (L, 2).
    joint_covariance: (3 + 2 L, 3 + 2 L) of the pose at joint_s and these. span_s: begin and end of
    what the log observes. smoothed: its poses have seen the future. labels: names by id,
    where landmarks have any.
    """

    name: str
    time_s: Array
    known: NDArray[np.bool_]
    pose: Array
    pose_covariance: Array
    landmark_id: NDArray[np.int64]
    landmark: Array
    joint_covariance: Array
    joint_s: float
    span_s: tuple[float, float]
    smoothed: bool = False
    labels: Mapping[int, str] = field(default_factory=dict)

    def landmark_name(self, row: int) -> str:
        """Return what a landmark is called: its label, else its id."""
        number = int(self.landmark_id[row])
        return self.labels.get(number, str(number))

    def at(self, time_s: Array) -> Reference:
        """Return it with those of its poses alone that are of some times (N,)."""
        rows = np.isin(self.time_s, time_s)
        return replace(
            self,
            time_s=self.time_s[rows],
            known=self.known[rows],
            pose=self.pose[rows],
            pose_covariance=self.pose_covariance[rows],
        )

    def landmark_covariances(self, landmarks: Index) -> Array:
        """Return (m, 2, 2) of some landmarks (m,)."""
        own = Layout.packed(3, len(self.landmark)).blocks(self.joint_covariance)
        return own[landmarks]
