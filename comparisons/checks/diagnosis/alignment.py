"""An estimate in a frame of its own, laid onto the start of a log: `slamcheck check --align`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from comparisons.adapters.alignment import PlaneMotion, first_reckoned_s, reckoned_at
from comparisons.arrays import Array
from comparisons.checks.diagnosis.diagnosis import PathTransform
from comparisons.checks.diagnosis.estimate_facts import undone
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate
from comparisons.logs.log import Log


def laid_at_start(given: ExternalEstimate, time_s: Array, log: Log) -> tuple[ExternalEstimate, str]:
    """Return an estimate whose first pose in a log's time is that of the odometry, and words.

    time_s: (K,) of its poses, on the log's clock. Poses, landmarks and covariances move as one.
    Raises InputError where no pose lies in the log's time, and for an estimate with a trace, which
    stays in the frame of its filter.
    """
    if given.trace is not None:
        raise InputError(
            "--align: the estimate has a trace, whose filter began elsewhere; give the pose that "
            "it began with by --prior-pose X,Y,RAD"
        )
    first_s = first_reckoned_s(log, float(time_s[0]))
    row = int(np.searchsorted(time_s, first_s))
    if row == len(time_s) or time_s[row] > log.end_s:
        raise InputError("--align: no pose of the estimate lies in the log's time, expected one")
    onto = reckoned_at(log, first_reckoned_s(log, float(time_s[row])))
    motion = PlaneMotion.between(given.pose[row], onto)
    by = np.exp(-1j * motion.turn_rad)
    shift = -by * complex(*motion.shift_m.tolist())
    moved = undone(given, PathTransform(a=by, b=shift), given.time_s)
    said = f"aligned: the estimate was {motion}, so that its first pose is the odometry's"
    return replace(moved, time_s=given.time_s, time_ns=given.time_ns), said
