"""Faults of when, how long and how often a filter's events are."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from comparisons.adapters.timeline import build_timeline
from comparisons.faults.data import (
    applied_twice,
    by_labels,
    predictions_late,
    previous_interval,
    scans_late,
    seen_times,
)
from comparisons.faults.fault import Family, Fault, Plant, moving, remembering
from comparisons.logs.log import Log
from ekf_reference.association.known import KnownAssociation

_COUNTS = (1, 2)
_WORDS = {1: "one", 2: "two"}
_GATES = (1.0, 2.0, 3.0, 4.0, 4.605, 5.991, 7.378, 9.0, 9.210, 11.83, 13.82, 16.0, 25.0)
"""Of normalised innovations squared, as they are written in programs: of 2 and of 3 numbers."""


def timing_faults(log: Log) -> Iterator[Fault]:
    """Yield the faults of events' times that have no number."""
    for count in _COUNTS:
        many = f"{_WORDS[count]} prediction{'s' * (count > 1)}"
        yield Fault(
            f"the measurements are fused {many} late",
            remembering(partial(predictions_late, count)),
        )
    for count in _COUNTS:
        many = f"{_WORDS[count]} scan{'s' * (count > 1)}"
        yield Fault(
            f"the measurements are fused {many} late, at the time of a later one",
            remembering(partial(scans_late, count)),
        )
    for count in (2, 3):
        yield Fault(f"every measurement is used {count} times", seen_times(count))
    yield Fault("every control moves the vehicle 2 times", moving(applied_twice))
    yield Fault("a step lasts as long as the one before it", remembering(previous_interval))
    usual_s = float(np.median(build_timeline(log).step_duration_s))
    yield Fault(f"every step lasts {usual_s:g} s, whatever the stamps say", _lasting(usual_s))
    for gate in _GATES if log.measurements.labelled else ():
        yield Fault(
            f"measurements whose normalised innovation squared is above {gate:g} are rejected",
            by_labels(KnownAssociation, gate=gate),
        )


def timing_families() -> Iterator[Family]:
    """Yield the faults of events' times that have a number."""
    yield Family("every control acts for {} of its interval", plant=_of_interval)


def _lasting(duration_s: float) -> Plant:
    return moving(lambda sound, pose, control, _: sound(pose, control, duration_s))


def _of_interval(share: float) -> Plant:
    return moving(lambda sound, pose, control, duration_s: sound(pose, control, share * duration_s))
