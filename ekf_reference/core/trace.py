"""What a filter linearised where: the record that lets another solver replay it exactly.

A trace holds the numbers the filter used, not the ones it should have used; a solver given the
same linear equations must reach the same estimate, or the filter's algebra is wrong.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

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

    step: (M,) steps made before. The rest is as in MeasurementRecord, a row each.
    """

    step: Index
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
    """D landmarks marginalised out. step: (D,) steps made before. kind, landmark_index: (D,)."""

    step: Index
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


Kept = list[tuple[int, MeasurementRecord]]
"""Records, with the steps made before each."""
_Key = tuple[str, LandmarkKind | None]
"""What was recorded, of which kind of landmarks."""


class RecordedTrace(Trace):
    """Keeps everything, in memory: numbers by the thousand in one array, not each in its own."""

    def __init__(self) -> None:
        """Start empty."""
        self._prior = np.zeros(3), np.eye(3)
        self._made, self._steps = 0, list[StepRecord]()
        self._stacked_steps: list[StepRecord] = []
        self._removals: list[tuple[int, RemovalRecord]] = []
        self._records: defaultdict[_Key, Kept] = defaultdict(list)
        self._stacked: defaultdict[_Key, list[MeasurementRecords]] = defaultdict(list)

    def prior(self, pose: Array, covariance: Array) -> None:
        """Keep the prior."""
        self._prior = pose, covariance

    def step(self, step: StepRecord) -> None:
        """Keep one step."""
        self._made += 1
        self._steps.append(step)
        if len(self._steps) >= machine.STACKED:
            self._stacked_steps.append(self._stack_steps())
            self._steps = []

    def measurement(self, used: MeasurementRecord) -> None:
        """Keep measurements of landmarks or positions, or a merge."""
        self._keep("measurement" if used.origin == VEHICLE else "merge", used)

    def initialisation(self, new: MeasurementRecord) -> None:
        """Keep new landmarks."""
        self._keep("initialisation", new)

    def removal(self, gone: RemovalRecord) -> None:
        """Keep which landmarks went."""
        self._removals.append((self._made, gone))

    def arrays(self) -> TraceArrays:
        """Return everything so far, stacked."""
        departed, arrived, f, q = (
            np.concatenate(parts)
            for parts in zip(*self._stacked_steps, self._stack_steps(), strict=True)
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
        self._records[key].append((self._made, record))
        if len(self._records[key]) >= machine.STACKED:
            self._stacked[key].append(self._stack(*key))
            self._records[key] = []

    def _stack(self, what: str, kind: LandmarkKind | None) -> MeasurementRecords:
        """Return what is not stacked yet."""
        p = POSE.width if what == "merge" else len(self._prior[0])
        return stack_records(self._records[what, kind], p, kind)

    def _stack_steps(self) -> StepRecord:
        """Return the steps that are not stacked yet: (N, p) poses, (N, p, p) matrices."""
        p = len(self._prior[0])
        shapes = (-1, p), (-1, p), (-1, p, p), (-1, p, p)
        columns = zip(*self._steps, strict=True) if self._steps else ((), (), (), ())
        return StepRecord(*(np.array(c).reshape(s) for c, s in zip(columns, shapes, strict=True)))

    def _joined(self, what: str, kind: LandmarkKind | None) -> MeasurementRecords:
        parts = [vars(part) for part in (*self._stacked[what, kind], self._stack(what, kind))]
        return MeasurementRecords(
            **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        )


def stack_records(records: Kept, p: int, kind: LandmarkKind | None) -> MeasurementRecords:
    """Return one row per measurement; what a record says once holds for all of its rows.

    Args:
        records: Each with the steps made before it.
        p: Entries of a pose.
        kind: Of the landmarks; None for absolute positions, which have a point's entries.

    Returns:
        The records as arrays, in order.
    """
    width, r = (kind.width, kind.width) if kind else (0, POINT.width)
    shapes = {"pose": (p,), "landmark": (width,), "jacobian_pose": (r, p), "noise": (r, r)}
    shapes |= {"jacobian_other": (r, width), "innovation": (r,), "whitened": (r,), "weight": ()}
    shapes |= {"spread": (r, r), "step": (), "number": (), "landmark_index": (), "origin": ()}
    found: dict[str, list[Any]] = {name: [np.zeros((0, *shape))] for name, shape in shapes.items()}
    for step, one in records:
        values = {"step": step, **one._asdict()}
        for name, shape in shapes.items():
            once = np.ndim(values[name]) == len(shape)
            found[name].append(
                np.full((len(one.landmark_index), *shape), values[name]) if once else values[name]
            )
    joined = {name: np.concatenate(values) for name, values in found.items()}
    whole = {
        name: joined[name].astype(np.intp)
        for name in ("step", "number", "landmark_index", "origin")
    }
    return MeasurementRecords(**(joined | whole))


def removal_records(removals: Sequence[tuple[int, RemovalRecord]]) -> RemovalRecords:
    """Return one row per landmark that was removed.

    Args:
        removals: Each with the steps made before it.

    Returns:
        The removals as arrays, in order.
    """
    rows = [
        (step, gone.kind, landmark_index)
        for step, gone in removals
        for landmark_index in gone.landmark_index.tolist()
    ]
    step, kind, landmark_index = zip(*rows, strict=True) if rows else ((), (), ())
    return RemovalRecords(np.array(step, dtype=np.intp), kind, np.array(landmark_index, np.intp))
