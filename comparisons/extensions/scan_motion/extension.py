"""Motion from scans: in place of the odometry, or for a third estimate beside the two on wheels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.scan_odometry import ScanMotion, run_scan_odometry
from comparisons.adapters.smoother_input import assemble, position_rows, smoothed_estimate
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.accuracy import assess
from comparisons.checks.finding import Finding
from comparisons.checks.map_agreement import compare_maps
from comparisons.config import Configured
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.extensions.scan_motion.config import ScanMotionConfig
from comparisons.extensions.scan_motion.increments import IncrementCheck, check_increments
from comparisons.extensions.scan_motion.log_by_scans import (
    BEYOND,
    measurements_kept,
    with_scan_motion,
)
from comparisons.extensions.scan_motion.result import (
    ScanOdometryResult,
    increment_remarks,
    scan_odometry_result,
    scan_odometry_rows,
    three_way_rows,
)
from comparisons.extensions.scan_motion.three_way import (
    ThreeWay,
    find_inconsistent_source,
    motion_cause,
    readable,
)
from comparisons.logs.log import Log, Positions
from comparisons.logs.transforms.known_landmarks import surveyed
from comparisons.pipeline.extension import Extension
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepared import Prepared
from comparisons.words import Row
from graphslam.scan.loop_closure import loop_closer
from graphslam.smoother import SmootherEvidence, smooth


class ScanMotionExtension(Extension):
    """Do the wheels and the scans tell the same motion?

    Runs scan odometry first, for whatever is moved by it.
    """

    name = "scan_motion"
    needs = "scans"
    errs = "not measured"
    figures = (
        ("scan_odometry", ScanOdometryResult),
        ("increments", IncrementCheck),
        ("three_way", ThreeWay),
    )

    def __init__(self, settings: ScanMotionConfig, config: Configured) -> None:
        """Of motion `scan` the wheels' is not used."""
        super().__init__(settings, config)
        self.brings_motion = settings.motion == "scan"
        self._motion: ScanMotion | None = None

    def prepare(self, prepared: Prepared[Any]) -> Prepared[Any]:
        """Run scan odometry; where it brings the motion, put it in place of the odometry."""
        with prepared.clock.stage("scan odometry"):
            progress = prepared.stage_progress("scan odometry")
            self._motion = run_scan_odometry(prepared.log, progress=progress)
        if not self.brings_motion:
            return prepared
        fused = prepared.ekf.gps != "off"
        return replace(prepared, log=with_scan_motion(prepared.log, self._motion, positions=fused))

    def find(self, known: Known) -> ScanMotionFinding | None:
        """Solve with the scans' motion beside the wheels', where both are asked for."""
        if self._motion is None:
            return None
        three = None
        prepared = known.prepared
        if not self.brings_motion:
            with prepared.clock.stage("smoother on scans"):
                prepared.progress("smoother on scans", 0, 0)
                three = solve_on_scans(known, self._motion)
        return ScanMotionFinding(known, self._motion, three)


class ScanMotionFinding(Finding):
    """What the scans gave, how honest that is, and the third estimate, where there is one."""

    def __init__(self, known: Known, motion: ScanMotion, three: ThreeWay | None) -> None:
        """The third estimate is heard in the verdict when its optimum is verified."""
        log, seconds = known.prepared.log, known.prepared.clock.seconds
        self.motion, self.three = motion, three
        self._odometry = scan_odometry_result(motion, seconds=seconds["scan odometry"])
        self._increments = check_increments(motion, log)
        entries: dict[str, object] = {"scan_odometry": self._odometry}
        if self._increments is not None:
            entries["increments"] = self._increments
        remarks = list(motion.remarks)
        if beyond := log.provenance.get(BEYOND):
            remarks.append(
                f"{beyond} measurements lie outside the time of the scans and were left out"
            )
        if three is not None:
            entries["three_way"] = three
            self.estimates = {"scans": three.estimate}
            self.titles = {"scans": "smoother on scans"}
            remarks += three.remarks
            if three.verified and not three.ekf.agrees:
                self.causes = [motion_cause(three)]
        self.entries = entries
        self.remarks = [*remarks, *increment_remarks(self._increments)]

    def rows(self) -> Sequence[Row]:
        """Return what became of the scans, and how the third estimate compares."""
        rows = scan_odometry_rows(self._odometry, self._increments)
        return rows if self.three is None else [*rows, *three_way_rows(self.three)]

    def draw(self, axis: Axes) -> None:
        """Draw the smoother on scans."""
        from comparisons.report.figures.style import draw_estimate

        if self.three is not None:
            draw_estimate(axis, "smoother on scans", self.three.estimate)


def solve_on_scans(known: Known, motion: ScanMotion) -> ThreeWay:
    """Solve with the scans' motion, and compare both estimates on wheels with that."""
    prepared, run, gaps = known.prepared, known.ekf, known.gaps
    result, estimate = smooth_on_scans(prepared.log, motion, run)
    accuracy = assess(estimate, prepared.judged, labelled=False)
    ekf, smoother = (compare_maps(own, estimate) for own in (run.estimate, gaps.smoothed))
    optimality = readable(result)
    inconsistent_source, evidence = "", "the maps agree"
    if not (ekf.agrees and smoother.agrees):
        inconsistent_source, evidence = find_inconsistent_source(
            readable(gaps.result),
            optimality,
            assess(gaps.smoothed, prepared.judged, labelled=False),
            accuracy,
        )
    return ThreeWay(
        ekf=ekf,
        smoother=smoother,
        loops=len(result.problem.loop_closures.first),
        verified=result.optimality.verified,
        chi2=optimality.chi_square.chi2,
        dof=optimality.chi_square.dof,
        accuracy=accuracy,
        inconsistent_source=inconsistent_source,
        evidence=evidence,
        too_high=optimality.chi_square.reading == "too high",
        estimate=estimate,
    )


def smooth_on_scans(log: Log, motion: ScanMotion, run: EkfRun) -> tuple[SmootherEvidence, Estimate]:
    """Solve with the scans' motion and the EKF's association and ids. Raises InputError.

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
    closed = loop_closer(motion.options).close(problem, motion.clouds(timeline.epoch_time_s))
    result = smooth(replace(problem, loop_closures=closed.loop_closures), {})
    ids = run.estimate.landmark_id[used]
    estimate = smoothed_estimate(result, timeline.epoch_time_s, ids, "the EKF's")
    return result, estimate


def _fused(run: EkfRun) -> Positions | None:
    """The positions that the filter was given and accepted."""
    given, rows = run.positions, run.fix_number
    if given is None or not len(rows):
        return None
    return given.chosen(rows)
