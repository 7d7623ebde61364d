"""Where an estimate, or a trace, first leaves what a sound filter does, by more than rounding."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from comparisons.adapters.timeline import Timeline
from comparisons.checks.diagnosis.model_differences import INITIALISATIONS, UPDATES, ModelDifference
from comparisons.checks.grade import pose_part
from comparisons.covariances import relative_difference
from comparisons.estimates.external import ExternalEstimate, with_poses
from comparisons.estimates.reference import Reference
from comparisons.logs.log import Log
from comparisons.rounding import ROUNDING

_CHECK_MOTION = ": check the prediction and the prior"
_NAMED = 4
"""Landmarks that a sentence names."""


@dataclass(frozen=True, kw_only=True)
class Departure:
    """The first departure of an estimate or of a trace.

    Attributes:
        time_s: when.
        what: what it departs from.
        event: event that it departs with.
        measurements: numbers of the measurements of that instant; none of a prediction or position.
        landmarks: their labels.
        place: where the estimate is then, east and north.
    """

    time_s: float
    what: str
    event: str
    measurements: list[int]
    landmarks: list[int]
    place: tuple[float, float]

    def __str__(self) -> str:
        """Return it as a remark."""
        return f"first difference from {self.what} at {self.time_s:.9g} s, {self.event}"

    @property
    def briefly(self) -> str:
        """The same without what to check, where the cause is known."""
        return str(self).removesuffix(_CHECK_MOTION)


def departure_from(
    given: ExternalEstimate, sound: Iterable[Reference], log: Log, timeline: Timeline
) -> Departure | None:
    """Return where poses leave the filter that they equal the longest; None if they never do.

    Poses are compared at the times that both have.
    """
    left = []
    for reference in sound:
        time_s = departed_s(given, reference)
        if time_s is None:
            return None
        left.append((time_s, reference.name))
    if not left:
        return None
    time_s, name = max(left, key=lambda one: one[0])  # the first of several
    rows = np.flatnonzero(timeline.epoch_time_s[timeline.measurement_epoch] == time_s)
    event = f"without a measurement{_CHECK_MOTION}"
    if len(rows):
        event = f"after {_measured(rows.tolist(), log)}"
    return _departure(given, time_s, name, event, rows.tolist(), log)


def model_departure(
    given: ExternalEstimate, differences: Sequence[ModelDifference], log: Log
) -> Departure | None:
    """Return where a trace's relations first differ from the log's models; None if untold."""
    timed = [difference for difference in differences if difference.first_s is not None]
    if not timed:
        return None
    # Of one instant the prediction comes first.
    first = min(timed, key=lambda one: (one.first_s or 0.0, one.number is not None))
    seen = first.number is not None and first.relation in (UPDATES, INITIALISATIONS)
    rows = [first.number or 0] if seen else []
    event = f"in a {first.relation.removesuffix('s')} ({first.quantity})" + (
        f", {_measured(rows, log)}" if rows else ""
    )
    what = "the log's models"
    return _departure(given, first.first_s or 0.0, what, event, rows, log)


def _departure(
    given: ExternalEstimate, time_s: float, what: str, event: str, rows: list[int], log: Log
) -> Departure:
    labels = np.unique(log.measurements.landmark[rows])
    near = min(int(np.searchsorted(given.time_s, time_s)), len(given.time_s) - 1)
    east, north = given.pose[near, :2].tolist()
    return Departure(
        time_s=time_s,
        what=what,
        event=event,
        measurements=rows,
        landmarks=labels[labels >= 0].tolist(),
        place=(east, north),
    )


def departed_s(given: ExternalEstimate, reference: Reference) -> float | None:
    """Return when poses first differ from a reference's by more than rounding; None for never."""
    reference = reference.at(given.time_s)
    given = with_poses(given, np.isin(given.time_s, reference.time_s))
    if not reference.known.any():
        return None
    poses = pose_part(given, reference)
    spread = relative_difference(poses.least, poses.largest)
    left = (poses.sigma > ROUNDING + poses.rounding[0]) | (spread > ROUNDING + poses.rounding[1])
    return float(reference.time_s[reference.known][np.argmax(left)]) if left.any() else None


def _measured(rows: list[int], log: Log) -> str:
    names = np.unique(log.measurements.landmark[rows])
    known = (one for one in names[:_NAMED].tolist() if one >= 0)
    named = ", ".join(log.labels.get(one, str(one)) for one in known)
    more = ", ..." if len(names) > _NAMED else ""
    many = f"measurements {rows[0]} to {rows[-1]}" if len(rows) > 1 else f"measurement {rows[0]}"
    of = f", of landmark{'s' if len(names) > 1 else ''} {named}{more}" if named else ""
    return many + of
