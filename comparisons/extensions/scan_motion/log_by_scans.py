"""A log whose motion comes from its scans instead of its wheels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.motion import motion_between
from comparisons.adapters.scan_odometry import ScanMotion
from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.log import Log, Prior
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.transforms.known_landmarks import join_known_measurements
from graphslam.increments import MotionSamples

BEYOND = "measurements_beyond_scans"
"""Key of a log's provenance: how many measurements were left out."""
_LEAST = 1e-10
"""Variance added to every increment, so that none is singular."""


def with_scan_motion(log: Log, motion: ScanMotion, *, positions: bool = False) -> Log:
    """The log with relative poses from scan odometry in place of its odometry.

    A pose for every scan and for every measurement in between, and, when asked, for every position:
    there the increment is divided as if the vehicle had moved evenly. The first scan is reached
    by the wheels; without them the prior holds there. What was seen before the first scan or
    after the last is left out; measurements of surveyed landmarks have joined the others. Raises
    InputError where no measurement is left.
    """
    log = join_known_measurements(log)
    start = float(motion.time_s[0])
    prior, lead = log.prior, None
    begin = _begin(log, motion)
    if begin < start:
        lead = motion_between(log, motion.time_s[:1])
    elif start > prior.time_s:
        prior = Prior(start, prior.pose, prior.covariance)
    knots = motion.time_s if lead is None else np.concatenate(([begin], motion.time_s))
    moves, spreads = motion.displacement[1:], motion.covariance[1:]
    if lead is not None:
        moves = np.vstack((lead.displacement, moves))
        spreads = np.concatenate((lead.covariance, spreads))
    seen = measurements_kept(log, motion)
    wanted = [knots, log.measurements.time_s[seen]]
    if positions and log.positions is not None:
        fix_s = log.positions.time_s
        wanted.append(fix_s[(fix_s >= begin) & (fix_s <= knots[-1])])
    times = np.unique(np.concatenate(wanted))
    pieces = divide(MotionSamples(moves, spreads), knots, times)
    spread = pieces.covariance + _LEAST * np.eye(3)
    left_out = int(np.count_nonzero(~seen))
    provenance = {**log.provenance, "motion": f"{len(motion.time_s)} scans"}
    if left_out:
        provenance[BEYOND] = str(left_out)
    if not seen.any() and len(seen):
        raise InputError(f"{log.name}: no measurement lies within the time of the usable scans")
    return replace(
        log,
        prior=prior,
        odometry=RelativePoses(times[1:], pieces.displacement, spread),
        measurements=log.measurements.chosen(seen),
        provenance=provenance,
    )


def measurements_kept(log: Log, motion: ScanMotion) -> NDArray[np.bool_]:
    """(M,) which measurements fall between where the motion begins and the last scan.

    Those of surveyed landmarks must have joined the others.
    """
    time_s = log.measurements.time_s
    kept: NDArray[np.bool_] = (time_s >= _begin(log, motion)) & (time_s <= motion.time_s[-1])
    return kept


def _begin(log: Log, motion: ScanMotion) -> float:
    """The prior's time where wheels lead from there to the first scan, else the first scan's."""
    start = float(motion.time_s[0])
    return log.prior.time_s if len(log.odometry.time_s) and start > log.prior.time_s else start


def divide(increments: MotionSamples, knots: Array, times: Array) -> MotionSamples:
    """Increments between knots (K,) as increments between times (N,), all knots among them.

    A piece is the same share of the motion's tangent as of the time, and of the covariance.
    """
    share = np.diff(times)
    interval = np.searchsorted(knots, times[1:]) - 1
    share /= np.diff(knots)[interval]
    whole = share >= 1.0
    displacement = increments.displacement[interval]
    part = _exponential(share[:, None] * _logarithm(displacement))
    displacement = np.where(whole[:, None], displacement, part)
    return MotionSamples(displacement, share[:, None, None] * increments.covariance[interval])


def _logarithm(motion: Array) -> Array:
    """Tangents (N, 3) that lead to motions (N, 3) when followed evenly."""
    half = 0.5 * motion[:, 2]
    scale = np.where(np.abs(half) < 1e-9, 1.0, half / np.tan(np.where(half == 0.0, 1.0, half)))
    x, y = motion[:, 0], motion[:, 1]
    return np.column_stack((scale * x + half * y, scale * y - half * x, motion[:, 2]))


def _exponential(tangent: Array) -> Array:
    """Motions (N, 3) of tangents (N, 3)."""
    turn = tangent[:, 2]
    safe = np.where(np.abs(turn) < 1e-9, 1.0, turn)
    along = np.where(np.abs(turn) < 1e-9, 1.0, np.sin(safe) / safe)
    across = np.where(np.abs(turn) < 1e-9, 0.5 * turn, (1.0 - np.cos(safe)) / safe)
    x, y = tangent[:, 0], tangent[:, 1]
    return np.column_stack((along * x - across * y, across * x + along * y, turn))
