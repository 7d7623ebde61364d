"""Which part of a filter's model differs from the smoother's: the recorded relations, one by one.

A relation may be multiplied by anything invertible without saying something else, so both sides
are solved for what they place: a measurement for its landmark, a step for the pose it arrives at.
What is compared is then the place, its Jacobian and its covariance, at the same linearisation
points. Differences are relative to the smoother's figures: Jacobians to the largest entry of their
columns, places to their sigma, covariances as generalised eigenvalues.

A place mixes what was recorded: a wrong Jacobian by the landmark stands in its covariance, too.
Where a relation differs, and one of its records is that of the log's sensor, they are in its units,
and are compared as they were recorded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.covariances import relative_difference, whitened_range
from ekf_reference.filters.misono import along_circle
from graphslam.layout import POINT, POSE_LANDMARK
from graphslam.linear_problem import (
    LinearPositions,
    LinearPrior,
    LinearProblem,
    LinearRelations,
    divided,
)

_PLACES = ("position", "heading")
_EXACT: Mapping[tuple[str, str], float] = {}
PREDICTIONS, UPDATES, POSITIONS = "predictions", "measurement updates", "position updates"
INITIALISATIONS = "landmark initialisations"


class Events(NamedTuple):
    """When relations of one kind were used (N,) [s], and their numbers in the log (N,), if any."""

    time_s: Array
    number: NDArray[np.int64] | None = None


_UNTIMED: Mapping[str, Events] = {}


@dataclass(frozen=True, kw_only=True)
class SensorRecords:
    """N records of a sensor in its own units, of range and bearing.

    Of updates residual = jacobian_pose (x - pose) + jacobian_other (y - landmark) + v, of new
    landmarks y = landmark + residual + jacobian_pose (x - pose) + jacobian_other v. residual:
    (N, 2). jacobian_pose: (N, 2, 3). jacobian_other: (N, 2, 2). noise: (N, 2, 2) of v.
    """

    residual: Array
    jacobian_pose: Array
    jacobian_other: Array
    noise: Array


SensorPairs = Mapping[str, tuple[SensorRecords, SensorRecords]]
"""Of each kind of relations what was recorded, and what the smoother's factors have there."""
_NOT_OF_A_SENSOR: SensorPairs = {}
_Differences = list[tuple[str, str, Array, NDArray[np.bool_]]]
"""Quantity, unit, difference (N,), and whether the filter has zeros there (N,)."""


@dataclass(frozen=True, kw_only=True)
class ModelDifference:
    """One quantity of one kind of relation.

    count: of relations in which it differs, of `total`. largest: difference, in `unit`. absent: it
    is zero in the filter wherever it differs. first_s: when it first differs; number: of the
    measurement or position with which it does.
    """

    relation: str
    quantity: str
    count: int
    total: int
    largest: float
    unit: str
    absent: bool = False
    first_s: float | None = None
    number: int | None = None

    @property
    def group(self) -> tuple[str, bool]:
        """The kind of relation, and whether it is of a Jacobian: the rest may follow from one."""
        return self.relation, "Jacobian" in self.quantity

    @property
    def weight(self) -> float:
        """Its size beside others: of a covariance at most the root, as its sigma differs."""
        of_covariance = self.quantity.endswith("covariance")
        return min(self.largest, np.sqrt(self.largest)) if of_covariance else self.largest

    def __str__(self) -> str:
        """For people to read."""
        how = "is missing" if self.absent else f"differs by up to {self.largest:.2g} {self.unit}"
        return f"{self.quantity} {how} in {self.count} of {self.total} {self.relation}"


@dataclass(frozen=True)
class _Places:
    """What N relations of one kind place: (N, d), by a pose (N, d, 3), covariance (N, d, d)."""

    place: Array
    jacobian: Array
    covariance: Array

    def rows(self, first: int, end: int | None = None) -> _Places:
        """Return some of them."""
        part = slice(first, end)
        return _Places(self.place[part], self.jacobian[part], self.covariance[part])


