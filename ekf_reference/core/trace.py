"""What a filter linearised where: the record that lets another solver replay it exactly.

A trace holds the numbers the filter used, not the ones it should have used; a solver given the
same linear equations must reach the same estimate, or the filter's algebra is wrong.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, Self, TypeVar

import numpy as np

from ekf_reference.core import machine
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import KINDS, POINT, POSE, LandmarkKind

VEHICLE = -1
"""The origin of what is measured from the vehicle."""


class StepRecord(NamedTuple):
    """One step: x' = arrived + f (x - departed) + w, w ~ N(0, q), poses (p,)."""

    departed: Array
    arrived: Array
    f: Array
    q: Array


class MeasurementRecord(NamedTuple):
    """m measurements fused together, or m landmarks initialised together, from one pose (p,).

    A measurement says innovation = H_v (x - pose) + H_l (l - landmark) + v, an initialisation
    l = landmark + G_x (x - pose) + G_z v, v ~ N(0, noise). jacobian_pose is H_v or G_x,
    jacobian_other H_l or G_z.

    kind: of the landmarks, of width w; None and w = 0 for an absolute position. number: (m,) in the
    order of arrival of the measurements of this kind, from 0; parts of an update share it. -1 for a
    landmark put into the map without one. landmark_index: (m,). landmark: (m, w). jacobian_pose:
    (m, r, p). jacobian_other: (m, r, w). noise: (m, r, r), R / weight. innovation: (m, r).
    whitened: (m, r), its part of L^-1 innovation, S = L L^T of all that were fused together, in
    their order. spread: (m, r, r), its own block of S = H P H^T + R / weight. The last three are
    zero for initialisations. weight: the share of the measurement's information: one, less for
    parts of an update, zero for a landmark that is surveyed or initialised with a boundless prior,
    whose noise is that prior's covariance. origin: VEHICLE, or for a merge of two landmarks that
    are one the first's landmark index; `pose` is then that landmark's place.
    """

    kind: LandmarkKind | None
    number: Index
    landmark_index: Index
    pose: Array
    landmark: Array
    jacobian_pose: Array
    jacobian_other: Array
    noise: Array
    innovation: Array
    whitened: Array
    spread: Array
    weight: float = 1.0
    origin: int = VEHICLE


class RemovalRecord(NamedTuple):
    """Landmarks (m,) of a kind that were marginalised out. entries: (w m,) of the state before."""

    landmark_index: Index
    kind: LandmarkKind
    entries: Index


class Trace:
    """Receives every linearisation of a filter, in order; this one keeps nothing."""

    def prior(self, pose: Array, covariance: Array) -> None:
        """Record where the filter starts.

        Args:
            pose: (p,) x, y and the direction.
            covariance: (p, p), of the additive global error.
        """

    def step(self, step: StepRecord) -> None:
        """Record one step of the vehicle.

        Args:
            step: Departed and arrived pose, F and Q as the filter used them.
        """

    def measurement(self, used: MeasurementRecord) -> None:
        """Record measurements that were fused, or a part of them.

        Args:
            used: All that were fused together, with the numbers that the filter used.
        """

    def initialisation(self, new: MeasurementRecord) -> None:
        """Record new landmarks.

        Args:
            new: All that were initialised together.
        """

    def removal(self, gone: RemovalRecord) -> None:
        """Record landmarks that are in the state no longer.

        Args:
            gone: Which, and the state entries that they had.
        """


