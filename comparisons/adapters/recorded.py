"""An EKF's trace as the frozen smoothers take it: its relations, and where they were linearised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.errors import InputError
from ekf_reference.core.trace import MeasurementRecords, TraceArrays
from graphslam.layout import KINDS, POINT, POSE_LANDMARK, LandmarkKind
from graphslam.linear_problem import LinearProblem, LinearRelations
from graphslam.model_system import RelationPoints
from graphslam.recorded_system import (
    RecordedPositions,
    RecordedPrior,
    RecordedRelations,
    RecordedSteps,
    recorded_motion,
    recorded_system,
)

_MOST_UNLIKE = 1e4
"""Sigmas along and across the ray of which a new landmark's covariance keeps half its digits. From
2.5e4 on the filter and the frozen smoother part by more than rounding may, from 1e8 on the
covariance is singular."""


def recorded(trace: TraceArrays, until: Index) -> LinearProblem:
    """F1: one linear problem from an EKF's own recorded matrices.

    until: (K,) steps made when each pose is reached. Landmarks that were put into the map without
    a measurement come last.
    """
    fixes = trace.positions
    return recorded_system(
        RecordedPrior(trace.prior_pose, trace.prior_covariance),
        _steps(trace),
        until,
        {
            KINDS[kind.name]: _joined(
                _measured(used, until),
                _initialised(trace.initialisations[kind], KINDS[kind.name], until),
            )
            for kind, used in trace.measurements.items()
        },
        {POSE_LANDMARK: replace(_measured(trace.merges, until), first=trace.merges.origin)},
        RecordedPositions(
            np.searchsorted(until, fixes.step),
            fixes.pose,
            fixes.innovation,
            fixes.jacobian_pose,
            fixes.noise,
        ),
    )


def recorded_predictions(trace: TraceArrays, until: Index) -> LinearRelations:
    """Return predictions alone, composed between these numbers (K,) of steps."""
    return recorded_motion(_steps(trace), until)


def _steps(trace: TraceArrays) -> RecordedSteps:
    return RecordedSteps(trace.departed, trace.arrived, trace.f, trace.q)


def measurement_points(
    trace: TraceArrays, as_headings: Callable[[Array, Index], Array]
) -> dict[LandmarkKind, RelationPoints]:
    """Return where measurements were linearised, by the landmarks' kind; rows are the trace's.

    A landmark initialised with a boundless prior is augmented without its measurement's
    information, and is left out. as_headings: recorded poses (M, p) at steps (M,) as x, y, heading.
    """
    points = {}
    for kind, used in trace.measurements.items():
        initialised = trace.initialisations[kind]
        both = used, initialised.rows(np.flatnonzero(initialised.weight > 0.0))
        pose, step = (np.concatenate([getattr(r, name) for r in both]) for name in ("pose", "step"))
        points[KINDS[kind.name]] = RelationPoints(
            np.concatenate([r.number for r in both]),
            np.concatenate([r.weight for r in both]),
            as_headings(pose, step),
            np.concatenate([r.landmark for r in both]),
            used_entries(used, len(both[1].step)),
        )
    return points


def used_entries(used: MeasurementRecords, more: int = 0) -> Array | None:
    """Return which entries of measurements (M, r) were used, before more that are whole.

    None where all were.
    """
    entries = used.entries
    if entries.all():
        return None
    return np.vstack((entries, np.ones((more, entries.shape[1]))))


def merge_points(trace: TraceArrays) -> dict[LandmarkKind, RelationPoints]:
    """Return where merges were linearised, by the landmarks' kind."""
    merges = trace.merges
    points = RelationPoints(merges.number, merges.weight, merges.pose, merges.landmark)
    return {POSE_LANDMARK: points}


def _joined(first: RecordedRelations, second: RecordedRelations) -> RecordedRelations:
    return RecordedRelations(
        **{
            name: np.concatenate((column, vars(second)[name]))
            for name, column in vars(first).items()
        }
    )


def _measured(r: MeasurementRecords, until: Index) -> RecordedRelations:
    return RecordedRelations(
        first=np.searchsorted(until, r.step),
        second=r.landmark_index,
        first_point=r.pose,
        second_point=r.landmark,
        residual=r.innovation,
        jacobian_first=r.jacobian_pose,
        jacobian_second=r.jacobian_other,
        covariance=r.noise,
    )


def _initialised(r: MeasurementRecords, kind: LandmarkKind, until: Index) -> RecordedRelations:
    """Landmark = point + G_x (x - pose) + G_z v, as a relation with residual zero.

    Raises InputError for a measurement whose sigmas the filter's covariance cannot hold together.
    """
    r = r.rows(np.argsort(r.weight <= 0.0, kind="stable"))
    covariance = r.jacobian_other @ r.noise @ r.jacobian_other.transpose(0, 2, 1)
    measured = r.weight > 0.0
    if kind == POINT:
        _check_spread(r.landmark_index[measured], covariance[measured])
    return replace(
        _measured(r, until),
        jacobian_first=-r.jacobian_pose,
        jacobian_second=np.broadcast_to(np.eye(r.noise.shape[-1]), r.noise.shape),
        covariance=covariance,
    )


def _check_spread(landmark_index: Index, covariance: Array) -> None:
    """Raise InputError where a point was initialised with sigmas of too large a ratio."""
    squared = np.linalg.eigvalsh(covariance)
    bad = np.flatnonzero(~(squared[:, 1] <= _MOST_UNLIKE**2 * squared[:, 0]))
    if len(bad):
        least, largest = np.sqrt(np.maximum(squared[bad[0]], 0.0))
        raise InputError(
            f"measurements: landmark {landmark_index[bad[0]]} of the map was initialised with "
            "sigmas of "
            f"{least:.3g} m and {largest:.3g} m, expected a ratio of at most {_MOST_UNLIKE:g}, "
            "since an EKF's covariance loses the smaller: raise one of sigma_range_m and "
            "sigma_bearing_rad, or lower the other"
        )
