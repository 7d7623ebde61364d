"""Other smoothers beside the one that follows the filter.

With its own association, with its own matcher of scan landmarks, or on scans.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.scan_odometry import ScanMotion
from comparisons.adapters.smoother_association import associate_own
from comparisons.adapters.smoother_input import position_rows, smoothed_estimate
from comparisons.checks.accuracy import assess
from comparisons.checks.association import score_association
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.extensions.own_association.check import OwnAssociationCheck, check_own_association
from comparisons.extensions.own_matching.check import OwnMatchingCheck, check_own_matching
from comparisons.extensions.own_matching.source import own_sightings
from comparisons.extensions.scan_landmarks.source import ScanSlamSource
from comparisons.extensions.scan_motion.smoother import smooth_on_scans
from comparisons.extensions.scan_motion.three_way import (
    ThreeWay,
    compare_maps,
    find_culprit,
    readable,
)
from comparisons.logs.log import Log
from ekf_reference.association import DYNAMIC
from graphslam.scan.loop_closure import loop_closer
from graphslam.smoother import SmootherOptions, SmootherResult, smooth


def with_own_association(
    log: Log, judged: Log, run: EkfRun, smoothed: Estimate, options: SmootherOptions
) -> OwnAssociationCheck:
    """Associate without the filter, solve, assess, and compare with what its association gave.

    Only points are associated anew: sightings of landmarks with a direction stay as they are.
    """
    rows = position_rows(run.timeline, run.positions)
    moving = np.flatnonzero(run.slot == DYNAMIC)
    found = associate_own(log, run.timeline, rows, moving)
    if not found.problem.landmark_count:
        raise InputError(f"{log.name}: the smoother's own association found no landmark")
    problem = replace(found.problem, oriented=run.oriented)
    result = smooth(problem, {"association": (found.poses, found.landmarks)}, options=options)
    ids = np.arange(found.problem.landmark_count)
    estimate = smoothed_estimate(result, run.timeline.epoch_time_s, ids, "its own")
    return check_own_association(
        log.sightings,
        run.timeline.sighting_epoch,
        run.slot,
        found.slot,
        smoothed,
        estimate,
        result.proof,
        assess(estimate, judged, labelled=False),
        score_association(found.slot, result.landmarks, log),
    )


def with_own_matching(
    log: Log,
    judged: Log,
    run: EkfRun,
    slam: ScanSlamSource,
    smoothed: Estimate,
    options: SmootherOptions,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> OwnMatchingCheck:
    """See the scan landmarks anew, solve, assess, and compare with the filter's alignments.

    Its sightings take the place of the filter's, so that no scan counts twice.
    """
    problem, found = own_sightings(log, run, slam.found.begun, progress)
    result = smooth(problem, {}, options=options)
    ids = run.estimate.landmark_id
    estimate = smoothed_estimate(result, run.timeline.epoch_time_s, ids, "the EKF's")
    return check_own_matching(
        run.oriented,
        found.alignments,
        run.estimate,
        smoothed,
        estimate,
        result.proof,
        assess(estimate, judged, labelled=False),
        found.reasons,
    )


def with_scans(
    log: Log,
    judged: Log,
    motion: ScanMotion,
    run: EkfRun,
    wheels: SmootherResult,
    smoothed: Estimate,
) -> ThreeWay:
    """Solve with the scans' motion, and hold both estimates on wheels against that."""
    closer = loop_closer(motion.options)
    scans = smooth_on_scans(log, motion, run, closer, SmootherOptions())
    accuracy = assess(scans.estimate, judged, labelled=False)
    ekf, smoother = (compare_maps(own, scans.estimate) for own in (run.estimate, smoothed))
    proof = readable(scans.result)
    culprit, evidence = "", "the maps agree"
    if not (ekf.agrees and smoother.agrees):
        culprit, evidence = find_culprit(
            readable(wheels),
            proof,
            assess(smoothed, judged, labelled=False),
            accuracy,
        )
    return ThreeWay(
        scans.estimate,
        scans.result.proof,
        proof.chi_square,
        accuracy,
        ekf,
        smoother,
        scans.loops,
        culprit,
        evidence,
    )
