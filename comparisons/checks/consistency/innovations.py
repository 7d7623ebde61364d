"""Normalised innovations squared, and whether innovations are white, per sensor.

Measurements of one instant share the pose's error, so the filter whitens them together: with
S = L L^T of the stacked innovation nu, L^-1 nu holds independent standard normal numbers if the
filter is consistent, within an instant and over time. A measurement's range is then judged given
the measurements fused before it at that instant, and its bearing given its range as well. Each
squared has one degree of freedom, and the averages over a whole run have an exact band.

What a gate rejects is missing: with a gate at 99 % the average of a consistent filter is 4 % low.
Association by distance shortens innovations, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.statistics import Nis, Whiteness, average, faults, mean_band, whiteness
from ekf_reference.core.landmark_types import POINT

_WINDOWS = 60
"""So many averages over a run are drawn."""


@dataclass(frozen=True)
class Windows:
    """Average NIS over stretches of a run. time_s, mean, low, high: (n,)."""

    time_s: Array
    mean: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class SensorInnovations:
    """One sensor. nis: of both components jointly, and of each. unusable: without a valid S."""

    sensor: str
    nis: tuple[Nis, ...]
    whiteness: tuple[Whiteness, ...]
    windows: Windows
    unusable: int


def check_innovations(run: EkfRun) -> tuple[SensorInnovations, ...]:
    """Of all measurements of mapped landmarks, and of the positions fused, where there are any.

    What was fused in parts is judged by its first part, with the whole observation's S, and
    alone. A measurement that began its landmark predicts nothing.
    """
    time_s = run.timeline.epoch_time_s
    u, fixes = run.trace.measurements[POINT], run.trace.positions
    initialised = run.trace.initialisations[POINT].number
    first = np.sort(np.unique(u.number, return_index=True)[1])
    rows = first[~np.isin(u.number[first], initialised)]
    weight = u.weight[rows]
    alone, bad = whiten(
        u.innovation[rows], u.spread[rows] + (weight[:, None, None] - 1.0) * u.noise[rows]
    )
    split = (weight < 1.0)[:, None]
    kept = ~(split[:, 0] & bad)
    standard = np.where(split, alone, u.whitened[rows])[kept]
    seen = u.number[rows][kept]
    names = ("forward", "left") if run.own_axes else ("range", "bearing")
    epoch = run.timeline.measurement_epoch[seen]
    landmark_index = u.landmark_index[rows][kept]
    made = [
        sensor(
            "measurements",
            names,
            standard,
            time_s[epoch],
            epoch,
            landmark_index,
            int((~kept).sum()),
        )
    ]
    first = np.sort(np.unique(fixes.number, return_index=True)[1])
    spread = fixes.spread[first] + (fixes.weight[first, None, None] - 1.0) * fixes.noise[first]
    standard, bad = whiten(fixes.innovation[first], spread)
    epoch = run.timeline.position_epoch[fixes.number[first]][~bad]
    names = ("east", "north")
    made.append(
        sensor("positions", names, standard[~bad], time_s[epoch], epoch, None, int(bad.sum()))
    )
    return tuple(one for one in made if one.nis)


def sensor(
    name: str,
    components: tuple[str, str],
    standard: Array,
    time_s: Array,
    epoch: Index,
    landmark_index: Index | None,
    unusable: int = 0,
) -> SensorInnovations:
    """Of standardised innovations (n, 2) at times (n,), in the order of their fusion.

    epoch, landmark_index: (n,) instants and landmarks, if it sees landmarks.
    """
    squared = standard**2
    rows = ((name, slice(0, 2)), (components[0], slice(0, 1)), (components[1], slice(1, 2)))
    nis = [average(title, squared[:, part]) for title, part in rows] if len(squared) else []
    white = []
    for i, component in enumerate(components):
        _, instant, count = np.unique(epoch, return_inverse=True, return_counts=True)
        summed = np.bincount(instant, standard[:, i]) / np.sqrt(count)
        white.append(whiteness(component, "time", summed))
        if landmark_index is not None:
            order = np.argsort(landmark_index, kind="stable")
            white.append(
                whiteness(component, "landmark", standard[order, i], landmark_index[order])
            )
    drawn = tuple(w for w in white if w is not None)
    return SensorInnovations(name, tuple(nis), drawn, _windows(squared, time_s), unusable)


def whiten(innovation: Array, spread: Array) -> tuple[Array, NDArray[np.bool_]]:
    """L^-1 nu (n, 2) of innovations (n, 2) by S = L L^T (n, 2, 2); and which S is no covariance."""
    bad = faults(spread) != ""
    safe = np.where(bad[:, None, None], np.eye(2), spread)
    standard = np.linalg.solve(np.linalg.cholesky(safe), innovation[:, :, None])[:, :, 0]
    return np.where(bad[:, None], 0.0, standard), bad


def _windows(squared: Array, time_s: Array) -> Windows:
    parts = np.array_split(np.arange(len(squared)), min(_WINDOWS, len(squared)) or 1)
    parts = [part for part in parts if len(part)]
    bands = [mean_band(len(part), 2) for part in parts]
    return Windows(
        np.array([time_s[part].mean() for part in parts]),
        np.array([squared[part].sum() / len(part) for part in parts]),
        np.array([band.low for band in bands]),
        np.array([band.high for band in bands]),
    )
