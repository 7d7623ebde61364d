"""Whether the filter used the data as the log has them: each once, in time, under its label.

Both estimators take the filter's association, so what it does to labels shows in no gap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.checks.misfit import squared_misfit
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Log
from comparisons.statistics import chi2_quantile
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.measurements import REJECTED

_WHOLE = 1e-9
"""Weights that add up to one do so to this."""
_FITS = float(chi2_quantile(0.99, 2))
"""A measurement whose residual at the optimum is within this had no reason to be rejected."""
_ALLOWED = 0.01
"""Share of fitting measurements that a gate may cost; the usual gates cost 0.1 %."""
_SURE = 1e-6
_SILENT_S, _SILENT_SAMPLES = 2.0, 20.0
"""Odometry that ends earlier than the measurements by more than both ends too early."""


@dataclass(frozen=True)
class DataFault:
    """What was done to the data, and what to look at."""

    evidence: str
    hint: str


def odometry_remarks(log: Log) -> list[str]:
    """Return a sentence where the odometry ends long before the measurements; none elsewhere."""
    moved, seen = log.odometry.time_s, log.measurements.time_s
    if len(moved) < 2 or not len(seen):
        return []
    silent = float(seen[-1] - moved[-1])
    if silent <= max(_SILENT_S, _SILENT_SAMPLES * float(np.median(np.diff(moved)))):
        return []
    return [
        f"the odometry ends at {moved[-1]:.1f} s, {silent:.1f} s before the last measurement, and "
        "both estimators hold its last sample from there on; check that its file is complete"
    ]


def data_faults(
    log: Log, run: EkfRun, smoothed: Estimate, *, labelled: bool, timed: bool = True
) -> tuple[DataFault, ...]:
    """All that is found.

    labelled: the filter was to go by the log's labels. timed: when it used them is asked for.
    """
    trace, timeline, faults = run.trace, run.timeline, []
    uses = trace.measurements[POINT], trace.initialisations[POINT]
    for kind, records, epoch in (
        ("measurements", uses, timeline.measurement_epoch),
        ("positions", (trace.positions,), timeline.position_epoch),
    ):
        number, step, weight = (
            np.concatenate([getattr(use, name)[use.number >= 0] for use in records])
            for name in ("number", "step", "weight")
        )
        if timed:
            late = step - timeline.steps_until()[epoch[number]]
            faults += untimely(kind, late, 0.0, "{} odometry steps")
        entries = np.concatenate([use.entries[use.number >= 0] for use in records])
        faults += _counted(kind, number, weight[:, None] * entries)
    if labelled:
        label = log.measurements.landmark[: len(run.landmark_index)]
        faults += _labels(label, run.landmark_index) or _names(label, run)
        faults += _gated(log, run, smoothed)
    return tuple(faults)


def untimely(kind: str, late: Array | Index, most: float, form: str) -> list[DataFault]:
    """What was used too late, or too early. late: (N,) of each. most: that is none. form: of it."""
    off = np.abs(late) > most
    if not off.any():
        return []
    middle = np.median(late[off]).astype(late.dtype)
    side = "late" if middle > 0 else "early"
    return [
        DataFault(
            f"{np.count_nonzero(off)} of {len(late)} {kind} are used too {side}, by "
            f"{form.format(abs(middle))} (median)",
            "check the order of events: predict up to the time of a measurement, then update "
            "with it",
        )
    ]


def _counted(kind: str, number: Index, weight: Array) -> list[DataFault]:
    """What is used more than once. weight: (M, r) of the information of each entry."""
    total = np.max([np.bincount(number, column) for column in weight.T], axis=0)
    often = int(np.count_nonzero(total > 1.0 + _WHOLE))
    if not often:
        return []
    return [
        DataFault(
            f"{often} of {len(np.unique(number))} {kind} are used more than once, with up to "
            f"{total.max():.3g} times their information",
            f"check for a second call with the same {kind}, or a queue that is not emptied",
        )
    ]


def _labels(label: NDArray[np.int64], landmark_index: Index) -> list[DataFault]:
    """One landmark per label, one label per landmark."""
    used = landmark_index >= 0
    pairs, count = np.unique(
        np.column_stack((label[used], landmark_index[used])), axis=0, return_counts=True
    )
    (labels, spread), (landmarks, shared) = (
        np.unique(pairs[:, k], return_counts=True) for k in (0, 1)
    )
    if (shared > 1).any():
        mixed = landmarks[shared > 1]
        usual = sum(int(count[pairs[:, 1] == one].max()) for one in mixed)
        stray = int(count[np.isin(pairs[:, 1], mixed)].sum()) - usual
        evidence = (
            f"measurements with different labels are assigned to one landmark: {len(mixed)} of "
            f"{len(landmarks)} landmarks, {stray} measurements"
        )
        return [DataFault(evidence, "check how a label becomes a landmark index of the map")]
    if (spread > 1).any():
        worst = int(spread.argmax())
        evidence = (
            f"measurements of {np.count_nonzero(spread > 1)} of {len(labels)} labels are assigned "
            f"to several landmarks, those of label {labels[worst]} to {spread[worst]}"
        )
        hint = "check for landmarks that are initialised again although they are in the map"
        return [DataFault(evidence, hint)]
    return []


def _names(label: NDArray[np.int64], run: EkfRun) -> list[DataFault]:
    """A label's landmark does not have the name of another label."""
    used = run.landmark_index >= 0
    name = run.estimate.landmark_id[run.landmark_index[used]]
    label = label[used]
    other = (name != label) & np.isin(name, label)
    pairs = np.unique(np.column_stack((label[other], name[other])), axis=0).tolist()
    if not pairs:
        return []
    listed = ", ".join(f"those of label {pair} to landmark {named}" for pair, named in pairs[:4])
    return [
        DataFault(
            f"the measurements of {len(pairs)} labels are assigned to a landmark of another id: "
            f"{listed}",
            "check for exchanged labels, and use the log's ids for the landmarks of the map",
        )
    ]


def _gated(log: Log, run: EkfRun, smoothed: Estimate) -> list[DataFault]:
    """Labelled measurements that were rejected, although they fit the optimum."""
    label = log.measurements.landmark[: len(run.landmark_index)]
    rows = np.flatnonzero((run.landmark_index == REJECTED) & np.isin(label, smoothed.landmark_id))
    if not len(rows):
        return []
    order = np.argsort(smoothed.landmark_id)
    place = order[np.searchsorted(smoothed.landmark_id[order], label[rows])]
    pose = smoothed.pose[run.timeline.measurement_epoch[rows]]
    squared = squared_misfit(log.measurements, rows, pose, smoothed.landmark[place])
    fitting = int(np.count_nonzero(squared <= _FITS))
    total = len(rows) + int(np.count_nonzero(run.landmark_index >= 0))
    if bdtrc(fitting - 1, total, _ALLOWED) > _SURE:
        return []
    return [
        DataFault(
            f"{fitting} of {total} labelled measurements were rejected although they fit the "
            "optimum within their own noise",
            "check the gate: it must compare the squared Mahalanobis distance with a chi-square "
            "quantile, not with a number of sigmas; or check why the filter is overconfident",
        )
    ]