def model_differences(
    recorded: LinearProblem,
    problem: LinearProblem,
    tolerance: float,
    initialised: int = 0,
    stored: Mapping[tuple[str, str], float] = _EXACT,
    events: Mapping[str, Events] = _UNTIMED,
    sensors: SensorPairs = _NOT_OF_A_SENSOR,
) -> tuple[ModelDifference, ...]:
    """What differs by more than the tolerance, the largest first; what is missing before that.

    stored: by relation and quantity, what storing the records explains besides.

    initialised: so many measurements, the last ones, initialise a landmark; they are a kind of
    their own. events, sensors: of each kind of relations, where known.
    """
    steps = _of_relations(recorded.motion), _of_relations(problem.motion)
    measurements = {}
    for kind, relations in problem.measurements.items():
        said, meant = _completed(_first(recorded.measurements[kind], len(relations.b)), relations)
        measurements[kind] = _of_relations(said), _of_relations(meant)
    fixes, own_fixes = _with_all_entries(recorded.positions, problem.positions)
    positions = _of_positions(fixes), _of_positions(own_fixes)
    merges = {
        kind: (_of_relations(recorded.merges[kind]), _of_relations(merged))
        for kind, merged in problem.merges.items()
    }
    of_points, own_points = measurements[POINT]
    uses = len(own_points.place) - initialised
    kinds = (
        (PREDICTIONS, "the predicted pose", *steps),
        (UPDATES, "the innovation", of_points.rows(0, uses), own_points.rows(0, uses)),
        (INITIALISATIONS, "the innovation", of_points.rows(uses), own_points.rows(uses)),
        (POSITIONS, "the innovation", *positions),
        ("measurements of scan landmarks", "the innovation", *measurements[POSE_LANDMARK]),
        ("merges of scan landmarks", "the innovation", *merges[POSE_LANDMARK]),
    )
    found = _priors(recorded.prior, problem.prior, tolerance)
    for relation, place, have, want in kinds:
        differences = _compare(place, have, want)
        if relation in sensors:
            differences = _as_recorded(relation, differences, *sensors[relation], tolerance, stored)
        for quantity, unit, difference, absent in differences:
            off = ~(difference <= tolerance + stored.get((relation, quantity), 0.0))
            if not off.any():
                continue
            first_s, number = _first_event(off, events.get(relation))
            found.append(
                ModelDifference(
                    relation=relation,
                    quantity=quantity,
                    count=int(np.count_nonzero(off)),
                    total=len(off),
                    largest=float(difference.max()),
                    unit=unit,
                    absent=bool(absent[off].all()),
                    first_s=first_s,
                    number=number,
                )
            )
    return tuple(sorted(found, key=lambda d: (not d.absent, -float(f"{d.weight:.6g}"))))


def _first_event(off: NDArray[np.bool_], events: Events | None) -> tuple[float | None, int | None]:
    """When the earliest of relations (N,) is, and its number in the log."""
    if events is None:
        return None, None
    rows = np.flatnonzero(off)
    order = events.time_s[rows] if events.number is None else events.number[rows]
    first = rows[np.argmin(order)]
    number = None if events.number is None else int(events.number[first])
    return float(events.time_s[first]), number


def _priors(said: LinearPrior, meant: LinearPrior, tolerance: float) -> list[ModelDifference]:
    """Of priors of x, y and heading."""
    if len(said.point) != 3:
        return []
    apart = float(np.abs(meant.a @ (said.point - meant.point)).max())
    within = meant.a @ _noisy(_inverse(said.a), said.sigma)
    spread = float(relative_difference(*whitened_range((within @ within.T)[None]))[0])
    return [
        ModelDifference(
            relation="priors", quantity=quantity, count=1, total=1, largest=size, unit=unit
        )
        for quantity, size, unit in (
            ("the pose", apart, "sigma"),
            ("the covariance", spread, "(relative)"),
        )
        if not size <= tolerance
    ]


