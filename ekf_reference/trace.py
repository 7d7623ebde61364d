"""What a filter linearised where: the record that lets another solver replay it exactly.

A trace holds the numbers the filter used, not the ones it should have used; a solver given the
same linear equations must reach the same estimate, or the filter's algebra is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class Beginning(NamedTuple):
    """The prior. pose: (p,). covariance: (p, p)."""

    pose: Array
    covariance: Array


class Prediction(NamedTuple):
    """One step: x' = arrived + f (x - departed) + w, w ~ N(0, q).

    departed, arrived: (p,). f, q: (p, p).
    """

    departed: Array
    arrived: Array
    f: Array
    q: Array


class SightingUse(NamedTuple):
    """m sightings fused together, or m landmarks begun together, at one pose (p,).

    An update says innovation = H_v (x - pose) + H_l (l - landmark) + v, an augmentation
    l = landmark + G_x (x - pose) + G_z v, v ~ N(0, noise). jacobian_pose is H_v or G_x,
    jacobian_other H_l or G_z. The other shapes and `weight` are as in SightingRecords.
    """

    sighting: Index
    slot: Index
    pose: Array
    landmark: Array
    innovation: Array
    jacobian_pose: Array
    jacobian_other: Array
    noise: Array
    spread: Array
    whitened: Array
    weight: float = 1.0


class PositionUse(NamedTuple):
    """A position fix or a part of it: innovation = H (x - pose) + v, v ~ N(0, noise).

    Shapes are as in PositionRecords, of one.
    """

    number: int
    pose: Array
    innovation: Array
    jacobian_pose: Array
    noise: Array
    spread: Array
    weight: float


class Trace(Protocol):
    """Receives every linearisation of a filter, in order.

    Poses have p entries: three (x, y, heading), or more where a filter's state has more.
    """

    def prior(self, start: Beginning) -> None:
        """Where the filter starts."""
        ...

    def prediction(self, step: Prediction) -> None:
        """One step of the vehicle."""
        ...

    def update(self, use: SightingUse) -> None:
        """Sightings of mapped landmarks."""
        ...

    def augmentation(self, use: SightingUse) -> None:
        """New landmarks."""
        ...

    def position(self, use: PositionUse) -> None:
        """An absolute position."""
        ...


class NullTrace:
    """Keeps nothing."""

    def prior(self, start: Beginning) -> None:
        """Discard."""

    def prediction(self, step: Prediction) -> None:
        """Discard."""

    def update(self, use: SightingUse) -> None:
        """Discard."""

    def augmentation(self, use: SightingUse) -> None:
        """Discard."""

    def position(self, use: PositionUse) -> None:
        """Discard."""


@dataclass(frozen=True)
class SightingRecords:
    """M sightings, in the order in which the filter used them.

    step: (M,) predictions made before. sighting: (M,) number in the order of arrival, from 0, or
    -1 for a surveyed landmark put into the map without one.
    slot: (M,) landmark's place in the map. pose: (M, p) and landmark: (M, 2), the points of
    linearisation. innovation: (M, 2), zero for augmentations. jacobian_pose: (M, 2, p), H_v or
    G_x. jacobian_other: (M, 2, 2), H_l or G_z. noise: (M, 2, 2), R / weight. spread: (M, 2, 2),
    the sighting's own block of S = H P H^T + R / weight, and whitened: (M, 2), its part of
    L^-1 innovation, S = L L^T of all that were fused together, in their order; both zero for
    augmentations. weight: (M,), the share of the sighting's information: one, less for parts of
    an update, zero for a landmark that is surveyed or begun with a boundless prior, whose noise
    is that prior's covariance.
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
    spread: Array
    whitened: Array
    weight: Array

    def rows(self, rows: Index) -> SightingRecords:
        """Some of them."""
        return SightingRecords(*(column[rows] for column in vars(self).values()))


@dataclass(frozen=True)
class PositionRecords:
    """G position fixes, or parts of them.

    step: (G,) predictions made before. number: (G,) in the order of arrival, from 0. pose:
    (G, p), the point of linearisation. innovation: (G, 2). jacobian_pose: (G, 2, p). noise:
    (G, 2, 2), R / weight. spread: (G, 2, 2), S = H P H^T + R / weight. weight: (G,).
    """

    step: Index
    number: Index
    pose: Array
    innovation: Array
    jacobian_pose: Array
    noise: Array
    spread: Array
    weight: Array


