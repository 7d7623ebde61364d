"""The full scan pose graph: scan increments, the EKF's landmarks, closed loops."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.scan_odometry import ScanMotion
from comparisons.adapters.smoother_input import assemble, position_rows, smoothed_estimate
from comparisons.adapters.timeline import build_timeline
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Log, Positions
from comparisons.logs.transforms.known_landmarks import surveyed
from comparisons.logs.transforms.scan_motion import measurements_kept, with_scan_motion
from graphslam.scan.loop_closure import LoopCloser
from graphslam.smoother import SmootherOptions, SmootherResult, smooth


class ScanSmoother(NamedTuple):
    """The smoother on scans, with the ids of the EKF's landmarks."""

    result: SmootherResult
    estimate: Estimate
    loops: int


def smooth_on_scans(
    log: Log, motion: ScanMotion, run: EkfRun, closer: LoopCloser, options: SmootherOptions
) -> ScanSmoother:
    """Solve with the scans' motion and the EKF's association. Raises InputError.

    Landmarks that were only seen outside the time of the scans are left out, but for surveyed
    ones. The positions are those that the filter fused. Measurements after a breakdown of the
    filter have no association and only mark poses.
    """
    log = replace(log, positions=_fused(run))
    scanned = with_scan_motion(log, motion, positions=True)
    positions = scanned.positions
    timeline = build_timeline(scanned, positions)
    kept = measurements_kept(log, motion)
    landmark_index = np.full(len(kept), -1, dtype=np.intp)
    landmark_index[: len(run.landmark_index)] = run.landmark_index
    landmark_index = landmark_index[kept]
    used = np.unique(landmark_index[landmark_index >= 0])
    if not len(used):
        raise InputError(f"{log.name}: no landmark was seen while scans were taken")
    used = np.union1d(used, np.arange(len(surveyed(log)[1])))
    compact = np.full(len(run.estimate.landmark), -1, dtype=np.intp)
    compact[used] = np.arange(len(used))
    landmark_index = np.where(landmark_index >= 0, compact[landmark_index], -1)
    rows = position_rows(timeline, positions)
    problem = assemble(scanned, timeline, landmark_index, len(used), rows)
    closed = closer.close(problem, motion.clouds(timeline.epoch_time_s))
    result = smooth(replace(problem, loop_closures=closed.loop_closures), {}, options=options)
    ids = run.estimate.landmark_id[used]
    estimate = smoothed_estimate(result, timeline.epoch_time_s, ids, "the EKF's")
    return ScanSmoother(result, estimate, len(closed.loop_closures.first))


def _fused(run: EkfRun) -> Positions | None:
    """The positions that the filter was given and accepted."""
    given, rows = run.positions, run.fix_number
    if given is None or not len(rows):
        return None
    return given.chosen(rows)
