"""The scan front end alone: odometry from scans, loop closure, and the graph of both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from comparisons.adapters.motion import motion_between
from comparisons.adapters.scan_odometry import ScanMotion, run_scan_odometry
from comparisons.adapters.scan_source import CloudsAt
from comparisons.adapters.smoother_input import assemble, position_rows, smoothed_estimate
from comparisons.arrays import Array
from comparisons.checks.accuracy import Accuracy, AccuracyFinding
from comparisons.checks.check import Answers, FromJob, Question
from comparisons.checks.finding import JobPart
from comparisons.checks.registry import BASIS, CHECKS
from comparisons.checks.smoother import AboutSmoother
from comparisons.config import EkfConfig, OdometryConfig
from comparisons.estimates.estimate import Estimate
from comparisons.extensions.scan_motion.increments import IncrementCheck, check_increments
from comparisons.extensions.scan_motion.log_by_scans import (
    divide,
    measurements_kept,
    with_scan_motion,
)
from comparisons.extensions.scan_motion.result import (
    LoopResult,
    ScanOdometryFinding,
    scan_odometry_result,
)
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.transforms.known_landmarks import SURVEYED, indices_by_label
from comparisons.pipeline.clock import Progress, no_progress
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepare import prepare
from comparisons.pipeline.prepared import Prepared
from comparisons.shown import Shown
from graphslam.increments import dead_reckoned
from graphslam.scan.loop_closure import Closed, LoopCloser, NoLoopClosure, loop_closer
from graphslam.scan.matchers import MATCHERS
from graphslam.scan.points import placed
from graphslam.smoother import SmootherEvidence, smooth


@dataclass(frozen=True, kw_only=True)
class FrontEnd(Shown):
    """Hold what the scans of a log say of the vehicle's motion.

    Attributes:
        prepared: The log as it was read, and the configuration.
        motion: Scan odometry, chained from its own origin.
        time_s: (K,) of the poses.
        odometry: (K, 3) poses by scan odometry, from the log's prior.
        wheels: (K, 3) poses by the wheels alone, from the log's prior; None without odometry.
        closed: The loop closures, and all that were tried.
        graph: The smoothed scan pose graph.
        estimate: The graph's trajectory, and landmarks where they are labelled or surveyed.
        clouds: The points of each scan, by the index of its pose.
        increments: Scan odometry against the wheels; None without odometry.
        answers: Of the checks on the graph's optimum, when they are asked for.
    """

    prepared: Prepared[OdometryConfig]
    motion: ScanMotion
    time_s: Array
    odometry: Array
    wheels: Array | None
    closed: Closed
    graph: SmootherEvidence
    estimate: Estimate
    clouds: CloudsAt
    increments: IncrementCheck | None
    answers: Answers

    def __repr__(self) -> str:
        """Return log and counts in one line."""
        return f"<FrontEnd of {self.log.name}: {len(self.time_s):,} poses by scans>"

    @property
    def log(self) -> Log:
        """The log as it was read, surveyed landmarks' measurements among the others."""
        return self.prepared.log

    @property
    def known(self) -> Known:
        """What is known of the graph's optimum, with what the checks find."""
        return self.answers.known

    @property
    def accuracy(self) -> Mapping[str, Accuracy | None]:
        """Errors by truth or positions of `scan graph`, `scans` and `wheels`; none without."""
        return self.known.value(AccuracyFinding) or {}

    @cached_property
    def _points(self) -> Array:
        return placed(list(self.clouds.values()), self.estimate.pose[list(self.clouds)])

    def map_points(self) -> Array:
        """Return what the scans saw, placed by the graph's poses.

        Returns:
            (P, 3) points [m] in the log's frame.
        """
        return self._points


