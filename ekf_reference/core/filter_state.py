"""What the filter's steps ask of a state."""

from __future__ import annotations

from typing import Protocol

from ekf_reference.association.nearest_neighbour import MappedState
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.layout import POINT, Layout
from ekf_reference.core.local_map import LocalMap, MapSnapshot
from ekf_reference.core.state import Correction


class FilterState(MappedState, Protocol):
    """Contract of all states; KalmanState is one."""

    @property
    def layout(self) -> Layout:
        """Where pose and landmarks lie."""
        ...

    @property
    def mean(self) -> Array:
        """(n,) pose, then landmarks."""
        ...

    @property
    def covariance(self) -> Array:
        """(n, n)."""
        ...

    @property
    def pose(self) -> Array:
        """(p,) x, y and the direction."""
        ...

    @property
    def pose_covariance(self) -> Array:
        """(p, p)."""
        ...

    @property
    def landmarks(self) -> Array:
        """(L, 2) points, NaN where one was removed."""
        ...

    @property
    def oriented(self) -> Array:
        """(Q, 3) landmarks with a direction, NaN where one was removed."""
        ...

    def map_of(self, slot: Index, width: int = POINT) -> LocalMap:
        """Some landmarks of a kind by slot."""
        ...

    def within(self, reach_m: float, width: int = POINT) -> Index:
        """Index of the landmarks of a kind at most `reach_m` from the vehicle."""
        ...

    def snapshot(self, kinds: tuple[int, ...] = (POINT,)) -> MapSnapshot:
        """Pose and places of all landmarks of some kinds, without moving anything."""
        ...

    def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        """Move the vehicle."""
        ...

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Fuse one stacked observation."""
        ...

    def augment(
        self, point: Array, jacobian_pose: Array, jacobian_sighting: Array, noise: Array
    ) -> None:
        """Append landmarks of the kind that `point` (m, w) tells by its width."""
        ...

    def remove(self, slot: Index, width: int = POINT) -> None:
        """Marginalise landmarks of a kind out."""
        ...
