"""Measurements of surveyed landmarks join the other measurements, under labels of their own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.logs.log import Log

SURVEYED = 10**9
"""Added to a surveyed landmark's id, so that it meets no other landmark's."""


def join_known_measurements(log: Log) -> Log:
    """The log with one stream of measurements, in order of time; ids of surveyed ones raised."""
    known = log.known_measurements
    if known is None or not len(known.time_s):
        return log
    measurements = log.measurements
    order = np.argsort(np.concatenate((measurements.time_s, known.time_s)), kind="stable")
    raised = replace(known, landmark=known.landmark + SURVEYED)
    columns: dict[str, Any] = {
        name: np.concatenate((value, getattr(raised, name)))[order]
        for name, value in vars(measurements).items()
        if isinstance(value, np.ndarray)
    }
    return replace(log, measurements=replace(measurements, **columns), known_measurements=None)


def surveyed(log: Log) -> tuple[dict[int, int], Array, Array]:
    """Index by raised id, positions (K, 2) and covariances (K, 2, 2) of surveyed landmarks.

    They take the first landmark indices. A covariance of zero becomes a tenth of a millimetre, so
    that the state's stays regular.
    """
    table = log.known_landmarks
    if table is None:
        return {}, np.zeros((0, 2)), np.zeros((0, 2, 2))
    raised = {SURVEYED + i: row for row, i in enumerate(table.id.tolist())}
    return raised, table.position_m, table.covariance + 1e-8 * np.eye(2)


def indices_by_label(log: Log) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Landmark indices (M,) of the measurements and ids (L,), surveyed landmarks first."""
    index_of, label = surveyed(log)[0], log.measurements.landmark
    for key in label[label >= 0].tolist():
        index_of.setdefault(key, len(index_of))
    landmark_index = np.array([index_of.get(key, -1) for key in label.tolist()], dtype=np.intp)
    return landmark_index, np.array(list(index_of), dtype=np.int64)
