"""A finished trace as arrays: what a filter linearised where, one row per use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ekf_reference.layout import POINT
from ekf_reference.trace_uses import FusionUse, PositionUse, Removal, SightingUse

Array = NDArray[np.float64]
Index = NDArray[np.intp]


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
