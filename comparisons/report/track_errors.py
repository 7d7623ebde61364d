"""Errors of the paths on a page: by truth, or else by what one estimate is off the other.

They colour the map, and a table has their statistics as evo prints them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.accuracy import SHORT_NAMES, AccuracyFinding
from comparisons.pipeline.known import Known
from comparisons.plane import pose_difference, rms

TRUTH = "truth"


class TrackErrors(NamedTuple):
    """Errors of a path at N instants.

    Attributes:
        name: Of the path, as on the map.
        reference: What it is compared with.
        time_s: (N,).
        distance_m: (N,) from the reference's positions.
        heading_rad: (N,) turn from its headings, from 0 to pi.
        rms_m: Root mean square of the distances, as the job's result has it.
    """

    name: str
    reference: str
    time_s: Array
    distance_m: Array
    heading_rad: Array
    rms_m: float


def track_errors(known: Known) -> tuple[TrackErrors, ...]:
    """Return the errors of all paths of a job against truth, or without it, of the judged one."""
    accuracies = known.value(AccuracyFinding) or {}
    errors = [
        TrackErrors(SHORT_NAMES.get(name, name), TRUTH, *accuracy.errors, accuracy.ate_m)
        for name, accuracy in accuracies.items()
        if accuracy is not None and accuracy.errors is not None and accuracy.ate_m is not None
    ]
    return tuple(errors) or _from_smoother(known)


def _from_smoother(known: Known) -> tuple[TrackErrors, ...]:
    """What the judged estimate is off the smoother, where there are both."""
    if known.given is not None:
        time_s, pose = known.given.inside.time_s, known.given.inside.pose
        optimum = known.given.optimum.pose
    elif known.run is not None and known.solved is not None:
        common, ours, theirs = np.intersect1d(
            known.ekf.estimate.time_s, known.smoothed.time_s, return_indices=True
        )
        time_s, pose, optimum = common, known.ekf.estimate.pose[ours], known.smoothed.pose[theirs]
    else:
        return ()
    if not len(time_s):
        return ()
    difference = pose_difference(pose, optimum)
    name = "EKF" if known.given is None else "estimate"
    distance_m, heading_rad = np.hypot(*difference[:, :2].T), np.abs(difference[:, 2])
    return (
        TrackErrors(name, known.called, time_s, distance_m, heading_rad, rms(difference[:, :2])),
    )
