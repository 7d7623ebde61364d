"""Where an estimate first leaves what it is most like."""

from __future__ import annotations

import numpy as np

from comparisons.adapters.timeline import Timeline
from comparisons.checks.grade import Likeness
from comparisons.logs.log import Log
from comparisons.statistics import ROUNDING

_NAMED = 4
"""Landmarks that a sentence names."""


def first_departure(found: Likeness, log: Log, timeline: Timeline) -> str:
    """Say when poses first differ by more than rounding, and what is measured then; "" if never."""
    poses, reference = found.parts[0], found.reference
    spread = np.fmax(np.abs(poses.least - 1.0), np.abs(poses.largest - 1.0))
    left = (poses.sigma > ROUNDING + poses.rounding[0]) | (spread > ROUNDING + poses.rounding[1])
    if not left.any():
        return ""
    first = int(np.argmax(left))
    time_s = float(reference.time_s[reference.known][first])
    said = f"the poses first differ from {reference.name} at {time_s:.9g} s"
    rows = np.flatnonzero(timeline.epoch_time_s[timeline.measurement_epoch] == time_s)
    if not len(rows):
        return f"{said}, without a measurement: check the prediction and the prior"
    names = np.unique(log.measurements.landmark[rows])
    named = ", ".join(str(name) for name in names[:_NAMED].tolist() if name >= 0)
    more = ", ..." if len(names) > _NAMED else ""
    measured = (
        f"measurements {rows[0]} to {rows[-1]}" if len(rows) > 1 else f"measurement {rows[0]}"
    )
    return f"{said}, after {measured}" + (f", of landmarks {named}{more}" if named else "")
