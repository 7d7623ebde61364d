"""Records a planar filter's trace anew, with other numbers."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from comparisons.estimates.planar_trace import read_trace
from comparisons.trace.recorder import Recorder
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.trace import MeasurementRecords
from tests.helpers import Array

Columns = dict[str, Array]
"""By part and name: `step_f`, `update_noise`, `initialise_weight`, `position_number` and so on."""
_STEPS = ("departed", "arrived", "f", "q")
_RECORDS = {
    "number": "measurement", "landmark_index": "landmark", "landmark": "point", "step": "step",
    "weight": "weight", "pose": "pose", "innovation": "innovation", "noise": "noise",
    "jacobian_pose": "jacobian_pose", "jacobian_other": "jacobian_other",
}  # fmt: skip
"""What columns call the fields of records."""


def edit_trace(path: Path, edit: Callable[[Columns], object]) -> None:
    """Put a trace with other columns in a trace's place. Of a step, new landmarks come last."""
    file = read_trace(path)
    trace = file.trace
    columns = {f"step_{name}": getattr(trace, name).copy() for name in _STEPS}
    columns["step_time_s"] = file.step_time_s.copy()
    columns |= _columns("update", trace.measurements[POINT])
    columns |= _columns("initialise", trace.initialisations[POINT])
    columns |= _columns("position", trace.positions)
    edit(columns)
    path.unlink()
    with Recorder(path, synced=False) as record:
        record.prior({"pose": 3}, trace.prior_covariance, point=trace.prior_pose)
        for step in range(len(columns["step_time_s"]) + 1):
            if step:
                _predict(record, columns, step - 1)
            for row in np.flatnonzero(columns["position_step"] == step).tolist():
                _fuse_position(record, columns, row)
            for row in np.flatnonzero(columns["update_step"] == step).tolist():
                _update(record, columns, row, file.blocks[columns["update_landmark"][row]])
            for row in np.flatnonzero(columns["initialise_step"] == step).tolist():
                _augment(record, columns, row, file.blocks[columns["initialise_landmark"][row]])


def _columns(part: str, records: MeasurementRecords) -> Columns:
    """Return what may be edited of records. Numbers are floats, for a fault may be a fraction."""
    columns = {f"{part}_{name}": getattr(records, of).copy() for of, name in _RECORDS.items()}
    return columns | {f"{part}_measurement": records.number.astype(np.float64)}


def _predict(record: Recorder, columns: Columns, row: int) -> None:
    names = ("time_s", "f", "q", "departed", "arrived")
    time_s, f, q, departed, arrived = (columns[f"step_{name}"][row] for name in names)
    record.at(float(time_s))
    record.predict(f, q, ["pose"], point=departed, after=arrived)


def _fuse_position(record: Recorder, columns: Columns, row: int) -> None:
    names = ("innovation", "jacobian_pose", "noise", "pose", "measurement", "weight")
    residual, h, r, pose, number, weight = (columns[f"position_{name}"][row] for name in names)
    record.update("position", residual, h, r, ["pose"], point=pose, numbers=number, weight=weight)


def _update(record: Recorder, columns: Columns, row: int, landmark: str) -> None:
    of = {name: columns[f"update_{name}"][row] for name in _RECORDS.values()}
    h = np.hstack((of["jacobian_pose"], of["jacobian_other"]))
    record.update(
        "range and bearing",
        of["innovation"],
        h,
        of["noise"],
        ["pose", landmark],
        point=np.concatenate((of["pose"], of["point"])),
        numbers=of["measurement"],
        weight=of["weight"],
    )


def _augment(record: Recorder, columns: Columns, row: int, landmark: str) -> None:
    of = {name: columns[f"initialise_{name}"][row] for name in _RECORDS.values()}
    record.augment(
        landmark,
        of["jacobian_pose"],
        of["jacobian_other"],
        of["noise"],
        ["pose"],
        point=of["pose"],
        after=of["point"],
        numbers=of["measurement"],
        weight=of["weight"],
    )
