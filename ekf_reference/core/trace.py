"""What a filter linearised where: the record that lets another solver replay it exactly.

A trace holds the numbers the filter used, not the ones it should have used; a solver given the
same linear equations must reach the same estimate, or the filter's algebra is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.layout import POINT, POSE


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


class FusionUse(NamedTuple):
    """Two landmarks with a direction that are one, or a part of that relation.

    innovation = H_1 (l_1 - first_place) + H_2 (l_2 - second_place) + v, v ~ N(0, noise), says
    where the second is in the frame of the first. Shapes are as in FusionRecords, of one.
    """

    number: int
    first: int
    second: int
    first_place: Array
    second_place: Array
    innovation: Array
    jacobian_first: Array
    jacobian_second: Array
    noise: Array
    weight: float


class Removal(NamedTuple):
    """Landmarks of a kind that were marginalised out.

    slot: (m,) and width: which, 2 for points and 3 for those with a direction. entries: (w m,) of
    the state as it was before.
    """

    slot: Index
    width: int
    entries: Index


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

    def oriented_update(self, use: SightingUse) -> None:
        """Sightings of mapped landmarks with a direction."""
        ...

    def oriented_augmentation(self, use: SightingUse) -> None:
        """New landmarks with a direction."""
        ...

    def fusion(self, use: FusionUse) -> None:
        """Two landmarks with a direction that are one."""
        ...

    def removal(self, gone: Removal) -> None:
        """Landmarks that are in the state no longer."""
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

    def oriented_update(self, use: SightingUse) -> None:
        """Discard."""

    def oriented_augmentation(self, use: SightingUse) -> None:
        """Discard."""

    def fusion(self, use: FusionUse) -> None:
        """Discard."""

    def removal(self, gone: Removal) -> None:
        """Discard."""


@dataclass(frozen=True, kw_only=True)
class SightingRecords:
    """M sightings of one kind of landmarks, in the order in which the filter used them.

    step: (M,) predictions made before. sighting: (M,) number in the order of arrival, from 0, or
    -1 for a surveyed landmark put into the map without one.
    slot: (M,) landmark's place in the map. pose: (M, p) and landmark: (M, w), the points of
    linearisation, w being 2 for points and 3 for landmarks with a direction. innovation: (M, w),
    zero for augmentations. jacobian_pose: (M, w, p), H_v or G_x. jacobian_other: (M, w, w), H_l
    or G_z. noise: (M, w, w), R / weight. spread: (M, w, w), the sighting's own block of
    S = H P H^T + R / weight, and whitened: (M, w), its part of L^-1 innovation, S = L L^T of all
    that were fused together, in their order; both zero for augmentations. weight: (M,), the share
    of the sighting's information: one, less for parts of an update, zero for a landmark that is
    surveyed or begun with a boundless prior, whose noise is that prior's covariance.
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
        return SightingRecords(**{name: column[rows] for name, column in vars(self).items()})


@dataclass(frozen=True, kw_only=True)
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


@dataclass(frozen=True, kw_only=True)
class FusionRecords:
    """T relations between two landmarks with a direction, or parts of them.

    step: (T,) predictions made before. number: (T,) in their order, from 0; parts share it.
    first, second: (T,) slots. first_place, second_place: (T, 3), the points of linearisation.
    innovation: (T, 3). jacobian_first, jacobian_second: (T, 3, 3). noise: (T, 3, 3), R / weight.
    weight: (T,).
    """

    step: Index
    number: Index
    first: Index
    second: Index
    first_place: Array
    second_place: Array
    innovation: Array
    jacobian_first: Array
    jacobian_second: Array
    noise: Array
    weight: Array


@dataclass(frozen=True)
class RemovalRecords:
    """D landmarks that were marginalised out.

    step: (D,) predictions made before. width: (D,) 2 for points, 3 for landmarks with a direction.
    slot: (D,).
    """

    step: Index
    width: Index
    slot: Index


