"""A filter's records of range and bearing beside the smoother's factors, in the sensor's units."""

from __future__ import annotations

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.checks.diagnosis.model_differences import (
    INITIALISATIONS,
    UPDATES,
    SensorPairs,
    SensorRecords,
)
from comparisons.logs.log import Log
from ekf_reference.core.landmark_types import POINT as POINTS
from ekf_reference.core.trace import MeasurementRecords, TraceArrays
from graphslam.layout import POINT
from graphslam.linear_problem import LinearProblem, LinearRelations


def sensor_pairs(log: Log, run: EkfRun, model: LinearProblem) -> SensorPairs:
    """Return what was recorded, and what F2 has, of updates and of new landmarks.

    None of a filter of other states, or of points in the vehicle's axes. model: F2, linearised
    where the filter was.
    """
    if run.own_axes or run.trace.prior_pose.shape != (3,):
        return {}
    relations, (used, new) = model.measurements[POINT], _used_and_new(run.trace)
    rows = np.arange(len(relations.b))
    meant = {
        UPDATES: _meant(log, used, relations, rows[: len(used.step)]),
        INITIALISATIONS: _of_new(_meant(log, new, relations, rows[len(used.step) :])),
    }
    return {kind: (said, meant[kind]) for kind, said in recorded_sensors(run.trace).items()}


def recorded_sensors(trace: TraceArrays) -> dict[str, SensorRecords]:
    """Return what a trace has of updates and of new landmarks, as it stands there."""
    used, new = _used_and_new(trace)
    return {UPDATES: _recorded(used), INITIALISATIONS: _recorded(new)}


def _used_and_new(trace: TraceArrays) -> tuple[MeasurementRecords, MeasurementRecords]:
    """Records of points, without what brings a landmark in that is not measured by then."""
    new = trace.initialisations[POINTS]
    return trace.measurements[POINTS], new.rows(np.flatnonzero(new.weight > 0.0))


def _recorded(records: MeasurementRecords) -> SensorRecords:
    return SensorRecords(
        residual=records.innovation,
        jacobian_pose=records.jacobian_pose,
        jacobian_other=records.jacobian_other,
        noise=records.noise,
    )


def _meant(
    log: Log, records: MeasurementRecords, relations: LinearRelations, rows: Index
) -> SensorRecords:
    """F2's rows of bearing and range, with noise of one, as range and bearing with the log's."""
    measurements = log.measurements
    sigma = np.column_stack((measurements.sigma_range_m, measurements.sigma_bearing_rad))[
        records.number
    ]
    sigma = sigma / np.sqrt(records.weight)[:, None]
    a, c, b = (part[rows][:, ::-1] for part in (relations.a, relations.c, relations.b))
    return SensorRecords(
        residual=b * sigma,
        jacobian_pose=a * sigma[:, :, None],
        jacobian_other=c * sigma[:, :, None],
        noise=sigma[:, :, None] * sigma[:, None, :] * np.eye(2),
    )


def _of_new(records: SensorRecords) -> SensorRecords:
    """The same measurements, solved for the landmark that they place."""
    by_z: Array = np.linalg.inv(records.jacobian_other).astype(np.float64, copy=False)
    return SensorRecords(
        residual=(by_z @ records.residual[..., None])[..., 0],
        jacobian_pose=-by_z @ records.jacobian_pose,
        jacobian_other=by_z,
        noise=records.noise,
    )