def run_front_end(
    log: Log, config: OdometryConfig | None = None, progress: Progress = no_progress
) -> FrontEnd:
    """Odometry, loops, graph, and how good they are. Raises InputError."""
    config = config or OdometryConfig()
    how, labelled = config.front_end, log.measurements.labelled
    ekf = EkfConfig(association="known" if labelled else "nn", gps=how.gps)
    prepared = prepare(log, config, ekf, progress)
    log, clock = prepared.log, prepared.clock
    with clock.stage("odometry"):
        motion = run_scan_odometry(
            log, progress=prepared.stage_progress("scan odometry"), guess=how.guess == "wheels"
        )
    with clock.stage("loops"):
        named = _with_named_measurements(log, motion, labelled=labelled)
        scanned = replace(prepared, log=with_scan_motion(named, motion, positions=how.gps != "off"))
        landmark_index, ids = indices_by_label(scanned.log)
        timeline = scanned.timeline
        rows = position_rows(timeline, scanned.positions)
        problem = assemble(scanned.log, timeline, landmark_index, len(ids), rows)
        clouds = motion.clouds(timeline.epoch_time_s)
        closer: LoopCloser = NoLoopClosure()
        if how.loop_closure:
            closer = loop_closer(
                motion.options,
                None if how.matcher == "surface" else MATCHERS[how.matcher](),
                prepared.stage_progress("loop closure"),
            )
        closed = closer.close(problem, clouds)
    with clock.stage("graph"):
        progress("graph", 0, 0)
        graph = smooth(replace(problem, loop_closures=closed.loop_closures), {})
        estimate = smoothed_estimate(graph, timeline.epoch_time_s, ids, "the log's labels")
    odometry = dead_reckoned(problem.prior_pose, problem.increment)
    wheels = None
    if len(log.odometry.time_s):
        wheels = dead_reckoned(problem.prior_pose, _driven(log, motion, timeline.epoch_time_s))
    increments = check_increments(motion, log)
    scans = scan_odometry_result(motion, seconds=clock.seconds["odometry"])
    loops = LoopResult.of(closed)
    tried = f"{loops.closed} closed of {loops.tried} tried"
    checks: tuple[Question[Known], ...] = (
        *BASIS,
        FromJob("scans", ScanOdometryFinding(scans, increments)),
        FromJob("loops", JobPart("loops", loops, ("loops", tried))),
        AboutSmoother("graph"),
        *CHECKS,
    )
    known = Known(
        prepared=scanned,
        source=log,
        solved=(graph, estimate),
        landmark_index=landmark_index,
        timeline=timeline,
        positions=scanned.positions,
        called="scan graph",
        ways={"scans": odometry} | ({} if wheels is None else {"wheels": wheels}),
    )
    return FrontEnd(
        prepared=prepared,
        motion=motion,
        time_s=timeline.epoch_time_s,
        odometry=odometry,
        wheels=wheels,
        closed=closed,
        graph=graph,
        estimate=estimate,
        clouds=clouds,
        increments=increments,
        answers=Answers(known, checks),
    )


def _driven(log: Log, motion: ScanMotion, time_s: Array) -> Array:
    """(K - 1, 3) by the wheels between times (K,), all those of the scans among them.

    Relative poses are known at the scans, but not in between, where the motion is taken as even.
    """
    if not isinstance(log.odometry, RelativePoses):
        return motion_between(log, time_s[1:]).displacement
    knots = np.union1d(time_s[:1], motion.time_s)
    return divide(motion_between(log, knots[1:]), knots, time_s).displacement


def _with_named_measurements(log: Log, motion: ScanMotion, *, labelled: bool) -> Log:
    """The log with the measurements that the graph can use, which may be none.

    Those of surveyed landmarks name theirs, and all others do when the log is labelled.
    """
    named = np.full(len(log.measurements.time_s), labelled) | (
        log.measurements.landmark >= SURVEYED
    )
    if not (named & measurements_kept(log, motion)).any():
        named[:] = False
    return replace(log, measurements=log.measurements.chosen(named))
