"""Examples 3.1 and 3.2 of Nieto 2005: one point of a region, followed until the loop closes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.errors import InputError
from comparisons.experiments.reproduction.watched_run import truth_in_order, watched_run
from comparisons.logs.log import Log
from ekf_reference.core.geometry import Array
from ekf_reference.core.layout import Layout
from ekf_reference.dense.decorrelation import (
    Correlations,
    Displacements,
    correlations,
    displacements,
)
from ekf_reference.dense.triangles import contains, is_degenerate, to_local

DISTANT_M = 15.0
"""How far away the distant landmark is, as near as there is one; the thesis gives no number."""


class Cast(NamedTuple):
    """Landmarks by order of incorporation. fused_s: when the point is last seen."""

    point: int
    base: tuple[int, int, int]
    distant: int
    fused_s: float


def rightmost(log: Log) -> Cast:
    """Choose region, point and time by geometry alone. Raises InputError where there are none.

    Example 3.1 takes three landmarks as a region, and one in it, in the rightmost part of the
    environment, after "a few observations", and names neither the landmarks nor the time. So the
    point is the easternmost landmark that lies within a triangle of three others and is in view
    together with them in some scan; of such triangles the one with the smallest perimeter, since
    correlation is high where landmarks are close. The point is last seen in the last scan that
    shows all four. The rule reads true places and which landmarks each scan shows. It reads no
    estimate, so all drives through one world have the same cast. The distant landmark is the one
    nearest to DISTANT_M away from the point, of those seen until then.
    """
    true, measurements = truth_in_order(log)[1], log.measurements
    order = measurements.labels_in_order
    time_s, scan = np.unique(measurements.time_s, return_inverse=True)
    view = np.zeros((len(time_s), len(order)), dtype=bool)
    rank = np.argsort(order)
    view[scan, rank[np.searchsorted(order[rank], measurements.landmark)]] = True
    for point in np.argsort(-true[:, 0]).tolist():
        base = _around(point, true, view)
        if base is None:
            continue
        last = np.flatnonzero(view[:, [point, *base]].all(axis=1))[-1]
        seen = np.setdiff1d(np.flatnonzero(view[: last + 1].any(axis=0)), (point, *base))
        if len(seen):
            off = np.abs(np.linalg.norm(true[seen] - true[point], axis=1) - DISTANT_M)
            distant = int(seen[np.argmin(off)])
            return Cast(point, base, distant, float(time_s[last]))
    raise InputError(f"{log.name}: no landmark is seen within three others")


def _around(point: int, true: Array, view: NDArray[np.bool_]) -> tuple[int, int, int] | None:
    """The smallest triangle around a landmark that some scan (N, L) shows with it."""
    shown = view[view[:, point]]
    others = np.setdiff1d(np.flatnonzero(shown.any(axis=0)), point).tolist()
    base = np.array(list(combinations(others, 3)), dtype=np.intp).reshape(-1, 3)
    base = base[shown[:, base].all(axis=2).any(axis=0) & ~is_degenerate(true[base])]
    base = base[contains(to_local(true[base], true[point]))]
    if not len(base):
        return None
    edges = np.linalg.norm(true[base] - np.roll(true[base], 1, axis=1), axis=2)
    first, second, third = base[np.argmin(edges.sum(axis=1))].tolist()
    return first, second, third


@dataclass(frozen=True)
class Snapshot:
    """The filter after a scan. landmark: (L, 2) [m]. covariance: (n, n) of the pose and these."""

    time_s: float
    landmark: Array
    covariance: Array

    def among(self, *landmark_index: int) -> Array:
        """(2 k, 2 k) covariance of k landmarks, in this order."""
        layout = Layout.packed(3, len(self.landmark))
        columns = layout.columns(np.array(landmark_index))[3:]
        return self.covariance[np.ix_(columns, columns)]


@dataclass(frozen=True, kw_only=True)
class DecorrelationExample:
    """The figures' data after each of T scans, from when the point is fused.

    triangle: (T, 3, 2), point: (T, 2) and distant: (T, 2) [m]. with_base: (T, 3, 2) correlation
    coefficients of the point with the base landmarks, in east and north. correlations: arrays
    (T, 2, 2) and (T, 2) of the distant landmark with the point. moved: (T,) since the first scan.
    landmark: (L, 2) all of the map at the first scan. true_point: (2,) [m], None if unknown.
    """

    time_s: Array
    triangle: Array
    point: Array
    distant: Array
    with_base: Array
    correlations: Correlations
    moved: Displacements
    landmark: Array
    true_point: Array | None


def decorrelation_example(log: Log) -> DecorrelationExample:
    """Drive a labelled log and follow its cast. Raises InputError where there is none."""
    cast, order = rightmost(log), log.measurements.labels_in_order
    seen = list(fused_until(log, cast))
    triangle = np.stack([now.landmark[list(cast.base)] for now in seen])
    point = np.stack([now.landmark[cast.point] for now in seen])
    found, with_base = [], []
    for now, corners, at in zip(seen, triangle, point, strict=True):
        joint = now.among(cast.distant, *cast.base, cast.point)
        found.append(correlations(corners, at, joint))
        sigma = np.sqrt(np.diag(joint))
        rho = np.abs(joint) / np.outer(sigma, sigma)
        with_base.append([rho[[2 * i, 2 * i + 1], [8, 9]] for i in (1, 2, 3)])
    true = log.truth.landmarks
    return DecorrelationExample(
        time_s=np.array([now.time_s for now in seen]),
        triangle=triangle,
        point=point,
        distant=np.stack([now.landmark[cast.distant] for now in seen]),
        with_base=np.array(with_base),
        correlations=Correlations(*(np.stack(column) for column in zip(*found, strict=True))),
        moved=displacements(triangle[0], point[0], triangle, point),
        landmark=seen[0].landmark,
        true_point=None if true is None else true.position_m[true.id == order[cast.point]][0],
    )


def fused_until(log: Log, cast: Cast) -> Iterator[Snapshot]:
    """The filter from when the point, like a dense one, has got its last look."""
    measurements = log.measurements
    label = measurements.labels_in_order[cast.point]
    keep = (measurements.landmark != label) | (measurements.time_s <= cast.fused_s)
    for time, ekf in watched_run(replace(log, measurements=measurements.chosen(keep))):
        if time >= cast.fused_s:
            yield Snapshot(time, ekf.state.landmarks, ekf.state.covariance.copy())