@dataclass(frozen=True, kw_only=True)
class MeasurementRecords:
    """M measurements of one kind, or parts of them, in the order in which the filter used them.

    step: (M,) steps made before. order: (M,) place in the order of all that the filter did; what
    was fused together, or initialised together, shares it. The rest is as in MeasurementRecord, a
    row each.
    """

    step: Index
    order: Index
    number: Index
    landmark_index: Index
    pose: Array
    landmark: Array
    jacobian_pose: Array
    jacobian_other: Array
    noise: Array
    innovation: Array
    whitened: Array
    spread: Array
    weight: Array
    origin: Index

    @property
    def entries(self) -> Array:
        """(M, r) one for each entry of a measurement that was used, zero for one that was not.

        A filter that fuses range and bearing one after the other has a row for either: the other
        entry's residual and Jacobians are zero there.
        """
        used = self.jacobian_pose.any(axis=2) | self.jacobian_other.any(axis=2)
        entries: Array = (used | (self.innovation != 0.0)).astype(np.float64)
        return entries

    def rows(self, rows: Index) -> Self:
        """Return some rows.

        Args:
            rows: (k,) of the records.

        Returns:
            These.
        """
        return replace(self, **{name: column[rows] for name, column in vars(self).items()})


@dataclass(frozen=True)
class RemovalRecords:
    """D landmarks marginalised out. step, order: (D,) as in MeasurementRecords. kind: of each.

    landmark_index: (D,).
    """

    step: Index
    order: Index
    kind: tuple[LandmarkKind, ...]
    landmark_index: Index


@dataclass(frozen=True, kw_only=True)
class TraceArrays:
    """A finished trace of N steps, its records stacked.

    measurements, initialisations: of landmarks, by their kind. positions: absolute ones. merges:
    of pose landmarks from others that they are one with. removals: of all kinds.
    """

    prior_pose: Array
    prior_covariance: Array
    departed: Array
    arrived: Array
    f: Array
    q: Array
    measurements: Mapping[LandmarkKind, MeasurementRecords]
    initialisations: Mapping[LandmarkKind, MeasurementRecords]
    positions: MeasurementRecords
    merges: MeasurementRecords
    removals: RemovalRecords


_R = TypeVar("_R", MeasurementRecord, RemovalRecord)


class PlacedRecord(NamedTuple, Generic[_R]):
    """A record, with the steps made before it and its place in the order of all records."""

    step: int
    order: int
    record: _R


_Key = tuple[str, LandmarkKind | None]
"""What was recorded, of which kind of landmarks."""


class RecordedTrace(Trace):
    """Keeps everything, in memory: numbers by the thousand in one array, not each in its own."""

    def __init__(self) -> None:
        """Start empty."""
        self._prior = np.zeros(3), np.eye(3)
        self._made, self._steps = 0, list[StepRecord]()
        self._stacked_steps: list[StepRecord] = []
        self._order = 0
        self._removals: list[PlacedRecord[RemovalRecord]] = []
        self._records: defaultdict[_Key, list[PlacedRecord[MeasurementRecord]]] = defaultdict(list)
        self._stacked: defaultdict[_Key, list[MeasurementRecords]] = defaultdict(list)

    def prior(self, pose: Array, covariance: Array) -> None:
        """Keep the prior."""
        self._prior = pose, covariance

    def step(self, step: StepRecord) -> None:
        """Keep one step."""
        self._made += 1
        self._steps.append(step)
        if len(self._steps) >= machine.STACKED:
            self._stacked_steps.append(stack_steps(self._steps, len(self._prior[0])))
            self._steps = []

    def measurement(self, used: MeasurementRecord) -> None:
        """Keep measurements of landmarks or positions, or a merge."""
        self._keep("measurement" if used.origin == VEHICLE else "merge", used)

    def initialisation(self, new: MeasurementRecord) -> None:
        """Keep new landmarks."""
        self._keep("initialisation", new)

    def removal(self, gone: RemovalRecord) -> None:
        """Keep which landmarks went."""
        self._removals.append(PlacedRecord(self._made, self._next(), gone))

    def arrays(self) -> TraceArrays:
        """Return everything so far, stacked."""
        p = len(self._prior[0])
        departed, arrived, f, q = (
            np.concatenate(parts)
            for parts in zip(*self._stacked_steps, stack_steps(self._steps, p), strict=True)
        )
        return TraceArrays(
            prior_pose=self._prior[0],
            prior_covariance=self._prior[1],
            departed=departed,
            arrived=arrived,
            f=f,
            q=q,
            measurements={kind: self._joined("measurement", kind) for kind in KINDS},
            initialisations={kind: self._joined("initialisation", kind) for kind in KINDS},
            positions=self._joined("measurement", None),
            merges=self._joined("merge", POSE),
            removals=removal_records(self._removals),
        )

    def _keep(self, what: str, record: MeasurementRecord) -> None:
        key = what, record.kind
        self._records[key].append(PlacedRecord(self._made, self._next(), record))
        if len(self._records[key]) >= machine.STACKED:
            self._stacked[key].append(self._stack(*key))
            self._records[key] = []

    def _next(self) -> int:
        """Return the place of the next record."""
        self._order += 1
        return self._order

    def _stack(self, what: str, kind: LandmarkKind | None) -> MeasurementRecords:
        """Return what is not stacked yet."""
        p = POSE.width if what == "merge" else len(self._prior[0])
        return stack_records(self._records[what, kind], p, kind)

    def _joined(self, what: str, kind: LandmarkKind | None) -> MeasurementRecords:
        parts = [vars(part) for part in (*self._stacked[what, kind], self._stack(what, kind))]
        return MeasurementRecords(
            **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        )