@dataclass(frozen=True)
class TraceArrays:
    """A finished trace.

    prior_pose: (p,). prior_covariance: (p, p). departed, arrived: (N, p) poses. f, q: (N, p, p).
    updates, augmentations: sightings. positions: absolute fixes.
    """

    prior_pose: Array
    prior_covariance: Array
    departed: Array
    arrived: Array
    f: Array
    q: Array
    updates: SightingRecords
    augmentations: SightingRecords
    positions: PositionRecords


class RecordedTrace:
    """Keeps everything, in memory."""

    def __init__(self) -> None:
        """Start empty."""
        self._prior = Beginning(np.zeros(3), np.eye(3))
        self._steps: list[Prediction] = []
        self._updates: list[tuple[int, SightingUse]] = []
        self._augmentations: list[tuple[int, SightingUse]] = []
        self._positions: list[tuple[int, PositionUse]] = []

    def prior(self, start: Beginning) -> None:
        """Keep the prior."""
        self._prior = start

    def prediction(self, step: Prediction) -> None:
        """Keep one step."""
        self._steps.append(step)

    def update(self, use: SightingUse) -> None:
        """Keep one stacked update."""
        self._updates.append((len(self._steps), use))

    def augmentation(self, use: SightingUse) -> None:
        """Keep one augmentation."""
        self._augmentations.append((len(self._steps), use))

    def position(self, use: PositionUse) -> None:
        """Keep one fix or a part of it."""
        self._positions.append((len(self._steps), use))

    def arrays(self) -> TraceArrays:
        """Everything so far, stacked."""
        p = len(self._prior.pose)
        departed, arrived, f, q = _stacked(self._steps, ((p,), (p,), (p, p), (p, p)))
        return TraceArrays(
            self._prior.pose,
            self._prior.covariance,
            departed,
            arrived,
            f,
            q,
            _sighting_records(self._updates, p),
            _sighting_records(self._augmentations, p),
            self._position_records(p),
        )

    def _position_records(self, p: int) -> PositionRecords:
        step = np.array([step for step, _ in self._positions], dtype=np.intp)
        uses = [use for _, use in self._positions]
        number, *columns = _stacked(uses, ((), (p,), (2,), (2, p), (2, 2), (2, 2), ()))
        return PositionRecords(step, number.astype(np.intp), *columns)


def _sighting_records(uses: list[tuple[int, SightingUse]], p: int) -> SightingRecords:
    """One row per sighting; what a use says once holds for all of its rows."""
    each = [use for _, use in uses]
    count = [len(use.slot) for use in each]

    def repeated(values: Sequence[Any], shape: tuple[int, ...]) -> Array:
        once = np.array(values, dtype=float).reshape(len(each), *shape)
        return np.repeat(once, count, axis=0)

    def joined(parts: Sequence[Any], shape: tuple[int, ...]) -> Array:
        return np.concatenate((np.zeros((0, *shape)), *parts))

    return SightingRecords(
        repeated([step for step, _ in uses], ()).astype(np.intp),
        joined([use.sighting for use in each], ()).astype(np.intp),
        joined([use.slot for use in each], ()).astype(np.intp),
        repeated([use.pose for use in each], (p,)),
        joined([use.landmark for use in each], (2,)),
        joined([use.innovation for use in each], (2,)),
        joined([use.jacobian_pose for use in each], (2, p)),
        joined([use.jacobian_other for use in each], (2, 2)),
        joined([use.noise for use in each], (2, 2)),
        joined([use.spread for use in each], (2, 2)),
        joined([use.whitened for use in each], (2,)),
        repeated([use.weight for use in each], ()),
    )


def _stacked(rows: Sequence[tuple[Any, ...]], shapes: tuple[tuple[int, ...], ...]) -> list[Array]:
    """Columns of equal tuples as arrays (N, *shape), also of none."""
    columns = zip(*rows, strict=True) if rows else ((),) * len(shapes)
    return [
        np.array(column, dtype=float).reshape(len(rows), *shape)
        for column, shape in zip(columns, shapes, strict=True)
    ]
