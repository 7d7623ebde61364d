"""Measurements of pose landmarks, made while the filter runs: fused, and kept.

Unlike a log's measurements they depend on the filter, as what a scan is matched with does. Whoever
makes them hands them to the filter through a recorder, from which the smoother reads the same.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from comparisons.arrays import Array, Index
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import POSE
from ekf_reference.core.state import LocalMap
from graphslam.graph_builder import right_perturbation
from graphslam.problem import Merges, PoseLandmarkMeasurements

if TYPE_CHECKING:
    from ekf_reference.core.measurements import DynamicGuard


class PoseLandmarkRecorder:
    """The measurements of pose landmarks that a filter used, in their order."""

    def __init__(self) -> None:
        """Start empty."""
        self._seen: list[tuple[int, int, Array, Array]] = []
        self._merges: list[tuple[int, int, int, Array, Array]] = []

    def observe(
        self, ekf: Ekf, epoch: int, z: Array, covariance: Array, landmark_index: Index
    ) -> Index:
        """Fuse measurements (m, 3) with covariances (m, 3, 3); see Ekf.observe_known."""
        found = ekf.observe_known(z, covariance, landmark_index, POSE)
        self._seen += [
            (epoch, int(s), at, r) for s, at, r in zip(found, z, covariance, strict=True)
        ]
        return found

    def fuse(
        self, ekf: Ekf, epoch: int, first: int, second: int, z: Array, covariance: Array
    ) -> LocalMap:
        """Fuse two that are one; see merge_landmarks."""
        from ekf_reference.scan_landmarks.merging import merge_landmarks

        known = merge_landmarks(ekf, first, second, z, covariance)
        self._merges.append((epoch, first, second, z, covariance))
        return known

    def reported(self) -> PoseLandmarkMeasurements:
        """All of it, as the smoother takes it."""
        return PoseLandmarkMeasurements(
            np.array([epoch for epoch, *_ in self._seen], dtype=np.intp),
            np.array([landmark_index for _, landmark_index, *_ in self._seen], dtype=np.intp),
            *_measured([row[-2:] for row in self._seen]),
            Merges(
                np.array([epoch for epoch, *_ in self._merges], dtype=np.intp),
                np.array([first for _, first, *_ in self._merges], dtype=np.intp),
                np.array([second for _, _, second, *_ in self._merges], dtype=np.intp),
                *_measured([row[-2:] for row in self._merges]),
            ),
        )


class PoseLandmarkSource(Protocol):
    """Someone who sees pose landmarks, such as a matcher of scans."""

    def look(self, ekf: Ekf, epoch: int, time_s: float, recorder: PoseLandmarkRecorder) -> None:
        """What is seen at an epoch, all else that was seen there being fused."""
        ...


@runtime_checkable
class GuardedSource(Protocol):
    """An PoseLandmarkSource that can leave out what moves."""

    def keep_from(self, guard: DynamicGuard) -> None:
        """What lies where something moves is left out from now on."""
        ...


class NoPoseLandmarkSource:
    """Sees none."""

    def look(self, ekf: Ekf, epoch: int, time_s: float, recorder: PoseLandmarkRecorder) -> None:
        """Nothing."""


def _measured(rows: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """x, y, heading (n, 3), and covariances (n, 3, 3) as of the right perturbation."""
    z = np.array([at for at, _ in rows], dtype=float).reshape(-1, 3)
    r = np.array([spread for _, spread in rows], dtype=float).reshape(-1, 3, 3)
    return z, right_perturbation(z, r)
