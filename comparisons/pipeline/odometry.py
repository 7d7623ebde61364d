"""The scan front end alone: odometry from scans, loop closure, and the graph of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from comparisons.adapters.ekf_factory import EkfChoices, fused_positions, judging_positions
from comparisons.adapters.motion import motion_between
from comparisons.adapters.scan_odometry import ScanMotion, run_scan_odometry
from comparisons.adapters.scan_source import CloudsAt
from comparisons.adapters.smoother_input import assemble, position_rows, smoothed_estimate
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.accuracy import Accuracy, assess, assess_trajectory
from comparisons.clock import Clock
from comparisons.errors import InputError
from comparisons.estimates.estimate import Array, Estimate
from comparisons.extensions.scan_motion.increments import IncrementCheck, check_increments
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.transforms.known_landmarks import (
    SURVEYED,
    join_known_sightings,
    slots_by_label,
)
from comparisons.logs.transforms.scan_motion import divide, sightings_kept, with_scan_motion
from graphslam.increments import dead_reckoned
from graphslam.scan.loop_closure import (
    Closed,
    LoopCloser,
    NoLoopClosure,
    loop_closer,
)
from graphslam.scan.matchers import MATCHERS
from graphslam.scan.points import placed
from graphslam.smoother import SmootherResult, smooth

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class FrontEndChoices:
    """How to go about it.

    guess: begin alignments from the wheels' motion. loops: close loops. gps: `off`, `on` or
    `half`, as of the other commands. matcher: of MATCHERS, for loops.
    """

    guess: bool = True
    loops: bool = True
    gps: str = "off"
    matcher: str = "surface"


@dataclass(frozen=True)
class FrontEnd:
    """What the scans of a log say.

    motion: scan odometry, chained from its own origin. odometry, wheels: (K, 3) poses at time_s by
    scan odometry and by the wheels alone, from the log's prior; wheels None without odometry.
    graph: the smoothed scan pose graph; estimate: its trajectory, and landmarks if labelled or
    surveyed.
    """

    log: Log
    choices: FrontEndChoices
    motion: ScanMotion
    time_s: Array
    odometry: Array
    wheels: Array | None
    closed: Closed
    graph: SmootherResult
    estimate: Estimate
    clouds: CloudsAt
    increments: IncrementCheck | None
    accuracy_wheels: Accuracy | None
    accuracy_odometry: Accuracy | None
    accuracy_graph: Accuracy | None
    seconds: dict[str, float]

    def map_points(self) -> Array:
        """(P, 3) what the scans saw, placed by the graph."""
        return placed(list(self.clouds.values()), self.estimate.pose[list(self.clouds)])


def run_front_end(
    log: Log,
    choices: FrontEndChoices | None = None,
    progress: Progress = lambda stage, done, total: None,
) -> FrontEnd:
    """Odometry, loops, graph, and how good they are. Raises InputError."""
    choices = choices or FrontEndChoices()
    if choices.matcher not in MATCHERS:
        raise InputError(
            f"matcher '{choices.matcher}' is unknown, expected one of {', '.join(MATCHERS)}"
        )
    labelled = log.sightings.labelled
    given = EkfChoices(association="known" if labelled else "nn", gps=choices.gps).settle(log)
    log = join_known_sightings(log)
    clock = Clock()
    with clock.stage("odometry"):
        motion = run_scan_odometry(
            log, progress=lambda k, n: progress("scan odometry", k, n), guess=choices.guess
        )
    with clock.stage("loops"):
        named = _with_named_sightings(log, motion, labelled=labelled)
        scanned = with_scan_motion(named, motion, positions=choices.gps != "off")
        positions = fused_positions(scanned, given)
        timeline = build_timeline(scanned, positions)
        slot, ids = slots_by_label(scanned)
        rows = position_rows(timeline, positions)
        problem = assemble(scanned, timeline, slot, len(ids), *rows)
        clouds = motion.clouds(timeline.epoch_time_s)
        closer: LoopCloser = NoLoopClosure()
        if choices.loops:
            closer = loop_closer(
                motion.options,
                None if choices.matcher == "surface" else MATCHERS[choices.matcher](),
                lambda k, n: progress("loop closure", k, n),
            )
        closed = closer.close(problem, clouds)
    with clock.stage("graph"):
        progress("graph", 0, 0)
        graph = smooth(replace(problem, closures=closed.closures), {})
        estimate = smoothed_estimate(graph, timeline.epoch_time_s, ids, "the log's labels")
    odometry = dead_reckoned(problem.prior_pose, problem.increment)
    wheels = None
    if len(log.odometry.time_s):
        wheels = dead_reckoned(problem.prior_pose, _driven(log, motion, timeline.epoch_time_s))
    # Fused ones are counted among those that the scans reach.
    judged = replace(log, positions=judging_positions(scanned if positions else log, given))
    return FrontEnd(
        log,
        choices,
        motion,
        timeline.epoch_time_s,
        odometry,
        wheels,
        closed,
        graph,
        estimate,
        clouds,
        check_increments(motion, log),
        None if wheels is None else assess_trajectory(timeline.epoch_time_s, wheels, judged),
        assess_trajectory(timeline.epoch_time_s, odometry, judged),
        assess(estimate, judged, labelled=labelled),
        clock.seconds,
    )


def _driven(log: Log, motion: ScanMotion, time_s: Array) -> Array:
    """(K - 1, 3) by the wheels between times (K,), all those of the scans among them.

    Relative poses are known at the scans, but not in between, where the motion is taken as even.
    """
    if not isinstance(log.odometry, RelativePoses):
        return motion_between(log, time_s[1:]).displacement
    knots = np.union1d(time_s[:1], motion.time_s)
    return divide(motion_between(log, knots[1:]), knots, time_s).displacement


def _with_named_sightings(log: Log, motion: ScanMotion, *, labelled: bool) -> Log:
    """The log with the sightings that the graph can use, which may be none.

    Those of surveyed landmarks name theirs, and all others do when the log is labelled.
    """
    named = np.full(len(log.sightings.time_s), labelled) | (log.sightings.landmark >= SURVEYED)
    if not (named & sightings_kept(log, motion)).any():
        named[:] = False
    return replace(log, sightings=log.sightings.chosen(named))
