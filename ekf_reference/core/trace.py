"""What a filter linearised where: the record that lets another solver replay it exactly.

A trace holds the numbers the filter used, not the ones it should have used; a solver given the
same linear equations must reach the same estimate, or the filter's algebra is wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.landmark_types import POINT, POSE, WIDTHS

VEHICLE = -1
"""The origin of what is measured from the vehicle."""


class PriorRecord(NamedTuple):
    """Where the filter starts. pose: (p,). covariance: (p, p)."""

    pose: Array
    covariance: Array


class StepRecord(NamedTuple):
    """One step: x' = arrived + f (x - departed) + w, w ~ N(0, q).

    departed, arrived: (p,). f, q: (p, p).
    """

    departed: Array
    arrived: Array
    f: Array
    q: Array


class MeasurementRecord(NamedTuple):
    """m measurements fused together, or m landmarks initialised together, from one pose (p,).

    A measurement says innovation = H_v (x - pose) + H_l (l - landmark) + v, an initialisation
    l = landmark + G_x (x - pose) + G_z v, v ~ N(0, noise). jacobian_pose is H_v or G_x,
    jacobian_other H_l or G_z.

    The width w of the landmarks tells what was measured: 2 points, 3 poses, and 0 none, as by an
    absolute position. origin: VEHICLE, or the slot of the pose landmark that another was measured
    from, whose place is then `pose`: two landmarks that were found to be one.

    number: (m,) in the order of arrival of the measurements of this kind, from 0; parts of an
    update share it. -1 for a landmark put into the map without one. slot: (m,). landmark: (m, w).
    innovation: (m, r), zero for initialisations. jacobian_pose: (m, r, p). jacobian_other:
    (m, r, w). noise: (m, r, r), R / weight. spread: (m, r, r), the measurement's own block of
    S = H P H^T + R / weight, and whitened: (m, r), its part of L^-1 innovation, S = L L^T of all
    that were fused together, in their order; both zero for initialisations. weight: the share of
    the measurement's information: one, less for parts of an update, zero for a landmark that is
    surveyed or initialised with a boundless prior, whose noise is that prior's covariance.
    """

    number: Index
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
    origin: int = VEHICLE


class RemovalRecord(NamedTuple):
    """Landmarks of a kind that were marginalised out.

    slot: (m,) and width: which. entries: (w m,) of the state as it was before.
    """

    slot: Index
    width: int
    entries: Index


class Trace:
    """Receives every linearisation of a filter, in order; this one keeps nothing.

    Poses have p entries: three (x, y, heading), or more where a filter's state has more.
    """

    def prior(self, start: PriorRecord) -> None:
        """Record where the filter starts."""

    def step(self, step: StepRecord) -> None:
        """Record one step of the vehicle."""

    def measurement(self, used: MeasurementRecord) -> None:
        """Record measurements that were fused."""

    def initialisation(self, new: MeasurementRecord) -> None:
        """Record new landmarks."""

    def removal(self, gone: RemovalRecord) -> None:
        """Record landmarks that are in the state no longer."""


@dataclass(frozen=True, kw_only=True)
class MeasurementRecords:
    """M measurements of one kind, or parts of them, in the order in which the filter used them.

    step: (M,) steps made before. The rest is as in MeasurementRecord, a row each.
    """

    step: Index
    number: Index
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
    origin: Index

    def rows(self, rows: Index) -> MeasurementRecords:
        """Return some of them."""
        return MeasurementRecords(**{name: column[rows] for name, column in vars(self).items()})


@dataclass(frozen=True)
class RemovalRecords:
    """D landmarks that were marginalised out. step: (D,) steps made before. width, slot: (D,)."""

    step: Index
    width: Index
    slot: Index


@dataclass(frozen=True, kw_only=True)
class TraceArrays:
    """A finished trace.

    prior_pose: (p,). prior_covariance: (p, p). departed, arrived: (N, p) poses. f, q: (N, p, p).
    measurements, initialisations: of landmarks, by their width. positions: absolute ones. merges:
    of pose landmarks from others that they are one with. removals: of all kinds.
    """

    prior_pose: Array
    prior_covariance: Array
    departed: Array
    arrived: Array
    f: Array
    q: Array
    measurements: Mapping[int, MeasurementRecords]
    initialisations: Mapping[int, MeasurementRecords]
    positions: MeasurementRecords
    merges: MeasurementRecords
    removals: RemovalRecords


class RecordedTrace(Trace):
    """Keeps everything, in memory."""

    def __init__(self) -> None:
        """Start empty."""
        self._prior = PriorRecord(np.zeros(3), np.eye(3))
        self._steps: list[StepRecord] = []
        self._measurements: list[tuple[int, MeasurementRecord]] = []
        self._initialisations: list[tuple[int, MeasurementRecord]] = []
        self._removals: list[tuple[int, RemovalRecord]] = []

    def prior(self, start: PriorRecord) -> None:
        """Keep the prior."""
        self._prior = start

    def step(self, step: StepRecord) -> None:
        """Keep one step."""
        self._steps.append(step)

    def measurement(self, used: MeasurementRecord) -> None:
        """Keep measurements, or a part of them."""
        self._measurements.append((len(self._steps), used))

    def initialisation(self, new: MeasurementRecord) -> None:
        """Keep new landmarks."""
        self._initialisations.append((len(self._steps), new))

    def removal(self, gone: RemovalRecord) -> None:
        """Keep which landmarks went."""
        self._removals.append((len(self._steps), gone))

    def arrays(self) -> TraceArrays:
        """Return everything so far, stacked."""
        p, steps = len(self._prior.pose), self._steps
        used = [(one.origin != VEHICLE, one.landmark.shape[1]) for _, one in self._measurements]
        new = [one.landmark.shape[1] for _, one in self._initialisations]

        def chosen(of: list[Any], kinds: list[Any], kind: Any) -> list[Any]:
            return [one for one, its in zip(of, kinds, strict=True) if its == kind]

        seen = {w: chosen(self._measurements, used, (False, w)) for w in (0, *WIDTHS)}
        merges = chosen(self._measurements, used, (True, POSE))
        return TraceArrays(
            prior_pose=self._prior.pose,
            prior_covariance=self._prior.covariance,
            departed=_stacked([one.departed for one in steps], (p,)),
            arrived=_stacked([one.arrived for one in steps], (p,)),
            f=_stacked([one.f for one in steps], (p, p)),
            q=_stacked([one.q for one in steps], (p, p)),
            measurements={w: stack_records(seen[w], p, w) for w in WIDTHS},
            initialisations={
                w: stack_records(chosen(self._initialisations, new, w), p, w) for w in WIDTHS
            },
            positions=stack_records(seen[0], p, 0, POINT),
            merges=stack_records(merges, POSE, POSE),
            removals=removal_records(self._removals),
        )


def stack_records(
    records: Sequence[tuple[int, MeasurementRecord]], p: int, width: int, size: int = 0
) -> MeasurementRecords:
    """Return one row per measurement; what a record says once holds for all of its rows.

    records: with the steps made before each. p: entries of the pose, width: of the landmark, and
    size: of the measurement, those of the landmark unless told.
    """
    each, r = [record for _, record in records], size or width
    rows = {"number": (), "slot": (), "landmark": (width,), "innovation": (r,), "whitened": (r,)}
    rows |= {"jacobian_pose": (r, p), "jacobian_other": (r, width), "noise": (r, r)}
    rows |= {"spread": (r, r)}
    joined = {
        name: np.concatenate((np.zeros((0, *shape)), *(getattr(one, name) for one in each)))
        for name, shape in rows.items()
    }
    once = {"pose": (p,), "weight": (), "origin": ()}
    joined |= {name: _stacked([getattr(one, name) for one in each], once[name]) for name in once}
    count = [len(record.slot) for record in each]
    joined |= {name: np.repeat(joined[name], count, axis=0) for name in once}
    step = np.repeat(np.array([step for step, _ in records], dtype=np.intp), count)
    joined |= {name: joined[name].astype(np.intp) for name in ("number", "slot", "origin")}
    return MeasurementRecords(step=step, **joined)


def removal_records(removals: Sequence[tuple[int, RemovalRecord]]) -> RemovalRecords:
    """Return one row per landmark. removals: with the steps made before each."""
    rows = [(step, gone.width, slot) for step, gone in removals for slot in gone.slot.tolist()]
    return RemovalRecords(*np.array(rows, dtype=np.intp).reshape(-1, 3).T)


def _stacked(values: Sequence[Any], shape: tuple[int, ...]) -> Array:
    """Return equal arrays as one (N, *shape), also none of them."""
    return np.array(values, dtype=float).reshape(len(values), *shape)