def _as_recorded(
    kind: str,
    by_place: _Differences,
    said: SensorRecords,
    meant: SensorRecords,
    tolerance: float,
    stored: Mapping[tuple[str, str], float],
) -> _Differences:
    """Return the differences of records where relations differ; those by place in other units."""
    if not by_place:
        return by_place

    def off(differences: _Differences) -> Array:
        limits = [tolerance + stored.get((kind, difference[0]), 0.0) for difference in differences]
        each = zip(differences, limits, strict=True)
        return np.array([~(difference <= limit) for (_, _, difference, _), limit in each])

    relations, records = off(by_place).any(axis=0), sensor_differences(kind, said, meant)
    deviating = off(records)[:, relations]
    if deviating.all(axis=0).any() or not deviating.any(axis=0).all():
        return by_place
    return [
        (quantity, unit, np.where(relations, difference, 0.0), absent)
        for quantity, unit, difference, absent in records
    ]


def sensor_differences(kind: str, said: SensorRecords, meant: SensorRecords) -> _Differences:
    """Return how records of a kind of relations differ from those of the smoother's factors."""
    new = kind == INITIALISATIONS
    other = "the Jacobian with respect to the " + ("measurement" if new else "landmark")
    units = _sigma(meant)
    found: _Differences = []
    for name, have, want in (
        ("the Jacobian with respect to position", *_columns(said, meant, slice(0, 2))),
        ("the Jacobian with respect to heading", *_columns(said, meant, slice(2, 3))),
        (other, said.jacobian_other, meant.jacobian_other),
    ):
        by_row, size = np.abs(have - want), np.abs(want)
        if new:  # of G_z a column is of range or bearing, of H a row
            unit = size.max(axis=1, keepdims=True)
        else:
            unit = size.max(axis=2, keepdims=True)
            whole = (size / units[:, :, None]).max(axis=(1, 2), keepdims=True)
            unit = np.where(unit > 0.0, unit, whole * units[:, :, None])
        relative = (by_row / np.where(unit > 0.0, unit, 1.0)).max(axis=(1, 2))
        found.append((name, "(relative)", relative, np.logical_not(have.any(axis=(1, 2)))))
    nothing = np.zeros(len(units), dtype=bool)
    apart = said.residual - meant.residual
    if new:
        root = meant.jacobian_other * units[:, None, :]
        (apart,) = divided(root, apart)
    else:
        apart = apart / units
    found.append(("the innovation", "sigma", np.abs(apart).max(axis=1), nothing))
    spread = _relative(_root(meant.noise), said.noise)
    found.append(("the noise covariance", "(relative)", spread, nothing))
    return found


def _columns(said: SensorRecords, meant: SensorRecords, part: slice) -> tuple[Array, Array]:
    """Columns of the Jacobians by the pose."""
    return said.jacobian_pose[:, :, part], meant.jacobian_pose[:, :, part]


def _sigma(records: SensorRecords) -> Array:
    """(N, 2) standard deviations of the entries."""
    sigma: Array = np.sqrt(np.diagonal(records.noise, 0, 1, 2))
    return sigma


def _compare(place: str, said: _Places, meant: _Places) -> _Differences:
    """What two kinds of places differ in."""
    if not len(said.place):
        return []
    results: _Differences = []
    for name, columns in zip(_PLACES, (slice(0, 2), slice(2, 3)), strict=True):
        have, want = said.jacobian[:, :, columns], meant.jacobian[:, :, columns]
        size = np.abs(want).max(axis=(1, 2))
        difference = np.abs(have - want).max(axis=(1, 2)) / np.where(size > 0.0, size, 1.0)
        absent = np.logical_not(have.any(axis=(1, 2)))
        results.append((f"the Jacobian with respect to {name}", "(relative)", difference, absent))
    nothing = np.zeros(len(said.place), dtype=bool)
    root = _root(meant.covariance)
    (apart,) = divided(root, said.place - meant.place)
    results.append((place, "sigma", np.abs(apart).max(axis=1), nothing))
    spread = _relative(root, said.covariance)
    results.append(("the noise covariance", "(relative)", spread, nothing))
    return results


