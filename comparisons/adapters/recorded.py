"""An EKF's trace as the frozen smoothers take it: its relations, and where they were linearised."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.trace import SightingRecords, TraceArrays
from graphslam.graph_builder import POINT, POSE_LANDMARK
from graphslam.linear_problem import LinearProblem
from graphslam.model_system import RelationPoints
from graphslam.recorded_system import (
    RecordedPositions,
    RecordedPrior,
    RecordedRelations,
    RecordedSteps,
    recorded_system,
)

Array = NDArray[np.float64]
Index = NDArray[np.intp]


def recorded(trace: TraceArrays, until: Index) -> LinearProblem:
    """F1: one linear problem from an EKF's own recorded matrices.

    until: (K,) steps made when each pose is reached. Landmarks that were put into the map without
    a sighting come last.
    """
    fixes, fusions = trace.positions, trace.fusions
    return recorded_system(
        RecordedPrior(trace.prior_pose, trace.prior_covariance),
        RecordedSteps(trace.departed, trace.arrived, trace.f, trace.q),
        until,
        {
            width: _measurements(updates, augmentations, until)
            for width, (updates, augmentations) in _by_width(trace).items()
        },
        {
            POSE_LANDMARK: RecordedRelations(
                first=fusions.first,
                second=fusions.second,
                first_point=fusions.first_place,
                second_point=fusions.second_place,
                residual=fusions.innovation,
                jacobian_first=fusions.jacobian_first,
                jacobian_second=fusions.jacobian_second,
                covariance=fusions.noise,
            )
        },
        RecordedPositions(
            np.searchsorted(until, fixes.step),
            fixes.pose,
            fixes.innovation,
            fixes.jacobian_pose,
            fixes.noise,
        ),
    )


def measurement_points(
    trace: TraceArrays, as_headings: Callable[[Array, Index], Array]
) -> dict[int, RelationPoints]:
    """Return where measurements were linearised, by the landmarks' width; rows are the trace's.

    A landmark initialised with a boundless prior is augmented without its measurement's
    information, and is left out. as_headings: recorded poses (M, p) at steps (M,) as x, y, heading.
    """
    points = {}
    for width, (updates, begun) in _by_width(trace).items():
        both = updates, begun.rows(np.flatnonzero(begun.weight > 0.0))
        points[width] = RelationPoints(
            np.concatenate([r.sighting for r in both]),
            np.concatenate([r.weight for r in both]),
            as_headings(
                np.concatenate([r.pose for r in both]), np.concatenate([r.step for r in both])
            ),
            np.concatenate([r.landmark for r in both]),
        )
    return points


def merge_points(trace: TraceArrays) -> dict[int, RelationPoints]:
    """Return where merges were linearised, by the landmarks' width."""
    fusions = trace.fusions
    return {
        POSE_LANDMARK: RelationPoints(
            fusions.number, fusions.weight, fusions.first_place, fusions.second_place
        )
    }


def _by_width(trace: TraceArrays) -> dict[int, tuple[SightingRecords, SightingRecords]]:
    """Updates and augmentations of each kind of landmark."""
    return {
        POINT: (trace.updates, trace.augmentations),
        POSE_LANDMARK: (trace.oriented_updates, trace.oriented_augmentations),
    }


def _measurements(
    updates: SightingRecords, begun: SightingRecords, until: Index
) -> RecordedRelations:
    begun = begun.rows(np.argsort(begun.weight <= 0.0, kind="stable"))
    used, augmented = _from_updates(updates, until), _from_augmentations(begun, until)
    return RecordedRelations(
        **{
            name: np.concatenate((column, vars(augmented)[name]))
            for name, column in vars(used).items()
        }
    )


def _from_updates(r: SightingRecords, until: Index) -> RecordedRelations:
    return RecordedRelations(
        first=np.searchsorted(until, r.step),
        second=r.slot,
        first_point=r.pose,
        second_point=r.landmark,
        residual=r.innovation,
        jacobian_first=r.jacobian_pose,
        jacobian_second=r.jacobian_other,
        covariance=r.noise,
    )


def _from_augmentations(r: SightingRecords, until: Index) -> RecordedRelations:
    """Landmark = point + G_x (x - pose) + G_z v, as a relation with residual zero."""
    return RecordedRelations(
        first=np.searchsorted(until, r.step),
        second=r.slot,
        first_point=r.pose,
        second_point=r.landmark,
        residual=r.innovation,
        jacobian_first=-r.jacobian_pose,
        jacobian_second=np.broadcast_to(np.eye(r.noise.shape[-1]), r.noise.shape),
        covariance=r.jacobian_other @ r.noise @ r.jacobian_other.transpose(0, 2, 1),
    )
