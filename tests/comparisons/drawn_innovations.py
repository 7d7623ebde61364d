"""Innovations drawn by hand, as those of a sensor."""

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index
from comparisons.innovations import InnovationLog, SensorInnovations
from comparisons.trace.events import SensorDescription


def drawn_sensor(
    sensor: SensorDescription,
    whitened: Array,
    time_s: Array | None = None,
    landmark: Index | None = None,
    used: NDArray[np.bool_] | None = None,
) -> SensorInnovations:
    """Figures of vectors (n, d), every tenth event one."""
    log = InnovationLog("measurements", sensor)
    for i, row in enumerate(whitened):
        log.add(
            10 * i,
            10.0 * i if time_s is None else time_s[i],
            row,
            used=used is None or bool(used[i]),
            landmark=-1 if landmark is None else landmark[i],
        )
    return log.judge(np.full(0 if landmark is None else landmark.max() + 1, -1))
