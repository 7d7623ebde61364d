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
        weight: float,
    ) -> None:
        """Sightings fused together (m): innovation = H (x - point) + v, v ~ N(0, noise).

        noise is R / weight; weights of the parts of one observation add up to one.
        """
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
        weight: float,
    ) -> None:
        """New landmarks (m): l = landmark + G_x (x - pose) + G_z v, v ~ N(0, noise)."""
        ...

    def position(
        self,
        number: int,
        pose: Array,
        innovation: Array,
        h_pose: Array,
        noise: Array,
        weight: float,
    ) -> None:
        """A position fix or a part of it: innovation = H (x - pose) + v, v ~ N(0, R / weight)."""
        ...


class NullTrace:
    """Keeps nothing."""

    def prediction(self, *record: Array) -> None:
        """Discard."""

    def update(self, *record: Array | Index | float) -> None:
        """Discard."""

    def augmentation(self, *record: Array | Index | float) -> None:
        """Discard."""

    def position(self, *record: Array | float) -> None:
        """Discard."""


@dataclass(frozen=True)
class SightingRecords:
    """M sightings, in the order in which the filter used them.

    step: (M,) predictions made before. sighting: (M,) number in the order of arrival, from 0, or
    -1 for a surveyed landmark put into the map without one.
    slot: (M,) landmark's place in the map. pose: (M, 3) and landmark: (M, 2), the points of
    linearisation. innovation: (M, 2), zero for augmentations. jacobian_pose: (M, 2, 3), H_v or
    G_x. jacobian_other: (M, 2, 2), H_l or G_z. noise: (M, 2, 2), R / weight. weight: (M,), the
    share of the sighting's information: one, less for parts of an update, zero for a landmark that
    is surveyed or begun with a boundless prior, whose noise is that prior's covariance.
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
    weight: Array

    def rows(self, rows: Index) -> SightingRecords:
        """Some of them."""
        return SightingRecords(*(column[rows] for column in vars(self).values()))


@dataclass(frozen=True)
class PositionRecords:
    """G position fixes, or parts of them.

    step: (G,) predictions made before. number: (G,) in the order of arrival, from 0. pose:
    (G, 3), the point of linearisation. innovation: (G, 2). jacobian_pose: (G, 2, 3). noise:
    (G, 2, 2), R / weight. weight: (G,).
    """

    step: Index
    number: Index
    pose: Array
    innovation: Array
    jacobian_pose: Array
    noise: Array
    weight: Array


@dataclass(frozen=True)
class TraceArrays:
    """A finished trace.

    departed, arrived: (N, 3) poses. f, q: (N, 3, 3). updates, augmentations: sightings.
    positions: absolute fixes.
    """

    departed: Array
    arrived: Array
    f: Array
    q: Array
    updates: SightingRecords
    augmentations: SightingRecords
    positions: PositionRecords


@dataclass
class _Sightings:
    step: list[int] = field(default_factory=list)
    rows: list[tuple[Array | Index, ...]] = field(default_factory=list)

    def add(
        self, step: int, weight: float, sighting: Index, slot: Index, pose: Array, *rest: Array
    ) -> None:
        count = len(slot)
        self.step += [step] * count
        weights = np.full(count, weight)
        self.rows.append((sighting, slot, np.broadcast_to(pose, (count, 3)), *rest, weights))

    def finish(self) -> SightingRecords:
        shapes = ((0,), (0,), (0, 3), (0, 2), (0, 2), (0, 2, 3), (0, 2, 2), (0, 2, 2), (0,))
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
        self._positions: list[tuple[int, int, Array, Array, Array, Array, float]] = []

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
        weight: float,
    ) -> None:
        """Keep one stacked update."""
        where = (len(self._steps), weight, sighting, slot, pose, landmark)
        self._updates.add(*where, innovation, h_pose, h_landmark, noise)

    def augmentation(
        self,
        sighting: Index,
        slot: Index,
        pose: Array,
        landmark: Array,
        g_pose: Array,
        g_sighting: Array,
        noise: Array,
        weight: float,
    ) -> None:
        """Keep one augmentation."""
        nothing = np.zeros((len(slot), 2))
        where = (len(self._steps), weight, sighting, slot, pose, landmark)
        self._augmentations.add(*where, nothing, g_pose, g_sighting, noise)

    def position(
        self,
        number: int,
        pose: Array,
        innovation: Array,
        h_pose: Array,
        noise: Array,
        weight: float,
    ) -> None:
        """Keep one fix or a part of it."""
        record = (len(self._steps), number, pose, innovation, h_pose, noise, weight)
        self._positions.append(record)

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
            self._finish_positions(),
        )

    def _finish_positions(self) -> PositionRecords:
        count = len(self._positions)
        step, number, pose, innovation, h_pose, noise, weight = (
            zip(*self._positions, strict=True) if count else ((),) * 7
        )
        return PositionRecords(
            np.array(step, dtype=np.intp),
            np.array(number, dtype=np.intp),
            np.array(pose).reshape(count, 3),
            np.array(innovation).reshape(count, 2),
            np.array(h_pose).reshape(count, 2, 3),
            np.array(noise).reshape(count, 2, 2),
            np.array(weight, dtype=float),
        )
