"""An EKF's trace as the frozen smoothers take it: its relations, and where they were linearised."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.landmark_types import POINT, POSE
from ekf_reference.core.trace import MeasurementRecords, TraceArrays
from graphslam.frozen import (
    RecordedPositions,
    RecordedPrior,
    RecordedSightings,
    RecordedSteps,
    RecordedTwins,
    recorded_problem,
)
from graphslam.frozen_own import FrozenPairs
from graphslam.linear_problem import LinearProblem

Array = NDArray[np.float64]
Index = NDArray[np.intp]


def recorded(trace: TraceArrays, until: Index) -> LinearProblem:
    """F1: one linear problem from an EKF's own recorded matrices.

    until: (K,) steps made when each pose is reached. Landmarks that were put into the map without
    a sighting come last.
    """
    fixes, merges = trace.positions, trace.merges
    return recorded_problem(
        RecordedPrior(trace.prior_pose, trace.prior_covariance),
        RecordedSteps(trace.departed, trace.arrived, trace.f, trace.q),
        until,
        _sightings(trace.measurements[POINT], trace.initialisations[POINT], until),
        RecordedPositions(
            np.searchsorted(until, fixes.step),
            fixes.pose,
            fixes.innovation,
            fixes.jacobian_pose,
            fixes.noise,
        ),
        _sightings(trace.measurements[POSE], trace.initialisations[POSE], until),
        RecordedTwins(
            first=merges.origin,
            second=merges.slot,
            first_place=merges.pose,
            second_place=merges.landmark,
            residual=merges.innovation,
            jacobian_first=merges.jacobian_pose,
            jacobian_second=merges.jacobian_other,
            covariance=merges.noise,
        ),
    )


def oriented_points(
    trace: TraceArrays, as_headings: Callable[[Array, Index], Array]
) -> tuple[FrozenPairs, FrozenPairs]:
    """Where oriented landmarks were sighted from and fused, for a problem that has all of it.

    as_headings: recorded poses (M, p) at steps (M,) as x, y, heading.
    """
    uses, merges = (trace.measurements[POSE], trace.initialisations[POSE]), trace.merges
    return (
        FrozenPairs(
            np.concatenate([r.number for r in uses]),
            np.concatenate([r.weight for r in uses]),
            np.concatenate([as_headings(r.pose, r.step) for r in uses]),
            np.concatenate([r.landmark for r in uses]),
        ),
        FrozenPairs(merges.number, merges.weight, merges.pose, merges.landmark),
    )


def _sightings(
    updates: MeasurementRecords, begun: MeasurementRecords, until: Index
) -> RecordedSightings:
    begun = begun.rows(np.argsort(begun.weight <= 0.0, kind="stable"))
    used, augmented = _from_updates(updates, until), _from_augmentations(begun, until)
    return RecordedSightings(
        **{
            name: np.concatenate((column, vars(augmented)[name]))
            for name, column in vars(used).items()
        }
    )


def _from_updates(r: MeasurementRecords, until: Index) -> RecordedSightings:
    return RecordedSightings(
        node=np.searchsorted(until, r.step),
        slot=r.slot,
        pose=r.pose,
        landmark=r.landmark,
        residual=r.innovation,
        jacobian_pose=r.jacobian_pose,
        jacobian_landmark=r.jacobian_other,
        covariance=r.noise,
    )


def _from_augmentations(r: MeasurementRecords, until: Index) -> RecordedSightings:
    """Landmark = point + G_x (x - pose) + G_z v, as a relation with residual zero."""
    return RecordedSightings(
        node=np.searchsorted(until, r.step),
        slot=r.slot,
        pose=r.pose,
        landmark=r.landmark,
        residual=r.innovation,
        jacobian_pose=-r.jacobian_pose,
        jacobian_landmark=np.broadcast_to(np.eye(r.noise.shape[-1]), r.noise.shape),
        covariance=r.jacobian_other @ r.noise @ r.jacobian_other.transpose(0, 2, 1),
    )
