"""The full scan pose graph: scan increments, the EKF's landmarks, closed loops."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.runs.ekf_run import EkfRun
from comparisons.runs.estimate import Estimate
from comparisons.runs.scan_log import sightings_kept, with_scan_motion
from comparisons.runs.scan_motion import ScanMotion
from comparisons.runs.smoother_run import assemble, position_rows, smoothed_estimate
from comparisons.runs.timeline import build_timeline
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

    Landmarks that were only seen outside the time of the scans are left out. Positions are fused
    when the filter fused them.
    """
    scanned = with_scan_motion(log, motion, positions=run.positions is not None)
    positions = None if run.positions is None else scanned.positions
    timeline = build_timeline(scanned, positions)
    slot = run.slot[sightings_kept(log, motion)]
    used = np.unique(slot[slot >= 0])
    if not len(used):
        raise InputError(f"{log.name}: no landmark was seen while scans were taken")
    compact = np.full(int(run.slot.max()) + 1, -1, dtype=np.intp)
    compact[used] = np.arange(len(used))
    slot = np.where(slot >= 0, compact[slot], -1)
    rows = position_rows(timeline, positions)
    problem = assemble(scanned, timeline, slot, len(used), *rows)
    closed = closer.close(problem, motion.clouds(timeline.epoch_time_s))
    result = smooth(replace(problem, closures=closed.closures), {}, options=options)
    ids = run.estimate.landmark_id[used]
    estimate = smoothed_estimate(result, timeline.epoch_time_s, ids, "the EKF's")
    return ScanSmoother(result, estimate, len(closed.closures.first))