def stack_steps(steps: Sequence[StepRecord], p: int) -> StepRecord:
    """Return N steps as one record.

    Args:
        steps: In order.
        p: Entries of a pose.

    Returns:
        Poses (N, p) and matrices (N, p, p).
    """
    shapes = (-1, p), (-1, p), (-1, p, p), (-1, p, p)
    columns = zip(*steps, strict=True) if steps else ((), (), (), ())
    return StepRecord(*(np.array(c).reshape(s) for c, s in zip(columns, shapes, strict=True)))


def stack_records(
    records: Sequence[PlacedRecord[MeasurementRecord]], p: int, kind: LandmarkKind | None
) -> MeasurementRecords:
    """Return one row per measurement; what a record says once holds for all of its rows.

    Args:
        records: Each with its place.
        p: Entries of a pose.
        kind: Of the landmarks; None for absolute positions, which have a point's entries.

    Returns:
        The records as arrays, in order.
    """
    width, r = (kind.width, kind.width) if kind else (0, POINT.width)
    shapes = {"pose": (p,), "landmark": (width,), "jacobian_pose": (r, p), "noise": (r, r)}
    shapes |= {"jacobian_other": (r, width), "innovation": (r,), "whitened": (r,), "weight": ()}
    whole_numbers = "step", "order", "number", "landmark_index", "origin"
    shapes |= {"spread": (r, r), **dict.fromkeys(whole_numbers, ())}
    parts: dict[str, list[Any]] = {name: [np.zeros((0, *shape))] for name, shape in shapes.items()}
    for step, order, record in records:
        values = {"step": step, "order": order, **record._asdict()}
        for name, shape in shapes.items():
            once = np.ndim(values[name]) == len(shape)
            rows = (len(record.landmark_index), *shape)
            parts[name].append(np.full(rows, values[name]) if once else values[name])
    joined = {name: np.concatenate(values) for name, values in parts.items()}
    whole = {name: joined[name].astype(np.intp) for name in whole_numbers}
    return MeasurementRecords(**(joined | whole))


def removal_records(removals: Sequence[PlacedRecord[RemovalRecord]]) -> RemovalRecords:
    """Return one row per landmark that was removed.

    Args:
        removals: Each with its place.

    Returns:
        The removals as arrays, in order.
    """
    rows = [
        (step, order, gone.kind, landmark_index)
        for step, order, gone in removals
        for landmark_index in gone.landmark_index.tolist()
    ]
    step, order, kind, landmark_index = zip(*rows, strict=True) if rows else ((), (), (), ())
    return RemovalRecords(
        np.array(step, np.intp), np.array(order, np.intp), kind, np.array(landmark_index, np.intp)
    )
