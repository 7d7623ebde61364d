"""The smoother alone: one log to its optimum, without a filter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import EkfChoices, fused_positions, judging_positions
from comparisons.adapters.smoother_association import associate_own
from comparisons.adapters.smoother_input import assemble, position_rows, smoothed_estimate
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.accuracy import Accuracy, assess, assess_trajectory
from comparisons.checks.association import AssociationScore, score_association
from comparisons.clock import Clock
from comparisons.errors import InputError
from comparisons.estimates.estimate import Array, Estimate
from comparisons.logs.log import Log
from comparisons.logs.transforms.known_landmarks import join_known_sightings, slots_by_label
from graphslam.increments import dead_reckoned
from graphslam.smoother import SmootherOptions, SmootherResult, smooth

Index = NDArray[np.intp]


@dataclass(frozen=True)
class Solution:
    """What the smoother found.

    slot: (M,) landmark of each of the log's sightings, negative where unused. association: how it
    compares with the log's labels, when it was made without them.
    """

    log: Log
    association_by: str
    gps: str
    slot: Index
    result: SmootherResult
    estimate: Estimate
    dead_reckoned: Array
    accuracy: Accuracy | None
    accuracy_dead_reckoned: Accuracy | None
    association: AssociationScore | None
    seconds: dict[str, float]


def solve_log(
    log: Log,
    association: str | None = None,
    gps: str = "off",
    options: SmootherOptions | None = None,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> Solution:
    """Associate, solve and assess.

    association: `known` by the log's labels, `own` by the smoother's reasoning; None for whichever
    the log allows. gps: `off`, `on` or `half`. Raises InputError for what the log cannot serve,
    and graphslam.marginals.SingularProblemError when there is no solution.
    """
    name = association or ("known" if log.sightings.labelled else "own")
    if name not in ("known", "own"):
        raise InputError(f"association '{name}' is unknown, expected known or own")
    if not len(log.odometry.time_s):
        raise InputError(f"{log.name}: holds no odometry; use slamcheck odometry for its scans")
    given = EkfChoices(association="known" if name == "known" else "nn", gps=gps).settle(log)
    log = join_known_sightings(log)
    positions = fused_positions(log, given)
    timeline = build_timeline(log, positions)
    clock = Clock()
    guesses = {}
    with clock.stage("association"):
        rows = position_rows(timeline, positions)
        if name == "own":
            progress("association", 0, 0)
            own = associate_own(log, timeline, rows)
            slot, problem = own.slot, own.problem
            ids = np.arange(problem.landmark_count)
            guesses["association"] = (own.poses, own.landmarks)
        else:
            slot, ids = slots_by_label(log)
            problem = assemble(log, timeline, slot, len(ids), *rows)
    if not len(ids):
        raise InputError(f"{log.name}: no sighting could be used, so there is no map to solve for")
    with clock.stage("smoother"):
        result = smooth(problem, guesses, lambda stage: progress(stage, 0, 0), options)
    with clock.stage("marginals"):
        progress("marginals", 0, 0)
        estimate = smoothed_estimate(result, timeline.epoch_time_s, ids, name)
    reckoned = dead_reckoned(problem.prior_pose, problem.increment)
    judged = replace(log, positions=judging_positions(log, given))
    labelled = name == "known"
    return Solution(
        log,
        name,
        gps,
        slot,
        result,
        estimate,
        reckoned,
        assess(estimate, judged, labelled=labelled),
        assess_trajectory(timeline.epoch_time_s, reckoned, judged),
        None if labelled else score_association(slot, result.landmarks, log),
        clock.seconds,
    )
