"""Dynamic regions against where things did move, in simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.simulate.dynamic_worlds import moved_over
from comparisons.logs.simulate.scan_worlds import Moving
from ekf_reference.dense.dynamic import DynamicLayer, places
from ekf_reference.dense.regions_at_map import RegionsAtMap

_SAMPLE_S = 0.02


@dataclass(frozen=True)
class DynamicScore:
    """Cells that are dynamic and cells that something moved over, among those ever seen.

    precision, recall: NaN where there is nothing to divide by. middle: (P, 2) [m] of the connected
    places found.
    """

    precision: float
    recall: float
    middle: Array


def score_dynamic(
    layer: DynamicLayer, placed: RegionsAtMap, movers: Sequence[Moving], duration_s: float
) -> DynamicScore:
    """Of a layer at the end of a log that lasted so long."""
    seen = layer.grid.samples(placed).point
    truth = moved_over(tuple(movers), seen, np.arange(0.0, duration_s, _SAMPLE_S))
    found = layer.covers(seen, placed)
    right = float(np.count_nonzero(truth & found))
    with np.errstate(invalid="ignore"):
        shares = np.array((right, right)) / (np.count_nonzero(found), np.count_nonzero(truth))
    return DynamicScore(float(shares[0]), float(shares[1]), middles(layer.points(placed)))


def middles(point: Array) -> Array:
    """(P, 2) of the connected places that points (N, 2) make."""
    number = places(point)
    count = int(number.max(initial=-1)) + 1
    return np.array([point[number == k].mean(axis=0) for k in range(count)]).reshape(-1, 2)
