"""Two landmarks whose labels are exchanged from some time on, or until then.

The rest of the log, without both, says where the vehicle was; from there each measurement of the
two lies at one of two places. The time that parts them best is tried by `log_fit` as any other
correction. `log_doctor` calls this where no value of the log explains its residuals.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.diagnosis.log_fit import TestedLog
from comparisons.checks.diagnosis.solved_log import SolvedLog
from comparisons.errors import InputError
from comparisons.faults.of_logs import LogCorrection
from comparisons.logs.log import Log
from graphslam.goodness_of_fit import row_origins
from graphslam.graph_builder import from_values
from graphslam.sparse_system import sparse_system

_SUSPECTS = 5
"""Landmarks of the largest residuals, whose pairs are tried."""
_FEWEST = 4
"""Measurements of both together before and after the time."""


def label_corrections(tested: TestedLog) -> Iterator[LogCorrection]:
    """Yield the exchange of each pair of suspects, at the time that parts their places best."""
    for first, second in combinations(_suspects(tested.solved), 2):
        since_s = _since_s(tested, first, second)
        if since_s is not None:
            yield _exchange(tested.log, first, second, since_s)


def _exchange(log: Log, first: int, second: int, since_s: float) -> LogCorrection:
    """Two labels of a log in each other's place from a time on."""

    def correct(log: Log) -> Log:
        measurements = log.measurements
        late, label = measurements.time_s >= since_s, measurements.landmark.copy()
        label[late & (measurements.landmark == first)] = second
        label[late & (measurements.landmark == second)] = first
        return replace(log, measurements=replace(measurements, landmark=label))

    names = " and ".join(log.labels.get(one, str(one)) for one in (first, second))
    return LogCorrection(
        "labels", "exchanged",
        lambda: f"the labels of landmarks {names} are exchanged from {since_s:.9g} s on",
        correct, "exchange these labels from then on", keeps_size=True,
    )  # fmt: skip


def _suspects(solved: SolvedLog) -> list[int]:
    """Ids of the point landmarks whose residuals are the largest beside their number."""
    goodness = solved.goodness
    landmark = row_origins(goodness.problem).landmark
    _, right = sparse_system(goodness.graph, goodness.values, goodness.rows)
    rows = np.flatnonzero(landmark >= 0)
    squared = np.bincount(landmark[rows], right[rows] ** 2)
    count = np.maximum(np.bincount(landmark[rows]), 1)
    excess = (squared - count) / np.sqrt(2.0 * count)
    return [solved.landmarks[k] for k in np.argsort(-excess)[:_SUSPECTS].tolist()]


def _since_s(tested: TestedLog, first: int, second: int) -> float | None:
    """The time from which on the places of two labels are exchanged; None where there is none."""
    measurements = tested.log.measurements
    pair = np.isin(measurements.landmark, (first, second))
    rows = np.flatnonzero(pair)
    rows = rows[np.argsort(measurements.time_s[rows], kind="stable")]
    try:
        rest = replace(tested.log, measurements=measurements.chosen(~pair))
        solved = tested.solver.solved(rest)
    except (InputError, RuntimeError, ValueError):
        return None
    poses, _ = from_values(solved.goodness.values, solved.goodness.problem)
    epoch = np.minimum(np.searchsorted(solved.time_s, measurements.time_s[rows]), len(poses) - 1)
    angle = poses[epoch, 2] + measurements.bearing_rad[rows]
    place = poses[epoch, :2] @ (1.0, 1j) + measurements.range_m[rows] * np.exp(1j * angle)
    is_first, time_s = measurements.landmark[rows] == first, measurements.time_s[rows]
    costs: list[tuple[float, float]] = []
    for since_s in np.unique(time_s):
        late = time_s >= since_s
        if min(late.sum(), (~late).sum()) >= _FEWEST:
            group = is_first ^ late
            costs.append((_scatter(place[group]) + _scatter(place[~group]), float(since_s)))
    return min(costs)[1] if costs else None


def _scatter(place: Array) -> float:
    """Squared distances from the middle."""
    return float((np.abs(place - place.mean()) ** 2).sum()) if len(place) else 0.0