def _relative(root: Array, covariance: Array) -> Array:
    """(N,) largest relative difference of covariances (N, d, d) from A A^T, A (N, d, d)."""
    (half,) = divided(root, covariance)
    (within,) = divided(root, half.transpose(0, 2, 1))
    return relative_difference(*whitened_range(within))


def _root(covariance: Array) -> Array:
    """(N, d, d) A with A A^T = P, which may be singular by rounding, as at points far away."""
    try:
        root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    except np.linalg.LinAlgError:
        values, axes = np.linalg.eigh(covariance)
        least = np.finfo(float).eps * values[:, -1:]
        root = axes * np.sqrt(np.maximum(values, least))[:, None, :]
    return root


def _of_relations(r: LinearRelations) -> _Places:
    """State y = second_point + c^-1 (b - a (x - first_point) - noise), poses as x, y, heading."""
    inverse = _inverse(r.c)
    if r.second_point.shape[1] == 4:
        inverse = np.array([along_circle(pose).T for pose in r.second_point]) @ inverse
    jacobian = -inverse @ _by_heading(r.a, r.first_point)
    place = (inverse @ r.b[..., None])[..., 0]
    root = _noisy(inverse, r.sigma)
    return _Places(place, jacobian, root @ root.transpose(0, 2, 1))


def _completed(
    said: LinearRelations, meant: LinearRelations
) -> tuple[LinearRelations, LinearRelations]:
    """Return relations where those of one entry of a measurement have another, the same in both.

    It says, to a unit noise, where across the entry's own direction the landmark lies.
    """
    unused = ~(meant.a.any(axis=2) | meant.c.any(axis=2))
    if not unused.any():
        return said, meant
    rows, entries = np.nonzero(unused)
    across = meant.c[rows, 1 - entries, ::-1] * (1.0, -1.0)
    across /= np.linalg.norm(across, axis=1)[:, None]

    def whole(r: LinearRelations) -> LinearRelations:
        c = r.c.copy()
        c[rows, entries] = across
        return replace(r, c=c)

    return whole(said), whole(meant)


def _with_all_entries(
    said: LinearPositions, meant: LinearPositions
) -> tuple[LinearPositions, LinearPositions]:
    """Return positions where those of one entry alone have the other, the same in both."""
    unused = ~meant.a.any(axis=2)
    if not unused.any():
        return said, meant
    rows, entries = np.nonzero(unused)

    def whole(p: LinearPositions) -> LinearPositions:
        a = p.a.copy()
        a[rows, entries, entries] = 1.0
        return replace(p, a=a)

    return whole(said), whole(meant)


def _noisy(inverse: Array, sigma: Array | None) -> Array:
    """Return (..., d, d) columns of the noise's root, those without noise as zeros."""
    return inverse if sigma is None else inverse * sigma[..., None, :]


def _by_heading(a: Array, pose: Array) -> Array:
    """Columns by x, y, heading of a Jacobian (N, d, p) at poses (N, p)."""
    if pose.shape[1] == 3:
        return a
    lift = np.array([along_circle(own) for own in pose]).reshape(len(pose), 4, 3)
    turned: Array = a @ lift
    return turned


def _of_positions(p: LinearPositions) -> _Places:
    """(x, y) = pose + a_xy^-1 (b - a_heading (heading - pose's) - noise)."""
    a = _by_heading(p.a, p.pose)
    inverse = _inverse(a[:, :, :2])
    jacobian = -inverse @ a
    place = (inverse @ p.b[..., None])[..., 0]
    return _Places(place, jacobian, inverse @ inverse.transpose(0, 2, 1))


def _inverse(a: Array) -> Array:
    """Of matrices (N, d, d); the pseudo-inverse where a filter's row is empty."""
    try:
        return np.linalg.inv(a).astype(np.float64, copy=False)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(a).astype(np.float64, copy=False)


def _first(r: LinearRelations, count: int) -> LinearRelations:
    """Only what comes from a measurement: behind that are priors of landmarks."""
    columns = {name: column[:count] for name, column in vars(r).items() if column is not None}
    return replace(r, **columns)
