"""What a filter linearised where: the record that lets another solver replay it exactly.

A trace holds the numbers the filter used, not the ones it should have used; a solver given the
same linear equations must reach the same estimate, or the filter's algebra is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class Trace(Protocol):
    """Receives every linearisation of a filter. See RecordedTrace for the shapes."""

    def prediction(self, departed: Array, arrived: Array, f: Array, q: Array) -> None:
        """One step: x' = arrived + F (x - departed) + w, w ~ N(0, Q)."""
        ...

    def update(
        self,
        sighting: Index,
        slot: Index,
        pose: Array,
        landmark: Array,
        innovation: Array,
        h_pose: Array,
        h_landmark: Array,
        noise: Array,
    ) -> None:
        """Sightings fused together (m): innovation = H (x - point) + v, v ~ N(0, R)."""
        ...

    def augmentation(
        self,
        sighting: Index,
        slot: Index,
        pose: Array,
        landmark: Array,
        g_pose: Array,
        g_sighting: Array,
        noise: Array,
    ) -> None:
        """New landmarks (m): l = landmark + G_x (x - pose) + G_z v, v ~ N(0, R)."""
        ...


class NullTrace:
    """Keeps nothing."""

    def prediction(self, *record: Array) -> None:
        """Discard."""

    def update(self, *record: Array | Index) -> None:
        """Discard."""

    def augmentation(self, *record: Array | Index) -> None:
        """Discard."""


@dataclass(frozen=True)
class SightingRecords:
    """M sightings, in the order in which the filter used them.

    step: (M,) predictions made before. sighting: (M,) number in the order of arrival, from 0.
    slot: (M,) landmark's place in the map. pose: (M, 3) and landmark: (M, 2), the points of
    linearisation. innovation: (M, 2), zero for augmentations. jacobian_pose: (M, 2, 3), H_v or
    G_x. jacobian_other: (M, 2, 2), H_l or G_z. noise: (M, 2, 2), R.
    """

    step: Index
    sighting: Index
    slot: Index
    pose: Array
    landmark: Array
    innovation: Array
    jacobian_pose: Array
    jacobian_other: Array
    noise: Array


@dataclass(frozen=True)
class TraceArrays:
    """A finished trace.

    departed, arrived: (N, 3) poses. f, q: (N, 3, 3). updates, augmentations: sightings.
    """

    departed: Array
    arrived: Array
    f: Array
    q: Array
    updates: SightingRecords
    augmentations: SightingRecords


@dataclass
class _Sightings:
    step: list[int] = field(default_factory=list)
    rows: list[tuple[Array | Index, ...]] = field(default_factory=list)

    def add(self, step: int, sighting: Index, slot: Index, pose: Array, *rest: Array) -> None:
        count = len(slot)
        self.step += [step] * count
        self.rows.append((sighting, slot, np.broadcast_to(pose, (count, 3)), *rest))

    def finish(self) -> SightingRecords:
        shapes = ((0,), (0,), (0, 3), (0, 2), (0, 2), (0, 2, 3), (0, 2, 2), (0, 2, 2))
        columns = [np.concatenate(c) for c in zip(*self.rows, strict=True)] or [
            np.zeros(shape, dtype=np.intp if i < 2 else float) for i, shape in enumerate(shapes)
        ]
        return SightingRecords(np.array(self.step, dtype=np.intp), *columns)


class RecordedTrace:
    """Keeps everything, in memory."""

    def __init__(self) -> None:
        """Start empty."""
        self._steps: list[tuple[Array, Array, Array, Array]] = []
        self._updates = _Sightings()
        self._augmentations = _Sightings()

    def prediction(self, departed: Array, arrived: Array, f: Array, q: Array) -> None:
        """Keep one step."""
        self._steps.append((departed, arrived, f, q))

    def update(
        self,
        sighting: Index,
        slot: Index,
        pose: Array,
        landmark: Array,
        innovation: Array,
        h_pose: Array,
        h_landmark: Array,
        noise: Array,
    ) -> None:
        """Keep one stacked update."""
        self._updates.add(
            len(self._steps), sighting, slot, pose, landmark, innovation, h_pose, h_landmark, noise
        )

    def augmentation(
        self,
        sighting: Index,
        slot: Index,
        pose: Array,
        landmark: Array,
        g_pose: Array,
        g_sighting: Array,
        noise: Array,
    ) -> None:
        """Keep one augmentation."""
        nothing = np.zeros((len(slot), 2))
        self._augmentations.add(
            len(self._steps), sighting, slot, pose, landmark, nothing, g_pose, g_sighting, noise
        )

    def arrays(self) -> TraceArrays:
        """Everything so far, stacked."""
        n = len(self._steps)
        columns = [np.array(c) for c in zip(*self._steps, strict=True)] or [np.zeros(0)] * 4
        departed, arrived, f, q = columns
        return TraceArrays(
            departed.reshape(n, 3),
            arrived.reshape(n, 3),
            f.reshape(n, 3, 3),
            q.reshape(n, 3, 3),
            self._updates.finish(),
            self._augmentations.finish(),
        )