@dataclass(frozen=True, kw_only=True)
class TraceArrays:
    """A finished trace.

    prior_pose: (p,). prior_covariance: (p, p). departed, arrived: (N, p) poses. f, q: (N, p, p).
    updates, augmentations: sightings of points. positions: absolute fixes. oriented_updates,
    oriented_augmentations: sightings of landmarks with a direction. fusions: of these, two that
    are one. removals: of either kind.
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
    oriented_updates: SightingRecords
    oriented_augmentations: SightingRecords
    fusions: FusionRecords
    removals: RemovalRecords


class RecordedTrace:
    """Keeps everything, in memory."""

    def __init__(self) -> None:
        """Start empty."""
        self._prior = Beginning(np.zeros(3), np.eye(3))
        self._steps: list[Prediction] = []
        self._updates: list[tuple[int, SightingUse]] = []
        self._augmentations: list[tuple[int, SightingUse]] = []
        self._positions: list[tuple[int, PositionUse]] = []
        self._oriented_updates: list[tuple[int, SightingUse]] = []
        self._oriented_augmentations: list[tuple[int, SightingUse]] = []
        self._fusions: list[tuple[int, FusionUse]] = []
        self._removals: list[tuple[int, Removal]] = []

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

    def oriented_update(self, use: SightingUse) -> None:
        """Keep one stacked update."""
        self._oriented_updates.append((len(self._steps), use))

    def oriented_augmentation(self, use: SightingUse) -> None:
        """Keep one augmentation."""
        self._oriented_augmentations.append((len(self._steps), use))

    def fusion(self, use: FusionUse) -> None:
        """Keep one fusion or a part of it."""
        self._fusions.append((len(self._steps), use))

    def removal(self, gone: Removal) -> None:
        """Keep which landmarks went."""
        self._removals.append((len(self._steps), gone))

    def arrays(self) -> TraceArrays:
        """Everything so far, stacked."""
        p = len(self._prior.pose)
        departed, arrived, f, q = stacked(self._steps, ((p,), (p,), (p, p), (p, p)))
        return TraceArrays(
            prior_pose=self._prior.pose,
            prior_covariance=self._prior.covariance,
            departed=departed,
            arrived=arrived,
            f=f,
            q=q,
            updates=sighting_records(self._updates, p),
            augmentations=sighting_records(self._augmentations, p),
            positions=position_records(self._positions, p),
            oriented_updates=sighting_records(self._oriented_updates, p, POSE),
            oriented_augmentations=sighting_records(self._oriented_augmentations, p, POSE),
            fusions=fusion_records(self._fusions),
            removals=removal_records(self._removals),
        )


def sighting_records(
    uses: list[tuple[int, SightingUse]], p: int, width: int = POINT
) -> SightingRecords:
    """One row per sighting; what a use says once holds for all of its rows."""
    each = [use for _, use in uses]
    count = [len(use.slot) for use in each]

    def repeated(values: Sequence[Any], shape: tuple[int, ...]) -> Array:
        once = np.array(values, dtype=float).reshape(len(each), *shape)
        return np.repeat(once, count, axis=0)

    def joined(parts: Sequence[Any], shape: tuple[int, ...]) -> Array:
        return np.concatenate((np.zeros((0, *shape)), *parts))

    return SightingRecords(
        step=repeated([step for step, _ in uses], ()).astype(np.intp),
        sighting=joined([use.sighting for use in each], ()).astype(np.intp),
        slot=joined([use.slot for use in each], ()).astype(np.intp),
        pose=repeated([use.pose for use in each], (p,)),
        landmark=joined([use.landmark for use in each], (width,)),
        innovation=joined([use.innovation for use in each], (width,)),
        jacobian_pose=joined([use.jacobian_pose for use in each], (width, p)),
        jacobian_other=joined([use.jacobian_other for use in each], (width, width)),
        noise=joined([use.noise for use in each], (width, width)),
        spread=joined([use.spread for use in each], (width, width)),
        whitened=joined([use.whitened for use in each], (width,)),
        weight=repeated([use.weight for use in each], ()),
    )


def position_records(uses: list[tuple[int, PositionUse]], p: int) -> PositionRecords:
    """One row per fix or part of it."""
    step = np.array([step for step, _ in uses], dtype=np.intp)
    shapes = ((), (p,), (2,), (2, p), (2, 2), (2, 2), ())
    number, pose, innovation, jacobian_pose, noise, spread, weight = stacked(
        [use for _, use in uses], shapes
    )
    return PositionRecords(
        step=step,
        number=number.astype(np.intp),
        pose=pose,
        innovation=innovation,
        jacobian_pose=jacobian_pose,
        noise=noise,
        spread=spread,
        weight=weight,
    )


def fusion_records(uses: list[tuple[int, FusionUse]]) -> FusionRecords:
    """One row per fusion or part of it."""
    step = np.array([step for step, _ in uses], dtype=np.intp)
    square = (3, 3)
    shapes = ((), (), (), (3,), (3,), (3,), square, square, square, ())
    number, first, second, *columns = stacked([use for _, use in uses], shapes)
    first_place, second_place, innovation, by_first, by_second, noise, weight = columns
    return FusionRecords(
        step=step,
        number=number.astype(np.intp),
        first=first.astype(np.intp),
        second=second.astype(np.intp),
        first_place=first_place,
        second_place=second_place,
        innovation=innovation,
        jacobian_first=by_first,
        jacobian_second=by_second,
        noise=noise,
        weight=weight,
    )


def removal_records(removals: list[tuple[int, Removal]]) -> RemovalRecords:
    """One row per landmark."""
    rows = [(step, gone.width, slot) for step, gone in removals for slot in gone.slot.tolist()]
    return RemovalRecords(*np.array(rows, dtype=np.intp).reshape(-1, 3).T)


def stacked(rows: Sequence[tuple[Any, ...]], shapes: tuple[tuple[int, ...], ...]) -> list[Array]:
    """Columns of equal tuples as arrays (N, *shape), also of none."""
    columns = zip(*rows, strict=True) if rows else ((),) * len(shapes)
    return [
        np.array(column, dtype=float).reshape(len(rows), *shape)
        for column, shape in zip(columns, shapes, strict=True)
    ]
