"""Kinds of landmarks, and where poses and landmarks lie in a joint mean or covariance."""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np

from graphslam.arrays import Index


class LandmarkKind(NamedTuple):
    """A kind of landmarks. width: entries of each. key: of the first."""

    name: str
    width: int
    key: int


POINT = LandmarkKind("point", 2, gtsam.symbol("l", 0))
POSE_LANDMARK = LandmarkKind("pose", 3, gtsam.symbol("t", 0))
KINDS = {kind.name: kind for kind in (POINT, POSE_LANDMARK)}
"""A point x, y, and a pose x, y, heading."""
_POSE = 3


class Layout(NamedTuple):
    """The entries of so many poses, then points, then pose landmarks."""

    poses: int
    points: int = 0
    pose_landmarks: int = 0

    @property
    def size(self) -> int:
        """Entries of all."""
        return self._oriented + POSE_LANDMARK.width * self.pose_landmarks

    @property
    def point(self) -> Index:
        """(L,) first entry of each point."""
        return _POSE * self.poses + POINT.width * np.arange(self.points)

    @property
    def frame(self) -> Index:
        """(P + Q,) first entry of each pose and pose landmark."""
        oriented = self._oriented + POSE_LANDMARK.width * np.arange(self.pose_landmarks)
        return np.concatenate((_POSE * np.arange(self.poses), oriented))

    @property
    def _oriented(self) -> int:
        return _POSE * self.poses + POINT.width * self.points
