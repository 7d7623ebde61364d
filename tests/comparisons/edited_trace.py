"""Records a planar filter's trace anew, with other numbers."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from comparisons.estimates.event_arrays import COLUMNS, event_arrays
from comparisons.trace.reader import TraceReader
from comparisons.trace.recorder import Recorder
from tests.helpers import Array

Columns = dict[str, Array]
"""By part and name, as `PlanarEvents.arrays`."""


def edit_trace(path: Path, edit: Callable[[Columns], object]) -> None:
    """Put a trace with other columns in a trace's place. Of a step, new landmarks come last."""
    planar = event_arrays(TraceReader(path))
    columns = {name: array.copy() for name, array in planar.arrays.items()}
    edit(columns)
    path.unlink()
    with Recorder(path, synced=False) as record:
        record.prior({"pose": 3}, columns["prior_covariance"], point=columns["prior_pose"])
        for step in range(len(columns["step_time_s"]) + 1):
            if step:
                _predict(record, columns, step - 1)
            for row in np.flatnonzero(columns["position_step"] == step).tolist():
                _fuse_position(record, columns, row)
            for row in np.flatnonzero(columns["update_step"] == step).tolist():
                name = planar.blocks[int(columns["update_landmark"][row])]
                _update(record, columns, row, name)
            for row in np.flatnonzero(columns["initialise_step"] == step).tolist():
                name = planar.blocks[int(columns["initialise_landmark"][row])]
                _augment(record, columns, row, name)


def _predict(record: Recorder, columns: Columns, row: int) -> None:
    names = ("time_s", "f", "q", "departed", "arrived")
    time_s, f, q, departed, arrived = (columns[f"step_{name}"][row] for name in names)
    record.at(float(time_s))
    record.predict(f, q, ["pose"], point=departed, after=arrived)


def _fuse_position(record: Recorder, columns: Columns, row: int) -> None:
    names = ("innovation", "jacobian_pose", "noise", "pose", "number", "weight")
    residual, h, r, pose, number, weight = (columns[f"position_{name}"][row] for name in names)
    record.update("position", residual, h, r, ["pose"], point=pose, numbers=number, weight=weight)


def _update(record: Recorder, columns: Columns, row: int, landmark: str) -> None:
    of = {name: columns[f"update_{name}"][row] for name in COLUMNS["update"]}
    h = np.hstack((of["jacobian_pose"], of["jacobian_landmark"]))
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
    of = {name: columns[f"initialise_{name}"][row] for name in COLUMNS["initialise"]}
    record.augment(
        landmark,
        of["jacobian_pose"],
        of["jacobian_measurement"],
        of["noise"],
        ["pose"],
        point=of["pose"],
        after=of["point"],
        numbers=of["measurement"],
        weight=of["weight"],
    )
